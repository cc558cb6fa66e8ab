//! Rungs of the robust fit: exact, noise, patches of outliers, degenerate; covariance against
//! repeated draws.

use super::{FitError, HarmonicsFit, fit_robust};
use nalgebra::Vector3;
use rilievo_scene::SphericalHarmonics;

const LIGHT: SphericalHarmonics =
    SphericalHarmonics([-0.2, -0.3, -0.25, 0.42, 0.03, 0.02, 0.05, -0.03, 0.02]);

/// Normals of the visible half of a sphere, as a picture of `radius` pixels samples them.
fn visible(radius: i32) -> Vec<Vector3<f64>> {
    let mut normals = Vec::new();
    for y in -radius..=radius {
        for x in -radius..=radius {
            let (u, v) = (
                f64::from(x) / f64::from(radius),
                f64::from(y) / f64::from(radius),
            );
            let rest = 1.0 - u * u - v * v;
            if rest > 0.02 {
                normals.push(Vector3::new(u, v, -rest.sqrt()));
            }
        }
    }
    normals
}

/// Normal deviates from a linear congruential stream.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        (0..12)
            .map(|_| {
                self.0 = self
                    .0
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (self.0 >> 11) as f64 / (1_u64 << 53) as f64
            })
            .sum::<f64>()
            - 6.0
    }
}

fn fit(normals: &[Vector3<f64>], values: &[f64]) -> HarmonicsFit {
    fit_robust(normals, values, None).unwrap()
}

fn largest_error(fit: &HarmonicsFit) -> f64 {
    fit.coefficients
        .0
        .iter()
        .zip(&LIGHT.0)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn exact_data_give_exact_coefficients() {
    let normals = visible(20);
    let values: Vec<f64> = normals.iter().map(|n| LIGHT.evaluate(n)).collect();
    let found = fit(&normals, &values);
    let error = largest_error(&found);
    assert!(error < 1e-10, "off by {error}");
    assert!(found.condition < 100.0, "condition {}", found.condition);
    assert_eq!(found.order, 2);
}

#[test]
fn patches_in_shadow_or_under_a_highlight_are_told_apart() {
    type Patch = (&'static str, fn(&Vector3<f64>) -> f64);
    let patches: [Patch; 5] = [
        ("foot", |n| if n.y > 0.4 { 0.5 } else { 1.0 }),
        ("foot, faint", |n| if n.y > 0.4 { 0.7 } else { 1.0 }),
        (
            "quarter",
            |n| if n.x > 0.0 && n.y > 0.0 { 0.35 } else { 1.0 },
        ),
        ("lit side", |n| if n.x < -0.35 { 0.4 } else { 1.0 }),
        ("highlight", |n| {
            if (n - Vector3::new(-0.3, -0.4, -0.86)).norm() < 0.25 {
                1.6
            } else {
                1.0
            }
        }),
    ];
    for (name, factor) in patches {
        for radius in [40, 70, 100] {
            let mut noise = Noise(3);
            let normals = visible(radius);
            let values: Vec<f64> = normals
                .iter()
                .map(|n| LIGHT.evaluate(n) * factor(n) * (1.0 + 0.01 * noise.next()))
                .collect();
            let found = fit(&normals, &values);
            let direction = |l: &SphericalHarmonics| Vector3::new(l.0[0], l.0[1], l.0[2]);
            let angle = direction(&found.coefficients)
                .angle(&direction(&LIGHT))
                .to_degrees();
            // Three statistical deviations with a quarter of the samples missing.
            let allowed = if radius < 50 { 2.0 } else { 0.5 };
            assert!(
                angle < allowed,
                "{name}, {radius} px: direction off by {angle}°"
            );
        }
    }
}

#[test]
fn covariance_agrees_with_repeated_draws() {
    let normals = visible(15);
    let mut noise = Noise(5);
    let (mut sum, mut square, mut stated) = ([0.0; 9], [0.0; 9], [0.0; 9]);
    let num_draws = 200.0;
    for _ in 0..200 {
        let values: Vec<f64> = normals
            .iter()
            .map(|n| {
                let clean = LIGHT.evaluate(n);
                clean + 0.01 * clean.max(0.1) * noise.next()
            })
            .collect();
        let found = fit(&normals, &values);
        for k in 0..9 {
            sum[k] += found.coefficients.0[k];
            square[k] += found.coefficients.0[k].powi(2);
            stated[k] += found.covariance[k * 10] / num_draws;
        }
    }
    for k in 0..9 {
        let variance = square[k] / num_draws - (sum[k] / num_draws).powi(2);
        let ratio = (variance / stated[k]).sqrt();
        // 200 draws know a deviation to 5 %.
        assert!(
            (0.8..1.25).contains(&ratio),
            "coefficient {k}: {ratio} of the stated deviation"
        );
    }
}

#[test]
fn poor_normals_give_four_coefficients_and_poorer_ones_an_error() {
    let few: Vec<Vector3<f64>> = visible(3).into_iter().take(8).collect();
    let values: Vec<f64> = few.iter().map(|n| LIGHT.evaluate(n)).collect();
    assert_eq!(fit(&few, &values).order, 1);
    let cap: Vec<Vector3<f64>> = visible(60)
        .into_iter()
        .filter(|n| n.x.hypot(n.y) < 0.25)
        .collect();
    let values: Vec<f64> = cap.iter().map(|n| LIGHT.evaluate(n)).collect();
    assert_eq!(
        fit(&cap, &values).order,
        1,
        "a small cap does not tell nine coefficients"
    );
    let same = vec![Vector3::new(0.0, 0.0, -1.0); 50];
    let result = fit_robust(&same, &[0.5; 50], None);
    assert!(
        matches!(result, Err(FitError::Degenerate { .. })),
        "{result:?}"
    );
    let result = fit_robust(&same[..2], &[0.5; 2], None);
    assert!(
        matches!(result, Err(FitError::TooFewSamples { .. })),
        "{result:?}"
    );
    let result = fit_robust(&same, &[f64::NAN; 50], None);
    assert!(
        matches!(result, Err(FitError::NotFinite { sample_idx: 0 })),
        "{result:?}"
    );
    let result = fit_robust(&same, &[0.5; 9], None);
    assert!(
        matches!(result, Err(FitError::Lengths { .. })),
        "{result:?}"
    );
}
