//! Output of stage 5: depth and normals of every view.

use crate::ids::ViewIdx;
use crate::maps::{ConfidenceMap, DepthMap, NormalMap};
use crate::photos::PixelError;
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

/// Whether the images of a view are wanted beside its maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Images {
    /// Rendered image and albedo as well, where there are any.
    With,
    /// Depth, normals and confidence only.
    Without,
}

/// Gives the maps of a view when asked, so that a large set need not be in memory at once.
pub trait MapSource: Sync {
    /// Number of views.
    fn num_views(&self) -> usize;

    /// Loads the maps of a view, with depth 0 where they hold none.
    ///
    /// # Errors
    /// When the backing store cannot be read.
    fn load(&self, idx: usize, images: Images) -> Result<ShadedView, PixelError>;
}

impl MapSource for ShadedViews {
    fn num_views(&self) -> usize {
        self.views.len()
    }

    fn load(&self, idx: usize, images: Images) -> Result<ShadedView, PixelError> {
        let view = self.views.get(idx).ok_or_else(|| PixelError {
            name: format!("view {idx}"),
            reason: format!("there are {} views", self.views.len()),
        })?;
        let wanted = |image: &Option<LinearImage>| match images {
            Images::With => image.clone(),
            Images::Without => None,
        };
        Ok(ShadedView {
            view: view.view,
            name: view.name.clone(),
            depth: view.depth.clone(),
            normal: view.normal.clone(),
            confidence: view.confidence.clone(),
            rendered: wanted(&view.rendered),
            albedo: wanted(&view.albedo),
        })
    }
}
