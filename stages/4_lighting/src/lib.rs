//! Stage 4: from a reference sphere, a shape, or a file to the lighting of every view.
//!
//! # Problem
//! The solver of stage 5 needs, for each view and channel, nine coefficients `l` with
//! `I = l · h(n)` (eq. 1 of the paper; the mean albedo is contained in `l`). They come from
//! surfaces with known normals:
//! * matte reference spheres, whose places stage 3 found: every pixel has an exact normal;
//! * a photo of a sphere in the object's place;
//! * a known shape, as the paper did for its real data;
//! * a file;
//! * or, uncalibrated, the program's own depth anchors.
//!
//! A light fixed in the world is *one* environment for all views, rotated exactly into each; a
//! light fixed to the camera (turntable, flash) is one per view.
//!
//! # Steps
//! 1. `side`: usable pixels of the spheres: inside the frame, off the object, off the
//!    outline, not clipped.
//! 2. `sphere_light`: robust fits (`environment`), exposure gains of the photos (`gains`), the check
//!    of the stated kind of light (`kind`), and of several spheres those that see one light
//!    (`agreement`).
//! 3. `object_light`: the sphere's light against the object at the depth anchors, and its
//!    correction.
//! 4. `shape`, `own_shape`: fits without a sphere.
//! 5. `light_samples`: what is known of the light point by point, for a solver that allows for shadows.
//!
//! # Entry
//! [`run`]; [`fit_on_shape`] for a single view; [`overlays`]
//! for the eye.

mod agreement;
mod anchor_normals;
mod calibration;
mod cells;
mod environment;
mod error;
mod findings;
mod gains;
mod kind;
mod light_samples;
mod object_light;
mod options;
mod overlay;
mod own_shape;
mod place;
mod pool;
mod report;
mod request;
mod residual;
mod shape;
mod side;
mod sphere_light;

pub use error::LightingError;
pub use options::{LightingOptions, ObjectLight, RETIRED_KEYS};
pub use overlay::{SphereOverlay, overlays};
pub use report::{
    ChannelReport, KindCheck, LightingReport, ObjectReport, SphereLightReport, ViewLightReport,
    ViewObjectReport,
};
pub use request::LightingRequest;
pub use shape::fit_on_shape;

use rilievo_scene::{LightingCalibration, Observer, PhotoSet, PosedViews};

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 8;

/// Lighting of all posed views.
///
/// # Errors
/// See [`LightingError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    request: &LightingRequest,
    options: &LightingOptions,
    observer: &dyn Observer,
) -> Result<(LightingCalibration, LightingReport), LightingError> {
    options.validate()?;
    let min_num_pixels = options.min_num_pixels;
    photos.check()?;
    posed.check_with(photos)?;
    if posed.views.is_empty() {
        return Err(LightingError::NoView);
    }
    match request {
        LightingRequest::Given(lightings) => {
            let (mut calibration, report) = request::given(posed, lightings)?;
            // Of the spheres the solver needs to know what they hide and send.
            let mut facts = LightingReport::default();
            let side = side::collect(photos, posed, min_num_pixels, observer, &mut facts)?;
            calibration.samples.extend(light_samples::of_spheres(&side));
            Ok((calibration, report))
        }
        LightingRequest::Shape(shapes) => shape::run(photos, posed, shapes, observer),
        LightingRequest::Sphere(sphere) => {
            let (mut calibration, mut report) =
                sphere_light::run(photos, posed, sphere, min_num_pixels, observer)?;
            if options.object_light == ObjectLight::Correct {
                let (light, facts) = (&mut calibration, &mut report);
                object_light::confront(photos, posed, light, facts, observer)?;
            }
            Ok((calibration, report))
        }
        LightingRequest::OwnShape => {
            own_shape::run(photos, posed, options.own_shape_light, observer)
        }
    }
}
