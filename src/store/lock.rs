//! One process at a time: an advisory lock that the system releases when its owner dies.

use super::error::StoreError;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;

/// Held while a process works in a run directory.
#[derive(Debug)]
pub struct Lock {
    file: File,
}

impl Lock {
    /// Takes the lock and writes this process's id into it. A dead owner's lock is free, because
    /// the system drops a lock with the process that holds it, however it ends.
    ///
    /// # Errors
    /// [`StoreError::InUse`] when a living process holds it.
    pub fn take(run: &Path) -> Result<Self, StoreError> {
        let path = run.join(".lock");
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(StoreError::files("open", &path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut owner = String::new();
                // The id is only reported; without it the lock still holds.
                let _ = file.read_to_string(&mut owner);
                let owner = owner.trim();
                return Err(StoreError::InUse {
                    path: run.to_path_buf(),
                    owner: if owner.is_empty() { "unknown" } else { owner }.to_owned(),
                });
            }
            Err(TryLockError::Error(error)) => return Err(StoreError::files("lock", &path)(error)),
        }
        file.set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| writeln!(file, "{}", std::process::id()))
            .map_err(StoreError::files("write", &path))?;
        Ok(Self { file })
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // The system releases the lock with the file; the stale id inside is never trusted.
        let _ = self.file.set_len(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_lock_names_its_owner_and_a_dropped_one_is_free() {
        let dir = tempfile::tempdir().unwrap();
        let held = Lock::take(dir.path()).unwrap();
        match Lock::take(dir.path()) {
            Err(StoreError::InUse { owner, .. }) => {
                assert_eq!(owner, std::process::id().to_string());
            }
            other => panic!("{other:?}"),
        }
        drop(held);
        assert!(Lock::take(dir.path()).is_ok());
    }

    #[test]
    fn a_file_left_by_a_dead_owner_does_not_block() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(".lock"), "999999\n").unwrap();
        assert!(Lock::take(dir.path()).is_ok());
    }
}
