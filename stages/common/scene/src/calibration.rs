//! Output of stage 4: lighting of every view.

use crate::ids::ViewIdx;
use crate::lighting::Lighting;
use crate::sphere::LightKind;
use serde::{Deserialize, Serialize};

/// Where the lighting came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightSource {
    /// The reference sphere in the photos.
    Sphere,
    /// A photo of a sphere in the object's place.
    CalibrationPhoto,
    /// Fitted on a given shape.
    Shape,
    /// Given by the user.
    #[default]
    Given,
    /// Estimated on the program's own rough shape: uncalibrated.
    OwnShape,
}

/// Lighting of one view, in its camera frame, times the object's mean albedo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewLighting {
    /// The view.
    pub view: ViewIdx,
    /// One row of harmonics per channel.
    pub lighting: Lighting,
    /// Relative RMS residual of the fit in this view, where the light was fitted on it.
    pub residual: Option<f64>,
    /// Gain of the photo per channel, 1 where exposure does not vary; already contained in
    /// `lighting`.
    pub gain: Vec<f64>,
}

/// How a reference sphere stands to the light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphereLight {
    /// Its name.
    pub name: String,
    /// Its albedo over the one that the lighting contains, per channel; `None` for a sphere that sees
    /// another light, from which the lighting does not come.
    pub paint: Option<Vec<f64>>,
}

/// A surface point with a known normal, and what a photo shows of it: what is known of the light beyond
/// nine harmonics, which have no shadows. A model of the light with shadow and bounce is fitted on these.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightSample {
    /// The view that shows it.
    pub view: ViewIdx,
    /// The posed sphere on which it lies, or `None` for a point in the object's place that nothing hides
    /// and nothing stands beside, as on a calibration photo, or read from given harmonics.
    pub sphere: Option<usize>,
    /// Unit normal, world frame.
    pub normal_in_world: [f32; 3],
    /// Linear intensity, never negative; grey photos have three equal values.
    pub intensity: [f32; 3],
    /// Whether the intensity is at the view's own exposure, its gain contained; else at that of a photo of
    /// gain 1, as a calibration photo's.
    pub has_gain: bool,
}

/// Lighting of all views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightingCalibration {
    /// Where it came from.
    pub source: LightSource,
    /// What the light is fixed to.
    pub kind: LightKind,
    /// The environment in the world frame (one row per channel), for a light fixed in the world.
    pub environment_in_world: Option<Lighting>,
    /// One entry per posed view, in their order.
    pub views: Vec<ViewLighting>,
    /// One entry per posed sphere, in their order, where the light came from the spheres beside the
    /// object; else empty.
    #[serde(default)]
    pub spheres: Vec<SphereLight>,
    /// What spheres, calibration photos and a given light show of the light, point by point. Empty where
    /// the light was fitted on the object itself, which the solver sees as well.
    #[serde(default)]
    pub samples: Vec<LightSample>,
}

impl LightingCalibration {
    /// Indices of the posed spheres that see another light.
    pub fn rejected_spheres(&self) -> Vec<usize> {
        let rejected = |(k, sphere): (usize, &SphereLight)| sphere.paint.is_none().then_some(k);
        self.spheres
            .iter()
            .enumerate()
            .filter_map(rejected)
            .collect()
    }
}
