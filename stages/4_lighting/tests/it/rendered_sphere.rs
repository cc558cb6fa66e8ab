//! Rungs: spheres rendered under a known light, at several angles off the axis and sizes, with
//! noise, cut by the frame, in shadow, clipped; the light must be recovered.

use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_lighting::{LightingError, LightingOptions, LightingRequest, run};
use rilievo_photometry::harmonics::{dominant_direction, rotate};
use rilievo_photometry::sphere::{SphereInCamera, SphereOptions, WorldScale, locate_request};
use rilievo_scene::{
    Intrinsics, LightKind, Lighting, LinearImage, MarkedSphere, PhotoIdx, PhotoSet, PosedViews,
    Recorder, RigidTransform, Silent, SphereMark, SphereRequest,
};
use rilievo_synthetic::testing::{PosedPhotos, Random, look_at, photo, tinted_light};

const RADIUS: f64 = 0.04;

/// A light from above left, in a frame with y down.
fn light() -> Lighting {
    tinted_light([-0.2, -0.3, -0.25, 0.42, 0.03, 0.02, 0.05, -0.03, 0.02])
}

/// What is put into a photo.
struct Shot<'a> {
    intrinsics: Intrinsics,
    cam_from_world: RigidTransform,
    center_in_world: Point3<f64>,
    light_in_cam: &'a Lighting,
    noise: f64,
    gain: f64,
    /// Darkens a pixel of the sphere (in radii from its centre).
    shadow: fn(f64, f64) -> f64,
}

impl Shot<'_> {
    fn sphere(&self) -> SphereInCamera {
        SphereInCamera {
            center: self.cam_from_world.apply(&self.center_in_world),
            radius: RADIUS,
        }
    }

    /// Sixteen rays a pixel; a grey, gently varying ground.
    fn render(&self, noise: &mut Random) -> LinearImage {
        let camera = &self.intrinsics;
        let sphere = self.sphere();
        let at = camera.project(&sphere.center).unwrap();
        let r = sphere.radius_px(camera);
        let mut image = LinearImage::filled(camera.width, camera.height, 3, 0.0);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let ground = 0.12 + 0.05 * x as f64 / camera.width as f64;
                let mut sum = [0.0; 3];
                let near = (x as f64 - at.x).hypot(y as f64 - at.y) < 1.5 * r + 3.0;
                let per_axis = if near { 4 } else { 1 };
                for sub in 0..per_axis * per_axis {
                    let offset = |k: usize| (k as f64 + 0.5) / per_axis as f64 - 0.5;
                    let p = Point2::new(
                        x as f64 + offset(sub % per_axis),
                        y as f64 + offset(sub / per_axis),
                    );
                    match sphere.normal_at(camera, &p) {
                        Some(n) => {
                            let dark = (self.shadow)((p.x - at.x) / r, (p.y - at.y) / r);
                            for (s, l) in sum.iter_mut().zip(&self.light_in_cam.channels) {
                                *s += dark * l.evaluate(&n);
                            }
                        }
                        None => sum.iter_mut().for_each(|s| *s += ground),
                    }
                }
                for (value, s) in image.pixel_mut(x, y).iter_mut().zip(sum) {
                    let clean = self.gain * s / (per_axis * per_axis) as f64;
                    *value = (clean * (1.0 + self.noise * noise.normal())).clamp(0.0, 1.0) as f32;
                }
            }
        }
        image
    }
}

fn set_of(shots: &[Shot]) -> (PhotoSet, PosedViews) {
    let mut noise = Random(11);
    let mut set = PosedPhotos::default();
    for (k, shot) in shots.iter().enumerate() {
        let image = shot.render(&mut noise);
        let photo = photo(&format!("view{k}.png"), image, shot.intrinsics);
        set.push(photo, shot.cam_from_world);
    }
    (set.photos, set.posed)
}

fn request(light: LightKind, marks: Vec<(PhotoIdx, SphereMark)>) -> SphereRequest {
    SphereRequest {
        spheres: vec![MarkedSphere::only(RADIUS, marks)],
        light: Some(light),
        ..SphereRequest::default()
    }
}

/// One photo with the sphere at an angle off the axis and an outline of a given radius.
fn single(off_axis_deg: f64, radius_px: f64, shadow: fn(f64, f64) -> f64, cut: f64) -> (f64, f64) {
    let focal = 1000.0;
    let angle = off_axis_deg.to_radians();
    let distance = RADIUS * focal / (radius_px * angle.cos());
    let center = Point3::new(
        distance * angle.sin() * 0.8,
        distance * angle.sin() * 0.6,
        distance * angle.cos(),
    );
    // A frame around the sphere only: the principal point may lie outside.
    let at = Point2::new(focal * center.x / center.z, focal * center.y / center.z);
    let half = 1.6 * radius_px + 8.0;
    let width = (2.0 * half - cut * 2.0 * radius_px) as usize;
    let intrinsics = Intrinsics::pinhole(
        width,
        (2.0 * half) as usize,
        focal,
        half - at.x,
        half - at.y,
    );
    let truth = light();
    let shot = Shot {
        intrinsics,
        cam_from_world: RigidTransform::identity(),
        center_in_world: center,
        light_in_cam: &truth,
        noise: 0.01,
        gain: 1.0,
        shadow,
    };
    let (photos, mut posed) = set_of(std::slice::from_ref(&shot));
    let outline: Vec<[f64; 2]> = shot
        .sphere()
        .outline(&intrinsics, 24)
        .iter()
        .filter(|p| p.x < width as f64 - 1.0)
        .map(|p| [p.x + 0.7, p.y - 0.4])
        .collect();
    let request = request(
        LightKind::World,
        vec![(PhotoIdx(0), SphereMark::Points(outline))],
    );
    let options = SphereOptions::default();
    let found = locate_request(
        &photos,
        &posed.views,
        &request,
        WorldScale::Metric,
        &options,
        2,
    );
    posed.spheres = vec![found.unwrap().fits.remove(0).sphere];
    let (calibration, _) = run(
        &photos,
        &posed,
        &LightingRequest::Sphere(request),
        &LightingOptions::default(),
        &Silent,
    )
    .unwrap();
    let fitted = &calibration.views[0].lighting;
    let direction = dominant_direction(fitted)
        .unwrap()
        .angle(&dominant_direction(&truth).unwrap())
        .to_degrees();
    let (mut error, mut size) = (0.0, 0.0);
    for pixel in shot.sphere().pixels(&intrinsics, 2.0) {
        for (l, t) in fitted.channels.iter().zip(&truth.channels) {
            let exact = t.evaluate(&pixel.normal_in_cam);
            error += (l.evaluate(&pixel.normal_in_cam) - exact).powi(2);
            size += exact * exact;
        }
    }
    (direction, (error / size).sqrt())
}

#[test]
fn light_is_recovered_at_every_angle_and_size() {
    for off_axis in [0.0, 10.0, 20.0, 30.0] {
        for radius_px in [20.0, 60.0, 200.0] {
            let (direction, rms) = single(off_axis, radius_px, |_, _| 1.0, 0.0);
            // With 20 px the noise alone moves the direction by 0.5° (one deviation, Cramér-Rao
            // bound of nine free coefficients); three of them are allowed.
            let allowed_deg = if radius_px < 50.0 { 1.5 } else { 0.5 };
            assert!(
                direction < allowed_deg && rms < 0.01,
                "{off_axis}° off axis, {radius_px} px: direction off by {direction:.3}°, RMS {rms:.4}"
            );
        }
    }
}

#[test]
fn a_quarter_cut_by_the_frame_or_in_shadow_costs_less_than_a_degree() {
    for off_axis in [0.0, 20.0] {
        for radius_px in [30.0, 60.0, 100.0] {
            let (cut, _) = single(off_axis, radius_px, |_, _| 1.0, 0.3 + 0.6 * 8.0 / radius_px);
            assert!(cut < 1.0, "cut, {off_axis}°, {radius_px} px: {cut:.3}°");
            let sector = |x: f64, y: f64| if x > 0.0 && y > 0.0 { 0.35 } else { 1.0 };
            let (shadowed, _) = single(off_axis, radius_px, sector, 0.0);
            assert!(
                shadowed < 1.0,
                "sector in shadow, {off_axis}°, {radius_px} px: {shadowed:.3}°"
            );
            let low = |_: f64, y: f64| if y > 0.4 { 0.5 } else { 1.0 };
            let (contact, _) = single(off_axis, radius_px, low, 0.0);
            assert!(
                contact < 1.0,
                "foot in shadow, {off_axis}°, {radius_px} px: {contact:.3}°"
            );
        }
    }
}

/// Five cameras around the sphere, with a light fixed in the world or to the cameras.
fn around(kind: LightKind, gains: [f64; 5]) -> (PhotoSet, PosedViews, Lighting) {
    let environment = rotate(
        &light(),
        &Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI).into(),
    );
    let intrinsics = Intrinsics::pinhole(240, 180, 900.0, 119.5, 89.5);
    let center = Point3::new(0.02, 0.05, -0.03);
    let poses: Vec<RigidTransform> = (0..5)
        .map(|k| {
            let angle = -0.7 + 0.35 * f64::from(k);
            let eye = center + Vector3::new(angle.sin(), 0.25, angle.cos()) * 0.7;
            look_at(eye, center, Vector3::y())
        })
        .collect();
    let lights: Vec<Lighting> = poses
        .iter()
        .map(|pose| match kind {
            LightKind::World => rotate(&environment, &pose.rotation),
            LightKind::Camera => light(),
        })
        .collect();
    let shots: Vec<Shot> = poses
        .iter()
        .zip(&lights)
        .zip(gains)
        .map(|((pose, light_in_cam), gain)| Shot {
            intrinsics,
            cam_from_world: *pose,
            center_in_world: center,
            light_in_cam,
            noise: 0.01,
            gain,
            shadow: |_, _| 1.0,
        })
        .collect();
    let (photos, mut posed) = set_of(&shots);
    let marks = [0, 3]
        .map(|k: usize| {
            let p = intrinsics.project(&shots[k].sphere().center).unwrap();
            let mark = SphereMark::Circle {
                center_px: [p.x + 1.0, p.y],
                radius_px: shots[k].sphere().radius_px(&intrinsics) + 0.5,
            };
            (PhotoIdx(k), mark)
        })
        .to_vec();
    let request = request(kind, marks);
    let options = SphereOptions::default();
    let fit = locate_request(
        &photos,
        &posed.views,
        &request,
        WorldScale::Metric,
        &options,
        2,
    )
    .unwrap()
    .fits
    .remove(0);
    assert_eq!(
        fit.sphere.seen_in.len(),
        5,
        "marks in two photos predict the others"
    );
    posed.spheres = vec![fit.sphere];
    (photos, posed, environment)
}

#[test]
fn one_environment_serves_all_views_and_gains_come_from_the_sphere() {
    let gains = [1.1, 0.9, 1.0, 0.85, 1.15];
    let mean = gains.iter().map(|g: &f64| g.ln()).sum::<f64>() / 5.0;
    let (photos, posed, environment) = around(LightKind::World, gains);
    let request = LightingRequest::Sphere(request(LightKind::World, Vec::new()));
    let options = LightingOptions::default();
    let (calibration, report) = run(&photos, &posed, &request, &options, &Silent).unwrap();
    assert!(report.gains_applied);
    for (view, gain) in calibration.views.iter().zip(gains) {
        for found in &view.gain {
            let error = (found.ln() - (gain.ln() - mean)).abs();
            assert!(
                error < 0.005,
                "gain of {}: {found}, off by {error}",
                view.view
            );
        }
    }
    let found = calibration.environment_in_world.unwrap();
    let angle = dominant_direction(&found)
        .unwrap()
        .angle(&dominant_direction(&environment).unwrap())
        .to_degrees();
    assert!(angle < 0.3, "direction off by {angle}°");
    let check = report.kind_check.unwrap();
    assert!(
        !check.contradicts && check.fits == Some(LightKind::World),
        "{check:?}"
    );
}

#[test]
fn equal_exposures_are_left_alone_and_wrongly_stated_kinds_are_named() {
    for (true_kind, stated) in [
        (LightKind::World, LightKind::Camera),
        (LightKind::Camera, LightKind::World),
    ] {
        let (photos, posed, _) = around(true_kind, [1.0; 5]);
        let options = LightingOptions::default();
        let wrong = LightingRequest::Sphere(request(stated, Vec::new()));
        let told = Recorder::default();
        let (_, report) = run(&photos, &posed, &wrong, &options, &told).unwrap();
        let check = report.kind_check.clone().unwrap();
        assert!(
            check.contradicts && check.fits == Some(true_kind),
            "{check:?}"
        );
        assert!(
            told.warnings().iter().any(|w| w.contains("stated")),
            "{:?}",
            told.warnings()
        );
        let stated = request(true_kind, Vec::new());
        let unstated = SphereRequest {
            light: None,
            ..stated.clone()
        };
        for right in [stated, unstated] {
            let right = LightingRequest::Sphere(right);
            let (calibration, report) = run(&photos, &posed, &right, &options, &Silent).unwrap();
            assert_eq!((calibration.kind, report.kind), (true_kind, true_kind));
            assert!(!report.kind_check.unwrap().contradicts && !report.gains_applied);
            for view in &calibration.views {
                let residual = view.residual.unwrap();
                assert!(residual < 0.012, "residual {residual}");
            }
        }
    }
}

#[test]
fn input_without_light_gives_named_errors() {
    let (photos, posed, _) = around(LightKind::World, [1.0; 5]);
    let options = LightingOptions::default();
    let sphere = LightingRequest::Sphere(request(LightKind::World, Vec::new()));
    let go = |posed: &PosedViews, request: &LightingRequest, options: &LightingOptions| {
        run(&photos, posed, request, options, &Silent)
    };
    let without = PosedViews {
        spheres: Vec::new(),
        ..posed.clone()
    };
    let result = go(&without, &sphere, &options);
    assert!(
        matches!(result, Err(LightingError::NoSphere { .. })),
        "{result:?}"
    );
    let result = go(&PosedViews::default(), &sphere, &options);
    assert!(matches!(result, Err(LightingError::NoView)), "{result:?}");
    let result = go(&posed, &LightingRequest::OwnShape, &options);
    assert!(
        matches!(result, Err(LightingError::TooFewAnchors { .. })),
        "{result:?}"
    );
    let named = vec![("view0".to_owned(), light())];
    let result = go(&posed, &LightingRequest::Given(named), &options);
    assert!(
        matches!(result, Err(LightingError::GivenMissing { .. })),
        "{result:?}"
    );
    let greedy = LightingOptions {
        min_num_pixels: 1_000_000,
        ..options.clone()
    };
    let result = go(&posed, &sphere, &greedy);
    assert!(
        matches!(result, Err(LightingError::SphereUnusable { .. })),
        "{result:?}"
    );
    let bad = LightingOptions {
        min_num_pixels: 0,
        ..options
    };
    let result = go(&posed, &sphere, &bad);
    assert!(
        matches!(result, Err(LightingError::InvalidOption { .. })),
        "{result:?}"
    );
}
