//! Working data of a stage in files without a name in its work folder: whatever stops the program, the system takes
//! them away.

use rilievo_scene::{Room, Scratch, ScratchError};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Room in files of a folder.
#[derive(Clone, Debug)]
pub struct FileScratch {
    folder: PathBuf,
}

impl FileScratch {
    /// Files in `folder`, which must exist.
    pub fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
        }
    }

    fn failed(folder: &Path, error: &io::Error) -> ScratchError {
        ScratchError {
            reason: format!("{}: {error}", folder.display()),
        }
    }
}

impl Scratch for FileScratch {
    fn room(&self) -> Result<Box<dyn Room>, ScratchError> {
        let file = tempfile::tempfile_in(&self.folder)
            .map_err(|error| Self::failed(&self.folder, &error))?;
        Ok(Box::new(FileRoom {
            file,
            folder: self.folder.clone(),
        }))
    }
}

#[derive(Debug)]
struct FileRoom {
    file: File,
    folder: PathBuf,
}

impl Room for FileRoom {
    fn write_at(&self, bytes: &[u8], place: u64) -> Result<(), ScratchError> {
        std::os::unix::fs::FileExt::write_all_at(&self.file, bytes, place)
            .map_err(|error| FileScratch::failed(&self.folder, &error))
    }

    fn read_at(&self, bytes: &mut [u8], place: u64) -> Result<(), ScratchError> {
        std::os::unix::fs::FileExt::read_exact_at(&self.file, bytes, place)
            .map_err(|error| FileScratch::failed(&self.folder, &error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_and_the_folder_stays_empty() {
        let dir = tempfile::tempdir().unwrap();
        let room = FileScratch::new(dir.path()).room().unwrap();
        room.write_at(&[1, 2, 3], 10).unwrap();
        let mut found = [0; 2];
        room.read_at(&mut found, 11).unwrap();
        assert_eq!(found, [2, 3]);
        assert!(room.read_at(&mut found, 12).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
