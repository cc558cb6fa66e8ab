//! Sphere, scale and light on a photo set with known poses and truth.
//!
//! Printed per photo: outline overlap with `sphere_masks`, radius, gain, residual on the sphere,
//! and the residual of the light applied to the true normals.

use crate::Failure;
use crate::data_set::Set;
use nalgebra::{Point3, Vector3};
use rilievo_lighting::{LightingOptions, LightingRequest, run};
use rilievo_photometry::sphere::{SphereInCamera, SphereOptions, WorldScale, locate_request};
use rilievo_photometry::surface_check::check;
use rilievo_scene::{
    LightKind, MarkedSphere, Recorder, Scale, ScaleSource, Silent, SphereRequest, Unit,
};
use std::path::PathBuf;
use std::time::Instant;

#[derive(clap::Args)]
pub struct Arguments {
    /// A data set
    set: PathBuf,
    /// Takes `linear/NAME.png` for the photos
    #[arg(long)]
    linear: bool,
    /// The sphere is marked by `sphere_masks`, not searched
    #[arg(long)]
    marks: bool,
    /// Uses the calibration photo
    #[arg(long)]
    calibration: bool,
    /// The light moves with the camera
    #[arg(long)]
    camera: bool,
    /// Poses are in metres; otherwise in an arbitrary unit
    #[arg(long)]
    metric: bool,
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let mut set = Set::load(&arguments.set, arguments.linear, &[])?;
    let marked = || MarkedSphere::only(set.radius, set.marks.clone());
    let request = SphereRequest {
        spheres: arguments.marks.then(marked).into_iter().collect(),
        search_radius: (!arguments.marks).then_some(set.radius),
        is_unitless: false,
        light: arguments.camera.then_some(LightKind::Camera),
        calibration: set
            .calibration
            .iter()
            .filter(|_| arguments.calibration)
            .cloned()
            .collect(),
    };
    // The world shrunk by an arbitrary factor, as poses without scale are.
    let (shrink, scale) = match arguments.metric {
        true => (1.0, WorldScale::Metric),
        false => (0.37, WorldScale::Free),
    };
    let mut views = set.posed.views.clone();
    for view in &mut views {
        view.cam_from_world.translation *= shrink;
    }
    let start = Instant::now();
    let options = SphereOptions::default();
    let found = locate_request(&set.photos, &views, &request, scale, &options, 2)?;
    println!(
        "{} located in {:.2} s, of other sizes {:?}, {:?}",
        found.fits.len(),
        start.elapsed().as_secs_f64(),
        found.other_sizes,
        found.scale
    );
    let fit = &found.fits[0];
    let own_scale = fit.scale.ok_or("one view only")?;
    let mut sphere = fit.sphere.clone();
    sphere.center_in_world = sphere.center_in_world.map(|x| x / shrink);
    sphere.radius /= shrink;
    let off = Point3::from(sphere.center_in_world) - Point3::from(set.center);
    println!(
        "seen in {} of {}; centre off by {:.3} mm, sigma {:.3} mm; scale off by {:+.3} %, sigma {:.3} %",
        sphere.seen_in.len(),
        views.len(),
        1e3 * off.norm(),
        1e3 * Vector3::from(sphere.center_sigma).norm() / shrink,
        100.0 * (own_scale.metres_per_unit * shrink - 1.0),
        100.0 * own_scale.relative_sigma,
    );
    for agreement in &fit.views {
        let mut views = set.posed.views.iter();
        let view = views
            .find(|view| view.photo == agreement.photo)
            .ok_or("view")?;
        let in_camera = SphereInCamera::seen(&sphere, &view.cam_from_world);
        println!(
            "  {} used {} rms {:.2} px bias {:+.2} px inliers {:.2} IoU {:.3} {}",
            view.name,
            agreement.used,
            agreement.rms_px,
            agreement.bias_px,
            agreement.inlier_share,
            set.overlap(agreement.photo, &in_camera, &view.intrinsics),
            agreement.reason.clone().unwrap_or_default()
        );
    }
    set.posed.spheres = vec![sphere];
    set.posed.scale = Scale {
        unit: Unit::Metre,
        source: ScaleSource::Sphere,
        relative_sigma: Some(own_scale.relative_sigma),
    };
    print_light(&set, request)
}

fn print_light(set: &Set, request: SphereRequest) -> Result<(), Failure> {
    let (photos, posed, options) = (&set.photos, &set.posed, LightingOptions::default());
    let (start, events) = (Instant::now(), Recorder::default());
    let request = LightingRequest::Sphere(request);
    let (calibration, report) = run(photos, posed, &request, &options, &events)?;
    println!(
        "light in {:.2} s from {:?}\n  {:?}\n  gains applied {}",
        start.elapsed().as_secs_f64(),
        report.source,
        report.kind_check,
        report.gains_applied
    );
    for channel in &report.channels {
        println!("  {channel:?}");
    }
    for (view, facts) in calibration.views.iter().zip(&report.views) {
        println!(
            "  {} pixels {} clipped {:.2} hidden {:.2} residual {:.3?} gain {:.3?} ± {:.4?} true {:.3?} \
             | on true normals {:.1} %{}",
            facts.name,
            facts.num_pixels,
            facts.clipped_share,
            facts.hidden_share,
            view.residual,
            facts.gain,
            facts.gain_sigma,
            set.true_gain(view.view.0),
            100.0 * set.residual_on_truth(view.view.0, &view.lighting)?,
            facts
                .left_out
                .as_ref()
                .map(|r| format!(" LEFT OUT: {r}"))
                .unwrap_or_default()
        );
    }
    let used = (calibration.source, calibration.views.as_slice());
    let surface = check(photos, posed, used, &set.true_shape()?, &Silent)?;
    for view in &surface.views {
        println!("  {view:?}");
    }
    for line in events.warnings() {
        println!("  ! {line}");
    }
    for finding in surface.findings() {
        println!("  ! {}", finding.sentence());
    }
    Ok(())
}
