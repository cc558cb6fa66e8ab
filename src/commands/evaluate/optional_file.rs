//! Files that a run or a truth may lack.

use crate::exit::Failure;
use rilievo_io::IoError;
use std::path::Path;

/// What a file holds; `None` where there is none.
pub(super) fn read_if_there<T>(
    path: &Path,
    read: impl FnOnce(&Path) -> Result<T, IoError>,
) -> Result<Option<T>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    read(path).map(Some).map_err(Failure::from)
}
