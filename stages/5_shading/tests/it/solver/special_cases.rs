//! What the general problem contains: known albedo, weights, one light, first order, a depth prior.

use super::surface::Surface;
use super::{problem, solved};
use rilievo_scene::{DepthMap, Lighting, LinearImage, Raster, Recorder, SphericalHarmonics};
use rilievo_shading::paper::{
    DepthPrior, HarmonicOrder, PaperOptions, ShadingView, StartShape, ViewLight, solve,
};
use std::sync::Arc;

/// A chequered albedo.
fn chequered(size: usize) -> LinearImage {
    let mut albedo = LinearImage::filled(size, size, 3, 1.0);
    for y in 0..size {
        for x in 0..size {
            if (x / 8 + y / 8).is_multiple_of(2) {
                albedo.pixel_mut(x, y).copy_from_slice(&[0.6, 0.45, 0.3]);
            }
        }
    }
    albedo
}

#[test]
fn a_given_albedo_leaves_no_pattern() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    let albedo = chequered(surface.size);
    let image = Arc::make_mut(&mut view.image);
    for (value, albedo) in image.data.iter_mut().zip(&albedo.data) {
        *value *= albedo;
    }
    let painted = surface.mean_angle(&solved(view.clone(), &PaperOptions::default()));
    view.albedo = Some(Arc::new(albedo));
    let known = surface.mean_angle(&solved(view, &PaperOptions::default()));
    assert!(known < 0.5, "{known}, {painted} without");
    assert!(known < 0.2 * painted, "{known}, {painted} without");
}

#[test]
fn pixels_without_weight_do_no_harm() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    let mut weights = Raster::filled(surface.size, surface.size, 1.0);
    let image = Arc::make_mut(&mut view.image);
    for y in 60..66 {
        for x in 40..90 {
            image.pixel_mut(x, y).fill(0.05);
            *weights.at_mut(x, y) = 0.0;
        }
    }
    view.weights = Some(weights);
    let angle = surface.mean_angle(&solved(view, &PaperOptions::default()));
    assert!(angle < 0.5, "{angle}");
}

fn under(surface: &Surface, rows: &[[f64; 9]]) -> ShadingView {
    let lighting = Lighting {
        channels: rows.iter().map(|&row| SphericalHarmonics(row)).collect(),
    };
    let mut view = ShadingView::new(
        "special",
        Arc::new(surface.image(&lighting)),
        surface.mask(),
        surface.camera(),
        ViewLight::Uniform(lighting),
    );
    view.initial_depth = Some(surface.rough());
    view
}

#[test]
fn a_view_without_any_depth_is_shaped_from_a_plane_up_to_one_factor() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    view.initial_depth = None;
    let options = PaperOptions {
        start: StartShape::Plane,
        ..PaperOptions::default()
    };
    let told = Recorder::default();
    let solution = solve(&problem(view), &options, &told).expect("a valid problem");
    let angle = surface.mean_angle(&solution);
    let warnings = told.warnings();
    assert!(angle < 0.5, "{angle}");
    assert!(
        warnings.len() == 1 && warnings[0].contains("up to one factor"),
        "{warnings:?}"
    );
}

#[test]
fn one_directional_light_explains_its_image() {
    let surface = Surface::new(128);
    let view = under(
        &surface,
        &[[-0.4, -0.3, -0.85, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]],
    );
    let solution = solved(view, &PaperOptions::default());
    let facts = &solution.report.views[0];
    let angle = surface.mean_angle(&solution);
    assert!(facts.rms_rendered < 0.2 * facts.rms_start, "{facts:?}");
    assert!(angle < 5.0, "{angle}");
}

#[test]
fn first_order_light_is_the_same_in_either_order() {
    let surface = Surface::new(96);
    let rows = [
        [-0.5, 0.0, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.5, 0.1, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.6, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
    let [first, second] = [HarmonicOrder::First, HarmonicOrder::Second].map(|order| {
        let options = PaperOptions {
            order,
            ..PaperOptions::default()
        };
        solved(under(&surface, &rows), &options)
    });
    assert_eq!(first.views[0].depth.data, second.views[0].depth.data);
    let angle = surface.mean_angle(&first);
    assert!(angle < 0.2, "{angle}");
}

#[test]
fn a_noisy_depth_is_refined_and_its_area_term_smooths() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    // A sensor's steps: far coarser than the relief.
    let step = 0.004 * surface.scale;
    let truth = surface.depth();
    let measured = DepthMap::from_fn(surface.size, surface.size, |x, y| {
        ((f64::from(*truth.at(x, y)) / step).round() * step) as f32
    });
    view.initial_depth = None;
    view.prior = Some(DepthPrior {
        depth: measured,
        weight: 500.0,
    });
    let area = |area_weight: f64| {
        let options = PaperOptions {
            area_weight,
            ..PaperOptions::default()
        };
        let solution = solved(view.clone(), &options);
        let facts = &solution.report.views[0];
        let per_weight = facts.energy_area / area_weight.max(1e-12);
        (surface.mean_angle(&solution), per_weight)
    };
    let (angle, _) = area(0.0);
    assert!(angle < 1.0, "{angle}");
    let (_, light) = area(1e-4);
    let (_, heavy) = area(0.05);
    assert!(
        heavy < light,
        "area {heavy} with a heavy weight, {light} with a light one"
    );
}
