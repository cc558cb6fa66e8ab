//! The photos of cameras whose format leaves out the images' size: found by name, measured by their
//! headers.

use crate::error::IoError;
use crate::files::{open_regular, read_regular_text};
use crate::photo::{decode_photo, is_raw_name, photo_size};
use std::path::{Path, PathBuf};

/// Endings that formats leave out.
const ENDINGS: [&str; 7] = ["", ".png", ".jpg", ".jpeg", ".JPG", ".tif", ".exr"];

/// What to try where a photo is not found.
const HINT: &str =
    "put the photos beside it, or say where they are: rilievo import FILE --photos DIR";

/// Folders that are looked through in turn.
pub(super) struct Photos {
    folders: Vec<PathBuf>,
}

impl Photos {
    /// The folder that the user names, then folders beside a file.
    pub(super) fn new(given: Option<&Path>, beside: &Path, inside: &[&str]) -> Self {
        let given = given.map(Path::to_path_buf);
        let inside = inside.iter().map(|name| beside.join(name));
        Self {
            folders: given.into_iter().chain(inside).collect(),
        }
    }

    pub(super) fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// The photo of a name, which may lack its ending.
    pub(super) fn find(&self, name: &str) -> Option<PathBuf> {
        self.folders.iter().find_map(|folder| {
            ENDINGS
                .iter()
                .map(|ending| folder.join(format!("{name}{ending}")))
                .find(|path| path.is_file())
        })
    }

    /// The refusal of a camera file where a photo is not there.
    pub(super) fn missing(&self, file: &Path, photo: &str) -> IoError {
        let folders: Vec<String> = self
            .folders
            .iter()
            .map(|folder| match folder.as_os_str().is_empty() {
                true => ".".to_owned(),
                false => folder.display().to_string(),
            })
            .collect();
        let reason = format!(
            "{photo} is not there; its size in pixels is needed, which this format leaves out (looked in {})",
            folders.join(", ")
        );
        IoError::input(file, reason).with_hint(HINT)
    }

    /// The photo of the first of its names that is there, or the refusal of the camera file.
    pub(super) fn named(&self, file: &Path, names: &[&str]) -> Result<PathBuf, IoError> {
        let found = names.iter().find_map(|name| self.find(name));
        found.ok_or_else(|| self.missing(file, &format!("the photo {}", names[0])))
    }
}

/// Number and name of each photo, by the list that this program writes beside the cameras: for
/// formats that know their photos by numbers alone.
pub(super) fn listed_names(list: &Path) -> Result<Vec<String>, IoError> {
    if !list.is_file() {
        return Ok(Vec::new());
    }
    let text = read_regular_text(list)?;
    let pairs = text.lines().filter_map(|line| line.split_once(' '));
    let names = pairs.map(|(_, name)| name.to_owned());
    Ok(names.filter(|name| !name.is_empty()).collect())
}

/// Columns and rows of a photo: by its header, or, where that describes a preview, by its pixels.
pub(super) fn size_of(path: &Path) -> Result<(usize, usize), IoError> {
    if let Some(size) = photo_size(path) {
        return Ok(size);
    }
    if is_raw_name(path) {
        let photo = decode_photo(path)?;
        return Ok((photo.width, photo.height));
    }
    // Why it cannot be opened, where that is the reason.
    open_regular(path)?;
    let reason = "its size cannot be read: it is no photo, or damaged";
    Err(IoError::input(path, reason))
}

/// The folder that a file is in.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}
