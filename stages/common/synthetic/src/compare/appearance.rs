//! Light, albedo and re-rendered photos against truth.
//!
//! * Light: the angle between the dominant directions `Σ_c (l₁, l₂, l₃)` of both lightings, and the
//!   relative RMS of the irradiance `l·h(n)` over all directions `n`, after the best common factor
//!   `a = ⟨E, T⟩ / ⟨E, E⟩` (brightness and mean albedo are one unknown).
//! * Albedo: the relative RMS after the best factor of each channel, for the same reason.
//! * Re-rendered photos: `‖rendered − photo‖ / ‖photo‖`, no factor left.

use crate::environment::fibonacci;
use nalgebra::Vector3;
use rilievo_scene::{Lighting, LinearImage, Raster};
use serde::Serialize;

/// Directions over which irradiances are compared: a few degrees apart, far finer than harmonics.
const NUM_DIRECTIONS: usize = 1000;

/// Appearance of all views against the truth; what could not be computed is `None`, and the
/// evaluation's `reasons` say why.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AppearanceComparison {
    /// Mean angle between the dominant directions of the light, degrees.
    pub light_direction_deg: Option<f64>,
    /// Mean relative RMS of the irradiance over all directions, up to one factor a view.
    pub light_rms_rel: Option<f64>,
    /// Relative RMS of the albedo, up to one factor a channel.
    pub albedo_rms_rel: Option<f64>,
    /// Relative RMS between the photos and the images that the result explains.
    pub rerender_rms_rel: Option<f64>,
}

/// One view's light against the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightComparison {
    /// Angle between the dominant directions, degrees.
    pub direction_deg: f64,
    /// Relative RMS of the irradiance.
    pub rms_rel: f64,
}

/// Sums for the relative RMS of `a·e − t` at its best factor `a`.
#[derive(Clone, Copy, Debug, Default)]
struct Fit {
    ee: f64,
    et: f64,
    tt: f64,
}

impl Fit {
    fn add(&mut self, estimate: f64, truth: f64) {
        self.ee += estimate * estimate;
        self.et += estimate * truth;
        self.tt += truth * truth;
    }

    /// Squares left at the best factor.
    fn rest(&self) -> f64 {
        let explained = if self.ee > 0.0 {
            self.et * self.et / self.ee
        } else {
            0.0
        };
        (self.tt - explained).max(0.0)
    }
}

/// Direction from which most light comes, all channels together.
fn dominant(lighting: &Lighting) -> Vector3<f64> {
    let first_order = |c: &rilievo_scene::SphericalHarmonics| Vector3::new(c.0[0], c.0[1], c.0[2]);
    lighting.channels.iter().map(first_order).sum()
}

/// Compares the lighting of a view, both in its camera's frame; `None` where channels differ in
/// number or there is no light.
pub fn compare_light(estimate: &Lighting, truth: &Lighting) -> Option<LightComparison> {
    if estimate.channels.len() != truth.channels.len() {
        return None;
    }
    let mut fit = Fit::default();
    for i in 0..NUM_DIRECTIONS {
        let n = fibonacci(i, NUM_DIRECTIONS);
        for (e, t) in estimate.channels.iter().zip(&truth.channels) {
            fit.add(e.evaluate(&n), t.evaluate(&n));
        }
    }
    let (e, t) = (dominant(estimate), dominant(truth));
    (fit.tt > 0.0 && e.norm() > 0.0 && t.norm() > 0.0).then(|| LightComparison {
        direction_deg: e.angle(&t).to_degrees(),
        rms_rel: (fit.rest() / fit.tt).sqrt(),
    })
}

/// Gathers albedos or images view by view.
#[derive(Clone, Debug, Default)]
pub struct ImageErrors {
    channels: Vec<Fit>,
    /// Squares of the differences, and of the truth.
    difference: [f64; 2],
}

impl ImageErrors {
    /// Adds the pixels of a view where `inside` says so; nothing where the sizes differ.
    pub fn add(&mut self, estimate: &LinearImage, truth: &LinearImage, inside: &Raster<bool>) {
        let sizes = [estimate, truth].map(|i| (i.width, i.height, i.channels));
        if sizes[0] != sizes[1] || (inside.width, inside.height) != (truth.width, truth.height) {
            return;
        }
        self.channels.resize(truth.channels, Fit::default());
        let pixels = estimate.data.chunks_exact(truth.channels);
        let pixels = pixels.zip(truth.data.chunks_exact(truth.channels));
        for ((e, t), _) in pixels.zip(&inside.data).filter(|(_, inside)| **inside) {
            for ((fit, &e), &t) in self.channels.iter_mut().zip(e).zip(t) {
                let (e, t) = (f64::from(e), f64::from(t));
                fit.add(e, t);
                self.difference[0] += (e - t).powi(2);
                self.difference[1] += t * t;
            }
        }
    }

    /// Relative RMS as they are; `None` without a pixel.
    pub fn rms_rel(&self) -> Option<f64> {
        let [difference, truth] = self.difference;
        (truth > 0.0).then(|| (difference / truth).sqrt())
    }

    /// Relative RMS after the best factor of each channel; `None` without a pixel.
    pub fn rms_rel_up_to_factor(&self) -> Option<f64> {
        let rest: f64 = self.channels.iter().map(Fit::rest).sum();
        let truth: f64 = self.channels.iter().map(|fit| fit.tt).sum();
        (truth > 0.0).then(|| (rest / truth).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::SphericalHarmonics;

    fn light(direction: [f64; 3], scale: f64) -> Lighting {
        let mut row = [0.0; 9];
        for (l, d) in row.iter_mut().zip(direction) {
            *l = scale * d;
        }
        row[3] = scale;
        Lighting {
            channels: vec![SphericalHarmonics(row); 3],
        }
    }

    #[test]
    fn a_factor_is_no_error_of_the_light_and_an_angle_is() {
        let truth = light([0.0, 0.6, -0.8], 0.7);
        let same = compare_light(&light([0.0, 0.6, -0.8], 2.1), &truth).unwrap();
        assert!(same.direction_deg < 1e-5 && same.rms_rel < 1e-7, "{same:?}");
        let turned = compare_light(&light([0.6, 0.0, -0.8], 0.7), &truth).unwrap();
        let expected = 0.64_f64.acos().to_degrees();
        assert!((turned.direction_deg - expected).abs() < 1e-9, "{turned:?}");
        // The mean of n·d squared over the sphere is a third; the constant part is common.
        let (common, cosine) = (1.0_f64, 0.64_f64 / 3.0);
        let total = common + 1.0 / 3.0;
        let rest = 1.0 - ((common + cosine) / total).powi(2);
        assert!((turned.rms_rel - rest.sqrt()).abs() < 1e-3, "{turned:?}");
        assert!(compare_light(&Lighting::default(), &truth).is_none());
    }

    #[test]
    fn albedo_is_compared_up_to_a_factor_and_images_are_not() {
        let mut truth = LinearImage::filled(4, 3, 3, 0.5);
        truth.data[0] = 0.7;
        let twice = LinearImage {
            data: truth.data.iter().map(|v| 2.0 * v).collect(),
            ..truth.clone()
        };
        let inside = Raster::filled(4, 3, true);
        let mut errors = ImageErrors::default();
        assert_eq!(errors.rms_rel(), None);
        errors.add(&twice, &truth, &inside);
        let left = errors.rms_rel_up_to_factor().unwrap();
        assert!(left < 1e-7, "{left}");
        assert!((errors.rms_rel().unwrap() - 1.0).abs() < 1e-9);
        // Pixels outside do not count.
        let mut none = ImageErrors::default();
        none.add(&twice, &truth, &Raster::filled(4, 3, false));
        assert_eq!(none.rms_rel_up_to_factor(), None);
    }
}
