//! A photo's alpha channel as a mask.

use rilievo_scene::Mask;

/// The alpha channel as a mask; an alpha that is opaque everywhere marks nothing.
pub(super) fn alpha_mask(
    width: usize,
    height: usize,
    opaque: impl Iterator<Item = bool>,
) -> Option<Mask> {
    let data: Vec<bool> = opaque.collect();
    if data.iter().all(|&inside| inside) {
        return None;
    }
    Mask::from_vec(width, height, data)
}
