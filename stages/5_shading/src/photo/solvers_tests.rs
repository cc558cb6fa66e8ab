//! The photo model's Gauss-Newton steps and the splitting, on one surface under one light per pixel.
//!
//! Both explain the same exact image by the same nine coefficients a pixel, from the same start; the
//! discretisations differ (pixels with a thin-plate stencil; corners with multigrid), so that they
//! agree to the order of a pixel's curvature.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

// The analytic surface of the solver's own tests, of which this one needs a part.
#[allow(dead_code)]
#[path = "../../tests/it/solver/surface.rs"]
mod surface;

use super::chroma::{ChromaNoise, Whitening};
use super::matching::MatchOptions;
use super::shading::{PixelHarmonics, ShadingTerm};
use super::step::{self, StepOptions};
use crate::paper::{
    DepthPrior, PaperOptions, PixelLighting, ShadingProblem, ShadingView, ViewLight, solve,
};
use nalgebra::Vector3;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_scene::{DepthMap, LinearImage, NormalMap, RigidTransform, Silent};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::surfaces::{Reading, Surfaces};
use std::sync::Arc;
use std::time::Instant;
use surface::Surface;

/// Light that differs from pixel to pixel as under a shadow's soft edge: the surface's own light,
/// dimmed across the image, its direction turned along it.
fn light_at(surface: &Surface, x: usize, y: usize) -> PixelHarmonics {
    let share = |v: usize| v as f64 / surface.size as f64 - 0.5;
    let (dim, turn) = (1.0 - 0.5 * share(x), 0.6 * share(y));
    let rows = surface.lighting(3).channels;
    [0, 1, 2].map(|c| {
        let mut row = rows[c].0;
        (row[0], row[1]) = (
            row[0] * turn.cos() - row[1] * turn.sin(),
            row[0] * turn.sin() + row[1] * turn.cos(),
        );
        row.map(|l| (dim * l) as f32)
    })
}

/// What both solvers are given, and the truth.
struct Case {
    surface: Surface,
    view: ShadingView,
    lights: Vec<PixelHarmonics>,
    /// Standard deviation of intensities.
    sigma: f64,
}

/// Standard deviation of a depth that is known beforehand, pixel footprints.
const KNOWN_PX: f64 = 1.0;

impl Case {
    fn new(size: usize) -> Self {
        let surface = Surface::new(size);
        let lights: Vec<PixelHarmonics> = (0..size * size)
            .map(|i| light_at(&surface, i % size, i / size))
            .collect();
        let mut image = LinearImage::filled(size, size, 3, 0.0);
        for (i, light) in lights.iter().enumerate() {
            let (x, y) = (i % size, i / size);
            let n = surface.normal(x as f64, y as f64);
            let seen = super::shading::render(light, n.into());
            image
                .pixel_mut(x, y)
                .copy_from_slice(&seen.map(|v| v as f32));
        }
        let mut view = surface.view(3);
        view.image = Arc::new(image);
        view.lighting = ViewLight::PerPixel(PixelLighting {
            width: size,
            height: size,
            channels: 3,
            coefficients: Arc::new(lights.iter().flatten().flatten().copied().collect()),
        });
        Self {
            surface,
            view,
            lights,
            sigma: PaperOptions::default().noise,
        }
    }

    /// As on photographs: brightness misses the light by `share`, and a depth is known beforehand that
    /// errs by half a footprint from pixel to pixel.
    fn with_errors(size: usize, share: f64) -> Self {
        let mut case = Self::new(size);
        let mut state = 7_u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // Uniform of unit variance.
            ((state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5) * 12.0_f64.sqrt()
        };
        for pixel in Arc::make_mut(&mut case.view.image).data.chunks_exact_mut(3) {
            let factor = (1.0 + share * noise()) as f32;
            pixel.iter_mut().for_each(|v| *v *= factor);
        }
        let mut depth = case.surface.depth();
        for z in &mut depth.data {
            *z *= (0.5 * noise() / case.surface.focal).exp() as f32;
        }
        case.sigma = share;
        case.view.prior = Some(DepthPrior {
            depth,
            weight: (share * case.surface.focal / KNOWN_PX).powi(2),
        });
        case
    }

    /// The full splitting's normals.
    fn by_splitting(&self) -> NormalMap {
        let problem = ShadingProblem {
            views: vec![self.view.clone()],
            matches: Vec::new(),
        };
        let options = PaperOptions {
            noise: self.sigma,
            ..PaperOptions::default()
        };
        let mut solution = solve(&problem, &options, &Silent).unwrap();
        solution.views.remove(0).normal
    }

    /// Gauss-Newton steps until one turns the normals by less than `still_deg`; normals and the number
    /// of steps.
    fn by_gauss_newton(&self, still_deg: f64) -> (NormalMap, usize) {
        let camera = Camera::new(&self.view.intrinsics, &RigidTransform::identity());
        let (view, corner) =
            LevelView::from_photo(&camera, &self.view.image, &self.view.mask, f32::INFINITY);
        let size = self.surface.size;
        let at = |p: usize, view: &LevelView| {
            (view.pixels.ys[p] as usize + corner.1) * size + view.pixels.xs[p] as usize + corner.0
        };
        let pixels: Vec<usize> = (0..view.pixels.len()).map(|p| at(p, &view)).collect();
        let start: &DepthMap = self.view.initial_depth.as_ref().unwrap();
        let mut depth: Vec<f64> = pixels
            .iter()
            .map(|&i| f64::from(start.data[i]).ln())
            .collect();
        let lights: Vec<PixelHarmonics> = pixels.iter().map(|&i| self.lights[i]).collect();
        let sigma = self.sigma;
        let term = ShadingTerm {
            light: &lights,
            target: (0..pixels.len()).map(|p| view.intensity(p)).collect(),
            scale: vec![1.0; pixels.len()],
            whitening: Whitening::new(sigma, [sigma; 2], 0.0),
            chroma_noise: ChromaNoise {
                sigma: [sigma; 2],
                correlation: 0.0,
            },
            floor: 1e-3,
            threshold: f64::INFINITY,
        };
        let solver = PlateSolver::direct(&view.pixels).unwrap();
        // A second view in the same place holds the depth that is known; its photo says nothing. Its noise
        // tilts it, by which it counts a little less than the first.
        let known = self.view.prior.as_ref().map(|prior| &prior.depth);
        let known = known.map(|map| {
            pixels
                .iter()
                .map(|&i| f64::from(map.data[i]).ln())
                .collect()
        });
        let sources = if known.is_some() { vec![1] } else { Vec::new() };
        let known: Vec<f64> = known.unwrap_or_else(|| depth.clone());
        let level = Level::new(vec![view.clone(), view], &[sources, Vec::new()]);
        let options = StepOptions {
            matching: MatchOptions {
                sigma,
                threshold: 2.0,
                visible_tolerance: 1.0,
                gain_field_px: 0.0,
                left_out: None,
            },
            sigma_consensus: KNOWN_PX / level.focal(),
            step_factor: 1.0,
            // Far below what shading weighs: it only ends what central slopes leave free.
            plate_weight: 1e-2,
            plate_threshold: f64::INFINITY,
            max_step: f64::INFINITY,
        };
        let mut num_steps = 0;
        for _ in 0..30 {
            let depths = vec![depth.clone(), known.clone()];
            let surfaces = Surfaces::new(&level, &depths, Reading::Bilinear);
            let outcome =
                step::improve(&surfaces, 0, &solver, &depth, Some(&term), &options).unwrap();
            let turned = rilievo_stereo::plate::mean_turn(&level.views[0], &depth, &outcome.depth);
            depth = outcome.depth;
            num_steps += 1;
            if turned.to_degrees() < still_deg {
                break;
            }
        }
        let mut map = NormalMap::filled(size, size, [0.0; 3]);
        for (&i, n) in pixels
            .iter()
            .zip(rilievo_stereo::plate::normals(&level.views[0], &depth))
        {
            map.data[i] = n.map(|v| v as f32);
        }
        (map, num_steps)
    }

    /// Mean angle, degrees, to normals that may come from another solver or from the truth.
    fn mean_angle(&self, map: &NormalMap, to: impl Fn(usize, usize) -> Vector3<f64>) -> f64 {
        let size = self.surface.size;
        let angles: Vec<f64> = (0..size * size)
            .filter_map(|i| {
                let (x, y) = (i % size, i / size);
                let n = map.normal(x, y)?;
                Some(n.dot(&to(x, y)).clamp(-1.0, 1.0).acos().to_degrees())
            })
            .collect();
        angles.iter().sum::<f64>() / angles.len() as f64
    }

    fn error(&self, map: &NormalMap) -> f64 {
        self.mean_angle(map, |x, y| self.surface.normal(x as f64, y as f64))
    }
}

#[test]
fn gauss_newton_and_the_splitting_reach_the_same_surface() {
    let case = Case::new(96);
    let splitting = case.by_splitting();
    let (newton, num_steps) = case.by_gauss_newton(0.01);
    let between = case.mean_angle(&splitting, |x, y| newton.normal(x, y).unwrap());
    let (a, b) = (case.error(&splitting), case.error(&newton));
    println!(
        "splitting {a:.3} deg, Gauss-Newton {b:.3} deg in {num_steps} steps, apart {between:.3} deg"
    );
    // The start lies some five degrees off.
    assert!(a < 0.5 && b < 0.5, "splitting {a}, Gauss-Newton {b}");
    assert!(between < 0.6, "{between} degrees apart");
}

#[test]
#[ignore = "a measurement"]
fn which_solver_is_faster() {
    // The second as outer iterations end on photographs.
    for (name, case, still_deg) in [
        ("exact", Case::new(384), 0.01),
        ("three per cent", Case::with_errors(384, 0.03), 0.4),
    ] {
        let began = Instant::now();
        let splitting = case.by_splitting();
        let middle = Instant::now();
        let (newton, num_steps) = case.by_gauss_newton(still_deg);
        println!(
            "{name}: splitting {:.3} deg {:.2?}, Gauss-Newton {:.3} deg {:.2?} in {num_steps} steps",
            case.error(&splitting),
            middle - began,
            case.error(&newton),
            middle.elapsed()
        );
    }
}
