//! Measures sphere, scale and light on a photo set with known poses and truth.
//!
//! `cargo run --release -p rilievo-lighting --example sphere_report -- SET [photos|linear]
//! [auto|marks] [calibration]` prints, per photo: outline overlap with `sphere_masks`, radius,
//! gain, residual on the sphere, and the residual of the light applied to the true normals;
//! `overlays=DIR` writes a picture per view; `anchors` adds anchors made from the truth, `own` fits
//! on anchors alone; `posed=RUN/3_poses/posed_views.json` takes poses, anchors and sphere of a run.
//! `SET` is a folder with `photos`, `masks`, `truth` as in `studio_stone`.

mod data;

use data::Set;
use rilievo_io::{Preview, write_preview_png};
use rilievo_lighting::{LightingOptions, LightingRequest, overlays, run};
use rilievo_photometry::sphere::{SphereInCamera, SphereOptions, WorldScale, locate_request};
use rilievo_photometry::surface_check::check;
use rilievo_scene::{
    Finding, LightKind, MarkedSphere, Recorder, Scale, ScaleSource, Silent, SphereRequest, Unit,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = arguments.first().ok_or("give the folder of a set")?;
    let has = |word: &str| arguments.iter().any(|a| a == word);
    let mut set = Set::load(std::path::Path::new(folder), has("linear"))?;
    let request = SphereRequest {
        spheres: if has("marks") {
            vec![MarkedSphere::only(set.radius, set.marks.clone())]
        } else {
            Vec::new()
        },
        search_radius: (!has("marks")).then_some(set.radius),
        light: has("camera").then_some(LightKind::Camera),
        calibration: if has("calibration") {
            set.calibration.clone()
        } else {
            Vec::new()
        },
    };
    // The world shrunk by an arbitrary factor, as poses without scale are.
    let shrink = if has("metric") { 1.0 } else { 0.37 };
    for view in &mut set.posed.views {
        view.cam_from_world.translation *= shrink;
    }
    let scale = if has("metric") {
        WorldScale::Metric
    } else {
        WorldScale::Free
    };
    let options = SphereOptions::default();
    let start = std::time::Instant::now();
    let found = locate_request(&set.photos, &set.posed.views, &request, scale, &options, 2)?;
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
    for view in &mut set.posed.views {
        view.cam_from_world.translation /= shrink;
    }
    let to_metres = if has("metric") {
        1.0
    } else {
        own_scale.metres_per_unit
    };
    let error: f64 = (0..3)
        .map(|k| (sphere.center_in_world[k] * to_metres - set.center[k]).powi(2))
        .sum::<f64>()
        .sqrt();
    // The error of the centre in the true world, scale apart.
    let place: f64 = (0..3)
        .map(|k| (sphere.center_in_world[k] / shrink - set.center[k]).powi(2))
        .sum::<f64>()
        .sqrt();
    println!(
        "seen in {} of {}; centre off by {:.3} mm ({:.3} mm by its own scale), sigma {:.3} mm; \
         scale off by {:+.3} %, sigma {:.3} %",
        sphere.seen_in.len(),
        set.posed.views.len(),
        1e3 * place,
        1e3 * error,
        1e3 * sphere
            .center_sigma
            .iter()
            .map(|s| s * s)
            .sum::<f64>()
            .sqrt()
            / shrink,
        100.0 * (own_scale.metres_per_unit * shrink - 1.0),
        100.0 * own_scale.relative_sigma,
    );
    for k in 0..3 {
        sphere.center_in_world[k] /= shrink;
    }
    sphere.radius /= shrink;
    for agreement in &fit.views {
        let view = set
            .posed
            .views
            .iter()
            .find(|v| v.photo == agreement.photo)
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
    if let Some(path) = arguments.iter().find_map(|a| a.strip_prefix("posed=")) {
        set.posed = serde_json::from_reader(std::fs::File::open(path)?)?;
        println!(
            "{} views, {} anchors from {path}",
            set.posed.views.len(),
            set.posed.anchors.len()
        );
    }
    let options = LightingOptions::default();
    let start = std::time::Instant::now();
    if set.posed.anchors.is_empty() && (has("own") || has("anchors")) {
        let noise = arguments
            .iter()
            .find_map(|a| a.strip_prefix("noise=")?.parse().ok());
        set.posed.anchors = set.true_anchors(24, noise.unwrap_or(5e-4))?;
    }
    let request = if has("own") {
        LightingRequest::OwnShape
    } else {
        LightingRequest::Sphere(request)
    };
    let told = Recorder::default();
    let (calibration, report) = run(&set.photos, &set.posed, &request, &options, &told)?;
    println!(
        "light in {:.2} s from {:?}",
        start.elapsed().as_secs_f64(),
        report.source
    );
    for channel in &report.channels {
        println!("  {channel:?}");
    }
    println!(
        "  {:?}\n  gains applied {}",
        report.kind_check, report.gains_applied
    );
    if let Some(object) = &report.object {
        println!("  {object:?}");
    }
    let used = (calibration.source, calibration.views.as_slice());
    let (photos, posed) = (&set.photos, &set.posed);
    let shape = set.true_shape()?;
    let surface = check(photos, posed, used, &shape, &Silent)?;
    for (view, facts) in calibration.views.iter().zip(&report.views) {
        println!(
            "  {} pixels {} clipped {:.2} hidden {:.2} residual {:?} gain {:.3?} ± {:.4?} true {:.3?} \
             | on true normals {:.1} %{}",
            facts.name,
            facts.num_pixels,
            facts.clipped_share,
            facts.hidden_share,
            view.residual.map(|r| (1000.0 * r).round() / 1000.0),
            facts.gain,
            facts.gain_sigma,
            set.true_gain(view.view.0),
            100.0 * set.residual_on_truth(view.view.0, &view.lighting)?,
            facts
                .left_out
                .clone()
                .map(|r| format!(" LEFT OUT: {r}"))
                .unwrap_or_default()
        );
    }
    if let Some(folder) = arguments.iter().find_map(|a| a.strip_prefix("overlays=")) {
        for overlay in overlays(&set.photos, &set.posed, &calibration)? {
            let path = std::path::Path::new(folder).join(format!("{}.png", overlay.name));
            write_preview_png(&path, Preview::Linear(&overlay.picture), usize::MAX)?;
        }
    }
    for view in &surface.views {
        println!("  {view:?}");
    }
    let findings = surface.findings();
    let found = findings.iter().map(Finding::sentence);
    for line in told.warnings().into_iter().chain(found) {
        println!("  ! {line}");
    }
    Ok(())
}
