//! Content hashes of input files, remembered by size, date and inode.
//!
//! The hash decides, never the date: a touched file is read again and found unchanged.

use super::error::StoreError;
use super::fingerprint::hash_bytes;
use super::run_dir::write_atomically;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    size: u64,
    modified_ns: u128,
    inode: u64,
}

/// Content hashes by path.
#[derive(Debug)]
pub struct Contents {
    file: PathBuf,
    known: BTreeMap<PathBuf, (Stamp, String)>,
    changed: bool,
}

impl Contents {
    /// Hashes remembered in a run directory; none when it has none yet.
    pub fn load(run: &Path) -> Self {
        let file = run.join(".contents.json");
        // A lost or damaged memory only costs reading the files again.
        let known = std::fs::read(&file)
            .ok()
            .and_then(|text| serde_json::from_slice::<Vec<(PathBuf, (Stamp, String))>>(&text).ok())
            .unwrap_or_default();
        Self {
            file,
            known: known.into_iter().collect(),
            changed: false,
        }
    }

    /// Nothing remembered, nothing to be kept.
    pub fn without_memory() -> Self {
        Self {
            file: PathBuf::new(),
            known: BTreeMap::new(),
            changed: false,
        }
    }

    /// Content hash of a file.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn hash(&mut self, path: &Path) -> Result<String, StoreError> {
        let stamp = stamp(path).map_err(StoreError::files("read", path))?;
        if let Some((known, hash)) = self.known.get(path)
            && *known == stamp
        {
            return Ok(hash.clone());
        }
        let bytes = std::fs::read(path).map_err(StoreError::files("read", path))?;
        let hash = hash_bytes(&bytes);
        self.known.insert(path.to_path_buf(), (stamp, hash.clone()));
        self.changed = true;
        Ok(hash)
    }

    /// Writes the memory back when it changed.
    ///
    /// # Errors
    /// When the run directory cannot be written.
    pub fn save(&self) -> Result<(), StoreError> {
        if !self.changed {
            return Ok(());
        }
        let entries: Vec<_> = self.known.iter().collect();
        let text = serde_json::to_vec(&entries).unwrap_or_default();
        write_atomically(&self.file, &text)
    }
}

fn stamp(path: &Path) -> std::io::Result<Stamp> {
    let metadata = std::fs::metadata(path)?;
    let modified_ns = metadata
        .modified()?
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos());
    #[cfg(unix)]
    let inode = std::os::unix::fs::MetadataExt::ino(&metadata);
    #[cfg(not(unix))]
    let inode = 0;
    Ok(Stamp {
        size: metadata.len(),
        modified_ns,
        inode,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_date_keeps_the_hash_and_a_new_content_changes_it() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("photo.jpg");
        std::fs::write(&file, b"one").unwrap();
        let mut contents = Contents::load(dir.path());
        let first = contents.hash(&file).unwrap();
        contents.save().unwrap();

        let later = std::time::SystemTime::now() + std::time::Duration::from_secs(60);
        std::fs::File::open(&file)
            .unwrap()
            .set_modified(later)
            .unwrap();
        let mut contents = Contents::load(dir.path());
        assert_eq!(contents.hash(&file).unwrap(), first);

        std::fs::write(&file, b"two").unwrap();
        assert_ne!(contents.hash(&file).unwrap(), first);
        assert!(contents.hash(&dir.path().join("none")).is_err());
    }
}
