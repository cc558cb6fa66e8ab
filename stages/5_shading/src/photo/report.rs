//! Facts on a run of the photo model.

use super::matching;
use super::steps::PhotoStep;
use super::validation::ValidationReport;
use rilievo_scene::ViewLighting;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Pixels over which the residuals of sharp photos are alike, at most.
const SHARP_PX: f64 = 7.0;
/// More is not reported: residuals are alike without end where nothing differs.
pub(super) const MOST_BLURRED_PX: f64 = 50.0;

/// Facts on one view.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoViewReport {
    /// The view's name.
    pub name: String,
    /// Masked pixels.
    pub num_pixels: usize,
    /// Views that it was compared with.
    pub sources: Vec<String>,
    /// Exposure gain per channel against the brightest photo.
    pub gain: [f64; 3],
    /// Standard deviation of the log ratio to other views at the same point, after the gains.
    pub disagreement: f64,
    /// Strength of the photo's finest detail at the last level that was solved as a whole, against that of the sharpest
    /// photo: its surface counts by the square against the others'.
    #[serde(default = "sharp")]
    pub sharpness: f64,
    /// Share of the pixels whose dense depth another view confirms.
    pub confirmed: f64,
    /// Share of the pixels that only this view sees.
    pub seen_alone: f64,
    /// Share of the pixels of the finest solved level whose normal lies more than 40° from the median of the 5×5
    /// pixels around it on the same side of a depth edge: as solved, and in the result.
    pub specks: [f64; 2],
    /// Median relative residual of the light at the shape that it was last fitted on, pigment divided out,
    /// where shading was used.
    pub light_residual: Option<f64>,
    /// Mean trust in shading after cross-validation, 0 to 1.
    pub shading_trust: Option<f64>,
    /// Share of the pixels where cross-validation ended shading.
    pub without_shading: Option<f64>,
}

fn sharp() -> f64 {
    1.0
}

/// One step of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// Pyramid level, 0 is full resolution.
    pub level: usize,
    /// Which.
    pub step: PhotoStep,
    /// Mean change of depth in the last round, pixel footprints.
    pub moved_px: f64,
    /// Mean turn of the normals in the last round, degrees.
    pub turned_deg: f64,
    /// Mean turn of the normals in the whole outer iteration, degrees; of relief the sum over its rounds.
    pub turned_in_all_deg: f64,
    /// Rounds.
    pub num_rounds: usize,
    /// Relative standard deviation that the photos' agreement was given; 0 where it took no part.
    pub sigma_match: f64,
    /// Relative standard deviation that shading was given; 0 where it took no part.
    pub sigma_shading: f64,
    /// Median relative residual between the photos over all views.
    pub match_residual: Option<f64>,
    /// Correlation of these residuals with the neighbouring pixel's: near 1 where the photos hold nothing as fine as a
    /// pixel of the level.
    #[serde(default)]
    pub match_correlation: Option<f64>,
    /// Of a fit of the light: what it found, if anything.
    #[serde(default)]
    pub light: Option<LightFacts>,
    /// Seconds.
    pub seconds: f64,
}

/// A fitted light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightFacts {
    /// Median relative residual over the views.
    pub residual: f64,
    /// Exponent of openness, where it was measured.
    pub openness_exponent: Option<f32>,
    /// Distance of the light from the middle of the object, world's unit, where it is not endlessly far.
    #[serde(default)]
    pub distance: Option<f64>,
    /// Whether a ground lay under the object.
    pub has_ground: bool,
}

/// Facts on a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoReport {
    /// Per view.
    pub views: Vec<PhotoViewReport>,
    /// The steps, in order.
    pub steps: Vec<StepReport>,
    /// Standard deviation of the log ratio between views at the same point.
    pub disagreement: f64,
    /// Standard deviation that follows for the match term at first; what each step was given stands in `steps`.
    pub sigma_match: f64,
    /// Median distance between the views' searched depths, pixel footprints.
    pub search_scatter_px: f64,
    /// The same of the last search at a finer level, where there was one.
    pub finer_search_scatter_px: Option<f64>,
    /// Whether shading took part, and why not.
    pub shading: String,
    /// Whether its light allows for shadow and bounce light.
    pub light_sees_shadows: bool,
    /// The verdict of photos that were left out on shading.
    pub validation: Option<ValidationReport>,
    /// Share of the small-scale brightness, beyond what the light explains, that colour predicts:
    /// pigment.
    pub pigment: Option<f64>,
    /// The light that was used, of every view.
    pub light: Vec<ViewLighting>,
    /// What the data could not determine.
    pub notes: Vec<String>,
}

impl PhotoReport {
    /// Distance of the light that was fitted last from the middle of the object, world's unit; `None` where it may be endlessly
    /// far.
    pub fn light_distance(&self) -> Option<f64> {
        self.steps
            .iter()
            .rev()
            .find_map(|step| step.light)?
            .distance
    }

    /// Adds a step that ends now.
    pub(crate) fn add_step(
        &mut self,
        step: PhotoStep,
        level: usize,
        began: Instant,
    ) -> &mut StepReport {
        self.steps.push_mut(StepReport {
            level,
            step,
            seconds: began.elapsed().as_secs_f64(),
            ..StepReport::default()
        })
    }

    /// Sharpness of every view.
    pub(crate) fn sharpness(&self) -> Vec<f64> {
        self.views.iter().map(|view| view.sharpness).collect()
    }

    /// Pixels below which the maps hold no relief: those of the last level, or by how much larger the area of alike
    /// residuals is than a sharp photo's.
    pub fn resolved_px(&self) -> f64 {
        let last = self.steps.iter().rev().find(|step| step.num_rounds > 0);
        let pixel = last.map_or(1.0, |step| (step.level as f64).exp2());
        let blurred = self.alike_px().unwrap_or(0.0).min(MOST_BLURRED_PX) / SHARP_PX;
        pixel.max(blurred)
    }

    /// Side of the area over which the residuals between the photos are alike in the last step, pixels of the photos
    /// (`matching::alike_px`). Detail finer than that the photos do not hold. `None` where neither the photos' own pixels were looked at nor relief ended before them for want of detail.
    pub fn alike_px(&self) -> Option<f64> {
        let mut steps = self.steps.iter().rev();
        let last = steps.find(|step| step.match_correlation.is_some())?;
        let ended = last.step == PhotoStep::Relief && last.num_rounds == 0;
        let rho = last
            .match_correlation
            .filter(|_| last.level == 0 || ended)?;
        Some(matching::alike_px(rho) * (last.level as f64).exp2())
    }
}
