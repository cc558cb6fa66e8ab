//! Exact and rough data on a smooth surface.

use super::solved;
use super::surface::Surface;
use rilievo_scene::{Lighting, Raster, SphericalHarmonics};
use rilievo_shading::paper::{
    DepthAnchor, PaperOptions, ShadingView, Splitting, StartShape, ViewLight,
};
use std::sync::Arc;

#[test]
fn recovers_an_exact_surface_and_better_as_pixels_shrink() {
    let angles: Vec<f64> = [48, 96, 192]
        .iter()
        .map(|&size| {
            let surface = Surface::new(size);
            surface.mean_angle(&solved(surface.view(3), &PaperOptions::default()))
        })
        .collect();
    assert!(angles[0] < 1.0 && angles[2] < 0.25, "{angles:?}");
    assert!(angles[2] < angles[0], "{angles:?}");
}

#[test]
fn finds_the_surface_from_a_plane() {
    let surface = Surface::new(128);
    let options = PaperOptions {
        start: StartShape::Plane,
        ..PaperOptions::default()
    };
    let angle = surface.mean_angle(&solved(surface.view(3), &options));
    assert!(angle < 1.0, "{angle}");
}

#[test]
fn a_grey_image_improves_a_rough_start() {
    let surface = Surface::new(128);
    let solution = solved(surface.view(1), &PaperOptions::default());
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    // Where shading weighs nothing, the surface stays where it starts.
    let mut unshaded = surface.view(1);
    let (width, height) = (unshaded.image.width, unshaded.image.height);
    unshaded.weights = Some(Raster::filled(width, height, 1e-12));
    let start = surface.mean_angle(&solved(unshaded, &PaperOptions::default()));
    assert!(facts.rms_rendered < 0.3 * facts.rms_start, "{facts:?}");
    assert!(angle < 0.6 * start, "{angle}, at the start {start}");
}

#[test]
fn anchors_fix_the_scale_without_any_start() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    view.initial_depth = None;
    for k in 0..60 {
        let (x, y) = (24.0 + ((k * 37) % 80) as f64, 24.0 + ((k * 53) % 80) as f64);
        view.anchors.push(DepthAnchor {
            pixel: [x, y],
            depth: surface.ln_depth(x, y).exp(),
            sigma_ln_depth: 1e-4,
        });
    }
    let solution = solved(view, &PaperOptions::default());
    let angle = surface.mean_angle(&solution);
    let truth = surface.depth();
    let worst = solution.views[0]
        .depth
        .data
        .iter()
        .zip(&truth.data)
        .filter(|(z, _)| **z > 0.0)
        .map(|(z, t)| (z / t - 1.0).abs())
        .fold(0.0, f32::max);
    assert!(angle < 0.5, "{angle}");
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn the_papers_splitting_converges_and_improves_the_start() {
    let surface = Surface::new(96);
    let options = PaperOptions {
        splitting: Splitting::Paper,
        ..PaperOptions::default()
    };
    let solution = solved(surface.view(3), &options);
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    assert!(facts.rms_rendered < 0.3 * facts.rms_start, "{facts:?}");
    assert!(angle < 2.0, "{angle}");
}

#[test]
fn the_eikonal_equation_is_a_special_case() {
    let surface = Surface::new(128);
    let lighting = Lighting {
        channels: vec![SphericalHarmonics([
            0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ])],
    };
    let mut view = ShadingView::new(
        "eikonal",
        Arc::new(surface.image(&lighting)),
        surface.mask(),
        surface.camera(),
        ViewLight::Uniform(lighting),
    );
    view.initial_depth = Some(surface.rough());
    let solution = solved(view, &PaperOptions::default());
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    assert!(facts.rms_rendered < 0.02, "{}", facts.rms_rendered);
    assert!(angle < 4.0, "{angle}");
}
