//! What stage 4 found, as facts.

use rilievo_photometry::harmonics::HarmonicsFit;
use rilievo_scene::{LightKind, LightSource};
use serde::{Deserialize, Serialize};

/// One channel's fit without its covariance matrix.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelReport {
    /// Order of the harmonics, 1 or 2.
    pub order: u8,
    /// Pixels used.
    pub num_samples: usize,
    /// Relative residual of the pixels within three deviations (root mean square).
    pub relative_rms: f64,
    /// Share of those pixels.
    pub inlier_share: f64,
    /// Condition number.
    pub condition: f64,
    /// Standard deviation of each coefficient, for independent pixels.
    pub coefficient_sigma: Vec<f64>,
}

impl From<&HarmonicsFit> for ChannelReport {
    fn from(fit: &HarmonicsFit) -> Self {
        Self {
            order: fit.order,
            num_samples: fit.num_samples,
            relative_rms: fit.relative_rms,
            inlier_share: fit.inlier_share,
            condition: fit.condition,
            coefficient_sigma: (0..9).map(|k| fit.covariance[k * 10].sqrt()).collect(),
        }
    }
}

/// One view's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewLightReport {
    /// The view's name.
    pub name: String,
    /// Usable pixels with a known normal.
    pub num_pixels: usize,
    /// Share of the sphere's (or shape's) pixels that were clipped.
    pub clipped_share: f64,
    /// Share of the spheres' discs outside the frame or behind something.
    pub hidden_share: f64,
    /// Relative residual of the light in this view (root mean square over good pixels).
    pub relative_rms: Option<f64>,
    /// With a calibration photo: residual of its light on the sphere beside the object, which
    /// stands in the object's shadow and bounce light.
    pub side_sphere_rms: Option<f64>,
    /// Gain of the photo per channel that was found, 1 where not looked for.
    pub gain: Vec<f64>,
    /// Relative standard deviation of the gain.
    pub gain_sigma: Option<f64>,
    /// Radius of the outline of the largest sphere, pixels.
    pub radius_px: Option<f64>,
    /// Why the view took no part in the fit.
    pub left_out: Option<String>,
    /// Why some of the spheres are not used in this view, where another is.
    pub unused_spheres: Vec<String>,
}

impl ViewLightReport {
    pub(crate) fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            ..Self::default()
        }
    }
}

/// One sphere's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SphereLightReport {
    /// Its name.
    pub name: String,
    /// Its usable pixels in all views.
    pub num_pixels: usize,
    /// Views that show enough of it.
    pub views: Vec<String>,
    /// The reference sphere, where this is another.
    pub compared_with: Option<String>,
    /// Brightness at equal normals over that of the other sphere, per channel.
    pub brightness_ratio: Vec<f64>,
    /// Relative residual of its own light on it.
    pub own_rms: Option<f64>,
    /// Relative residual of the other sphere's light on it, after the ratio of brightness.
    pub other_rms: Option<f64>,
    /// Angle between the dominant directions of both lights, degrees.
    pub direction_difference_deg: Option<f64>,
    /// Whether it took no part, because it sees another light.
    pub left_out: bool,
}

/// What the light is fixed to by the brightness of the spheres, of a known shape or of the anchors in several
/// views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KindCheck {
    /// What was stated, where anything was.
    pub stated: Option<LightKind>,
    /// Relative scatter of brightness between views at equal normals in the world.
    pub scatter_world: f64,
    /// The same at equal normals in the camera.
    pub scatter_camera: f64,
    /// The kind that fits, where the data decide.
    pub fits: Option<LightKind>,
    /// Whether that contradicts what was stated.
    pub contradicts: bool,
}

/// One view of [`ObjectReport`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewObjectReport {
    /// The view's name.
    pub name: String,
    /// Anchors with a normal that it sees.
    pub num_anchors: usize,
    /// Relative residual at the anchors of the light that was found first (root mean square).
    pub used_rms: Option<f64>,
    /// The same after the factor common to all views.
    pub used_rms_after_albedo: Option<f64>,
    /// The same for a light fitted on the other half of the anchors.
    pub cross_validated_rms: Option<f64>,
}

/// The light against the object's brightness at the depth anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectReport {
    /// Every view.
    pub views: Vec<ViewObjectReport>,
    /// Brightness of the object over what the light predicts: its albedo relative to the sphere's.
    pub albedo_factor: f64,
    /// Whether the light was multiplied by it.
    pub factor_applied: bool,
    /// Whether the light fitted on the anchors replaces the sphere's.
    pub light_replaced: bool,
}

/// Facts of a run of stage 4.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LightingReport {
    /// Where the light came from.
    pub source: LightSource,
    /// What it is fixed to.
    pub kind: LightKind,
    /// Fit per channel, of the common environment or of the worst view.
    pub channels: Vec<ChannelReport>,
    /// Direction from which most light comes, unit vector in the world frame (of the first view
    /// for a light fixed to the camera: in its camera frame).
    pub dominant_direction: Option<[f64; 3]>,
    /// Every view.
    pub views: Vec<ViewLightReport>,
    /// Every sphere beside the object.
    pub spheres: Vec<SphereLightReport>,
    /// Check of the stated kind of light.
    pub kind_check: Option<KindCheck>,
    /// The light against the object at the depth anchors, where there are enough.
    pub object: Option<ObjectReport>,
    /// Whether gains were applied.
    pub gains_applied: bool,
    /// Whether the light is uncalibrated: only known up to the ambiguities that a warning names.
    pub uncalibrated: bool,
}
