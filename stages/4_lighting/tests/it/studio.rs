//! Sphere, scale, gains and light on the shared photo sets, where they are present.

#[path = "../../../../benches/measure/data_set.rs"]
#[allow(dead_code)]
mod data_set;

use data_set::Set;
use rilievo_lighting::{LightingOptions, LightingRequest, run};
use rilievo_photometry::sphere::{SphereInCamera, SphereOptions, WorldScale, locate_request};
use rilievo_photometry::surface_check::check;
use rilievo_scene::{MarkedSphere, ShadedViews, Silent, SphereRequest};
use rilievo_synthetic::testing::{Random, shared_data};

/// The world's unknown unit: poses without scale.
const SHRINK: f64 = 0.37;

fn set(name: &str) -> Option<Set> {
    Some(Set::load(&shared_data(name)?, false, &[]).unwrap())
}

fn find(radius: f64) -> SphereRequest {
    SphereRequest {
        search_radius: Some(radius),
        ..SphereRequest::default()
    }
}

#[test]
fn sphere_cut_by_the_frame_and_clipped_is_found_and_gives_scale_and_gains() {
    let Some(mut set) = set("studio_stained") else {
        return;
    };
    locate_in(&mut set, 4);
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
    let result = locate_request(
        &set.photos,
        views,
        &find(0.04),
        WorldScale::Free,
        &options,
        2,
    );
    assert!(result.is_err(), "{result:?}");
}

#[test]
fn masks_of_a_sphere_cut_by_the_frame_give_the_size_whatever_edges_the_photos_show() {
    for name in ["studio_real", "studio_near"] {
        let Some(set) = set(name) else {
            return;
        };
        let request = SphereRequest {
            spheres: vec![MarkedSphere {
                name: MarkedSphere::ONLY.to_owned(),
                radius: set.radius,
                marks: set.marks.clone(),
                center_in_world: None,
            }],
            ..SphereRequest::default()
        };
        let (views, options) = (&set.posed.views, SphereOptions::default());
        let found = locate_request(&set.photos, views, &request, WorldScale::Free, &options, 2);
        let found = found.unwrap().scale.estimate.unwrap();
        let (off, sigma) = (found.metres_per_unit - 1.0, found.relative_sigma);
        assert!(
            off.abs() < 1e-3 && off.abs() < sigma,
            "{name}: {off}, stated {sigma}"
        );
    }
}

/// Finds the sphere in a world of unknown unit, and checks in how many photos, overlap, place and
/// scale.
fn locate_in(set: &mut Set, num_views: usize) {
    let mut shrunk = set.posed.views.clone();
    for view in &mut shrunk {
        view.cam_from_world.translation *= SHRINK;
    }
    let request = find(set.radius);
    let options = SphereOptions::default();
    let found = locate_request(
        &set.photos,
        &shrunk,
        &request,
        WorldScale::Free,
        &options,
        2,
    )
    .unwrap();
    assert!(found.other_sizes.is_empty(), "{:?}", found.other_sizes);
    assert_eq!(found.fits.len(), 1, "{:?}", found.fits);
    let fit = &found.fits[0];
    assert_eq!(fit.sphere.seen_in.len(), num_views, "{:?}", fit.views);
    let scale = found.scale.estimate.unwrap().metres_per_unit * SHRINK;
    assert!((scale - 1.0).abs() < 0.003, "scale {scale}");
    let mut sphere = fit.sphere.clone();
    let mut off = 0.0;
    for (found, truth) in sphere.center_in_world.iter_mut().zip(set.center) {
        *found /= SHRINK;
        off += (*found - truth).powi(2);
    }
    sphere.radius /= SHRINK;
    assert!(off.sqrt() < 0.0005, "centre off by {} m", off.sqrt());
    for view in &set.posed.views {
        let in_camera = SphereInCamera::seen(&sphere, &view.cam_from_world);
        let overlap = set.overlap(view.photo, &in_camera, &view.intrinsics);
        assert!(overlap >= 0.97, "{}: IoU {overlap}", view.name);
    }
    set.posed.spheres = vec![sphere];
}

#[test]
fn the_sphere_of_a_smooth_object_is_found_in_all_photos() {
    if let Some(mut set) = set("studio_smooth") {
        locate_in(&mut set, 8);
    }
}

/// The shape with normals tilted at random by `tilt` (radians, root mean square).
fn roughened(shape: &ShadedViews, tilt: f32) -> ShadedViews {
    let mut random = Random(11);
    // Uniform deviates of unit variance.
    let mut deviate = || (random.unit() as f32 - 0.5) * 12.0_f32.sqrt();
    let mut rough = shape.clone();
    for view in &mut rough.views {
        for normal in view.normal.data.iter_mut().filter(|n| n[2] != 0.0) {
            // Of three random components, the two across the normal tilt it.
            let tilted =
                nalgebra::Vector3::from(normal.map(|n| n + tilt / 2.0_f32.sqrt() * deviate()));
            *normal = tilted.normalize().into();
        }
    }
    rough
}

#[test]
fn a_calibration_photo_gives_the_objects_light_and_a_sphere_beside_it_is_warned_of() {
    let Some(mut set) = set("studio_stone") else {
        return;
    };
    locate_in(&mut set, 8);
    let mut request = find(set.radius);
    // The sphere's own light, as it is without the object's say.
    let options = LightingOptions {
        object_light: rilievo_lighting::ObjectLight::Off,
        ..LightingOptions::default()
    };
    let shape = set.true_shape().unwrap();
    let judge = |request: &SphereRequest, shape: &ShadedViews| {
        let light = LightingRequest::Sphere(request.clone());
        let (calibration, _) = run(&set.photos, &set.posed, &light, &options, &Silent).unwrap();
        let residuals: Vec<f64> = calibration
            .views
            .iter()
            .map(|view| set.residual_on_truth(view.view.0, &view.lighting).unwrap())
            .collect();
        let used = (calibration.source, calibration.views.as_slice());
        let (photos, posed) = (&set.photos, &set.posed);
        let surface = check(photos, posed, used, shape, &Silent);
        (residuals, surface.unwrap())
    };
    let (side, surface) = judge(&request, &shape);
    let mean = side.iter().sum::<f64>() / side.len() as f64;
    // What a plain robust fit on the true sphere gives is 20.0 % on average.
    assert!(mean < 0.2005, "{side:?}");
    assert!(!surface.findings().is_empty());
    // Normals as wrong as those of a reconstruction still tell how wrong the light is.
    let (_, surface) = judge(&request, &roughened(&shape, 0.12));
    for (view, truth) in surface.views.iter().zip(&side) {
        let told = view.used_rms;
        assert!(
            (told / truth - 1.0).abs() < 0.33,
            "{}: {told} told, {truth} true",
            view.name
        );
    }
    request.calibration = set.calibration.clone();
    let (placed, surface) = judge(&request, &shape);
    for residual in &placed {
        assert!(*residual <= 0.125, "{placed:?}");
    }
    assert!(surface.findings().is_empty(), "{:?}", surface.findings());
}
