//! Rungs of the fit over many views.

use super::known::PosedOutline;
use super::locate::{WorldScale, locate, locate_with};
use super::mark::{OUTLINE_BIAS_PX, distance_px, outline_of_mark};
use super::outline_fit::residual;
use super::{SphereError, SphereInCamera};
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_scene::{Intrinsics, Mask, PhotoIdx, RigidTransform, SphereMark};

const RADIUS: f64 = 0.04;

fn center() -> Point3<f64> {
    Point3::new(0.2, 0.04, 0.06)
}

/// Eight cameras on an arc, one metre away, the world shrunk by `shrink`.
fn views(shrink: f64, noise_px: f64) -> Vec<PosedOutline> {
    let mut state = 7_u64;
    let mut noise = move || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    };
    (0..8)
        .map(|k| {
            let angle = -0.8 + 0.2 * k as f64;
            let eye = Point3::new(angle.sin(), 0.3 + 0.1 * (k % 2) as f64, angle.cos());
            let forward = (Point3::new(0.0, 0.1, 0.0) - eye).normalize();
            let right = forward.cross(&Vector3::y()).normalize();
            let down = forward.cross(&right);
            let world_from_cam = Rotation3::from_basis_unchecked(&[right, down, forward]);
            let metric = RigidTransform::from_world_pose(world_from_cam, eye);
            let intrinsics = Intrinsics::pinhole(1280, 960, 1700.0, 639.5, 479.5);
            let outline = SphereInCamera {
                center: metric.apply(&center()),
                radius: RADIUS,
            }
            .outline(&intrinsics, 200)
            .into_iter()
            .map(|p| Point2::new(p.x + noise_px * noise(), p.y + noise_px * noise()))
            .collect();
            PosedOutline {
                photo: PhotoIdx(k),
                intrinsics,
                cam_from_world: RigidTransform {
                    translation: metric.translation * shrink,
                    ..metric
                },
                outline,
            }
        })
        .collect()
}

#[test]
fn exact_outlines_give_center_and_scale_exactly() {
    let fit = locate(&views(0.37, 0.0), RADIUS, WorldScale::Free).unwrap();
    let metres_per_unit = fit.scale.unwrap().metres_per_unit;
    let scale_error = (metres_per_unit * 0.37 - 1.0).abs();
    let found = Point3::from(fit.sphere.center_in_world) * metres_per_unit;
    let error = (found - center()).norm();
    assert!(scale_error < 1e-9, "scale off by {scale_error}");
    assert!(error < 1e-9, "centre off by {error}");
    assert_eq!(fit.sphere.seen_in.len(), 8);
}

#[test]
fn an_outline_that_is_wider_in_all_views_stays_within_the_stated_deviation() {
    // A tenth of a pixel of about 70: eight photos do not average it out.
    let mut wider = views(1.0, 0.05);
    for view in &mut wider {
        let num = view.outline.len() as f64;
        let sum = view
            .outline
            .iter()
            .map(|p| p.coords)
            .sum::<nalgebra::Vector2<f64>>();
        let middle = Point2::from(sum / num);
        for point in &mut view.outline {
            *point += (*point - middle).normalize() * 0.1;
        }
    }
    let fit = locate(&wider, RADIUS, WorldScale::Free).unwrap();
    let scale = fit.scale.unwrap();
    let error = (scale.metres_per_unit - 1.0).abs();
    let sigma = scale.relative_sigma;
    assert!(
        error > 1e-3 && error < 1.5 * sigma && sigma < 1.5 * error,
        "{error} {sigma}"
    );
}

#[test]
fn noise_stays_within_the_stated_deviations() {
    let fit = locate_with(&views(0.37, 0.3), RADIUS, WorldScale::Free, 0.0).unwrap();
    let scale = fit.scale.unwrap();
    let scale_error = (scale.metres_per_unit * 0.37 - 1.0).abs();
    assert!(
        scale_error < 4.0 * scale.relative_sigma && scale.relative_sigma < 1e-3,
        "scale off by {scale_error}, stated {}",
        scale.relative_sigma
    );
    let found = fit.sphere.center_in_world;
    for (axis, found) in found.iter().enumerate() {
        let error = (found - 0.37 * center()[axis]).abs();
        let sigma = fit.sphere.center_sigma[axis];
        assert!(
            error < 4.0 * sigma && sigma < 1e-3,
            "axis {axis}: {error}, stated {sigma}"
        );
    }
}

#[test]
fn one_bad_view_is_left_out_and_named() {
    let mut views = views(1.0, 0.1);
    for point in &mut views[3].outline {
        point.x += 60.0;
    }
    for scale in [WorldScale::Free, WorldScale::Metric] {
        let fit = locate(&views, RADIUS, scale).unwrap();
        assert!(!fit.views[3].used && fit.views[3].reason.is_some());
        assert_eq!(fit.sphere.seen_in.len(), 7, "{:?}", fit.views);
        let error = (Point3::from(fit.sphere.center_in_world) - center()).norm();
        assert!(error < 2e-4, "centre off by {error}");
    }
}

#[test]
fn degenerate_input_gives_named_errors() {
    let all = views(1.0, 0.0);
    let result = locate(&all, -1.0, WorldScale::Free);
    assert!(
        matches!(result, Err(SphereError::Radius { .. })),
        "{result:?}"
    );
    let result = locate(&all[..1], RADIUS, WorldScale::Free);
    assert_eq!(result, Err(SphereError::OneView));
    let result = locate(&[], RADIUS, WorldScale::Metric);
    assert_eq!(result, Err(SphereError::NoView));
    let result = locate(&all, 10.0 * RADIUS, WorldScale::Metric);
    assert!(
        matches!(result, Err(SphereError::RadiusMismatch { .. })),
        "{result:?}"
    );
    assert!(locate(&all[..1], RADIUS, WorldScale::Metric).is_ok());
    let mut two = all[..2].to_vec();
    for point in &mut two[1].outline {
        point.y += 200.0;
    }
    let result = locate(&two, RADIUS, WorldScale::Metric);
    assert!(
        matches!(result, Err(SphereError::Contradiction { .. })),
        "{result:?}"
    );
}

#[test]
fn residual_derivatives_match_differences() {
    let sphere = SphereInCamera {
        center: Point3::new(0.1, -0.2, 0.9),
        radius: 0.05,
    };
    let ray = Vector3::new(0.15, -0.16, 1.0).normalize();
    let (_, by_center, by_radius) = residual(&sphere, &ray).unwrap();
    let h = 1e-6;
    for axis in 0..4 {
        let value = |sign: f64| {
            let mut moved = sphere;
            if axis < 3 {
                moved.center[axis] += sign * h;
            } else {
                moved.radius += sign * h;
            }
            residual(&moved, &ray).unwrap().0
        };
        let numeric = (value(1.0) - value(-1.0)) / (2.0 * h);
        let analytic = if axis < 3 { by_center[axis] } else { by_radius };
        assert!(
            (numeric - analytic).abs() < 1e-8,
            "axis {axis}: {numeric} {analytic}"
        );
    }
}

/// Random numbers: a linear congruential generator, and the sum of twelve as a normal one.
struct Random(u64);

impl Random {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.between(-0.5, 0.5)).sum()
    }
}

/// Mask of a sphere behind what hides all columns from `hidden_from` on. Its outline lies `wider` outwards and
/// is moved as a whole, as blur and threshold do it; every pixel's own distance has an error of `noise_px`.
fn mask_of(
    random: &mut Random,
    sphere: &SphereInCamera,
    camera: &Intrinsics,
    (wider, noise_px): (f64, f64),
    hidden_from: f64,
) -> Option<Mask> {
    let cone = sphere.cone()?;
    let [columns, rows] = sphere.part_of_frame(camera, 64, 4.0)?;
    let moved = [(); 2].map(|()| OUTLINE_BIAS_PX * random.normal());
    let mut mask = Mask::filled(camera.width, camera.height, false);
    for y in rows {
        for x in columns.clone().take_while(|x| (*x as f64) < hidden_from) {
            let ray = camera.ray(&Point2::new(x as f64, y as f64)).normalize();
            let around = (ray - cone.axis * ray.dot(&cone.axis)).xy().normalize();
            let limit = wider + around.x * moved[0] + around.y * moved[1];
            let distance = distance_px(&cone, &ray, camera) + noise_px * random.normal();
            *mask.at_mut(x, y) = distance < limit;
        }
    }
    Some(mask)
}

#[test]
fn the_stated_deviation_of_the_size_holds_in_random_placements() {
    let camera = Intrinsics::pinhole(320, 240, 400.0, 159.5, 119.5);
    let mut random = Random(5);
    let (mut ratios, mut num_cut, mut num_hidden) = (Vec::new(), 0, 0);
    while ratios.len() < 200 {
        let radius = random.between(0.02, 0.1);
        let center = Point3::new(
            random.between(-0.4, 0.4),
            random.between(-0.3, 0.3),
            random.between(-0.2, 0.2),
        );
        let wider = OUTLINE_BIAS_PX * random.normal();
        let noise_px = [0.0, 0.3][ratios.len() % 2];
        let mut outlines = Vec::new();
        for k in 0..4 {
            let angle = -0.45 + 0.3 * f64::from(k) + random.between(-0.1, 0.1);
            let eye = Point3::new(angle.sin(), random.between(-0.3, 0.3), angle.cos());
            let forward = -eye.coords.normalize();
            let right = forward.cross(&Vector3::y()).normalize();
            let axes = [right, forward.cross(&right), forward];
            let turn = Rotation3::from_basis_unchecked(&axes);
            let cam_from_world = RigidTransform::from_world_pose(turn, eye);
            let sphere = SphereInCamera {
                center: cam_from_world.apply(&center),
                radius,
            };
            let (at, size) = (camera.project(&sphere.center), sphere.radius_px(&camera));
            let Some(at) = at else { continue };
            let is_hidden = random.between(0.0, 1.0) < 0.25;
            let hidden_from = if is_hidden {
                at.x + size * random.between(0.0, 1.0)
            } else {
                f64::INFINITY
            };
            let errors = (wider, noise_px);
            let mask = mask_of(&mut random, &sphere, &camera, errors, hidden_from);
            // A sphere outside the frame is marked by nobody.
            let Some(mask) = mask.filter(|mask| mask.count() > 40) else {
                continue;
            };
            num_hidden += usize::from(is_hidden);
            num_cut += usize::from(
                at.x + size > 319.0 || at.y + size > 239.0 || at.x < size || at.y < size,
            );
            outlines.push(PosedOutline {
                photo: PhotoIdx(k as usize),
                intrinsics: camera,
                cam_from_world,
                outline: outline_of_mark(&SphereMark::Mask(mask)),
            });
        }
        // Seen in one photo, or on short arcs alone, it gives no scale.
        let Ok(fit) = locate(&outlines, radius, WorldScale::Free) else {
            continue;
        };
        let scale = fit.scale.unwrap();
        ratios.push((scale.metres_per_unit - 1.0) / scale.relative_sigma);
    }
    let square = ratios.iter().map(|r| r * r).sum::<f64>();
    let spread = (square / ratios.len() as f64).sqrt();
    let largest = ratios.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
    println!("spread {spread}, largest {largest}, {num_cut} cut, {num_hidden} hidden");
    assert!(
        (0.7..1.3).contains(&spread),
        "spread {spread}, largest {largest}"
    );
    assert!(
        num_cut > 100 && num_hidden > 100,
        "{num_cut} cut, {num_hidden} hidden"
    );
}
