//! Opening a run directory, and finding its way back from an interrupted commit.

use super::error::StoreError;
use super::evaluation::drop_evaluation;
use super::files::{WRITING, create_folder, own_file, own_folder, write_atomically};
use super::lock::Lock;
use super::manifest::Manifest;
use super::places::{Places, delete_empty, delete_folders};
use super::run_file::RunFile;
use super::writer::StageWriter;
use rilievo_scene::StageId;
use serde::Serialize;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};

/// Folders beside those of the stages.
const FOLDERS: [&str; 7] = [
    ".work",
    ".old",
    "evaluation",
    "masks",
    "masks-overlays",
    "masks-unsure",
    "masks.partial",
];

/// File by which processes check that they see the same run directory.
const MARKER: &str = ".work/ranks";

/// A run directory, locked when it was opened for work.
#[derive(Debug)]
pub struct RunDir {
    root: PathBuf,
    /// Held for its `Drop`.
    _lock: Option<Lock>,
}

impl RunDir {
    /// Opens a run directory for work, creating it when the folder is absent or empty. One whose
    /// `run.json` is damaged or gone is opened too if a stage's manifest shows that it is ours: what
    /// is asked for is written anew.
    ///
    /// # Errors
    /// When it belongs to another program or version, is in use, or cannot be written.
    pub fn create_or_open(root: &Path) -> Result<Self, StoreError> {
        if RunFile::marks(root) {
            return match Self::open(root) {
                Err(StoreError::DamagedRequest { .. }) if holds_results(root) => Self::lock(root),
                opened => opened,
            };
        }
        if root.exists() && !holds_results(root) {
            let mut entries = std::fs::read_dir(root).map_err(StoreError::files("read", root))?;
            // A lock and a half-written file are what a process leaves that dies right after
            // creating the folder.
            let foreign = entries.any(|entry| {
                entry.map_or(true, |entry| {
                    let name = entry.file_name();
                    let name = name.to_string_lossy();
                    name != ".lock" && !name.starts_with(WRITING)
                })
            });
            if foreign {
                return Err(StoreError::NotARun {
                    path: root.to_path_buf(),
                });
            }
        }
        create_folder(root)?;
        Self::lock(root)
    }

    /// Whether what was asked for has been written into it yet.
    pub fn is_new(&self) -> bool {
        !RunFile::marks(&self.root)
    }

    /// Opens an existing run directory for work.
    ///
    /// # Errors
    /// When there is none, it is of another version, or in use.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_to_read(root)?;
        Self::lock(root)
    }

    fn lock(root: &Path) -> Result<Self, StoreError> {
        own_places(root)?;
        let run = Self {
            root: root.to_path_buf(),
            _lock: Some(Lock::take(root)?),
        };
        run.recover()?;
        Ok(run)
    }

    /// Opens an existing run directory without the right to change it.
    ///
    /// # Errors
    /// When there is none, or it is of another version.
    pub fn open_to_read(root: &Path) -> Result<Self, StoreError> {
        let run = Self {
            root: root.to_path_buf(),
            _lock: None,
        };
        run.read_run_file()?;
        own_places(root)?;
        Ok(run)
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Folder of a committed stage.
    pub fn stage_dir(&self, stage: StageId) -> PathBuf {
        Places::of(&self.root, stage).result
    }

    /// Manifest of a committed stage; `None` when the stage has none.
    ///
    /// # Errors
    /// When it cannot be read, is damaged, or is of another version.
    pub fn manifest(&self, stage: StageId) -> Result<Option<Manifest>, StoreError> {
        Manifest::read(&self.stage_dir(stage))
    }

    /// What was asked for.
    ///
    /// # Errors
    /// When it is absent, damaged, or of another version.
    pub fn read_run_file(&self) -> Result<RunFile, StoreError> {
        match RunFile::read(&self.root) {
            Err(StoreError::Missing { path, .. }) => Err(StoreError::Missing {
                holds_results: holds_results(&path),
                path,
            }),
            read => read,
        }
    }

    /// Writes what is asked for; untouched where it says the same already.
    pub fn write_run_file(&self, request: &impl Serialize) -> Result<(), StoreError> {
        RunFile::write(&self.root, request)
    }

    /// Writes a marker that no other run directory has, so that other processes can check that they
    /// see this one.
    pub fn mark(&self) -> Result<String, StoreError> {
        let path = self.root.join(MARKER);
        create_folder(&self.root.join(".work"))?;
        // The keys of a new hasher are random: so is its hash of nothing.
        let marker = format!("{:016x}", RandomState::new().build_hasher().finish());
        write_atomically(&path, marker.as_bytes())?;
        Ok(marker)
    }

    /// The marker that a process finds in a run directory; `None` where there is none.
    pub fn marker(root: &Path) -> Result<Option<String>, StoreError> {
        let found = own_file(&root.join(MARKER))?;
        Ok(found.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()))
    }

    /// Takes the marker away.
    pub fn unmark(&self) -> Result<(), StoreError> {
        let path = self.root.join(MARKER);
        std::fs::remove_file(&path).map_err(StoreError::files("delete", &path))?;
        // Fails where a stage has something there, as it should.
        let _ = std::fs::remove_dir(self.root.join(".work"));
        Ok(())
    }

    /// Takes part in a stage that the owner of the run directory has begun: what is written goes to its work folder.
    pub fn take_part(&self, stage: StageId) -> StageWriter {
        StageWriter::take_part(&self.root, stage)
    }

    /// Starts a stage: its files go to a work folder until they are committed.
    pub fn begin(&self, stage: StageId) -> Result<StageWriter, StoreError> {
        StageWriter::begin(&self.root, stage)
    }

    /// The folder of work in progress, for working data that belongs to no stage.
    pub fn work_folder(&self) -> Result<PathBuf, StoreError> {
        let folder = self.root.join(".work");
        create_folder(&folder)?;
        Ok(folder)
    }

    /// Deletes a stage's results, and an evaluation of them.
    pub fn clean(&self, stage: StageId) -> Result<bool, StoreError> {
        let Places {
            result,
            old,
            work,
            previous,
        } = Places::of(&self.root, stage);
        let found = delete_folders(&[&result, &work, &previous, &old])?;
        if found {
            drop_evaluation(&self.root)?;
        }
        Ok(found)
    }

    /// A commit moves the old result aside before the new one takes its name; put the old one
    /// back where the program died in between. Half-written files go.
    fn recover(&self) -> Result<(), StoreError> {
        let entries =
            std::fs::read_dir(&self.root).map_err(StoreError::files("read", &self.root))?;
        for entry in entries.flatten() {
            if entry.file_name().to_string_lossy().starts_with(WRITING) {
                let path = entry.path();
                std::fs::remove_file(&path).map_err(StoreError::files("delete", &path))?;
            }
        }
        for stage in StageId::ALL {
            let Places { result, old, .. } = Places::of(&self.root, stage);
            if result.exists() {
                delete_folders(&[&old])?;
            } else if old.exists() {
                std::fs::rename(&old, &result).map_err(StoreError::files("rename", &old))?;
            }
        }
        delete_empty(&self.root);
        Ok(())
    }

    /// Deletes what a stopped run left of a stage whose results are valid: it belongs to another request, and
    /// takes space.
    pub fn drop_unfinished(&self, stage: StageId) -> Result<(), StoreError> {
        let Places { work, previous, .. } = Places::of(&self.root, stage);
        delete_folders(&[&work, &previous])?;
        delete_empty(&self.root);
        Ok(())
    }
}

/// Whether a stage was committed in a folder.
fn holds_results(root: &Path) -> bool {
    StageId::ALL
        .into_iter()
        .any(|stage| matches!(Manifest::read(&root.join(stage.name())), Ok(Some(_))))
}

/// Refuses a run directory in which something else stands in the place of one of its folders or of
/// the lock: work in it would change what is not the run's.
fn own_places(root: &Path) -> Result<(), StoreError> {
    for folder in FOLDERS {
        own_folder(&root.join(folder))?;
    }
    for stage in StageId::ALL {
        Places::of(root, stage).check()?;
    }
    own_file(&root.join(".lock")).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_newer_and_absent_folders_are_told_apart() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("run");
        assert!(matches!(
            RunDir::open_to_read(&root),
            Err(StoreError::Missing { .. })
        ));
        let run = RunDir::create_or_open(&root).unwrap();
        run.write_run_file(&"asked").unwrap();
        assert!(matches!(RunDir::open(&root), Err(StoreError::InUse { .. })));
        drop(run);
        assert!(RunDir::open(&root).is_ok());

        for file in ["run.json", ".run.json"] {
            let newer = r#"{"program": "rilievo", "format_version": 99}"#;
            std::fs::write(root.join(file), newer).unwrap();
        }
        assert!(matches!(
            RunDir::create_or_open(&root),
            Err(StoreError::OtherVersion { found: 99, .. })
        ));

        let half = dir.path().join("half");
        std::fs::create_dir(&half).unwrap();
        for left in [".lock", ".writing-x7"] {
            std::fs::write(half.join(left), "").unwrap();
        }
        assert!(RunDir::create_or_open(&half).unwrap().is_new());
        assert!(!half.join(".writing-x7").exists());

        let other = dir.path().join("other");
        std::fs::create_dir(&other).unwrap();
        std::fs::write(other.join("letter.txt"), "x").unwrap();
        assert!(matches!(
            RunDir::create_or_open(&other),
            Err(StoreError::NotARun { .. })
        ));
    }
}
