//! Where the folders of a stage are in a run directory.

use super::error::StoreError;
use super::files::own_folder;
use rilievo_scene::StageId;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The folders of a stage, there or not.
#[derive(Debug)]
pub struct Places {
    /// The committed result.
    pub result: PathBuf,
    /// The result that a commit replaces, until it has.
    pub old: PathBuf,
    /// Work in progress.
    pub work: PathBuf,
    /// What an interrupted run left of it.
    pub previous: PathBuf,
}

impl Places {
    /// Those in a run directory.
    pub fn of(root: &Path, stage: StageId) -> Self {
        let (name, work) = (stage.name(), root.join(".work"));
        Self {
            result: root.join(name),
            old: root.join(".old").join(name),
            work: work.join(name),
            previous: work.join(format!("{name}.previous")),
        }
    }

    /// Refuses what stands in the place of one of them.
    pub fn check(&self) -> Result<(), StoreError> {
        let mut all = [&self.result, &self.old, &self.work, &self.previous].into_iter();
        all.try_for_each(|folder| own_folder(folder))
    }
}

/// Deletes folders with all in them; whether any was there.
pub fn delete_folders(folders: &[&Path]) -> Result<bool, StoreError> {
    let mut found = false;
    for folder in folders {
        match std::fs::remove_dir_all(folder) {
            Ok(()) => found = true,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(StoreError::files("delete", folder)(error)),
        }
    }
    Ok(found)
}

/// Deletes the folders that hold those of all stages, where they are empty.
pub fn delete_empty(root: &Path) {
    for folder in [".work", ".old"] {
        // Fails where another stage has something there, as it should.
        let _ = std::fs::remove_dir(root.join(folder));
    }
}
