//! Light from a known shape and from the object's own anchors; the correction of a sphere's light
//! that is wrong for the object; the check on the surface.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_lighting::{
    LightingError, LightingOptions, LightingRequest, ObjectLight, fit_on_shape, run,
};
use rilievo_photometry::harmonics::{dominant_direction, rotate};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_photometry::surface_check::check;
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, DepthMap, FocalSource, InMemoryPixels, Intrinsics,
    LightKind, Lighting, LightingCalibration, LinearImage, LocatedSphere, MarkedSphere, Photo,
    PhotoIdx, PhotoSet, PosedView, PosedViews, Raster, Recorder, RigidTransform, ShadedView,
    ShadedViews, Silent, SphereRequest, SphericalHarmonics, ViewIdx,
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
    let base = [
        0.15 + tilt,
        0.3,
        0.25 - tilt,
        0.45,
        0.03,
        0.04,
        0.02,
        -0.03,
        0.02,
    ];
    Lighting {
        channels: [1.0, 0.9, 0.8]
            .iter()
            .map(|tint| SphericalHarmonics(base.map(|l| l * tint)))
            .collect(),
    }
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
    normals: Vec<Raster<[f32; 3]>>,
}

/// The object under one light, a sphere beside it under another, both at rest.
fn world(on_object: &Lighting, on_ball: &Lighting, albedo: f64) -> World {
    lit(on_object, on_ball, albedo, LightKind::World)
}

/// [`world`], with the lights fixed to the world or the camera.
fn lit(on_object: &Lighting, on_ball: &Lighting, albedo: f64, kind: LightKind) -> World {
    let intrinsics = Intrinsics::pinhole(260, 200, 420.0, 129.5, 99.5);
    let mut made = World {
        photos: PhotoSet::default(),
        posed: PosedViews::default(),
        depths: Vec::new(),
        normals: Vec::new(),
    };
    for k in 0..NUM_VIEWS {
        let angle = -0.6 + 0.4 * k as f64;
        let eye = Point3::new(angle.sin() + 0.05, 0.2, angle.cos()) * 0.8;
        let forward = (Point3::new(0.06, 0.0, 0.0) - eye).normalize();
        let right = forward.cross(&Vector3::y()).normalize();
        let world_from_cam =
            Rotation3::from_basis_unchecked(&[right, forward.cross(&right), forward]);
        let pose = RigidTransform::from_world_pose(world_from_cam, eye);
        let ball = SphereInCamera {
            center: pose.apply(&ball_center()),
            radius: BALL_RADIUS,
        };
        let mut image = LinearImage::filled(intrinsics.width, intrinsics.height, 3, 0.1);
        let mut depth = DepthMap::filled(intrinsics.width, intrinsics.height, 0.0);
        let mut normals = Raster::filled(intrinsics.width, intrinsics.height, [0.0; 3]);
        let mut mask = Raster::filled(intrinsics.width, intrinsics.height, false);
        for y in 0..intrinsics.height {
            for x in 0..intrinsics.width {
                let pixel = Point2::new(x as f64, y as f64);
                let ray_in_cam = intrinsics.ray(&pixel).normalize();
                let ray = pose.rotation.inverse() * ray_in_cam;
                let mut paint = |light: &Lighting, n: &Vector3<f64>, factor: f64| {
                    let n = &match kind {
                        LightKind::World => *n,
                        LightKind::Camera => pose.rotation * n,
                    };
                    for (value, l) in image.pixel_mut(x, y).iter_mut().zip(&light.channels) {
                        *value = (factor * l.evaluate(n)).max(0.0) as f32;
                    }
                };
                if let Some((t, n)) = hit_object(&eye, &ray) {
                    paint(on_object, &n, albedo);
                    *depth.at_mut(x, y) = (ray_in_cam.z * t) as f32;
                    let n = pose.rotation * n;
                    *normals.at_mut(x, y) = [n.x as f32, n.y as f32, n.z as f32];
                    *mask.at_mut(x, y) = true;
                } else if let Some(n) = ball.normal_at(&intrinsics, &pixel) {
                    paint(on_ball, &(pose.rotation.inverse() * n), 1.0);
                }
            }
        }
        let name = format!("view{k}");
        made.posed.views.push(PosedView {
            photo: PhotoIdx(k),
            name: name.clone(),
            file_name: format!("{name}.png"),
            intrinsics,
            cam_from_world: pose,
        });
        made.photos.photos.push(Photo {
            file_name: format!("{name}.png"),
            name,
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: 1,
            mask: Some(Arc::new(mask)),
            clip_level: 1.0,
            given_cam_from_world: None,
        });
        made.depths.push(depth);
        made.normals.push(normals);
    }
    made.posed.spheres.push(LocatedSphere {
        name: MarkedSphere::ONLY.to_owned(),
        center_in_world: ball_center().coords.into(),
        radius: BALL_RADIUS,
        center_sigma: [0.0; 3],
        seen_in: Vec::new(),
    });
    made.posed.anchors = anchors(&made);
    made
}

/// Anchors on a grid of pixels, half a thousandth of noise in depth.
fn anchors(made: &World) -> Vec<Anchor> {
    let mut state = 5_u64;
    let mut anchors = Vec::new();
    for (first, view) in made.posed.views.iter().enumerate() {
        for y in (0..200).step_by(6) {
            for x in (0..260).step_by(6) {
                let z = f64::from(*made.depths[first].at(x, y));
                if z == 0.0 {
                    continue;
                }
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                let noise = 1e-3 * ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5);
                let pixel = Point2::new(x as f64, y as f64);
                let in_camera = view.intrinsics.unproject(&pixel, z * (1.0 + noise));
                let point = view.cam_from_world.inverse().apply(&in_camera);
                let observations: Vec<AnchorObservation> = (0..NUM_VIEWS)
                    .filter_map(|other| {
                        let seen = &made.posed.views[other];
                        let p = seen.cam_from_world.apply(&point);
                        let at = seen.intrinsics.project(&p)?;
                        let there =
                            made.depths[other].get(at.x.round() as isize, at.y.round() as isize)?;
                        let visible = (f64::from(*there) / p.z).ln().abs() < 0.01;
                        visible.then_some(AnchorObservation {
                            view: ViewIdx(other),
                            pixel: [at.x, at.y],
                            depth: p.z,
                            sigma_ln_depth: 1e-3,
                        })
                    })
                    .collect();
                if observations.len() >= 2 {
                    anchors.push(Anchor {
                        position: point.coords.into(),
                        covariance: [0.0; 6],
                        origin: AnchorOrigin::Grown,
                        observations,
                    });
                }
            }
        }
    }
    anchors
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
        &options,
    )
    .unwrap();
    let truth = rotate(&light, &view.cam_from_world.rotation);
    let (angle, rms) = (angle_deg(&found, &truth), fit.relative_rms());
    assert!(
        angle < 0.6 && rms < 0.01,
        "direction off by {angle}°, residual {rms}"
    );
    let small = DepthMap::filled(10, 10, 1.0);
    let result = fit_on_shape(&image, None, &view.intrinsics, &small, 1.0, &options);
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
            photo.pixels = Arc::new(InMemoryPixels(Arc::new(image)));
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
fn a_sphere_in_another_light_is_overruled_by_the_object_and_said_so() {
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
    assert!(
        told.warnings().iter().any(|w| w.contains("shadow")),
        "{:?}",
        told.warnings()
    );
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
        check(photos, posed, used, shaded, &options.check(), &Silent).unwrap()
    };
    let bad = check_of(&plain, &shaded);
    assert!(
        bad.views.iter().any(|v| v.suffers) && !bad.advice.is_empty(),
        "{bad:?}"
    );
    let good = check_of(&corrected, &shaded);
    assert!(good.advice.is_empty(), "{:?}", good.advice);
    // A model that allows for what the sphere did not see explains the photos, and is not hurt.
    let mut explained = shaded;
    for (view, photo) in explained.views.iter_mut().zip(&made.photos.photos) {
        view.rendered = Some((*photo.linear().unwrap()).clone());
    }
    let unhurt = check_of(&plain, &explained);
    assert!(unhurt.advice.is_empty(), "{:?}", unhurt.advice);
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
