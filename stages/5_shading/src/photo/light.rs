//! The light of a level: nine coefficients per pixel of every view, and the pigment that it leaves.

use super::albedo::{self, Albedo};
use super::shading::{self, PixelHarmonics, PixelLight};
use nalgebra::{Rotation3, UnitQuaternion};
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{LightKind, Lighting};
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::{plate, spread};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// The light of all views at one level.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Light {
    /// Per view and masked pixel of the level that it was fitted at, camera frame; finer levels interpolate them.
    pub harmonics: Vec<Vec<PixelHarmonics>>,
    /// Median relative residual per view, at the shape that it was fitted on, pigment divided out.
    pub residuals: Vec<f64>,
    /// Pigment, where it was looked for.
    pub pigment: Option<Albedo>,
    /// Per view, what falls on a surface in the open, camera frame.
    pub in_the_open: Vec<Lighting>,
    /// Per view and masked pixel, how far shading may move the surface, 0 to 1; empty: everywhere.
    pub trust: Vec<Vec<f32>>,
    /// Log depth difference at which another view's intensity no longer counts; 0 where the views are lit
    /// differently.
    pub mean_tolerance: f64,
    /// Exponent of openness, as the photos show it ([`hidden_light`]); none where the light moves with the camera or
    /// is taken to cast no shadow.
    pub openness_exponent: Option<f32>,
    /// Distance of the light from the middle of the object, world's unit; none where it may be endlessly far.
    pub distance: Option<f64>,
}

/// Relative depth, in pixel footprints, at which another view's intensity counts half.
const MEAN_TOLERANCE_PX: f64 = 1.8;

impl Light {
    /// The light of a level, without pigment. Where it is fixed to the camera, the views see a
    /// point under different light, and their mean intensity is that of none.
    pub fn new(
        (level, normals): (&Level, &[Vec<[f64; 3]>]),
        harmonics: Vec<Vec<PixelHarmonics>>,
        in_the_open: Vec<Lighting>,
        kind: LightKind,
    ) -> Self {
        let mut light = Self {
            harmonics,
            residuals: Vec::new(),
            pigment: None,
            in_the_open,
            trust: Vec::new(),
            mean_tolerance: match kind {
                LightKind::World => MEAN_TOLERANCE_PX / level.focal(),
                LightKind::Camera => 0.0,
            },
            openness_exponent: None,
            distance: None,
        };
        light.measure_residuals(level, normals);
        light
    }

    /// The pigment that this light leaves, at the shape that it was fitted on.
    pub fn estimate_pigment(&self, level: &Level, depths: &[Vec<f64>]) -> Albedo {
        albedo::estimate(level, depths, &|i| self.own(i), self.mean_tolerance)
    }

    /// With its pigment divided out.
    pub fn with_pigment(
        mut self,
        level: &Level,
        depths: &[Vec<f64>],
        normals: &[Vec<[f64; 3]>],
    ) -> Self {
        self.pigment = Some(self.estimate_pigment(level, depths));
        self.measure_residuals(level, normals);
        self
    }

    fn measure_residuals(&mut self, level: &Level, normals: &[Vec<[f64; 3]>]) {
        let views = level.views.par_iter().enumerate();
        self.residuals = views
            .map(|(i, view)| {
                let pixels = (0..view.pixels.len()).step_by(3);
                let mut r: Vec<f64> = pixels
                    .filter(|&p| view.shows_surface(p))
                    .map(|p| {
                        let mut rgb = view.intensity(p);
                        if let Some(pigment) = self.pigment_of(i) {
                            rgb = without_pigment(rgb, pigment[p]);
                        }
                        relative(&self.harmonics[i][p], normals[i][p], rgb)
                    })
                    .collect();
                median(&mut r).unwrap_or(f64::NAN)
            })
            .collect();
    }

    /// Median over the views.
    pub fn residual(&self) -> f64 {
        let known = self.residuals.iter().copied().filter(|r| r.is_finite());
        median(&mut known.collect::<Vec<f64>>()).unwrap_or(1.0)
    }

    /// The light of a view's pixels, whose `harmonics` are of the same level as everything else.
    pub fn of<'a>(&'a self, view: usize, harmonics: Cow<'a, [PixelHarmonics]>) -> PixelLight<'a> {
        PixelLight {
            harmonics,
            pigment: self.pigment_of(view).map(Cow::Borrowed),
            trust: self.trust.get(view).map(Cow::from),
            mean_tolerance: self.mean_tolerance,
            openness_exponent: self.openness_exponent.unwrap_or(0.0),
        }
    }

    /// The coefficients of a view at the level of the fit.
    pub fn own(&self, view: usize) -> Cow<'_, [PixelHarmonics]> {
        Cow::Borrowed(&self.harmonics[view])
    }

    /// Pigment of a view's pixels.
    pub fn pigment_of(&self, view: usize) -> Option<&[[f32; 3]]> {
        self.pigment.as_ref().map(|p| p.relative[view].as_slice())
    }
}

/// Object pixels of a view on which a light is fitted.
pub(crate) const FIT_PIXELS: usize = 3000;

pub(crate) fn rotation(view: &LevelView) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(view.camera.rotation))
}

/// Normals of all views.
pub(crate) fn normals(level: &Level, depths: &[Vec<f64>]) -> Vec<Vec<[f64; 3]>> {
    let views = level.views.par_iter().zip(depths);
    views
        .map(|(view, depth)| plate::normals(view, depth))
        .collect()
}

pub(crate) fn without_pigment(rgb: [f32; 3], albedo: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| rgb[c] / albedo[c].max(0.1))
}

fn relative(light: &PixelHarmonics, normal: [f64; 3], rgb: [f32; 3]) -> f64 {
    let s = shading::render(light, normal);
    let mean = (rgb.iter().sum::<f32>() / 3.0).max(1e-5);
    let sum: f64 = (0..3)
        .map(|c| ((s[c] - f64::from(rgb[c])) / f64::from(mean)).powi(2))
        .sum();
    (sum / 3.0).sqrt()
}

/// Coefficients at a finer level.
pub(crate) fn finer(
    coarse: &LevelView,
    fine: &LevelView,
    values: &[PixelHarmonics],
) -> Vec<PixelHarmonics> {
    let flat = values.iter();
    let flat: Vec<[f32; 27]> = flat
        .map(|l| std::array::from_fn(|k| l[k / 9][k % 9]))
        .collect();
    let finer = spread::spread(coarse, fine, &flat);
    finer.iter().map(|l| pixel_harmonics(l)).collect()
}

/// Coefficients from a row of them, channel by channel.
pub(crate) fn pixel_harmonics(row: &[f32]) -> PixelHarmonics {
    std::array::from_fn(|c| std::array::from_fn(|k| row[9 * c + k]))
}
