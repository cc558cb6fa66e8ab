//! Multi-view stereo: depth from the photos of several cameras, before any light is known.
//!
//! * [`camera`], [`rectify`]: pinholes, the warp between two of them, and lens distortion.
//! * [`level`], [`between_levels`], [`spread`]: photos cropped to the object, at every resolution.
//! * [`sightings`]: the other views that see a point.
//! * [`sampling`], [`window`]: interpolation in rasters, smoothing inside a mask, crops and block means.
//! * [`hull`], [`patch_cost`], [`patchmatch`], [`search`]: dense search inside the visual hull.
//! * [`start`], [`edges`], [`plate`]: what the views agree on, continued over their masks.
//! * [`searched_depths`]: the slow part of a surface's error, which searches of single views show together.
//! * [`stored`], [`tile`]: fine levels out of core, and parts of them, for what is local there.
//! * [`openness`]: the share of its light that the relief around a pixel leaves it.
//! * [`specks`]: pixels whose normals stand out from all around them.
//! * [`gains`]: exposure of the photos, and how far they disagree.
//! * [`surfaces`], [`consensus`]: the views' surfaces compared with each other, and their fusion.
//!
//! Depth `z` is along the optical axis, `ζ = ln z`; per-pixel lists hold a value for every masked pixel of a
//! view, in the order of its [`PixelNumbering`](rilievo_numerics::plate_system::PixelNumbering). A pixel's
//! relative footprint is one over the focal length. Shared by stages 3 (anchors) and 5.

pub mod between_levels;
pub mod camera;
pub mod consensus;
pub mod edges;
pub mod gains;
pub mod hull;
pub mod level;
pub mod openness;
pub mod patch_cost;
pub mod patchmatch;
pub mod plate;
pub mod rectify;
pub mod sampling;
pub mod search;
pub mod searched_depths;
pub mod sharpness;
pub mod sightings;
pub mod specks;
pub mod spread;
pub mod start;
pub mod stored;
#[cfg(test)]
mod stored_tests;
pub mod surfaces;
pub mod tile;
pub mod window;
