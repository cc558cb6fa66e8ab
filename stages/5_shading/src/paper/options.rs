//! Options of the paper's model.

use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{OptionError, in_range};
use serde::{Deserialize, Serialize};

/// How the non-linear shading term is separated from the integration of slopes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Splitting {
    /// The whole shading term on the slopes: constant z-step (default).
    #[default]
    Full,
    /// Eq. 9–12 of the paper: frozen linearisation in the z-step, penalty adapted as in He et al.
    Paper,
    /// The fixed point without splitting, which the paper shows to fail; for comparison.
    FixedPoint,
}

/// Order of the harmonics that are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum HarmonicOrder {
    /// Four coefficients.
    #[serde(rename = "1")]
    First,
    /// Nine coefficients.
    #[default]
    #[serde(rename = "2")]
    Second,
}

/// How a pixel's ray is modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Projection {
    /// Pinhole; the unknown is the logarithm of depth.
    #[default]
    Perspective,
    /// Parallel rays; the unknown is depth in pixels.
    Orthographic,
}

/// Where the iteration starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartShape {
    /// Anchors where there are enough, else the given depth, else the prior, else a plane.
    #[default]
    Automatic,
    /// The view's initial depth.
    Given,
    /// A fronto-parallel plane at the median known depth.
    Plane,
    /// Thin plate through the anchors.
    Anchors,
}

/// Options of [`super::solve`] and [`super::run`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PaperOptions {
    /// How slopes and depth are separated.
    pub splitting: Splitting,
    /// Order of the harmonics.
    pub order: HarmonicOrder,
    /// Projection.
    pub projection: Projection,
    /// Start.
    pub start: StartShape,
    /// Loss on an intensity residual; its scale is a share of the image's robust maximum.
    /// Too small a scale ignores good pixels, too large lets stains shape the surface.
    pub loss: RobustLoss,
    /// Standard deviation of intensities as a share of the image's robust maximum; weighs shading
    /// against anchors and prior. Too small overrules the anchors, too large ignores fine relief.
    pub noise: f64,
    /// Weight of the area term of RGB-D refinement, per pixel of the reference plane, with shading
    /// weighing 1 and slopes in (log depth, pixel) units; 0 is off. Too large flattens.
    pub area_weight: f64,
    /// Cut the gradient where shading and an integrable surface are found to disagree.
    pub depth_edges: bool,
    /// Leave out pixels in cast or attached shadow below this share of the robust maximum.
    pub shadow_level: f64,
}

impl Default for PaperOptions {
    fn default() -> Self {
        Self {
            splitting: Splitting::default(),
            order: HarmonicOrder::default(),
            projection: Projection::default(),
            start: StartShape::default(),
            loss: RobustLoss::Squared,
            noise: 0.01,
            area_weight: 0.0,
            depth_edges: true,
            shadow_level: 0.0,
        }
    }
}

impl PaperOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("noise", self.noise, 1e-6..=10.0)?;
        in_range("area_weight", self.area_weight, 0.0..=1e6)?;
        in_range("shadow_level", self.shadow_level, 0.0..=0.999)?;
        match self.loss {
            RobustLoss::Squared => Ok(()),
            RobustLoss::Huber(scale)
            | RobustLoss::Cauchy(scale)
            | RobustLoss::GemanMcClure(scale) => in_range("loss", scale, 1e-6..=1000.0),
        }
    }
}
