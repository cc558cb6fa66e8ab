//! Verification in rungs: exact, noise, outliers, degenerate.

use super::*;
use nalgebra::{Point3, UnitQuaternion};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rilievo_numerics::derivatives::jacobian_error;

const FOCAL_PX: f64 = 1000.0;

struct Pair {
    x1: Vec<Point2<f64>>,
    x2: Vec<Point2<f64>>,
    essential: Matrix3<f64>,
}

fn pair(points: &[Point3<f64>], baseline: f64, noise_px: f64, seed: u64) -> Pair {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rotation = UnitQuaternion::from_euler_angles(0.05, -0.25, 0.1);
    let direction = Vector3::new(0.9, 0.1, 0.3).normalize();
    let mut noise = || rng.random_range(-1.7..1.7) * noise_px / FOCAL_PX;
    let mut project = |p: Point3<f64>| Point2::new(p.x / p.z + noise(), p.y / p.z + noise());
    Pair {
        x1: points.iter().map(|p| project(*p)).collect(),
        x2: points
            .iter()
            .map(|p| project(rotation * p + direction * baseline))
            .collect(),
        essential: direction.cross_matrix() * rotation.to_rotation_matrix().into_inner(),
    }
}

fn cloud(num: usize, flat: bool) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    (0..num)
        .map(|_| {
            let (x, y) = (rng.random_range(-1.5..1.5), rng.random_range(-1.0..1.0));
            let z = if flat {
                4.0 + 0.3 * x
            } else {
                rng.random_range(3.0..6.0)
            };
            Point3::new(x, y, z)
        })
        .collect()
}

/// Distance of two essential matrices up to sign.
fn distance(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    let (a, b) = (a / a.norm(), b / b.norm());
    (a - b).norm().min((a + b).norm())
}

fn verified(pair: &Pair) -> Option<TwoViewGeometry> {
    let all: Vec<usize> = (0..pair.x1.len()).collect();
    verify(&pair.x1, &pair.x2, &all, FOCAL_PX).unwrap()
}

#[test]
fn exact_matches_give_the_exact_matrix() {
    let pair = pair(&cloud(150, false), 0.8, 0.0, 1);
    let found = verified(&pair).unwrap();
    assert_eq!(found.inliers.len(), 150);
    let error = distance(&found.essential, &pair.essential);
    assert!(error < 1e-6, "{error}");
    assert!(found.homography_share < 0.6, "{}", found.homography_share);
}

#[test]
fn refinement_makes_the_most_of_noisy_matches() {
    let pair = pair(&cloud(400, false), 0.8, 0.4, 2);
    let found = verified(&pair).unwrap();
    let error = distance(&found.essential, &pair.essential);
    // RANSAC's own matrix comes from five matches and errs by some 1e-2.
    assert!(error < 3e-3, "{error}");
    assert_eq!(found.inliers.len(), 400);
}

#[test]
fn half_of_wrong_matches_is_sorted_out() {
    let mut pair = pair(&cloud(300, false), 0.8, 0.3, 3);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for k in 150..300 {
        pair.x2[k] = Point2::new(rng.random_range(-0.4..0.4), rng.random_range(-0.3..0.3));
    }
    let found = verified(&pair).unwrap();
    let good = found.inliers.iter().filter(|&&k| k < 150).count();
    assert!(good >= 149, "{good}");
    // A wrong match lies near its epipolar line by chance in about 6 px of 600.
    assert!(found.inliers.len() < 160, "{}", found.inliers.len());
    let error = distance(&found.essential, &pair.essential);
    assert!(error < 1e-2, "{error}");
}

#[test]
fn flat_scenes_and_pure_rotations_show_in_the_homography() {
    let flat = verified(&pair(&cloud(150, true), 0.8, 0.2, 4)).unwrap();
    assert!(flat.homography_share > 0.97, "{}", flat.homography_share);
    let turned = verified(&pair(&cloud(150, false), 0.0, 0.2, 4)).unwrap();
    assert!(
        turned.homography_share > 0.97,
        "{}",
        turned.homography_share
    );
}

#[test]
fn strangers_do_not_pass() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut random = || -> Vec<Point2<f64>> {
        (0..40)
            .map(|_| Point2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.4..0.4)))
            .collect()
    };
    let strangers = Pair {
        x1: random(),
        x2: random(),
        essential: Matrix3::zeros(),
    };
    assert!(verified(&strangers).is_none());
    let few = pair(&cloud(10, false), 0.8, 0.0, 1);
    assert!(verified(&few).is_none());
}

#[test]
fn the_sampson_derivative_agrees_with_differences() {
    let pair = pair(&cloud(1, false), 0.8, 2.0, 9);
    let svd = pair.essential.svd(true, true);
    let state = EssentialState {
        u: svd.u.unwrap(),
        v: svd.v_t.unwrap().transpose(),
    };
    let problem = SampsonProblem {
        x1: &pair.x1,
        x2: &pair.x2,
        inliers: &[0],
        loss: RobustLoss::Squared,
    };
    let r = sampson(&state.matrix(), &pair.x1[0], &pair.x2[0]);
    // The gradient of r²/2 is r times the derivative of r.
    let (_, gradient) = problem.linearize(&state);
    let analytic: Vec<f64> = gradient.iter().map(|g| g / r).collect();
    let residual = |x: &[f64], out: &mut [f64]| {
        let moved = problem.retract(&state, &SVector::<f64, 5>::from_column_slice(x));
        out[0] = sampson(&moved.matrix(), &pair.x1[0], &pair.x2[0]);
    };
    let error = jacobian_error(&[0.0; 5], 1, residual, &analytic);
    assert!(error < 1e-7, "{error}");
}

#[test]
fn indistinctive_matches_join_but_do_not_decide() {
    let good = pair(&cloud(200, false), 0.8, 0.2, 8);
    let some: Vec<usize> = (0..200).step_by(4).collect();
    let found = verify(&good.x1, &good.x2, &some, FOCAL_PX)
        .unwrap()
        .unwrap();
    assert_eq!(found.inliers.len(), 200);
    let few: Vec<usize> = (0..10).collect();
    let none = verify(&good.x1, &good.x2, &few, FOCAL_PX).unwrap();
    assert!(none.is_none());
}

#[test]
fn few_noisy_matches_are_enough() {
    for seed in 0..20 {
        let few = pair(&cloud(16, false), 0.8, 0.5, seed);
        let found = verified(&few);
        assert!(found.is_some(), "seed {seed}: nothing was found");
    }
}

#[test]
fn a_pair_that_may_count_gets_the_samples_that_find_it() {
    for num_matches in [15, 20, 40, 60] {
        let samples = num_useful_samples(num_matches);
        assert!(samples <= MAX_NUM_RANSAC_SAMPLES);
        let share = MIN_NUM_INLIERS as f64 / num_matches as f64;
        let missed = (1.0 - share.powi(5)).powi(samples as i32);
        assert!(
            missed <= 1.01e-4 || samples == MAX_NUM_RANSAC_SAMPLES,
            "{num_matches} matches: {samples} samples miss with probability {missed}"
        );
    }
    assert_eq!(num_useful_samples(15), MIN_NUM_SAMPLES);
    assert_eq!(num_useful_samples(5000), MAX_NUM_RANSAC_SAMPLES);
}
