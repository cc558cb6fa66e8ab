//! Pixels and anchors of one view or several, gathered for one fit of the light.

use crate::error::LightingError;
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_photometry::harmonics::{LightingFit, Reading, fit_lighting};

/// Readings in one frame, intensities divided by the gains where they apply.
#[derive(Default)]
pub(crate) struct Pool(Vec<Reading>);

impl Pool {
    /// One reading, in the pool's frame.
    pub fn push(&mut self, reading: Reading) {
        self.0.push(reading);
    }

    /// At most `max_num` of a view's readings, evenly taken: normals rotated into the pool's frame, values
    /// divided by the view's gain per channel.
    pub fn add(
        &mut self,
        readings: &[Reading],
        rotation: &UnitQuaternion<f64>,
        gain: &[f64],
        max_num: usize,
    ) {
        let stride = readings.len().div_ceil(max_num.max(1)).max(1);
        let chosen = readings.iter().step_by(stride);
        self.0
            .extend(chosen.map(|reading| reading.turned(rotation, gain)));
    }

    /// Harmonics of the whole pool; `of` names it in the error.
    pub fn fit(&self, of: &str) -> Result<LightingFit, LightingError> {
        fit_lighting(&self.0).map_err(|source| LightingError::Fit {
            of: of.to_owned(),
            source,
        })
    }

    /// Normals and brightness of what is not clipped.
    pub fn brightness(&self) -> Vec<(Vector3<f64>, f64)> {
        let whole = self.0.iter().filter(|reading| reading.is_whole());
        whole.map(|r| (r.normal, r.brightness())).collect()
    }
}
