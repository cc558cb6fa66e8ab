//! The plane that a patch is taken for: inverse depth, affine in the pixel.

/// A plane through a reference pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PatchPlane {
    /// Column of the centre.
    pub x: usize,
    /// Row of the centre.
    pub y: usize,
    /// Inverse depth at the centre.
    pub q: f64,
    /// Change of the inverse depth per column.
    pub qx: f64,
    /// Change of the inverse depth per row.
    pub qy: f64,
}
