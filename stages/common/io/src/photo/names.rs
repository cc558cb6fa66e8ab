//! Names of photos: which files are photos, and of which kind, by their endings.

use std::path::Path;

/// Endings of photos that can be decoded.
const PHOTO_ENDINGS: [&str; 12] = [
    "jpg", "jpeg", "jpe", "jfif", "png", "tif", "tiff", "exr", "hdr", "heic", "heif", "hif",
];

/// Endings of photos that people have and this program cannot decode.
pub(super) const FOREIGN_ENDINGS: [(&str, &str); 4] = [
    ("avif", "AVIF"),
    ("webp", "WebP"),
    ("jxl", "JPEG XL"),
    ("gif", "GIF"),
];

/// Endings of camera RAW files.
const RAW_ENDINGS: [&str; 21] = [
    "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "srf", "sr2", "raf", "rw2", "orf", "pef",
    "srw", "x3f", "3fr", "iiq", "mrw", "kdc", "dcr", "erf",
];

pub(super) fn ending(path: &Path) -> String {
    path.extension()
        .map(|ending| ending.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
}

/// Whether a file name has the ending of camera RAW.
pub(crate) fn is_raw_name(path: &Path) -> bool {
    RAW_ENDINGS.contains(&ending(path).as_str())
}

/// Whether a file name has the ending of a photo, be it one that can be decoded or one of a format
/// that is refused with advice (camera RAW, WebP).
pub fn is_photo_name(path: &Path) -> bool {
    let hidden = path
        .file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with('.'));
    let ending = ending(path);
    !hidden
        && (PHOTO_ENDINGS.contains(&ending.as_str())
            || RAW_ENDINGS.contains(&ending.as_str())
            || FOREIGN_ENDINGS.iter().any(|(name, _)| *name == ending))
}

/// A photo's file name, as results name it.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}
