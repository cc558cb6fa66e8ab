//! Input of the solver: views with what is known of them, and matches between them.

use rilievo_scene::{DepthMap, Intrinsics, Lighting, LinearImage, Mask, Raster, RigidTransform};
use std::sync::Arc;

/// Lighting of one view, in its camera frame.
#[derive(Clone, Debug)]
pub enum ViewLight {
    /// One environment for all pixels.
    Uniform(Lighting),
    /// Nine coefficients per channel and pixel (occlusion and bounces folded in).
    PerPixel(PixelLighting),
}

/// Nine coefficients per channel for every pixel of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelLighting {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// 1 or 3.
    pub channels: usize,
    /// `height * width * channels * 9` coefficients, a pixel's together, channel by channel.
    pub coefficients: Arc<Vec<f32>>,
}

/// A depth known at one place of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthAnchor {
    /// Column and row, pixels.
    pub pixel: [f64; 2],
    /// Depth along the optical axis.
    pub depth: f64,
    /// Standard deviation of its logarithm.
    pub sigma_ln_depth: f64,
}

/// A measured depth map that is to be refined (RGB-D).
#[derive(Clone, Debug)]
pub struct DepthPrior {
    /// Measured depth; 0 where there is none.
    pub depth: DepthMap,
    /// Weight of the squared difference of log depths against shading's 1, intensities with white
    /// at 1 (the authors use 500).
    pub weight: f64,
}

/// One image with what is known of it.
#[derive(Clone, Debug)]
pub struct ShadingView {
    /// Name for messages and files.
    pub name: String,
    /// Linear image.
    pub image: Arc<LinearImage>,
    /// The object.
    pub mask: Mask,
    /// Camera; distortion must have been removed.
    pub intrinsics: Intrinsics,
    /// Lighting times mean albedo.
    pub lighting: ViewLight,
    /// Albedo relative to that contained in the lighting; `None` is 1 everywhere.
    pub albedo: Option<Arc<LinearImage>>,
    /// Weight of each pixel's shading term, 0 to leave it out; `None` is 1 everywhere.
    pub weights: Option<Raster<f32>>,
    /// Value at and above which a channel counts as clipped and is left out.
    pub clip_level: Option<f32>,
    /// Standard deviation of what the lighting leaves unexplained, as a share of the image's robust
    /// maximum, where it is known and larger than the options' noise.
    pub noise: Option<f64>,
    /// Start.
    pub initial_depth: Option<DepthMap>,
    /// Measured depth to stay near to.
    pub prior: Option<DepthPrior>,
    /// Depth anchors.
    pub anchors: Vec<DepthAnchor>,
    /// Pose, needed where matches tie the view to others.
    pub cam_from_world: Option<RigidTransform>,
}

impl ShadingView {
    /// A view with only what is always needed.
    pub fn new(
        name: impl Into<String>,
        image: Arc<LinearImage>,
        mask: Mask,
        intrinsics: Intrinsics,
        lighting: ViewLight,
    ) -> Self {
        Self {
            name: name.into(),
            image,
            mask,
            intrinsics,
            lighting,
            albedo: None,
            weights: None,
            clip_level: None,
            noise: None,
            initial_depth: None,
            prior: None,
            anchors: Vec::new(),
            cam_from_world: None,
        }
    }
}

/// Pixels of two views that see the same point.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewMatches {
    /// Indices into [`ShadingProblem::views`].
    pub views: [usize; 2],
    /// `[x1, y1, x2, y2]`, pixels.
    pub pixels: Vec<[f64; 4]>,
}

/// Views to be solved together.
#[derive(Clone, Debug, Default)]
pub struct ShadingProblem {
    /// The views.
    pub views: Vec<ShadingView>,
    /// Matches between them.
    pub matches: Vec<ViewMatches>,
}
