//! Output of stage 5: depth and normals of every view.

use crate::ids::ViewIdx;
use crate::maps::{ConfidenceMap, DepthMap, NormalMap};
use crate::raster::LinearImage;

/// Dense shape of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadedView {
    /// The view.
    pub view: ViewIdx,
    /// The photo's name without ending.
    pub name: String,
    /// Depth, world's unit.
    pub depth: DepthMap,
    /// Normals, camera frame.
    pub normal: NormalMap,
    /// How well data determine each pixel, where it was computed.
    pub confidence: Option<ConfidenceMap>,
    /// The image that the result explains, linear.
    pub rendered: Option<LinearImage>,
    /// Albedo relative to the mean albedo contained in the lighting, where it was estimated.
    pub albedo: Option<LinearImage>,
}

/// Dense shape of all views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadedViews {
    /// One entry per view that was solved, ordered by view.
    pub views: Vec<ShadedView>,
}
