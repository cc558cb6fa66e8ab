//! Options of the paper's model.

use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::{InTable, OptionError, in_range};
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

/// How views are tied together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coupling {
    /// Each match or track is triangulated once and anchors the depth of each view.
    #[default]
    Anchors,
    /// Eq. 15: the distance between the two views' points of every match, re-linearised.
    Literal,
}

/// Course of the penalty β.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PenaltySchedule {
    /// Start and growth computed from the lighting and from what holds the low frequencies.
    #[default]
    Automatic,
    /// `beta = start · growthᵏ`, intensities scaled so that white is 1.
    Explicit {
        /// First penalty. Too small drifts where the light is ambiguous, too large stays at the start.
        start: f64,
        /// Factor per iteration, above 1.
        growth: f64,
        /// Number of iterations.
        num_iterations: usize,
        /// Iterations with a global search over slopes.
        num_search_iterations: usize,
    },
}

impl PenaltySchedule {
    fn validate(&self) -> Result<(), OptionError> {
        match *self {
            Self::Automatic => Ok(()),
            Self::Explicit {
                start,
                growth,
                num_iterations,
                num_search_iterations,
            } => {
                in_range("start", start, 1e-12..=1e12)?;
                in_range("num_iterations", num_iterations, 1..=100_000)?;
                in_range(
                    "num_search_iterations",
                    num_search_iterations,
                    0..=num_iterations,
                )?;
                // The last penalty, `start * growth^num_iterations`, stays below 1e30.
                let steepest = (1e30 / start).powf(1.0 / num_iterations as f64);
                in_range("growth", growth, 1.0 + 1e-9..=steepest)
            }
        }
    }
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
    /// How matched views are tied.
    pub coupling: Coupling,
    /// Penalty.
    pub schedule: PenaltySchedule,
    /// Loss on an intensity residual; its scale is a share of the image's robust maximum.
    /// Too small a scale ignores good pixels, too large lets stains shape the surface.
    pub loss: RobustLoss,
    /// Standard deviation of intensities as a share of the image's robust maximum; weighs shading
    /// against anchors and prior. Too small overrules the anchors, too large ignores fine relief.
    pub noise: f64,
    /// Standard deviation of a match in pixels; `None` estimates it from the epipolar distances.
    pub match_noise_px: Option<f64>,
    /// Weight of the area term of RGB-D refinement, per pixel of the reference plane, with shading
    /// weighing 1 and slopes in (log depth, pixel) units; 0 is off. Too large flattens.
    pub area_weight: f64,
    /// Cut the gradient where the surface breaks: at the pixels of a view's map of depth breaks, and
    /// where shading and an integrable surface are found to disagree.
    pub depth_edges: bool,
    /// Solve on coarser grids first. Off in the paper's splitting.
    pub coarse_to_fine: bool,
    /// Leave out pixels in cast or attached shadow below this share of the robust maximum.
    pub shadow_level: f64,
    /// Largest number of iterations of the paper's splitting and of the fixed point.
    pub max_num_iterations: usize,
    /// Relative change of energy at which the paper's splitting and the fixed point stop.
    pub relative_tolerance: f64,
    /// Compute the confidence map.
    pub confidence: bool,
}

impl Default for PaperOptions {
    fn default() -> Self {
        Self {
            splitting: Splitting::default(),
            order: HarmonicOrder::default(),
            projection: Projection::default(),
            start: StartShape::default(),
            coupling: Coupling::default(),
            schedule: PenaltySchedule::default(),
            loss: RobustLoss::Squared,
            noise: 0.01,
            match_noise_px: None,
            area_weight: 0.0,
            depth_edges: true,
            coarse_to_fine: true,
            shadow_level: 0.0,
            max_num_iterations: 100,
            relative_tolerance: 1e-3,
            confidence: true,
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
        in_range(
            "match_noise_px",
            self.match_noise_px.unwrap_or(1.0),
            1e-4..=1000.0,
        )?;
        in_range("area_weight", self.area_weight, 0.0..=1e6)?;
        in_range("shadow_level", self.shadow_level, 0.0..=0.999)?;
        in_range("relative_tolerance", self.relative_tolerance, 1e-15..=1.0)?;
        in_range("max_num_iterations", self.max_num_iterations, 1..=100_000)?;
        match self.loss {
            RobustLoss::Squared => {}
            RobustLoss::Huber(scale)
            | RobustLoss::Cauchy(scale)
            | RobustLoss::GemanMcClure(scale) => in_range("loss", scale, 1e-6..=1000.0)?,
        }
        self.schedule.validate().in_table("schedule")
    }
}
