//! What the sphere's position and detection allow.

/// How spheres are located and found.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereOptions {
    /// Half width of the search for the photo's edge across a marked outline, pixels: how far off a
    /// mark may be. Too small misses the edge of a rough mark, too large finds other edges.
    pub search_px: f64,
    /// Without marks: largest relative residual of nine harmonics on a candidate's normals. Larger
    /// finds dirty spheres, and takes other round things for one.
    pub max_shading_residual: f64,
}

impl Default for SphereOptions {
    fn default() -> Self {
        Self {
            search_px: 4.0,
            max_shading_residual: 0.06,
        }
    }
}
