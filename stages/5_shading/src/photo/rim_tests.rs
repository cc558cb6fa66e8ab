//! Outlines and clipped highlights, each on a scene of one view that isolates it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::chroma::ChromaNoise;
use super::matching::MatchOptions;
use super::rim;
use super::shading::{PixelHarmonics, PixelLight, ShadingTerm, ShadingWeights, render};
use super::step::{self, StepOptions};
use nalgebra::Vector3;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::PlateSystem;
use rilievo_scene::{Intrinsics, LinearImage, Mask, RigidTransform};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::plate;
use rilievo_stereo::surfaces::{Reading, Surfaces};

const SIZE: usize = 160;
const FOCAL: f64 = 800.0;
/// Radius of the ball, pixels.
const RADIUS: f64 = 60.0;
const CENTRE: f64 = (SIZE as f64 - 1.0) / 2.0;
/// Depth of a surface's nearest point.
const NEAREST: f64 = 1.0;
/// What the photo's background shows.
const BACKGROUND: f32 = 0.05;

/// From the left, the top and the front.
const LIGHT: PixelHarmonics = [
    [-0.40, -0.20, -0.30, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.30, -0.30, -0.30, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.30, -0.20, -0.40, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0],
];

/// A surface by its log depth, and where the photo shows it.
struct Scene {
    view: LevelView,
    /// Log depths and normals of the masked pixels.
    depth: Vec<f64>,
    normals: Vec<[f64; 3]>,
}

/// Light without pigment, trust and other views' intensities.
fn alone(harmonics: &[PixelHarmonics]) -> PixelLight<'_> {
    PixelLight {
        harmonics: harmonics.into(),
        pigment: None,
        trust: None,
        mean_tolerance: 0.0,
        openness_exponent: 0.0,
    }
}

impl Scene {
    /// The photo of a surface of `height` footprints behind [`NEAREST`], inside `is_object`, clipped from `clip_level` on;
    /// outermost pixels show half the background.
    fn new(
        height: impl Fn(f64, f64) -> f64,
        is_object: impl Fn(f64, f64) -> bool,
        clip_level: f32,
    ) -> Self {
        let intrinsics = Intrinsics::pinhole(SIZE, SIZE, FOCAL, CENTRE, CENTRE);
        let camera = Camera::new(&intrinsics, &RigidTransform::identity());
        let mask = Mask::from_fn(SIZE, SIZE, |x, y| is_object(x as f64, y as f64));
        let blank = LinearImage::filled(SIZE, SIZE, 3, BACKGROUND);
        let (grid, corner) = LevelView::from_photo(&camera, &blank, &mask, f32::INFINITY);
        let xy = |p: usize| {
            let (x, y) = grid.xy(p);
            (x + corner.0 as f64, y + corner.1 as f64)
        };
        let ln = |x: f64, y: f64| NEAREST.ln() + height(x, y) / FOCAL;
        let depth: Vec<f64> = (0..grid.pixels.len())
            .map(|p| {
                let (x, y) = xy(p);
                ln(x, y)
            })
            .collect();
        let step = 1e-4;
        let normals: Vec<[f64; 3]> = (0..grid.pixels.len())
            .map(|p| {
                let (x, y) = xy(p);
                let slope = |a: f64, b: f64| {
                    // One-sided towards the middle, where the surface is known.
                    FOCAL * (a - b) / step
                };
                let towards = |v: f64| if v > CENTRE { -step } else { step };
                let (dx, dy) = (towards(x), towards(y));
                let sx = slope(ln(x + dx, y), ln(x, y)) * dx.signum();
                let sy = slope(ln(x, y + dy), ln(x, y)) * dy.signum();
                plate::normal_with_derivatives(&grid, p, sx, sy).0
            })
            .collect();
        let mut photo = blank;
        for (p, &normal) in normals.iter().enumerate() {
            let (x, y) = xy(p);
            let background = if grid.is_on_outline(p) { 0.5 } else { 0.0 };
            let seen = render(&LIGHT, normal).map(|v| v as f32);
            let pixel = photo.pixel_mut(x as usize, y as usize);
            for (out, value) in pixel.iter_mut().zip(seen) {
                let mixed = (1.0 - background) * value + background * BACKGROUND;
                *out = mixed.clamp(0.0, clip_level);
            }
        }
        let (view, _) = LevelView::from_photo(&camera, &photo, &mask, clip_level);
        Self {
            view,
            depth,
            normals,
        }
    }

    /// A ball.
    fn ball(clip_level: f32) -> Self {
        let height = |x: f64, y: f64| {
            let squared = (x - CENTRE).powi(2) + (y - CENTRE).powi(2);
            RADIUS - (RADIUS * RADIUS - squared).max(0.0).sqrt()
        };
        let is_object = |x: f64, y: f64| (x - CENTRE).hypot(y - CENTRE) < RADIUS;
        Self::new(height, is_object, clip_level)
    }

    /// A slab that faces the camera, with waves, and ends at sharp edges.
    fn slab() -> Self {
        let height = |x: f64, y: f64| 2.0 * (0.1 * x).sin() * (0.13 * y).cos();
        let is_object = |x: f64, y: f64| (x - CENTRE).abs().max((y - CENTRE).abs()) < RADIUS;
        Self::new(height, is_object, f32::INFINITY)
    }

    /// The surface after rounds from `start`, held by shading alone.
    fn solved(&self, start: &[f64], num_rounds: usize) -> Vec<f64> {
        let level = Level::new(vec![self.view.clone()], &[Vec::new()]);
        let solver = PlateSolver::direct(&self.view.pixels).unwrap();
        let options = StepOptions {
            matching: MatchOptions {
                sigma: 0.01,
                threshold: 2.0,
                visible_tolerance: 3.5 / FOCAL,
                gain_field_px: 0.0,
                left_out: None,
            },
            sigma_consensus: 0.0,
            step_factor: 1.0,
            plate_weight: 180.0,
            plate_threshold: 0.05,
            max_step: 9.0 / FOCAL,
        };
        let lights = vec![LIGHT; self.view.pixels.len()];
        let mut depth = start.to_vec();
        for _ in 0..num_rounds {
            let depths = vec![depth.clone()];
            let surfaces = Surfaces::new(&level, &depths, Reading::Cubic);
            let light = alone(&lights);
            let term = self.term(&level, &depth, &light);
            let outcome = step::improve(&surfaces, 0, &solver, &depth, Some(&term), &options);
            depth = outcome.unwrap().depth;
        }
        depth
    }

    fn term<'a>(&self, level: &Level, depth: &[f64], light: &'a PixelLight<'_>) -> ShadingTerm<'a> {
        let weights = ShadingWeights {
            sigma: 0.02,
            chroma_share: 1.0,
            threshold: 2.0,
            correction_px: 0.0,
            max_correction: 0.15,
            chroma_noise: Some(ChromaNoise {
                sigma: [0.01; 2],
                correlation: 0.0,
            }),
        };
        let surfaces = Surfaces::new(level, &[depth.to_vec()], Reading::Cubic);
        ShadingTerm::new(level, 0, depth, &surfaces.rasters, light, &weights)
    }

    /// Errors of the normals of `depth` in the pixels that `counts` tells, degrees.
    fn errors(&self, depth: &[f64], counts: impl Fn(usize) -> bool) -> Vec<f64> {
        let found = plate::normals(&self.view, depth);
        (0..found.len())
            .filter(|&p| counts(p))
            .map(|p| {
                let (a, b) = (Vector3::from(found[p]), Vector3::from(self.normals[p]));
                a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
            })
            .collect()
    }

    /// Pixels from the middle of the photo.
    fn radius_at(&self, pixel: usize) -> f64 {
        let (x, y) = self.view.xy(pixel);
        (x - self.view.camera.cx).hypot(y - self.view.camera.cy)
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The ball, but flat outside: beyond a distance from the middle it goes on as steep as it was there.
fn flattened(scene: &Scene, from_px: f64) -> Vec<f64> {
    let drop = |r: f64| RADIUS - (RADIUS * RADIUS - r * r).sqrt();
    let slope = from_px / (RADIUS * RADIUS - from_px * from_px).sqrt();
    (0..scene.depth.len())
        .map(|p| {
            let r = scene.radius_at(p);
            let height = if r < from_px {
                drop(r)
            } else {
                drop(from_px) + slope * (r - from_px)
            };
            NEAREST.ln() + height / FOCAL
        })
        .collect()
}

#[test]
fn a_clipped_rim_turns_away_from_the_camera() {
    // The lit side is clipped up to the outline: there nothing but the outline tells the shape.
    let scene = Scene::ball(0.55);
    let is_dark_rim = |p: usize| !scene.view.is_usable(p) && scene.radius_at(p) > 45.0;
    let num = (0..scene.depth.len()).filter(|&p| is_dark_rim(p)).count();
    assert!(num > 500, "{num} clipped pixels beside the outline");
    let start = flattened(&scene, 40.0);
    let before = mean(&scene.errors(&start, is_dark_rim));
    let found = scene.solved(&start, 25);
    let after = mean(&scene.errors(&found, is_dark_rim));
    println!("clipped rim: {before:.2} deg at the start, {after:.2} deg in the end");
    assert!(before > 15.0 && after < 0.6 * before, "{before}, {after}");
}

#[test]
fn a_sharp_edge_stays_as_it_is_but_for_its_last_pixel() {
    let scene = Scene::slab();
    let found = scene.solved(&scene.depth, 15);
    let inside = scene.errors(&found, |p| {
        let (x, y) = scene.view.xy(p);
        let camera = &scene.view.camera;
        (x - camera.cx).abs().max((y - camera.cy).abs()) < RADIUS - 2.0
    });
    let worst = inside.iter().copied().fold(0.0, f64::max);
    println!("slab: {:.3} deg inside, {worst:.2} at most", mean(&inside));
    assert!(
        mean(&inside) < 0.5 && worst < 8.0,
        "{}, {worst}",
        mean(&inside)
    );
}

#[test]
fn what_other_views_see_is_pulled_less() {
    let scene = Scene::ball(f32::INFINITY);
    let start = flattened(&scene, 40.0);
    let pulls = |num_visible: u8| {
        let mut system = PlateSystem::new(start.len());
        let seen = vec![num_visible; start.len()];
        rim::add_terms(&scene.view, &start, &seen, &mut system);
        system
    };
    let (alone, seen) = (pulls(0), pulls(3));
    let outermost: Vec<usize> = (0..start.len())
        .filter(|&p| alone.rhs[p] != 0.0 && scene.view.is_on_outline(p))
        .collect();
    assert!(outermost.len() > 200, "{}", outermost.len());
    for &p in &outermost {
        assert!((alone.rhs[p] / seen.rhs[p] - 16.0).abs() < 1e-9);
    }
    // A surface that has turned away is left alone, and so is all that lies farther inside than a difference reaches.
    let steep: Vec<f64> = (0..start.len())
        .map(|p| start[p] + 8.0 * scene.radius_at(p) / FOCAL)
        .collect();
    let mut system = PlateSystem::new(start.len());
    rim::add_terms(&scene.view, &steep, &vec![0; start.len()], &mut system);
    assert!(system.rhs.iter().all(|&v| v == 0.0));
    for p in (0..start.len()).filter(|&p| scene.radius_at(p) < RADIUS - 4.0) {
        assert_eq!(alone.rhs[p], 0.0);
    }
}

#[test]
fn the_pull_leads_to_the_tilt_that_it_asks_for() {
    // The slope across the outline after the increment that the term alone asks for, solved again and again.
    let scene = Scene::ball(f32::INFINITY);
    let solver = PlateSolver::direct(&scene.view.pixels).unwrap();
    let num = scene.depth.len();
    let mut depth = flattened(&scene, 40.0);
    for _ in 0..30 {
        let mut system = PlateSystem::new(num);
        for coefficients in &mut system.coefficients {
            coefficients[0] = 1e-3;
        }
        rim::add_terms(&scene.view, &depth, &vec![0; num], &mut system);
        let increment = solver.solve(&system).unwrap();
        for (z, d) in depth.iter_mut().zip(increment) {
            *z += d.clamp(-9.0 / FOCAL, 9.0 / FOCAL);
        }
    }
    let normals = plate::normals(&scene.view, &depth);
    let mut tilts: Vec<f64> = (0..num)
        .filter(|&p| scene.view.is_on_outline(p))
        .map(|p| {
            let cosine = scene.view.incidence_cosine(p, normals[p]);
            cosine.clamp(-1.0, 1.0).acos().to_degrees()
        })
        .collect();
    let median = rilievo_numerics::robust::median(&mut tilts).unwrap();
    assert!((median - 75.0).abs() < 4.0, "{median}");
}

#[test]
fn a_clipped_pixel_asks_for_brightness_alone_and_only_where_it_lacks() {
    let scene = Scene::ball(0.55);
    let level = Level::new(vec![scene.view.clone()], &[Vec::new()]);
    let lights = vec![LIGHT; scene.depth.len()];
    // The true surface is brighter than the clipped photo, and no clipped pixel asks for anything.
    let light = alone(&lights);
    let term = scene.term(&level, &scene.depth, &light);
    let mut system = PlateSystem::new(scene.depth.len());
    term.add(&scene.view, &scene.depth, &mut system);
    let is_far_from = |p: usize, usable: bool| {
        [
            (0, 0),
            (2, 0),
            (-2, 0),
            (0, 2),
            (0, -2),
            (1, 1),
            (-1, -1),
            (1, -1),
            (-1, 1),
        ]
        .iter()
        .all(|&(dx, dy)| {
            let near = scene.view.pixels.neighbour(p, dx, dy);
            near.is_none_or(|k| scene.view.is_usable(k) != usable)
        })
    };
    let clipped: Vec<usize> = (0..scene.depth.len())
        .filter(|&p| is_far_from(p, true) && scene.radius_at(p) < RADIUS - 6.0)
        .collect();
    assert!(clipped.len() > 300, "{}", clipped.len());
    for &p in &clipped {
        assert_eq!(system.rhs[p], 0.0);
        assert_eq!(system.coefficients[p][0], 0.0);
    }
    // Turned from the light it would be darker than the photo: now it asks.
    let (away, camera) = (1.5 / FOCAL, &scene.view.camera);
    let dark: Vec<f64> = (0..scene.depth.len())
        .map(|p| {
            let (x, y) = scene.view.xy(p);
            scene.depth[p] + away * (x - camera.cx + y - camera.cy)
        })
        .collect();
    let light = alone(&lights);
    let term = scene.term(&level, &dark, &light);
    let mut system = PlateSystem::new(dark.len());
    term.add(&scene.view, &dark, &mut system);
    let num_asking = clipped
        .iter()
        .filter(|&&p| system.coefficients[p][0] > 0.0)
        .count();
    assert!(2 * num_asking > clipped.len(), "{num_asking}");
}

#[test]
fn mixed_pixels_of_the_outline_move_nothing() {
    let ball = Scene::ball(f32::INFINITY);
    let level = Level::new(vec![ball.view.clone()], &[Vec::new()]);
    let lights = vec![LIGHT; ball.depth.len()];
    let light = alone(&lights);
    let term = ball.term(&level, &ball.depth, &light);
    let mut num_mixed = 0;
    for p in 0..ball.depth.len() {
        let is_mixed = ball.radius_at(p) > RADIUS - 0.7;
        num_mixed += usize::from(is_mixed);
        assert!(term.scale[p] == 0.0 || !is_mixed, "{p}");
        assert!(
            term.scale[p] > 0.0 || ball.radius_at(p) > RADIUS - 1.5,
            "{p}"
        );
    }
    assert!(num_mixed > 100, "{num_mixed}");
}
