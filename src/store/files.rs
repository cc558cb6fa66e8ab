//! Files that other people may have put there: a run directory may come from anywhere.
//!
//! Nothing inside a run directory is followed to another place: a link there could make the program
//! read, truncate or delete what is not the run's.

use super::error::StoreError;
use rilievo_io::{IoError, open_regular, read_regular};
use std::io::Write;
use std::io::{Error, ErrorKind};
use std::path::{Component, Path, PathBuf};

/// What the names of files begin with while they are written.
pub const WRITING: &str = ".writing-";

/// Hash of a file's content, in hexadecimal; the file is read piece by piece.
///
/// # Errors
/// When it cannot be read, or is no regular file.
pub fn hash_file(path: &Path) -> Result<String, IoError> {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_reader(open_regular(path)?)
        .map_err(|error| IoError::read(path, &error))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Content of a file of the run directory; `None` when it is not there.
///
/// # Errors
/// [`StoreError::NotOurs`] for a link or anything that is no file; when it cannot be read.
pub fn own_file(path: &Path) -> Result<Option<Vec<u8>>, StoreError> {
    match std::fs::symlink_metadata(path) {
        Err(error) if is_absent(&error) => return Ok(None),
        Err(error) => return Err(StoreError::files("read", path)(error)),
        Ok(found) if !found.is_file() => {
            return Err(StoreError::not_ours(path, "a file", &found));
        }
        Ok(_) => {}
    }
    Ok(Some(read_regular(path)?))
}

/// Refuses what stands in the place of a folder of the run directory.
///
/// # Errors
/// [`StoreError::NotOurs`] for a link or anything that is no folder.
pub fn own_folder(path: &Path) -> Result<(), StoreError> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.is_dir() => Err(StoreError::not_ours(path, "a folder", &found)),
        Err(error) if !is_absent(&error) => Err(StoreError::files("read", path)(error)),
        _ => Ok(()),
    }
}

/// Makes a folder with all above it, where it is not there.
pub fn create_folder(path: &Path) -> Result<(), StoreError> {
    std::fs::create_dir_all(path).map_err(StoreError::files("create", path))
}

/// A path from the root on, without looking whether it is there.
///
/// # Errors
/// When there is no working directory to start from, or no path at all.
pub fn absolute(path: &Path) -> Result<PathBuf, StoreError> {
    std::path::absolute(path).map_err(StoreError::files("find", path))
}

fn is_absent(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory)
}

/// Whether a relative path stays inside its folder.
pub fn is_inside(path: &str) -> bool {
    let mut parts = Path::new(path).components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

/// Whether a name can be a file's without its ending: it names results, so it may not lead elsewhere.
pub fn is_name(name: &str) -> bool {
    is_inside(name) && !name.contains(['/', '\0'])
}

/// Writes a file so that it is either the old one or the complete new one.
///
/// # Errors
/// When it cannot be written; the old file is then untouched.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let write = || -> std::io::Result<()> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(WRITING);
        // Temporary files are private by default; a result is as readable as the umask allows.
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = builder.tempfile_in(folder)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        file.persist(path)?;
        Ok(())
    };
    write().map_err(StoreError::files("write", path))
}
