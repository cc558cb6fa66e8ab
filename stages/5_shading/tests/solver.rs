//! The solver on analytic surfaces: recovery, invariances, special cases, refusals.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Vector3;
use rilievo_scene::{
    DepthMap, Event, Flow, Intrinsics, Lighting, LinearImage, Mask, Observer, Silent,
    SphericalHarmonics,
};
use rilievo_shading::{
    Coupling, DepthAnchor, PenaltySchedule, Projection, ShadingError, ShadingOptions,
    ShadingProblem, ShadingSolution, ShadingView, Splitting, StartShape, ViewLight, solve,
};
use std::sync::Arc;

#[path = "../examples/table/mod.rs"]
mod table;

/// A smooth surface: depth relative to the reference as a function of the viewing ray, and slopes by
/// differences far below a pixel.
struct Surface {
    size: usize,
    focal: f64,
    scale: f64,
    intensity: f64,
}

impl Surface {
    fn new(size: usize) -> Self {
        Self {
            size,
            focal: 1.5 * size as f64,
            scale: 2.0,
            intensity: 1.0,
        }
    }

    fn camera(&self) -> Intrinsics {
        let centre = (self.size as f64 - 1.0) / 2.0;
        Intrinsics::pinhole(self.size, self.size, self.focal, centre, centre)
    }

    fn ln_depth(&self, x: f64, y: f64) -> f64 {
        // Image coordinates from −1 to 1.
        let half = self.size as f64 / 2.0;
        let centre = (self.size as f64 - 1.0) / 2.0;
        let (u, v) = ((x - centre) / half, (y - centre) / half);
        let bump = 0.5 * (u * u + 0.8 * v * v) + 0.06 * (5.0 * u).sin() * (4.0 * v + 0.5).cos();
        self.scale.ln() + bump * half / self.focal
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let h = 1e-4;
        let p = self.focal * (self.ln_depth(x + h, y) - self.ln_depth(x - h, y)) / (2.0 * h);
        let q = self.focal * (self.ln_depth(x, y + h) - self.ln_depth(x, y - h)) / (2.0 * h);
        let camera = self.camera();
        let (u, v) = ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
        Vector3::new(p, q, -1.0 - u * p - v * q).normalize()
    }

    fn mask(&self) -> Mask {
        let centre = (self.size as f64 - 1.0) / 2.0;
        let radius = 0.45 * self.size as f64;
        Mask::from_fn(self.size, self.size, |x, y| {
            (x as f64 - centre).hypot(y as f64 - centre) < radius
        })
    }

    fn lighting(&self, channels: usize) -> Lighting {
        let rows = [
            [-0.2, -0.2, -1.0, 0.4, 0.1, -0.1, -0.1, -0.1, 0.05],
            [0.0, 0.2, -1.0, 0.3, 0.0, 0.2, 0.1, 0.0, 0.1],
            [0.2, -0.2, -1.0, 0.2, -0.1, 0.0, 0.0, 0.1, 0.0],
        ];
        Lighting {
            channels: rows[..channels]
                .iter()
                .map(|row| SphericalHarmonics(row.map(|l| l * self.intensity)))
                .collect(),
        }
    }

    fn image(&self, lighting: &Lighting) -> LinearImage {
        let channels = lighting.channels.len();
        let mut image = LinearImage::filled(self.size, self.size, channels, 0.0);
        for y in 0..self.size {
            for x in 0..self.size {
                let n = self.normal(x as f64, y as f64);
                for (c, row) in lighting.channels.iter().enumerate() {
                    image.pixel_mut(x, y)[c] = row.evaluate(&n) as f32;
                }
            }
        }
        image
    }

    fn depth(&self) -> DepthMap {
        DepthMap::from_fn(self.size, self.size, |x, y| {
            self.ln_depth(x as f64, y as f64).exp() as f32
        })
    }

    /// The surface without its waves, 3 to 6 degrees off.
    fn rough(&self) -> DepthMap {
        let half = self.size as f64 / 2.0;
        let centre = (self.size as f64 - 1.0) / 2.0;
        DepthMap::from_fn(self.size, self.size, |x, y| {
            let (u, v) = ((x as f64 - centre) / half, (y as f64 - centre) / half);
            let bump = 0.45 * (u * u + 0.8 * v * v);
            (self.scale * (bump * half / self.focal).exp()) as f32
        })
    }

    fn view(&self, channels: usize) -> ShadingView {
        let lighting = self.lighting(channels);
        let mut view = ShadingView::new(
            "view",
            Arc::new(self.image(&lighting)),
            self.mask(),
            self.camera(),
            ViewLight::Uniform(lighting),
        );
        view.initial_depth = Some(self.rough());
        view
    }

    fn mean_angle(&self, solution: &ShadingSolution) -> f64 {
        let normals = &solution.views[0].normal;
        let (mut sum, mut count) = (0.0, 0);
        for y in 0..self.size {
            for x in 0..self.size {
                if let Some(n) = normals.normal(x, y) {
                    let truth = self.normal(x as f64, y as f64);
                    sum += n.dot(&truth).clamp(-1.0, 1.0).acos().to_degrees();
                    count += 1;
                }
            }
        }
        sum / f64::from(count)
    }
}

fn problem(view: ShadingView) -> ShadingProblem {
    ShadingProblem {
        views: vec![view],
        matches: Vec::new(),
    }
}

fn solved(view: ShadingView, options: &ShadingOptions) -> ShadingSolution {
    solve(&problem(view), options, &Silent).expect("a valid problem")
}

fn refused(view: ShadingView) -> ShadingError {
    match solve(&problem(view), &ShadingOptions::default(), &Silent) {
        Ok(_) => panic!("accepted"),
        Err(error) => error,
    }
}

#[test]
fn recovers_an_exact_surface_and_better_as_pixels_shrink() {
    let angles: Vec<f64> = [48, 96, 192]
        .iter()
        .map(|&size| {
            let surface = Surface::new(size);
            surface.mean_angle(&solved(surface.view(3), &ShadingOptions::default()))
        })
        .collect();
    assert!(angles[0] < 1.0 && angles[2] < 0.25, "{angles:?}");
    assert!(angles[2] < angles[0], "{angles:?}");
}

#[test]
fn finds_the_surface_from_a_plane() {
    let surface = Surface::new(128);
    let options = ShadingOptions {
        start: StartShape::Plane,
        ..ShadingOptions::default()
    };
    let angle = surface.mean_angle(&solved(surface.view(3), &options));
    assert!(angle < 1.0, "{angle}");
}

#[test]
fn a_grey_image_improves_a_rough_start() {
    let surface = Surface::new(128);
    let solution = solved(surface.view(1), &ShadingOptions::default());
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    let frozen = ShadingOptions {
        schedule: PenaltySchedule::Explicit {
            start: 1e6,
            growth: 2.0,
            num_iterations: 1,
            num_search_iterations: 0,
        },
        noise: 100.0,
        ..ShadingOptions::default()
    };
    let start = surface.mean_angle(&solved(surface.view(1), &frozen));
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
    let solution = solved(view, &ShadingOptions::default());
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
fn the_literal_coupling_of_two_views_agrees_with_anchors() {
    // Two views of one plane-like relief from cameras side by side, matched by projection.
    let data = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(3)
        .map(|root| root.join("shared/data/shading_table"));
    let Some(data) = data.filter(|data| data.is_dir()) else {
        eprintln!("skipped: no shared data beside the repository");
        return;
    };
    let problem = table::two_views(&data, "L3");
    for coupling in [Coupling::Anchors, Coupling::Literal] {
        let options = ShadingOptions {
            coupling,
            ..ShadingOptions::default()
        };
        let solution = solve(&problem, &options, &Silent).expect("a valid problem");
        for view in &solution.views {
            let angle = table::mean_angle(&data, view);
            println!("{coupling:?} {}: {angle}", view.name);
            assert!(angle < 2.2, "{coupling:?} {}: {angle}", view.name);
        }
    }
}

#[test]
fn the_papers_cells_are_reached_on_the_shared_scene() {
    let data = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(3)
        .map(|root| root.join("shared/data/shading_table"));
    let Some(data) = data.filter(|data| data.is_dir()) else {
        eprintln!("skipped: no shared data beside the repository");
        return;
    };
    for (light, start, limit) in [
        ("L3", "rough", 1.4),
        ("L1", "rough", 5.3),
        ("L2", "rough", 5.9),
        ("L3", "flat", 1.85),
        ("L1", "flat", 29.5),
    ] {
        let view = table::view(&data, "view1", light, start);
        let solution = solved(view, &ShadingOptions::default());
        let angle = table::mean_angle(&data, &solution.views[0]);
        assert!(angle < limit, "{light} {start}: {angle} over {limit}");
    }
}

#[test]
fn confidence_ranks_the_true_errors() {
    let data = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(3)
        .map(|root| root.join("shared/data/shading_table"));
    let Some(data) = data.filter(|data| data.is_dir()) else {
        eprintln!("skipped: no shared data beside the repository");
        return;
    };
    for light in ["L3", "L1", "L2"] {
        let view = table::view(&data, "view1", light, "rough");
        let solution = solved(view, &ShadingOptions::default());
        let solved = &solution.views[0];
        let confidence = solved.confidence.as_ref().expect("asked for");
        let mut pairs: Vec<(f32, f64)> = table::angles(&data, solved)
            .into_iter()
            .map(|(x, y, angle)| (*confidence.at(x, y), angle))
            .collect();
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        let fifths: Vec<f64> = pairs
            .chunks(pairs.len().div_ceil(5))
            .map(|fifth| fifth.iter().map(|pair| pair.1).sum::<f64>() / fifth.len() as f64)
            .collect();
        println!("{light}: {fifths:?}");
        assert!(fifths[0] < fifths[4], "{light}: {fifths:?}");
    }
}

#[test]
fn scales_of_scene_and_intensity_do_not_matter() {
    let base = Surface::new(96);
    let reference = solved(base.view(3), &ShadingOptions::default());
    let larger = Surface {
        scale: 200.0,
        ..Surface::new(96)
    };
    let brighter = Surface {
        intensity: 7.0,
        ..Surface::new(96)
    };
    for (other, factor) in [(larger, 100.0), (brighter, 1.0)] {
        let solution = solved(other.view(3), &ShadingOptions::default());
        let worst = reference.views[0]
            .depth
            .data
            .iter()
            .zip(&solution.views[0].depth.data)
            .map(|(a, b)| (a * factor - b).abs() / factor)
            .fold(0.0, f32::max);
        assert!(worst < 2e-3, "{worst} at factor {factor}");
    }
}

#[test]
fn a_quarter_turn_of_image_and_light_turns_the_result() {
    let surface = Surface::new(96);
    let view = surface.view(3);
    let size = surface.size;
    // New (x, y) shows old (y, size − 1 − x): the frame turns by 90°, n → (−n₂, n₁, n₃).
    let turn = |x: usize, y: usize| (y, size - 1 - x);
    let ViewLight::Uniform(light) = &view.lighting else {
        panic!("uniform by construction")
    };
    let turned_light = Lighting {
        channels: light
            .channels
            .iter()
            .map(|row| {
                let l = row.0;
                // l · h(n) with n₁ = m₂, n₂ = −m₁ for the turned normal m.
                SphericalHarmonics([-l[1], l[0], l[2], l[3], -l[4], -l[6], l[5], -l[7], l[8]])
            })
            .collect(),
    };
    let mut image = LinearImage::filled(size, size, 3, 0.0);
    for y in 0..size {
        for x in 0..size {
            let (u, v) = turn(x, y);
            image
                .pixel_mut(x, y)
                .copy_from_slice(view.image.pixel(u, v));
        }
    }
    let rough = surface.rough();
    let mut turned = ShadingView::new(
        "turned",
        Arc::new(image),
        Mask::from_fn(size, size, |x, y| {
            let (u, v) = turn(x, y);
            *view.mask.at(u, v)
        }),
        surface.camera(),
        ViewLight::Uniform(turned_light),
    );
    turned.initial_depth = Some(DepthMap::from_fn(size, size, |x, y| {
        let (u, v) = turn(x, y);
        *rough.at(u, v)
    }));
    let straight = solved(view, &ShadingOptions::default());
    let turned = solved(turned, &ShadingOptions::default());
    let mut worst = 0.0_f32;
    for y in 0..size {
        for x in 0..size {
            let (u, v) = turn(x, y);
            let difference = turned.views[0].depth.at(x, y) - straight.views[0].depth.at(u, v);
            worst = worst.max(difference.abs());
        }
    }
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn orthographic_and_perspective_agree_as_the_focal_length_grows() {
    let mut distances = Vec::new();
    for focal in [2.0, 50.0] {
        let surface = Surface {
            focal: focal * 192.0,
            ..Surface::new(192)
        };
        let perspective = solved(surface.view(3), &ShadingOptions::default());
        let mut view = surface.view(3);
        // Parallel rays: magnification f/z₀ pixels per unit of depth.
        let magnification = surface.focal / surface.scale;
        view.intrinsics.fx = magnification;
        view.intrinsics.fy = magnification;
        let options = ShadingOptions {
            projection: Projection::Orthographic,
            ..ShadingOptions::default()
        };
        let orthographic = solved(view, &options);
        // Colours fix the normals in either projection: depth tells them apart, in units of the
        // relief, after the free offset. The median, since a few pixels may settle elsewhere.
        let mut ratios: Vec<f64> = perspective.views[0]
            .depth
            .data
            .iter()
            .zip(&orthographic.views[0].depth.data)
            .filter(|(z, _)| **z > 0.0)
            .map(|(a, b)| f64::from(a / b).ln() * surface.focal / surface.size as f64)
            .collect();
        let offset = rilievo_numerics::robust::median(&mut ratios).expect("pixels");
        let mut away: Vec<f64> = ratios.iter().map(|r| (r - offset).abs()).collect();
        distances.push(rilievo_numerics::robust::median(&mut away).expect("pixels"));
    }
    assert!(
        distances[1] < 0.01 && distances[1] < 0.5 * distances[0],
        "{distances:?}"
    );
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
    let solution = solved(view, &ShadingOptions::default());
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    assert!(facts.rms_rendered < 0.02, "{}", facts.rms_rendered);
    assert!(angle < 4.0, "{angle}");
}

#[test]
fn the_papers_splitting_converges_and_improves_the_start() {
    let surface = Surface::new(96);
    let options = ShadingOptions {
        splitting: Splitting::Paper,
        ..ShadingOptions::default()
    };
    let solution = solved(surface.view(3), &options);
    let angle = surface.mean_angle(&solution);
    let facts = &solution.report.views[0];
    assert!(facts.rms_rendered < 0.3 * facts.rms_start, "{facts:?}");
    assert!(angle < 2.0, "{angle}");
}

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
    let plain = surface.mean_angle(&solved(view.clone(), &ShadingOptions::default()));
    let options = ShadingOptions {
        loss: rilievo_numerics::robust::RobustLoss::Cauchy(0.05),
        ..ShadingOptions::default()
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
    let options = ShadingOptions {
        shadow_level: 0.01,
        ..ShadingOptions::default()
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
fn thread_count_does_not_change_a_bit() {
    let surface = Surface::new(160);
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool")
            .install(|| solved(surface.view(3), &ShadingOptions::default()))
    };
    assert_eq!(with(1).views[0].depth.data, with(3).views[0].depth.data);
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
        let solution = solved(view, &ShadingOptions::default());
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
        &ShadingOptions::default(),
        &Silent,
    );
    assert!(matches!(error, Err(ShadingError::NoViews)));
}

#[test]
fn an_observer_can_stop_it() {
    struct Stopper;
    impl Observer for Stopper {
        fn event(&self, _event: Event) -> Flow {
            Flow::Stop
        }
    }
    let surface = Surface::new(48);
    let result = solve(
        &problem(surface.view(3)),
        &ShadingOptions::default(),
        &Stopper,
    );
    assert!(matches!(result, Err(ShadingError::Interrupted)));
}
