//! The terms' derivatives against central differences, on rendered views off their true depth.
//!
//! Derivatives of the shading residual stand beside it, those of a landing point in `camera`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::matching::{self, MatchOptions};
use super::rendered_tests::{depths, loaded, options, photographed};
use rilievo_numerics::robust::{median, quantile};
use rilievo_stereo::level::{Level, depth_rasters};
use rilievo_stereo::plate;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_synthetic::{LightModel, Subject};

/// Two views, one the other's source, and log depths that are off by up to a pixel's footprint.
fn two_views() -> (Level, Vec<Vec<f64>>) {
    let (mut scene, mut render) = options(Subject::Ellipsoid, LightModel::Harmonics, (240, 180));
    // Structure that reaches over several pixels, so that differences are those of the photo.
    scene.speckle = 0.05;
    render.num_views = 2;
    render.arc_deg = 12.0;
    render.noise = 0.0;
    let world = photographed(scene, &render, None);
    let scene = loaded(&world);
    let mut truth = depths(&world, &scene);
    let level = Level::new(scene.pyramid[0].views.clone(), &[vec![1], vec![0]]);
    let footprint = 1.0 / level.focal();
    for (view, depth) in level.views.iter().zip(&mut truth) {
        for (i, z) in depth.iter_mut().enumerate() {
            let (x, y) = view.xy(i);
            *z += footprint * (0.11 * x + 0.07 * y).sin();
        }
    }
    (level, truth)
}

#[test]
fn slope_of_the_photos_disagreement_agrees_with_differences() {
    let (level, depths) = two_views();
    let rasters = depth_rasters(&level, &depths);
    let options = MatchOptions {
        sigma: 1.0,
        threshold: f64::INFINITY,
        visible_tolerance: 1.0,
        gain_field_px: 0.0,
        left_out: None,
    };
    // With unit sigma and no Huber threshold a pixel's cost is half its squared residual, and `−rhs` its slope.
    let at = |shift: f64| {
        let moved: Vec<f64> = depths[0].iter().map(|z| z + shift).collect();
        matching::terms(&level, 0, &moved, &rasters, &options)
    };
    let step = 0.02 / level.focal();
    let (back, here, ahead) = (at(-step), at(0.0), at(step));
    let cost = |r: f32| 0.5 * f64::from(r).powi(2);
    let mut deviations = Vec::new();
    for p in 0..depths[0].len() {
        let slope = -here.rhs[p];
        let numeric = (cost(ahead.residual[p]) - cost(back.residual[p])) / (2.0 * step);
        // Where the residual is nearly zero its slope is a difference of roundings.
        if [&back, &here, &ahead].iter().all(|t| t.num_visible[p] == 1) && here.residual[p] > 0.02 {
            // The mean intensity by which residuals are divided moves too: half the residual.
            let bound = 0.6 * f64::from(here.residual[p]);
            deviations.push((numeric / slope - 1.0).abs() - bound);
        }
    }
    let count = deviations.len();
    let (middle, most) = (
        median(&mut deviations).unwrap(),
        quantile(&mut deviations, 0.95).unwrap(),
    );
    println!("{count} pixels: beyond half the residual {middle:.4}, 95 % within {most:.4}");
    assert!(count > 300, "{count} pixels");
    assert!(middle < 0.01 && most < 0.1, "{middle}, {most}");
}

#[test]
fn slope_of_the_distance_to_another_view_agrees_with_differences() {
    let (level, depths) = two_views();
    let step = 0.01 / level.focal();
    let mut slopes = Vec::new();
    // Where a difference crosses a pixel's edge the slope of a bilinear depth jumps.
    for reading in [Reading::Bilinear, Reading::Cubic] {
        let surfaces = Surfaces::new(&level, &depths, reading);
        let at = |p: usize, shift: f64| {
            let proposal = surfaces.propose(0, 0, p, depths[0][p] + shift, 0.1)?;
            Some((proposal.r, proposal.slope))
        };
        let mut errors: Vec<f64> = (0..depths[0].len())
            .filter_map(|p| {
                let (back, here, ahead) = (at(p, -step)?, at(p, 0.0)?, at(p, step)?);
                Some(((ahead.0 - back.0) / (2.0 * step) - here.1).abs())
            })
            .collect();
        let count = errors.len();
        let (middle, most) = (
            median(&mut errors).unwrap(),
            quantile(&mut errors, 0.9).unwrap(),
        );
        println!("{reading:?}, {count} pixels: {middle:.5}, nine of ten within {most:.5}");
        assert!(count > 3000, "{reading:?}: {count} pixels");
        assert!(
            middle < 2e-4 && most < 2e-3,
            "{reading:?}: {middle}, {most}"
        );
        slopes.push(
            (0..depths[0].len())
                .map(|p| at(p, 0.0).map(|o| o.1))
                .collect::<Vec<_>>(),
        );
    }
    // A cubic reading falls back to a bilinear one beside borders alone.
    let pairs = slopes[0]
        .iter()
        .zip(&slopes[1])
        .filter(|(a, _)| a.is_some());
    let (count, same) = pairs.fold((0, 0), |(count, same), (a, b)| {
        (count + 1, same + usize::from(a == b))
    });
    assert!(same * 5 < count, "{same} of {count} slopes are the same");
}

#[test]
fn normals_turn_with_slopes_as_differences_say() {
    let (level, _) = two_views();
    let view = &level.views[0];
    let step = 1e-6;
    for pixel in (0..view.pixels.len()).step_by(997) {
        for (p, q) in [(0.0, 0.0), (0.8, -0.4), (-2.0, 1.5)] {
            let normal = |p: f64, q: f64| plate::normal_with_derivatives(view, pixel, p, q);
            let (_, dp, dq) = normal(p, q);
            for (analytic, (a, b)) in [(dp, (step, 0.0)), (dq, (0.0, step))] {
                let (ahead, back) = (normal(p + a, q + b).0, normal(p - a, q - b).0);
                for k in 0..3 {
                    let numeric = (ahead[k] - back[k]) / (2.0 * step);
                    assert!(
                        (analytic[k] - numeric).abs() < 1e-8,
                        "pixel {pixel}, slopes {p} {q}: {} against {numeric}",
                        analytic[k]
                    );
                }
            }
        }
    }
}
