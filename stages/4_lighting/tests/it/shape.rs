//! Light from a known shape and from the object's own anchors; the correction of a sphere's light
//! that is wrong for the object; the check on the surface.

use nalgebra::{Point2, Point3, Vector3};
use rilievo_lighting::{
    LightingError, LightingOptions, LightingRequest, ObjectLight, fit_on_shape, run,
};
use rilievo_photometry::harmonics::{dominant_direction, rotate};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_photometry::surface_check::{WRONG_LIGHT_RATIO, check};
use rilievo_scene::{
    DepthMap, Intrinsics, LightKind, Lighting, LightingCalibration, NormalMap, Photo, PhotoSet,
    PosedViews, Recorder, ShadedView, ShadedViews, Silent, SphereRequest, ViewIdx,
};
use rilievo_synthetic::testing::{
    Maps, PosedPhotos, Random, anchors_on_grid, in_memory, look_at, painted, photo, tinted_light,
    true_sphere,
};
use std::sync::Arc;

const NUM_VIEWS: usize = 4;
/// The object: an ellipsoid with these semi-axes at the origin, metres.
const AXES: [f64; 3] = [0.09, 0.12, 0.07];
const BALL_RADIUS: f64 = 0.03;

fn ball_center() -> Point3<f64> {
    Point3::new(0.2, 0.0, 0.02)
}

fn environment(tilt: f64) -> Lighting {
    let (x, z) = (0.15 + tilt, 0.25 - tilt);
    tinted_light([x, 0.3, z, 0.45, 0.03, 0.04, 0.02, -0.03, 0.02])
}

/// Distance along a ray to the object, and its normal, both in the world.
fn hit_object(origin: &Point3<f64>, ray: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let squash = |v: &Vector3<f64>| Vector3::new(v.x / AXES[0], v.y / AXES[1], v.z / AXES[2]);
    let (o, d) = (squash(&origin.coords), squash(ray));
    let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return None;
    }
    let t = (-b - discriminant.sqrt()) / a;
    Some((t, squash(&squash(&(origin.coords + ray * t))).normalize()))
}

struct World {
    photos: PhotoSet,
    posed: PosedViews,
    depths: Vec<DepthMap>,
    normals: Vec<NormalMap>,
}

/// The object under one light, a sphere beside it under another, both at rest.
fn world(on_object: &Lighting, on_ball: &Lighting, albedo: f64) -> World {
    lit(on_object, on_ball, albedo, LightKind::World)
}

/// [`world`], with the lights fixed to the world or the camera.
fn lit(on_object: &Lighting, on_ball: &Lighting, albedo: f64, kind: LightKind) -> World {
    let camera = Intrinsics::pinhole(260, 200, 420.0, 129.5, 99.5);
    let mut made = PosedPhotos::default();
    let (mut depths, mut normals) = (Vec::new(), Vec::new());
    for k in 0..NUM_VIEWS {
        let angle = -0.6 + 0.4 * k as f64;
        let eye = Point3::new(angle.sin() + 0.05, 0.2, angle.cos()) * 0.8;
        let pose = look_at(eye, Point3::new(0.06, 0.0, 0.0), Vector3::y());
        let ball = SphereInCamera {
            center: pose.apply(&ball_center()),
            radius: BALL_RADIUS,
        };
        let object = |[x, y]: [f64; 2]| {
            let ray_in_cam = camera.ray(&Point2::new(x, y)).normalize();
            let (t, n) = hit_object(&eye, &(pose.rotation.inverse() * ray_in_cam))?;
            Some((ray_in_cam.z * t, pose.rotation * n))
        };
        let image = painted(&camera, 0.1, |pixel| {
            let (light, n, factor) = match object(pixel) {
                Some((_, n)) => (on_object, n, albedo),
                None => (on_ball, ball.normal_at(&camera, &pixel.into())?, 1.0),
            };
            let n = match kind {
                LightKind::World => pose.rotation.inverse() * n,
                LightKind::Camera => n,
            };
            let channel = |c: usize| (factor * light.channels[c].evaluate(&n)).max(0.0);
            Some([channel(0), channel(1), channel(2)])
        });
        let maps = Maps::of(&camera, object);
        let photo = Photo {
            mask: Some(Arc::new(maps.mask.packed())),
            ..photo(&format!("view{k}.png"), image, camera)
        };
        made.push(photo, pose);
        depths.push(maps.depth);
        normals.push(maps.normal);
    }
    let PosedPhotos { photos, mut posed } = made;
    let center = ball_center().coords.into();
    posed.spheres.push(true_sphere(center, BALL_RADIUS));
    let mut random = Random(5);
    // Half a thousandth of noise in depth.
    posed.anchors = anchors_on_grid(&posed, &depths, 6, 0.01, || {
        1.0 + 1e-3 * (random.unit() - 0.5)
    });
    World {
        photos,
        posed,
        depths,
        normals,
    }
}

/// Relative residual of a lighting on the true normals.
fn residual(made: &World, view: usize, lighting: &Lighting) -> f64 {
    let image = made.photos.photos[view].linear().unwrap();
    let (mut error, mut size) = (0.0, 0.0);
    for y in 0..image.height {
        for x in 0..image.width {
            if let Some(n) = made.normals[view].normal(x, y) {
                for (l, v) in lighting.channels.iter().zip(image.pixel(x, y)) {
                    error += (l.evaluate(&n) - f64::from(*v)).powi(2);
                    size += f64::from(*v).powi(2);
                }
            }
        }
    }
    (error / size).sqrt()
}

fn angle_deg(a: &Lighting, b: &Lighting) -> f64 {
    dominant_direction(a)
        .unwrap()
        .angle(&dominant_direction(b).unwrap())
        .to_degrees()
}

fn sphere_request() -> LightingRequest {
    LightingRequest::Sphere(SphereRequest {
        light: Some(LightKind::World),
        ..SphereRequest::default()
    })
}

#[test]
fn a_known_shape_gives_its_light_and_other_sizes_are_refused() {
    let light = environment(0.0);
    let made = world(&light, &light, 1.0);
    let options = LightingOptions::default();
    let image = made.photos.photos[1].linear().unwrap();
    let view = &made.posed.views[1];
    let (found, fit) = fit_on_shape(
        &image,
        made.photos.photos[1].mask.as_deref(),
        &view.intrinsics,
        &made.depths[1],
        1.0,
    )
    .unwrap();
    let truth = rotate(&light, &view.cam_from_world.rotation);
    let (angle, rms) = (angle_deg(&found, &truth), fit.relative_rms());
    assert!(
        angle < 0.6 && rms < 0.01,
        "direction off by {angle}°, residual {rms}"
    );
    let small = DepthMap::filled(10, 10, 1.0);
    let result = fit_on_shape(&image, None, &view.intrinsics, &small, 1.0);
    assert!(matches!(result, Err(LightingError::ShapeSize { .. })));
    let shapes = vec![(ViewIdx(0), made.depths[0].clone())];
    let request = LightingRequest::Shape(shapes);
    let told = Recorder::default();
    let (calibration, _) = run(&made.photos, &made.posed, &request, &options, &told).unwrap();
    assert_eq!(calibration.views.len(), 1);
    let warnings = told.warnings();
    assert_eq!(warnings.len(), NUM_VIEWS - 1, "{warnings:?}");
}

#[test]
fn a_known_shape_and_given_lightings_tell_what_the_light_is_fixed_to() {
    for kind in [LightKind::World, LightKind::Camera] {
        let light = environment(0.0);
        let mut made = lit(&light, &light, 1.0, kind);
        // Exposures of two photos differ, and noise.
        for (k, photo) in made.photos.photos.iter_mut().enumerate() {
            let mut image = photo.linear().unwrap().as_ref().clone();
            let gain = [1.0, 0.8, 1.1, 1.0][k];
            for (j, value) in image.data.iter_mut().enumerate() {
                *value *= gain * (1.0 + 0.05 * (12.9 * j as f32).sin());
            }
            photo.pixels = in_memory(image);
        }
        let run = |request: &LightingRequest| {
            let options = LightingOptions::default();
            run(&made.photos, &made.posed, request, &options, &Silent).unwrap()
        };
        let shapes = (0..NUM_VIEWS)
            .map(|k| (ViewIdx(k), made.depths[k].clone()))
            .collect();
        let (of_shape, report) = run(&LightingRequest::Shape(shapes));
        assert_eq!(of_shape.kind, kind, "{:?}", report.kind_check);
        let given = of_shape
            .views
            .iter()
            .map(|v| (made.posed.views[v.view.0].name.clone(), v.lighting.clone()))
            .collect();
        let (of_file, _) = run(&LightingRequest::Given(given));
        assert_eq!(of_file.kind, kind);
        let (of_anchors, report) = run(&LightingRequest::OwnShape);
        assert_eq!(of_anchors.kind, kind, "{:?}", report.kind_check);
        let one = vec![("*".to_owned(), of_shape.views[0].lighting.clone())];
        assert_eq!(run(&LightingRequest::Given(one)).0.kind, LightKind::Camera);
    }
}

#[test]
fn anchors_alone_give_a_light_that_is_marked_uncalibrated() {
    let light = environment(0.0);
    let made = world(&light, &light, 1.0);
    let options = LightingOptions::default();
    let request = LightingRequest::OwnShape;
    let told = Recorder::default();
    let (calibration, report) = run(&made.photos, &made.posed, &request, &options, &told).unwrap();
    assert!(report.uncalibrated && !told.warnings().is_empty());
    for view in &calibration.views {
        let rms = residual(&made, view.view.0, &view.lighting);
        assert!(rms < 0.05, "view {}: {rms}", view.view);
    }
}

#[test]
fn a_sphere_in_another_light_is_overruled_by_the_object_and_reported() {
    let made = world(&environment(0.0), &environment(-0.25), 1.0);
    let options = LightingOptions::default();
    let told = Recorder::default();
    let (corrected, report) = run(
        &made.photos,
        &made.posed,
        &sphere_request(),
        &options,
        &told,
    )
    .unwrap();
    let object = report.object.clone().unwrap();
    assert!(object.light_replaced, "{object:?}");
    // Shape solved under the object's own light does not suffer: a fact of the report, not an alarm.
    assert!(told.warnings().is_empty(), "{:?}", told.warnings());
    for view in &object.views {
        let [used, own] =
            [view.used_rms_after_albedo, view.cross_validated_rms].map(Option::unwrap);
        assert!(used > WRONG_LIGHT_RATIO * own, "{view:?}");
    }
    let untouched = LightingOptions {
        object_light: ObjectLight::Off,
        ..options.clone()
    };
    let (plain, _) = run(
        &made.photos,
        &made.posed,
        &sphere_request(),
        &untouched,
        &Silent,
    )
    .unwrap();
    for k in 0..NUM_VIEWS {
        let before = residual(&made, k, &plain.views[k].lighting);
        let after = residual(&made, k, &corrected.views[k].lighting);
        assert!(
            before > 0.1 && after < 0.05,
            "view {k}: {before} before, {after} after"
        );
        // The anchors predict what the surface shows later.
        let predicted = object.views[k].used_rms.unwrap();
        assert!(
            (predicted / before - 1.0).abs() < 0.33,
            "{predicted} for {before}"
        );
    }
    let shaded = ShadedViews {
        views: (0..NUM_VIEWS)
            .map(|k| ShadedView {
                view: ViewIdx(k),
                name: format!("view{k}"),
                depth: made.depths[k].clone(),
                normal: made.normals[k].clone(),
                confidence: None,
                rendered: None,
                albedo: None,
            })
            .collect(),
    };
    let check_of = |calibration: &LightingCalibration, shaded: &ShadedViews| {
        let used = (calibration.source, calibration.views.as_slice());
        let (photos, posed) = (&made.photos, &made.posed);
        check(photos, posed, used, shaded, &Silent).unwrap()
    };
    let bad = check_of(&plain, &shaded);
    assert!(
        bad.views.iter().any(|v| v.suffers) && !bad.findings().is_empty(),
        "{bad:?}"
    );
    let good = check_of(&corrected, &shaded);
    assert!(good.findings().is_empty(), "{:?}", good.findings());
    // A model that allows for what the sphere did not see explains the photos, and is not hurt.
    let mut explained = shaded;
    for (view, photo) in explained.views.iter_mut().zip(&made.photos.photos) {
        view.rendered = Some((*photo.linear().unwrap()).clone());
    }
    let unhurt = check_of(&plain, &explained);
    assert!(unhurt.findings().is_empty(), "{:?}", unhurt.findings());
}

#[test]
fn a_darker_object_only_scales_the_light() {
    let light = environment(0.0);
    let made = world(&light, &light, 0.7);
    let options = LightingOptions::default();
    let (calibration, report) = run(
        &made.photos,
        &made.posed,
        &sphere_request(),
        &options,
        &Silent,
    )
    .unwrap();
    let object = report.object.unwrap();
    assert!(
        object.factor_applied && !object.light_replaced,
        "{object:?}"
    );
    let off = (object.albedo_factor / 0.7 - 1.0).abs();
    assert!(off < 0.02, "albedo factor {}", object.albedo_factor);
    for view in &calibration.views {
        let rms = residual(&made, view.view.0, &view.lighting);
        assert!(rms < 0.03, "view {}: {rms}", view.view);
    }
}
