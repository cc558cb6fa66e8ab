//! The adjuster against a dense oracle, and on problems with known minimum.

use super::bundle::PRIOR_LOSS;
use super::*;
use crate::projection::CenteredPose;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, UnitQuaternion, Vector3};
use rilievo_scene::Intrinsics;
use std::sync::Arc;

/// Views on an arc, points in a cloud; residuals of up to `noise` pixels.
fn bundle(noise: f64, refine: bool) -> Bundle {
    let camera = Intrinsics::pinhole(800, 600, 700.0, 399.5, 299.5);
    let mut adjusted = AdjustedCamera::fixed(camera);
    if refine {
        adjusted.prior_sigma[0] = Some(0.05);
        adjusted.prior_sigma[3] = Some(0.3);
    }
    let views: Vec<AdjustedView> = (0..4)
        .map(|k| {
            let angle = 0.25 * f64::from(k);
            AdjustedView {
                camera: 0,
                pose: CenteredPose {
                    rotation: UnitQuaternion::from_euler_angles(0.0, -angle, 0.02 * f64::from(k)),
                    center: Point3::new(-3.0 * angle.sin(), 0.1 * f64::from(k), -3.0 * angle.cos()),
                },
                free: [true; 6],
            }
        })
        .collect();
    let mut points = Vec::new();
    let (mut observations, mut offsets) = (Vec::new(), vec![0]);
    for k in 0..30 {
        let t = f64::from(k);
        let point = Point3::new((1.3 * t).sin(), (0.7 * t).cos(), (2.1 * t).sin() * 0.5);
        points.push(point);
        for (v, view) in views.iter().enumerate() {
            // Some points are not seen by all.
            if (k as usize + v) % 5 == 4 {
                continue;
            }
            let pixel = camera.project(&view.pose.apply(&point)).unwrap();
            let wiggle = Vector3::new((9.1 * t + v as f64).sin(), (7.7 * t - v as f64).cos(), 0.0);
            observations.push(Observation {
                view: v,
                pixel: pixel + noise * wiggle.xy(),
                weight: 1.0 + 0.1 * t,
            });
        }
        offsets.push(observations.len());
    }
    let mut bundle = Bundle {
        cameras: vec![adjusted],
        views,
        points,
        observations: observations.into(),
        offsets: offsets.into(),
    };
    bundle.fix_gauge();
    bundle
}

/// Two of the views have a principal point of their own, with the lens of the others.
fn crop_some(bundle: &mut Bundle) {
    bundle.cameras[0].prior_sigma[1] = Some(40.0);
    let mut cropped = bundle.cameras[0].clone();
    cropped.lens_of = Some(0);
    cropped.prior_sigma[1..3].fill(Some(40.0));
    cropped.deviation[1..3].copy_from_slice(&[30.0, -20.0]);
    bundle.cameras.push(cropped);
    bundle.views[1].camera = 1;
    bundle.views[3].camera = 1;
    let observations = Arc::make_mut(&mut bundle.observations);
    for o in observations.iter_mut().filter(|o| o.view % 2 == 1) {
        o.pixel += nalgebra::Vector2::new(35.0, -22.0);
    }
}

/// Full normal equations by differences of all residuals.
fn dense(bundle: &Bundle, layout: &Layout, num_columns: usize) -> (DMatrix<f64>, DVector<f64>) {
    let num_points = bundle.points.len();
    let total = num_columns + 3 * num_points;
    let residuals = |x: &DVector<f64>| -> Vec<f64> {
        let step = schur::Step {
            reduced: x.rows(0, num_columns).iter().copied().collect(),
            points: (0..num_points)
                .map(|p| x.fixed_rows::<3>(num_columns + 3 * p).into_owned())
                .collect(),
            predicted_decrease: 0.0,
        };
        let moved = bundle.retract(layout, &step);
        let mut out = Vec::new();
        for p in 0..num_points {
            for o in &moved.observations[moved.offsets[p]..moved.offsets[p + 1]] {
                let seen = moved.cameras[moved.views[o.view].camera]
                    .current()
                    .project(&moved.views[o.view].pose.apply(&moved.points[p]))
                    .unwrap();
                let root = o.weight.sqrt();
                out.extend([root * (seen.x - o.pixel.x), root * (seen.y - o.pixel.y)]);
            }
        }
        for (before, moved) in bundle.cameras.iter().zip(&moved.cameras) {
            let is_own = |k: &usize| before.lens_of.is_none() || (1..3).contains(k);
            for k in (0..8).filter(is_own) {
                let (start, d) = (before.deviation[k], moved.deviation[k]);
                let sigma = before.prior_sigma[k];
                out.extend(sigma.map(|s| PRIOR_LOSS.weight(start / s).sqrt() * d / s));
            }
        }
        out
    };
    let r = DVector::from_vec(residuals(&DVector::zeros(total)));
    let mut j = DMatrix::zeros(r.len(), total);
    for c in 0..total {
        let h = 1e-6;
        let mut x = DVector::zeros(total);
        x[c] = h;
        let plus = DVector::from_vec(residuals(&x));
        x[c] = -h;
        let minus = DVector::from_vec(residuals(&x));
        j.set_column(c, &((plus - minus) / (2.0 * h)));
    }
    (j.transpose() * &j, j.transpose() * r)
}

#[test]
fn the_step_is_that_of_the_dense_system() {
    for (refine, is_cropped, num_columns) in
        [(false, false, 17), (true, false, 19), (true, true, 22)]
    {
        let mut bundle = bundle(0.8, refine);
        if refine {
            bundle.cameras[0].deviation[0] = 0.01;
        }
        if is_cropped {
            crop_some(&mut bundle);
        }
        let layout = Layout::new(&bundle);
        let (h, g) = dense(&bundle, &layout, num_columns);
        let lambda = 1e-3;
        let mut damped = h.clone();
        for k in 0..h.nrows() {
            damped[(k, k)] *= 1.0 + lambda;
        }
        let oracle = damped.cholesky().unwrap().solve(&-&g);
        let system = schur::System::build(&bundle, &layout, RobustLoss::Squared);
        let method = Method::new(&layout.pattern);
        let step = system.solve(&method, lambda).unwrap();
        assert_eq!(step.reduced.len(), num_columns);
        let scale = oracle.norm();
        for (k, value) in step.reduced.iter().enumerate() {
            let error = (value - oracle[k]).abs() / scale;
            assert!(error < 1e-5, "column {k}: {value} {}", oracle[k]);
        }
        for (p, delta) in step.points.iter().enumerate() {
            let expected = oracle.fixed_rows::<3>(num_columns + 3 * p);
            let error = (delta - expected).norm() / scale;
            assert!(error < 1e-5, "point {p}: {error}");
        }
        let predicted = -g.dot(&oracle) - 0.5 * oracle.dot(&(&h * &oracle));
        let relative = (step.predicted_decrease / predicted - 1.0).abs();
        assert!(relative < 1e-5, "{} {predicted}", step.predicted_decrease);
        // Covariances are blocks of the inverse.
        let inverse = h.try_inverse().unwrap();
        let covariances = system.covariances(&layout, &method).unwrap();
        let last = covariances.points.last().unwrap();
        let corner = h_corner(&inverse);
        assert!(
            (last - corner).norm() < 1e-5 * corner.norm(),
            "{last} {corner}"
        );
    }
}

/// Views on a ring, each point seen by four neighbours: most pairs of views do not meet.
fn ring(num_views: usize, refine: bool) -> Bundle {
    let camera = Intrinsics::pinhole(800, 600, 700.0, 399.5, 299.5);
    let mut adjusted = AdjustedCamera::fixed(camera);
    if refine {
        adjusted.prior_sigma[0] = Some(0.05);
        adjusted.prior_sigma[3] = Some(0.3);
    }
    let turn = |k: f64| std::f64::consts::TAU * k / num_views as f64;
    let views: Vec<AdjustedView> = (0..num_views)
        .map(|k| AdjustedView {
            camera: 0,
            pose: CenteredPose {
                rotation: UnitQuaternion::from_euler_angles(0.0, turn(k as f64), 0.0),
                center: Point3::new(
                    -6.0 * turn(k as f64).sin(),
                    0.1 * (k as f64).sin(),
                    -6.0 * turn(k as f64).cos(),
                ),
            },
            free: [true; 6],
        })
        .map(|mut view| {
            view.pose.rotation = view.pose.rotation.inverse();
            view
        })
        .collect();
    let mut bundle = Bundle {
        cameras: vec![adjusted],
        views,
        points: Vec::new(),
        observations: Arc::default(),
        offsets: vec![0].into(),
    };
    for k in 0..num_views {
        for l in 0..8 {
            let t = (8 * k + l) as f64;
            let angle = turn(k as f64 + 1.5 + 0.5 * t.sin());
            let point = Point3::new(
                -angle.sin() + 0.3 * (1.3 * t).sin(),
                0.8 * (0.7 * t).cos(),
                -angle.cos() + 0.3 * (2.1 * t).sin(),
            );
            for step in 0..4 {
                let view = (k + step) % num_views;
                let pose = &bundle.views[view].pose;
                let pixel = camera.project(&pose.apply(&point)).unwrap();
                let wiggle = Vector3::new((9.1 * t + view as f64).sin(), (7.7 * t).cos(), 0.0);
                Arc::make_mut(&mut bundle.observations).push(Observation {
                    view,
                    pixel: pixel + 0.5 * wiggle.xy(),
                    weight: 1.0 + 0.01 * t,
                });
            }
            bundle.points.push(point);
            Arc::make_mut(&mut bundle.offsets).push(bundle.observations.len());
        }
    }
    bundle.fix_gauge();
    bundle
}

#[test]
fn the_sparse_system_gives_what_the_dense_one_gives() {
    for refine in [false, true] {
        let bundle = ring(40, refine);
        let layout = Layout::new(&bundle);
        let n = layout.pattern.num_columns();
        // A view meets three to either side, and its camera.
        assert!(layout.pattern.len() < n * n / 6, "{}", layout.pattern.len());
        let system = schur::System::build(&bundle, &layout, RobustLoss::Squared);
        let (dense, sparse) = (
            Method::dense(&layout.pattern),
            Method::sparse(&layout.pattern),
        );
        let (a, b) = (
            system.solve(&dense, 1e-3).unwrap(),
            system.solve(&sparse, 1e-3).unwrap(),
        );
        let apart = |a: &[f64], b: &[f64]| {
            let largest = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let difference = a.iter().zip(b).map(|(a, b)| (a - b).abs());
            difference.fold(0.0_f64, f64::max) / largest
        };
        let error = apart(&a.reduced, &b.reduced);
        assert!(error < 1e-10, "{error}");
        let (matrix, _) = system.reduced(&layout.pattern, 0.0).unwrap();
        let (a, b) = (
            dense.inverse(&matrix).unwrap(),
            sparse.inverse(&matrix).unwrap(),
        );
        let error = apart(&a, &b);
        assert!(error < 1e-9, "{error}");
        // What is chosen by itself is one of them.
        let chosen = bundle.covariances(RobustLoss::Squared).unwrap();
        let forced = system.covariances(&layout, &dense).unwrap();
        for (a, b) in chosen.points.iter().zip(&forced.points) {
            let error = (a - b).norm() / b.norm();
            assert!(error < 1e-9, "{error}");
        }
    }
}

#[test]
fn a_singular_system_is_none_however_it_is_factored() {
    let mut bundle = ring(40, false);
    // Without a gauge all lengths are free.
    bundle.views.iter_mut().for_each(|v| v.free = [true; 6]);
    // A view that sees two points only.
    let view = bundle.views.len() - 1;
    let mut kept = (Vec::new(), vec![0], Vec::new());
    for p in 0..bundle.points.len() {
        let seen = &bundle.observations[bundle.offsets[p]..bundle.offsets[p + 1]];
        let drop = p % 8 > 0;
        kept.0
            .extend(seen.iter().filter(|o| o.view != view || !drop));
        kept.1.push(kept.0.len());
        kept.2.push(bundle.points[p]);
    }
    (bundle.observations, bundle.offsets, bundle.points) = (kept.0.into(), kept.1.into(), kept.2);
    Arc::make_mut(&mut bundle.observations)
        .iter_mut()
        .filter(|o| o.view == view)
        .for_each(|o| o.weight = 0.0);
    let layout = Layout::new(&bundle);
    let system = schur::System::build(&bundle, &layout, RobustLoss::Squared);
    for method in [
        Method::dense(&layout.pattern),
        Method::sparse(&layout.pattern),
    ] {
        assert!(system.solve(&method, 0.0).is_none());
        assert!(system.covariances(&layout, &method).is_none());
    }
}

fn h_corner(inverse: &DMatrix<f64>) -> Matrix3<f64> {
    let n = inverse.nrows();
    inverse.fixed_view::<3, 3>(n - 3, n - 3).into_owned()
}

fn disturb(bundle: &mut Bundle) {
    for (k, view) in bundle.views.iter_mut().enumerate() {
        if view.free.iter().any(|f| *f) {
            let k = k as f64;
            let mut step = [0.01 * k, -0.008, 0.006 * k, 0.02, -0.03 * k, 0.01];
            for (s, free) in step.iter_mut().zip(view.free) {
                *s = if free { *s } else { 0.0 };
            }
            view.pose = view.pose.retract(&step);
        }
    }
    for (k, point) in bundle.points.iter_mut().enumerate() {
        *point += Vector3::new(0.02, -0.01, 0.03) * (k as f64).sin();
    }
}

#[test]
fn exact_observations_are_reached_from_a_disturbed_start() {
    let truth = bundle(0.0, false);
    let mut disturbed = truth.clone();
    disturb(&mut disturbed);
    let options = BundleOptions {
        loss: RobustLoss::Squared,
        max_num_iterations: 50,
        relative_cost_change: 1e-12,
    };
    let report = disturbed.adjust(&options).unwrap();
    assert!(report.final_cost < 1e-12, "{report:?}");
    for (a, b) in disturbed.views.iter().zip(&truth.views) {
        let (moved, turned) = (
            (a.pose.center - b.pose.center).norm(),
            a.pose.rotation.angle_to(&b.pose.rotation),
        );
        assert!(moved < 1e-6 && turned < 1e-6, "{moved} {turned}");
    }
}

#[test]
fn costs_fall_monotonically_and_outliers_are_outvoted() {
    let truth = bundle(0.0, false);
    let mut disturbed = truth.clone();
    disturb(&mut disturbed);
    for k in (0..disturbed.observations.len()).step_by(11) {
        Arc::make_mut(&mut disturbed.observations)[k].pixel.x += 60.0;
    }
    let options = BundleOptions {
        loss: RobustLoss::Cauchy(1.0),
        max_num_iterations: 100,
        relative_cost_change: 1e-10,
    };
    let report = disturbed.adjust(&options).unwrap();
    let costs: Vec<f64> = report.iterations.iter().map(|i| i.cost).collect();
    assert!(costs.windows(2).all(|w| w[1] <= w[0]), "{costs:?}");
    for (a, b) in disturbed.views.iter().zip(&truth.views) {
        let moved = (a.pose.center - b.pose.center).norm();
        assert!(moved < 0.02, "{moved}");
    }
}

#[test]
fn what_is_fixed_stays_to_the_bit() {
    let mut bundle = bundle(0.5, false);
    let before = (bundle.views[0].pose, bundle.cameras[0].current());
    disturb(&mut bundle);
    let options = BundleOptions {
        loss: RobustLoss::Huber(1.0),
        max_num_iterations: 10,
        relative_cost_change: 1e-6,
    };
    bundle.adjust(&options).unwrap();
    assert_eq!(before, (bundle.views[0].pose, bundle.cameras[0].current()));
}
