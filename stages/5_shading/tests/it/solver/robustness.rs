//! Stains, pixels that cannot be used, odd masks, and input that is refused.

use super::surface::Surface;
use super::{problem, refused, solved};
use rilievo_scene::{Lighting, LinearImage, Mask, Silent, SphericalHarmonics};
use rilievo_shading::ShadingError;
use rilievo_shading::paper::{PaperOptions, ShadingProblem, ViewLight, solve};
use rilievo_synthetic::testing::Impatient;
use std::sync::Arc;

#[test]
fn stains_are_ignored_by_a_robust_loss() {
    let surface = Surface::new(128);
    let mut view = surface.view(3);
    let mut image = view.image.as_ref().clone();
    for k in 0..40 {
        let (x, y) = (30 + (k * 29) % 68, 30 + (k * 43) % 68);
        image.pixel_mut(x, y).fill(0.1);
    }
    view.image = Arc::new(image);
    let plain = surface.mean_angle(&solved(view.clone(), &PaperOptions::default()));
    let options = PaperOptions {
        loss: rilievo_numerics::robust::RobustLoss::Cauchy(0.05),
        ..PaperOptions::default()
    };
    let robust = surface.mean_angle(&solved(view, &options));
    assert!(robust < plain && robust < 0.8, "{robust} against {plain}");
}

#[test]
fn clipped_dark_and_undefined_pixels_are_left_out_and_counted() {
    let surface = Surface::new(96);
    let mut view = surface.view(3);
    let mut image = view.image.as_ref().clone();
    image.pixel_mut(40, 40)[0] = f32::NAN;
    image.pixel_mut(50, 50)[1] = 10.0;
    image.pixel_mut(60, 40).fill(0.001);
    view.image = Arc::new(image);
    view.clip_level = Some(5.0);
    let options = PaperOptions {
        shadow_level: 0.01,
        ..PaperOptions::default()
    };
    let solution = solved(view, &options);
    let facts = &solution.report.views[0];
    assert_eq!(
        (
            facts.num_not_finite,
            facts.num_saturated,
            facts.num_shadowed
        ),
        (1, 1, 1)
    );
    assert!(surface.mean_angle(&solution) < 0.8);
    assert!(solution.views[0].depth.data.iter().all(|z| z.is_finite()));
}

#[test]
fn odd_masks_have_a_defined_result() {
    let surface = Surface::new(64);
    let single = Mask::from_fn(64, 64, |x, y| (x, y) == (30, 31));
    let islands = Mask::from_fn(64, 64, |x, y| (x < 20 && y < 20) || (x > 40 && y > 45));
    let frame = Mask::filled(64, 64, true);
    for mask in [single, islands, frame] {
        let mut view = surface.view(3);
        view.mask = mask.clone();
        let solution = solved(view, &PaperOptions::default());
        let depth = &solution.views[0].depth;
        for (z, inside) in depth.data.iter().zip(&mask.data) {
            assert!(z.is_finite() && (*z > 0.0) == *inside, "{z} {inside}");
        }
    }
}

#[test]
fn impossible_input_is_named() {
    let surface = Surface::new(48);
    let mut view = surface.view(3);
    view.mask = Mask::filled(48, 48, false);
    assert!(matches!(
        refused(view),
        ShadingError::EmptyMask { num_masked: 0, .. }
    ));

    let mut view = surface.view(3);
    view.mask = Mask::filled(47, 48, true);
    assert!(matches!(refused(view), ShadingError::SizeMismatch { .. }));

    for (row, expected) in [
        ([0.0; 9], "zero"),
        ([f64::NAN; 9], "not finite"),
        (
            [0.0, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0],
            "the same for every normal",
        ),
    ] {
        let mut view = surface.view(1);
        view.lighting = ViewLight::Uniform(Lighting {
            channels: vec![SphericalHarmonics(row)],
        });
        let error = refused(view);
        assert!(
            matches!(error, ShadingError::UninformativeLighting { reason, .. } if reason == expected),
            "{error}"
        );
    }

    let mut view = surface.view(3);
    view.lighting = ViewLight::Uniform(surface.lighting(1));
    assert!(matches!(
        refused(view),
        ShadingError::ChannelMismatch { .. }
    ));

    let mut view = surface.view(3);
    view.initial_depth = None;
    assert!(matches!(refused(view), ShadingError::NoDepth { .. }));

    let mut view = surface.view(3);
    view.image = Arc::new(LinearImage::filled(48, 48, 3, f32::NAN));
    assert!(matches!(refused(view), ShadingError::EmptyMask { .. }));

    let error = solve(
        &ShadingProblem::default(),
        &PaperOptions::default(),
        &Silent,
    );
    assert!(matches!(error, Err(ShadingError::NoViews)));
}

#[test]
fn an_observer_can_stop_it() {
    let surface = Surface::new(48);
    let result = solve(
        &problem(surface.view(3)),
        &PaperOptions::default(),
        &Impatient,
    );
    assert!(matches!(result, Err(ShadingError::Interrupted)));
}
