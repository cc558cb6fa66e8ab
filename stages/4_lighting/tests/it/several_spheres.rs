//! Rungs of two matte spheres in one scene: exact, noise, one in a shadow, another paint, a wrong
//! radius.

use nalgebra::{Point2, Point3, Vector3};
use rilievo_lighting::{LightingOptions, LightingReport, LightingRequest, overlays, run};
use rilievo_photometry::sphere::{
    LocatedSpheres, ScaleOutcome, SphereInCamera, SphereOptions, WorldScale, locate_request,
};
use rilievo_scene::{
    LightKind, Lighting, LightingCalibration, MarkedSphere, PhotoIdx, PhotoSet, PosedViews,
    Recorder, SphereMark, SphereRequest,
};
use rilievo_synthetic::testing::{PosedPhotos, rendered_photo};
use rilievo_synthetic::{
    BallOptions, LightModel, ReferenceSphere, RenderOptions, Renderer, Scene, SceneOptions, Subject,
};

/// The world's unknown unit: poses without scale.
const SHRINK: f64 = 0.37;
/// Radius of the first sphere, metres.
const RADIUS: f64 = 0.03;

/// Photographs of two spheres beside an object.
struct World {
    photos: PhotoSet,
    /// In a world of unknown unit.
    posed: PosedViews,
    spheres: Vec<ReferenceSphere>,
    /// True light of every view.
    lights: Vec<Lighting>,
    masks: Vec<Vec<rilievo_scene::Mask>>,
}

/// Four photos under exact harmonics; `tint` multiplies the second sphere's pixels by its world
/// normal.
fn world(second_radius: f64, noise: f64, tint: impl Fn(&Vector3<f64>) -> [f64; 3]) -> World {
    let scene = Scene::new(SceneOptions {
        subject: Subject::Ellipsoid,
        relief: 0.0,
        mesh_spacing_m: 0.006,
        sphere_radius_m: RADIUS,
        more_spheres: vec![BallOptions {
            at_m: [-0.19, -0.05],
            radius_m: second_radius,
        }],
        ..SceneOptions::default()
    })
    .unwrap();
    let options = RenderOptions {
        num_views: 4,
        light: LightModel::Harmonics,
        noise,
        ..RenderOptions::default()
    };
    let renderer = Renderer::new(&scene, &options).unwrap();
    let mut made = PosedPhotos::default();
    let (mut lights, mut masks) = (Vec::new(), Vec::new());
    for k in 0..options.num_views {
        let mut view = renderer.render(k).unwrap();
        let second = SphereInCamera {
            center: view
                .cam_from_world
                .apply(&Point3::from(scene.spheres[1].center_in_world)),
            radius: second_radius,
        };
        for y in 0..view.image.height {
            for x in (0..view.image.width).filter(|&x| *view.sphere_masks[1].at(x, y)) {
                let at = Point2::new(x as f64, y as f64);
                let Some(normal) = second.normal_at(&view.intrinsics, &at) else {
                    continue;
                };
                let factor = tint(&(view.cam_from_world.rotation.inverse() * normal));
                for (value, factor) in view.image.pixel_mut(x, y).iter_mut().zip(factor) {
                    *value *= factor as f32;
                }
            }
        }
        let mut cam_from_world = view.cam_from_world;
        cam_from_world.translation *= SHRINK;
        let photo = rendered_photo(&format!("{}.png", view.name), &view);
        made.push(photo, cam_from_world);
        lights.push(view.lighting);
        masks.push(view.sphere_masks);
    }
    World {
        photos: made.photos,
        posed: made.posed,
        spheres: scene.spheres,
        lights,
        masks,
    }
}

/// Both spheres, marked in the first and the last photo, with the radii stated.
fn marked(world: &World, radii: [f64; 2]) -> SphereRequest {
    let sphere = |k: usize| {
        let mark = |view: usize| {
            let mask = world.masks[view][k].clone();
            (PhotoIdx(view), SphereMark::Mask(mask))
        };
        MarkedSphere {
            name: ["left", "right"][k].to_owned(),
            ..MarkedSphere::only(radii[k], vec![mark(0), mark(3)])
        }
    };
    SphereRequest {
        spheres: vec![sphere(0), sphere(1)],
        ..SphereRequest::default()
    }
}

fn located(world: &World, request: &SphereRequest) -> LocatedSpheres {
    let views = &world.posed.views;
    let options = SphereOptions::default();
    locate_request(&world.photos, views, request, WorldScale::Free, &options, 2).unwrap()
}

/// Error of the common scale, and of each centre in metres with its stated deviation.
fn errors(world: &World, found: &LocatedSpheres) -> (f64, Vec<(f64, f64)>) {
    let scale = found.scale.estimate.unwrap().metres_per_unit;
    let centers = found.fits.iter().map(|fit| {
        let at = Point3::from(fit.sphere.center_in_world.map(|c| c / SHRINK));
        let sigma: f64 = fit.sphere.center_sigma.iter().map(|s| s * s).sum();
        let distance = |truth: &ReferenceSphere| (at - Point3::from(truth.center_in_world)).norm();
        let nearest = world.spheres.iter().map(distance).fold(f64::MAX, f64::min);
        (nearest, sigma.sqrt() / SHRINK)
    });
    ((scale * SHRINK - 1.0).abs(), centers.collect())
}

/// The light, its report, and what was warned of.
fn lit(
    world: &mut World,
    request: SphereRequest,
) -> (LightingCalibration, LightingReport, Vec<String>) {
    let found = located(world, &request);
    world.posed.spheres = found.fits.into_iter().map(|fit| fit.sphere).collect();
    let request = LightingRequest::Sphere(request);
    let options = LightingOptions::default();
    let told = Recorder::default();
    let (calibration, report) =
        run(&world.photos, &world.posed, &request, &options, &told).unwrap();
    (calibration, report, told.warnings())
}

/// Largest relative difference (root mean square over the visible half) from a view's true light.
fn light_error(world: &World, calibration: &LightingCalibration) -> f64 {
    let of_view = |(found, truth): (&Lighting, &Lighting)| {
        let (mut error, mut size) = (0.0, 0.0);
        for k in 0..400 {
            let z = -(f64::from(k) + 0.5) / 400.0;
            let angle = f64::from(k) * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let n = Vector3::new(r * angle.cos(), r * angle.sin(), z);
            for (l, t) in found.channels.iter().zip(&truth.channels) {
                error += (l.evaluate(&n) - t.evaluate(&n)).powi(2);
                size += t.evaluate(&n).powi(2);
            }
        }
        (error / size).sqrt()
    };
    let found = calibration.views.iter().map(|view| &view.lighting);
    found.zip(&world.lights).map(of_view).fold(0.0, f64::max)
}

fn told(warnings: &[String], parts: &[&str]) {
    let told = |w: &String| parts.iter().all(|part| w.contains(part));
    assert!(warnings.iter().any(told), "{parts:?} not in {warnings:?}");
}

#[test]
fn two_spheres_of_different_size_give_one_scale_and_one_light() {
    let mut world = world(0.02, 0.0, |_| [1.0; 3]);
    let request = marked(&world, [RADIUS, 0.02]);
    let found = located(&world, &request);
    assert!(found.scale.contradictions.is_empty(), "{:?}", found.scale);
    let (scale, centers) = errors(&world, &found);
    // Edges of photographs: a twentieth of a pixel of the smaller sphere's radius of about 30 px.
    let sigma = found.scale.estimate.unwrap().relative_sigma;
    assert!(
        scale < 2e-3 && scale < 3.0 * sigma,
        "scale off by {scale}, stated {sigma}"
    );
    for ((error, sigma), fit) in centers.iter().zip(&found.fits) {
        assert_eq!(
            fit.sphere.seen_in.len(),
            4,
            "marks in two photos predict the others"
        );
        assert!(
            *error < 2e-4 && *sigma < 5e-4,
            "centre off by {error} m, stated {sigma}"
        );
    }
    let (calibration, report, warnings) = lit(&mut world, request);
    let error = light_error(&world, &calibration);
    assert!(error < 3e-3, "light off by {error}");
    assert!(warnings.is_empty(), "{:?}", warnings);
    let views: Vec<usize> = report.spheres.iter().map(|s| s.views.len()).collect();
    assert_eq!(views, [4, 4]);
    let compared: Vec<_> = report.spheres.iter().filter_map(|s| s.other_rms).collect();
    assert!(compared.len() == 1 && compared[0] < 0.01, "{compared:?}");
    let pictures = overlays(&world.photos, &world.posed, &calibration).unwrap();
    // A row for each sphere: higher than the larger one alone, in three crops.
    for picture in pictures.iter().map(|p| &p.picture) {
        assert!(
            picture.height * 3 > picture.width + 30,
            "{} x {}",
            picture.width,
            picture.height
        );
    }
}

#[test]
fn noise_stays_within_the_stated_deviations() {
    let mut world = world(0.02, 0.01, |_| [1.0; 3]);
    let request = marked(&world, [RADIUS, 0.02]);
    let found = located(&world, &request);
    let (scale, centers) = errors(&world, &found);
    let sigma = found.scale.estimate.unwrap().relative_sigma;
    assert!(
        scale < 4.0 * sigma && sigma < 5e-3,
        "scale off by {scale}, stated {sigma}"
    );
    for (error, sigma) in centers {
        assert!(error < 4.0 * sigma, "centre off by {error}, stated {sigma}");
    }
    let (calibration, _, _) = lit(&mut world, request);
    let error = light_error(&world, &calibration);
    assert!(error < 0.01, "light off by {error}");
}

#[test]
fn a_search_finds_both_and_tells_one_of_another_size() {
    let search = |radius| SphereRequest {
        search_radius: Some(radius),
        ..SphereRequest::default()
    };
    let equal = world(RADIUS, 0.004, |_| [1.0; 3]);
    let found = located(&equal, &search(RADIUS));
    let names: Vec<&str> = found.fits.iter().map(|f| f.sphere.name.as_str()).collect();
    assert_eq!(names, ["sphere 1", "sphere 2"]);
    let (scale, centers) = errors(&equal, &found);
    assert!(scale < 2e-3, "scale off by {scale}");
    for (error, _) in &centers {
        assert!(*error < 5e-4, "centres off by {centers:?}");
    }
    let unequal = world(0.02, 0.004, |_| [1.0; 3]);
    let found = located(&unequal, &search(RADIUS));
    assert_eq!(found.fits.len(), 1);
    let [size] = found.other_sizes[..] else {
        panic!("{:?}", found.other_sizes);
    };
    let ratio = size.ln().abs() - (RADIUS / 0.02).ln();
    assert!(ratio.abs() < 0.01, "{size} times as large");
}

#[test]
fn a_sphere_in_a_shadow_is_named_and_left_out() {
    // Darkened towards one side, as by something that stands there.
    let mut world = world(0.02, 0.004, |n| {
        [1.0 - 0.35 * (1.0 + n.x + 0.3 * n.z).max(0.0); 3]
    });
    let request = marked(&world, [RADIUS, 0.02]);
    let (calibration, report, warnings) = lit(&mut world, request.clone());
    told(
        &warnings,
        &[
            "right does not see the light that left sees",
            "it is left out",
        ],
    );
    assert!(report.spheres[1].left_out && !report.spheres[0].left_out);
    assert_eq!(calibration.rejected_spheres(), [1]);
    let own = report.spheres[1].own_rms.unwrap();
    let other = report.spheres[1].other_rms.unwrap();
    assert!(own < 0.03 && other > 0.08, "own {own}, other {other}");
    let error = light_error(&world, &calibration);
    assert!(error < 0.01, "light off by {error}");
    let (_, _, warnings) = lit(
        &mut world,
        SphereRequest {
            light: Some(LightKind::Camera),
            ..request
        },
    );
    told(&warnings, &["right does not see the light that left sees"]);
}

#[test]
fn a_contact_shadow_on_each_is_rejected_in_the_common_fit() {
    let below = |n: &Vector3<f64>| if n.z < -0.35 { [0.3; 3] } else { [1.0; 3] };
    let mut world = world(0.02, 0.004, below);
    let request = marked(&world, [RADIUS, 0.02]);
    let (calibration, report, _) = lit(&mut world, request);
    assert!(
        report.spheres.iter().all(|s| !s.left_out),
        "{:?}",
        report.spheres
    );
    let error = light_error(&world, &calibration);
    assert!(error < 0.01, "light off by {error}");
}

#[test]
fn a_sphere_of_another_paint_counts_with_its_factor() {
    let paint = [0.7, 0.75, 0.8];
    let mut world = world(0.02, 0.004, |_| paint);
    let request = marked(&world, [RADIUS, 0.02]);
    let (calibration, report, warnings) = lit(&mut world, request);
    told(
        &warnings,
        &[
            "right is 0.70, 0.75, 0.80 times as bright as left",
            "per channel",
            "another paint",
        ],
    );
    let paints: Vec<_> = calibration.spheres.iter().map(|s| &s.paint).collect();
    assert!(
        paints[0].as_ref().is_some_and(|p| *p == [1.0; 3]),
        "{paints:?}"
    );
    assert!(calibration.rejected_spheres().is_empty(), "{paints:?}");
    for overlay in overlays(&world.photos, &world.posed, &calibration).unwrap() {
        let pixels = overlay.picture.data.chunks_exact(3);
        let far = pixels.filter(|p| *p == [0.05, 0.1, 0.9]).count();
        assert!(far < 50, "{}: {far} pixels drawn as far", overlay.name);
    }
    for (found, truth) in report.spheres[1].brightness_ratio.iter().zip(paint) {
        assert!((found / truth - 1.0).abs() < 0.01, "{found} for {truth}");
    }
    let error = light_error(&world, &calibration);
    assert!(error < 0.01, "light off by {error}");
}

#[test]
fn a_radius_that_is_wrong_by_a_twentieth_contradicts_the_other() {
    let world = world(0.02, 0.0, |_| [1.0; 3]);
    let found = located(&world, &marked(&world, [RADIUS, 1.05 * 0.02]));
    let common = &found.scale;
    let [told] = &common.contradictions[..] else {
        panic!("{:?}", common.contradictions);
    };
    let gap = told.ratio.ln().abs() - 1.05_f64.ln();
    assert!(gap.abs() < 3e-3, "{told:?}");
    assert_eq!(told.outcome, ScaleOutcome::Averaged);
    let scale = common.estimate.unwrap().metres_per_unit * SHRINK;
    assert!((1.0..1.05).contains(&scale), "scale {scale}");
}

#[test]
fn a_radius_in_another_unit_costs_the_scale_but_not_the_light() {
    let mut world = world(0.02, 0.0, |_| [1.0; 3]);
    let request = marked(&world, [RADIUS, 20.0]);
    let found = located(&world, &request);
    assert_eq!(found.fits.len(), 2, "{:?}", found.missing);
    assert_eq!(found.scale.estimate, None);
    let outcomes: Vec<_> = found
        .scale
        .contradictions
        .iter()
        .map(|c| c.outcome)
        .collect();
    assert_eq!(outcomes, [ScaleOutcome::NoScale]);
    let (calibration, _, _) = lit(&mut world, request);
    let error = light_error(&world, &calibration);
    assert!(error < 3e-3, "light off by {error}");
}
