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
    /// How far each normal can be trusted, 0 to 1: one half where an error of five degrees is
    /// expected. Where it was computed.
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

/// Images of one view beside its maps, where there are any.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadedImages {
    /// The image that the result explains, linear.
    pub rendered: Option<LinearImage>,
    /// Albedo relative to the mean albedo contained in the lighting.
    pub albedo: Option<LinearImage>,
}

/// Gives the maps of a view when asked, so that a large set need not be in memory at once.
pub trait MapSource: Sync {
    /// Number of views.
    fn num_views(&self) -> usize;

    /// Loads the maps of a view, with depth 0 where they hold none, and without its images.
    ///
    /// # Errors
    /// When the backing store cannot be read.
    fn load(&self, idx: usize) -> Result<ShadedView, PixelError>;

    /// Loads the images of a view; the rendered one may be left out where there is an albedo.
    ///
    /// # Errors
    /// When the backing store cannot be read.
    fn images(&self, idx: usize) -> Result<ShadedImages, PixelError>;

    /// Pixels below which the maps hold no relief: 1, or more where it is known.
    fn resolved_px(&self) -> f64 {
        1.0
    }
}

impl ShadedViews {
    fn view(&self, idx: usize) -> Result<&ShadedView, PixelError> {
        self.views.get(idx).ok_or_else(|| PixelError {
            name: format!("view {idx}"),
            reason: format!("there are {} views", self.views.len()),
        })
    }
}

impl MapSource for ShadedViews {
    fn num_views(&self) -> usize {
        self.views.len()
    }

    fn load(&self, idx: usize) -> Result<ShadedView, PixelError> {
        let view = self.view(idx)?;
        Ok(ShadedView {
            view: view.view,
            name: view.name.clone(),
            depth: view.depth.clone(),
            normal: view.normal.clone(),
            confidence: view.confidence.clone(),
            rendered: None,
            albedo: None,
        })
    }

    fn images(&self, idx: usize) -> Result<ShadedImages, PixelError> {
        let view = self.view(idx)?;
        Ok(ShadedImages {
            rendered: view.rendered.clone(),
            albedo: view.albedo.clone(),
        })
    }
}
