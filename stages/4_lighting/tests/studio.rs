//! Sphere, scale, gains and light on the shared photo sets, where they are present.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

#[path = "../examples/sphere_report/data.rs"]
#[allow(dead_code)]
mod data;

use data::Set;
use rilievo_lighting::{LightingOptions, LightingRequest, run};
use rilievo_photometry::sphere::{SphereOptions, WorldScale, locate_request};
use rilievo_scene::{Silent, SphereRequest};
use std::path::PathBuf;

/// The world's unknown unit: poses without scale.
const SHRINK: f64 = 0.37;

fn set(name: &str) -> Option<Set> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let folder = root
        .ancestors()
        .map(|above| above.join("shared/data").join(name))
        .find(|folder| folder.is_dir());
    match folder {
        Some(folder) => Some(Set::load(&folder, false).unwrap()),
        None => {
            eprintln!("skipped: no shared/data/{name} beside the repository");
            None
        }
    }
}

fn find(radius: f64) -> SphereRequest {
    SphereRequest {
        radius: Some(radius),
        detect: true,
        ..SphereRequest::default()
    }
}

#[test]
fn sphere_cut_by_the_frame_and_clipped_is_found_and_gives_scale_and_gains() {
    let Some(mut set) = set("studio_stained") else {
        return;
    };
    let mut shrunk = set.posed.views.clone();
    for view in &mut shrunk {
        view.cam_from_world.translation *= SHRINK;
    }
    let request = find(set.radius);
    let options = SphereOptions::default();
    let fit = locate_request(&set.photos, &shrunk, &request, WorldScale::Free, &options).unwrap();
    assert_eq!(fit.sphere.seen_in.len(), 4, "{:?}", fit.views);
    let scale = fit.metres_per_unit * SHRINK;
    assert!((scale - 1.0).abs() < 0.003, "scale {scale}");
    let mut sphere = fit.sphere;
    let mut off = 0.0;
    for (found, truth) in sphere.center_in_world.iter_mut().zip(set.center) {
        *found /= SHRINK;
        off += (*found - truth).powi(2);
    }
    sphere.radius /= SHRINK;
    assert!(off.sqrt() < 0.0005, "centre off by {} m", off.sqrt());
    set.posed.sphere = Some(sphere);
    let request = LightingRequest::Sphere(find(set.radius));
    let options = LightingOptions::default();
    let (calibration, report) = run(&set.photos, &set.posed, &request, &options, &Silent).unwrap();
    assert!(report.gains_applied);
    for view in &calibration.views {
        let truth = set.true_gain(view.view.0).unwrap();
        for gain in &view.gain {
            assert!(
                (gain / truth - 1.0).abs() < 0.02,
                "gain {gain}, true {truth}"
            );
        }
    }
}

#[test]
fn no_sphere_is_found_where_there_is_none() {
    let Some(set) = set("sokrates8") else {
        return;
    };
    let options = SphereOptions::default();
    let views = &set.posed.views[..4];
    let result = locate_request(&set.photos, views, &find(0.04), WorldScale::Free, &options);
    assert!(result.is_err(), "{result:?}");
}
