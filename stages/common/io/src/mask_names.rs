//! Mask names.

/// The mask among `mask_files` (file names, no folders) that belongs to a photo: `x.png`,
/// `x.jpg.png`, `x_mask.png` and their like.
pub fn find_mask<'a>(_photo_file_name: &str, _mask_files: &'a [String]) -> Option<&'a str> {
    None
}
