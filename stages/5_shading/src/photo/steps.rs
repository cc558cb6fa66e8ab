//! The steps of a run, under one name for progress, report and forecast.

use super::memory::Sizes;
use super::options::PhotoOptions;
use serde::{Deserialize, Serialize};

/// A step of the photo model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PhotoStep {
    /// The first search, and the gains of the photos that follow from it.
    #[default]
    Exposure,
    /// The search at the coarse level.
    Search,
    /// Gauss-Newton rounds on the photos' agreement alone.
    Photos,
    /// Fusion of the views' surfaces.
    Fusion,
    /// A fit of the light.
    Light,
    /// Shading judged by photos that are left out.
    Validation,
    /// Gauss-Newton rounds under a light.
    LightAndShape,
    /// A search around the surface of a finer level.
    FinerSearch,
    /// Gauss-Newton rounds at a finer level that is solved as a whole.
    Finer,
    /// Gauss-Newton rounds at a finer level, tile by tile.
    Relief,
}

/// A step that a run is expected to take.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedStep {
    /// Which.
    pub step: PhotoStep,
    /// CPU seconds of the machine that the factors were measured on.
    pub cpu_seconds: f64,
    /// Whether only some runs take it.
    pub is_optional: bool,
}

impl PhotoStep {
    /// What progress calls it.
    pub fn message(self) -> &'static str {
        match self {
            Self::Exposure => "comparing exposures",
            Self::Search => "searching depth",
            Self::Photos => "photos",
            Self::Fusion => "fusing views",
            Self::Light => "fitting light",
            Self::Validation => "leaving photos out",
            Self::LightAndShape => "light and shape",
            Self::FinerSearch => "searching depth again",
            Self::Finer => "finer",
            Self::Relief => "relief",
        }
    }
}

/// The steps of a run that take time, in order. The factors were measured with `benches/scale` and
/// on photos of 18 megapixels (`benches/EXPERIMENTS.md`).
pub fn forecast(sizes: &Sizes, options: &PhotoOptions) -> Vec<ExpectedStep> {
    /// Outer iterations of light and shape that are mostly taken.
    const NUM_ITERATIONS: usize = 4;
    let whole_px = sizes.whole_share(options) * sizes.masked;
    let coarse_px = sizes.coarse_share(options) * sizes.masked;
    let coarse = 1e-5 * coarse_px;
    let expected = |step, cpu_seconds| ExpectedStep {
        step,
        cpu_seconds,
        is_optional: false,
    };
    let mut steps = vec![
        expected(PhotoStep::Exposure, 2.5 * coarse),
        expected(PhotoStep::Search, 7.0 * coarse),
        expected(PhotoStep::Photos, 1.5 * coarse),
    ];
    for _ in 0..NUM_ITERATIONS {
        steps.push(expected(PhotoStep::Light, 3.7 * coarse));
        steps.push(expected(PhotoStep::LightAndShape, 3.0 * coarse));
    }
    let finer_px = whole_px - coarse_px;
    steps.push(ExpectedStep {
        // Where the photos' brightness disagrees.
        is_optional: true,
        ..expected(PhotoStep::FinerSearch, 1e-4 * finer_px)
    });
    steps.push(expected(PhotoStep::Finer, 2.5e-5 * finer_px));
    let tiled_px = (sizes.masked - whole_px).max(0.0);
    steps.push(expected(PhotoStep::Relief, 1.6e-5 * tiled_px));
    steps
}
