//! Anchors of rendered surfaces: exact, noisy, occluded, clipped and degenerate photos.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod kernel;
mod scene;

use super::prepare::Working;
use super::{AnchorOptions, AnchorReport, find, find_at};
use crate::error::PosesError;
use nalgebra::Point3;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{Anchor, Distortion, Event, Flow, Observer, Recorder};
use scene::{Scene, Settings, Shape, photograph};

const BALL: Shape = Shape::Sphere {
    center: Point3::new(0.05, -0.03, 0.0),
    radius: 0.7,
};

const SQUARE: Shape = Shape::Square {
    height: 0.1,
    half_side: 0.6,
};

fn anchors_with(scene: &Scene, options: &AnchorOptions) -> (Vec<Anchor>, AnchorReport) {
    let (anchors, report, _) = anchors_and_told(scene, options);
    (anchors, report)
}

/// The anchors, their report, and what was warned of.
fn anchors_and_told(
    scene: &Scene,
    options: &AnchorOptions,
) -> (Vec<Anchor>, AnchorReport, Vec<String>) {
    let told = Recorder::default();
    let (anchors, report) = find(&scene.photos, &scene.posed, options, None, &told).unwrap();
    (anchors, report, told.warnings())
}

fn anchors(scene: &Scene) -> (Vec<Anchor>, AnchorReport) {
    anchors_with(scene, &AnchorOptions::default())
}

/// Relative depth errors with predicted deviations, over all observations.
fn errors(scene: &Scene, anchors: &[Anchor]) -> Vec<(f64, f64)> {
    anchors
        .iter()
        .flat_map(|anchor| &anchor.observations)
        .map(|o| {
            let truth = scene.depth(o.view.0, o.pixel);
            let error = truth.map_or(f64::INFINITY, |z| o.depth / z - 1.0);
            (error.abs(), o.sigma_ln_depth)
        })
        .collect()
}

fn percentile(errors: &[(f64, f64)], share: f64) -> f64 {
    let mut values: Vec<f64> = errors.iter().map(|e| e.0).collect();
    quantile(&mut values, share).unwrap_or(f64::NAN)
}

/// Every view is covered, and depth is right to `median` (half) and `tail` (99 of 100).
fn assert_recovered(scene: &Scene, coverage: f64, median: f64, tail: f64) {
    let (anchors, report) = anchors(scene);
    for view in &report.views {
        assert!(
            view.coverage.is_some_and(|c| c >= coverage),
            "{view:?}, wanted {coverage}"
        );
    }
    let errors = errors(scene, &anchors);
    let (half, most) = (percentile(&errors, 0.5), percentile(&errors, 0.99));
    assert!(
        half <= median && most <= tail,
        "{} observations, median {half:.2e} (wanted {median:.0e}), 99 % {most:.2e} (wanted {tail:.0e})",
        errors.len()
    );
}

#[test]
fn a_plane_is_recovered_tightly() {
    assert_recovered(
        &photograph(&[SQUARE], &Settings::default()),
        0.9,
        1e-4,
        1e-3,
    );
}

#[test]
fn a_sphere_is_recovered_up_to_the_curvature_of_a_patch() {
    // A window of deviation s = 6 px · z/f = 0.044 on radius 0.7 lies s²/R = 2.8e-3 deeper than its
    // centre on average, 0.9e-3 of the depth, and more where it is tilted.
    assert_recovered(
        &photograph(&[BALL], &Settings::default()),
        0.75,
        1.3e-3,
        6e-3,
    );
}

#[test]
fn predicted_deviations_are_honest_under_noise() {
    let settings = Settings {
        noise: 0.03,
        contrast: 0.06,
        ..Settings::default()
    };
    let scene = photograph(&[SQUARE], &settings);
    let (anchors, report) = anchors(&scene);
    let mut scaled: Vec<f64> = errors(&scene, &anchors)
        .iter()
        .map(|(error, sigma)| error / sigma)
        .collect();
    assert!(scaled.len() > 500, "{} observations", scaled.len());
    let ratio = quantile(&mut scaled, 0.6827).unwrap();
    // White noise correlates only through the blur: the floor makes the prediction careful.
    assert!(
        (0.4..=1.3).contains(&ratio),
        "68 % of errors lie within {ratio:.2} deviations, noise factor {:?}",
        report.noise_factor
    );
}

#[test]
fn a_body_in_front_gives_no_anchors_between_the_surfaces() {
    let front = Shape::Sphere {
        center: Point3::new(0.0, 0.05, -0.45),
        radius: 0.2,
    };
    let scene = photograph(&[SQUARE, front], &Settings::default());
    let (anchors, _) = anchors(&scene);
    let errors = errors(&scene, &anchors);
    let wrong = errors.iter().filter(|e| e.0.is_nan() || e.0 > 0.01).count();
    assert!(
        errors.len() > 700 && wrong * 100 <= errors.len(),
        "{wrong} of {} observations are off by more than 1 %",
        errors.len()
    );
}

#[test]
fn exposure_and_clipping_do_not_harm() {
    let mut scene = photograph(&[SQUARE], &Settings::default());
    // A fifth of a stop, and a glint that stays where it is in the photo.
    scene.change(1, |_, _, v| 0.87 * v);
    let glint = |x: usize, y: usize| (110..140).contains(&x) && (90..120).contains(&y);
    scene.change(2, |x, y, v| if glint(x, y) { 1.0 } else { v });
    let (anchors, _) = anchors(&scene);
    let near_glint: Vec<Anchor> = anchors
        .iter()
        .filter(|anchor| {
            anchor
                .observations
                .iter()
                .any(|o| o.view.0 == 2 && (o.pixel[0] - 125.0).hypot(o.pixel[1] - 105.0) < 30.0)
        })
        .cloned()
        .collect();
    let worst = percentile(&errors(&scene, &near_glint), 1.0);
    assert!(worst < 5e-3, "{worst:.2e} near the glint");
    let errors = errors(&scene, &anchors);
    let most = percentile(&errors, 0.99);
    assert!(
        errors.len() > 900 && most < 2e-3,
        "{} observations, 99 % within {most:.2e}",
        errors.len()
    );
}

#[test]
fn distorted_lenses_are_undone() {
    let settings = Settings {
        distortion: Distortion {
            k1: -0.25,
            k2: 0.1,
            p1: 2e-3,
            ..Distortion::default()
        },
        ..Settings::default()
    };
    assert_recovered(&photograph(&[SQUARE], &settings), 0.85, 3e-4, 2e-3);
}

#[test]
fn reduced_photos_keep_positions_and_depths() {
    let scene = photograph(&[SQUARE], &Settings::default());
    let working = Working {
        max_mpx: 0.02,
        patch_radius_px: 8,
    };
    let options = AnchorOptions::default();
    let (photos, posed) = (&scene.photos, &scene.posed);
    let told = Recorder::default();
    let (anchors, _) = find_at(photos, posed, &options, working, None, &told).unwrap();
    let errors = errors(&scene, &anchors);
    let most = percentile(&errors, 0.95);
    assert!(
        errors.len() > 150 && most < 3e-3,
        "{} observations, 95 % within {most:.2e}",
        errors.len()
    );
}

/// Stops at the first event.
struct Impatient;

impl Observer for Impatient {
    fn event(&self, _event: Event) -> Flow {
        Flow::Stop
    }
}

#[test]
fn an_observer_can_stop_it() {
    let scene = photograph(&[SQUARE], &Settings::default());
    let options = AnchorOptions::default();
    let result = find(&scene.photos, &scene.posed, &options, None, &Impatient);
    assert!(matches!(result, Err(PosesError::Interrupted)), "{result:?}");
}

#[test]
fn images_that_do_not_fit_into_memory_are_loaded_when_their_turn_comes() {
    let scene = photograph(&[BALL], &Settings::default());
    let found = |memory| {
        let options = AnchorOptions::default();
        let told = Recorder::default();
        find(&scene.photos, &scene.posed, &options, memory, &told).unwrap()
    };
    let (all, report) = found(None);
    assert!(all.len() > 100, "{}", all.len());
    for memory in [1, 2_000_000] {
        assert_eq!(found(Some(memory)), (all.clone(), report.clone()));
    }
}

#[test]
fn options_out_of_range_are_named() {
    let options = AnchorOptions { spacing_px: 0.5 };
    let message = options.validate().unwrap_err().to_string();
    assert!(message.contains("spacing_px"), "{message}");
}

/// An empty result with a warning, never an error.
fn assert_empty(scene: &Scene, reason: &str) {
    let (anchors, _, warnings) = anchors_and_told(scene, &AnchorOptions::default());
    assert!(anchors.is_empty(), "{reason}: {} anchors", anchors.len());
    assert!(!warnings.is_empty(), "{reason}: no warning");
}

#[test]
fn degenerate_photos_give_nothing_and_say_so() {
    let one = Settings {
        num_views: 1,
        ..Settings::default()
    };
    assert_empty(&photograph(&[BALL], &one), "one view");
    let apart = Settings {
        num_views: 2,
        step_deg: 170.0,
        ..Settings::default()
    };
    assert_empty(&photograph(&[BALL], &apart), "no overlap");
    let flat = Settings {
        contrast: 0.0,
        ..Settings::default()
    };
    assert_empty(&photograph(&[SQUARE], &flat), "nothing to see");
    let unmasked = Settings {
        masks: false,
        ..Settings::default()
    };
    assert_empty(&photograph(&[BALL], &unmasked), "no masks, no points");
    let mut nothing = photograph(&[BALL], &Settings::default());
    nothing.posed.views.clear();
    assert_empty(&nothing, "no poses");
}

#[test]
fn without_masks_the_sparse_points_bound_the_search() {
    let settings = Settings {
        masks: false,
        ..Settings::default()
    };
    let mut scene = photograph(&[SQUARE], &settings);
    for (x, y) in [
        (-0.5, -0.5),
        (0.5, -0.4),
        (-0.4, 0.5),
        (0.5, 0.5),
        (0.0, 0.1),
    ] {
        scene.posed.points.push(rilievo_scene::SparsePoint {
            position: [x, y, 0.1],
            color: [0; 3],
            error_px: 0.3,
            track: Vec::new(),
        });
    }
    let (anchors, report, warnings) = anchors_and_told(&scene, &AnchorOptions::default());
    // Just outside its outline the square still fills half of a patch.
    let mut on_square = errors(&scene, &anchors);
    let all = on_square.len();
    on_square.retain(|e| e.0.is_finite());
    let most = percentile(&on_square, 0.95);
    assert!(
        on_square.len() > 700 && on_square.len() * 10 > 8 * all && most < 2e-3,
        "{} of {all} observations on the square, 95 % within {most:.2e}",
        on_square.len()
    );
    assert!(report.unmasked_views == 5 && !warnings.is_empty());
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let scene = photograph(&[BALL], &Settings::default());
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| anchors(&scene))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn the_order_of_the_photos_hardly_matters() {
    let scene = photograph(&[BALL], &Settings::default());
    let mut turned = photograph(&[BALL], &Settings::default());
    turned.posed.views.reverse();
    let (a, b) = (anchors(&scene).0, anchors(&turned).0);
    let near = a
        .iter()
        .filter(|anchor| {
            b.iter().any(|other| {
                (Point3::from(anchor.position) - Point3::from(other.position)).norm() < 1e-5
            })
        })
        .count();
    // Rounding may tip a threshold here and there.
    assert!(
        near * 100 >= a.len() * 98 && a.len().abs_diff(b.len()) * 50 <= a.len(),
        "{near} of {} are among {}",
        a.len(),
        b.len()
    );
}
