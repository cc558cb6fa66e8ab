//! Pixels and anchors of one view or several, gathered for one fit of the light.

use crate::error::LightingError;
use crate::options::LightingOptions;
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_photometry::harmonics::{LightingFit, fit_lighting};
use rilievo_photometry::samples::SphereSamples;

/// Normals and intensities in one frame, intensities divided by the gains where they apply.
#[derive(Default)]
pub(crate) struct Pool {
    normals: Vec<Vector3<f64>>,
    values: Vec<Vec<f64>>,
    usable: Vec<Vec<bool>>,
}

impl Pool {
    /// One sample; values and their usability per channel.
    pub fn push(&mut self, normal: Vector3<f64>, values: Vec<f64>, usable: Vec<bool>) {
        self.normals.push(normal);
        self.values.push(values);
        self.usable.push(usable);
    }

    /// At most `max_num` of a view's samples, evenly taken: normals rotated into the pool's frame, values
    /// divided by the view's gain per channel.
    pub fn add(
        &mut self,
        samples: &SphereSamples,
        rotation: &UnitQuaternion<f64>,
        gain: &[f64],
        max_num: usize,
    ) {
        let stride = samples.normals.len().div_ceil(max_num.max(1)).max(1);
        for k in (0..samples.normals.len()).step_by(stride) {
            let values = samples.values[k].iter().zip(gain).map(|(v, g)| v / g);
            self.push(
                rotation * samples.normals[k],
                values.collect(),
                samples.usable[k].clone(),
            );
        }
    }

    /// Harmonics of the whole pool; `of` names it in the error.
    pub fn fit(&self, of: &str, options: &LightingOptions) -> Result<LightingFit, LightingError> {
        fit_lighting(&self.normals, &self.values, &self.usable, &options.fit).map_err(|source| {
            LightingError::Fit {
                of: of.to_owned(),
                source,
            }
        })
    }

    /// Normals and brightness of what is not clipped.
    pub fn brightness(&self) -> Vec<(Vector3<f64>, f64)> {
        (0..self.normals.len())
            .filter(|&k| !self.usable[k].contains(&false))
            .map(|k| (self.normals[k], self.values[k].iter().sum()))
            .collect()
    }
}
