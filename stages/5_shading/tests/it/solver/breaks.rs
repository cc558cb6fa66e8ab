//! Depth edges: found where the surface breaks, and nowhere else, however noisy the image.

use super::solved;
use super::surface::Surface;
use nalgebra::Vector3;
use rilievo_scene::{DepthMap, Lighting, LinearImage, SphericalHarmonics};
use rilievo_shading::paper::{PaperOptions, ShadingView, SolvedView, ViewLight};
use rilievo_synthetic::testing::Random;
use std::sync::Arc;

const SIZE: usize = 160;
/// Noise of the image as a share of white.
const NOISES: [f64; 4] = [0.0, 0.005, 0.01, 0.02];

/// Adds normal noise, the same for every run.
fn noisy(image: &LinearImage, sigma: f64) -> LinearImage {
    let mut image = image.clone();
    let mut random = Random(4711);
    for value in &mut image.data {
        *value += (sigma * random.normal()) as f32;
    }
    image
}

/// The smooth surface of the other tests, cut along a wavy line: below it the surface leans the other
/// way, so that the step's height changes along the line and no whole surface explains both sides.
struct Cut {
    surface: Surface,
}

impl Cut {
    fn line(&self, x: f64) -> f64 {
        0.5 * SIZE as f64 + 10.0 * (x / 17.0).sin()
    }

    /// What is added to the slope along x on either side.
    fn lean(&self, x: f64, y: f64) -> f64 {
        if y < self.line(x) { 0.25 } else { -0.25 }
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let camera = self.surface.camera();
        let n = self.surface.normal(x, y);
        let (u, v) = ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
        let along = -(n.x * u + n.y * v + n.z);
        let (p, q) = (n.x / along + self.lean(x, y), n.y / along);
        Vector3::new(p, q, -1.0 - u * p - v * q).normalize()
    }

    fn view(&self) -> ShadingView {
        let mut view = self.surface.view(3);
        // Three directions far apart: no other slope has nearly the same colour.
        let lighting = Lighting {
            channels: [
                [-0.5, 0.0, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
                [0.5, 0.1, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
                [0.0, 0.6, -0.8, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
            ]
            .map(SphericalHarmonics)
            .to_vec(),
        };
        let image = Arc::make_mut(&mut view.image);
        for y in 0..SIZE {
            for x in 0..SIZE {
                let n = self.normal(x as f64, y as f64);
                for (c, row) in lighting.channels.iter().enumerate() {
                    image.pixel_mut(x, y)[c] = row.evaluate(&n) as f32;
                }
            }
        }
        view.lighting = ViewLight::Uniform(lighting);
        let centre = (SIZE as f64 - 1.0) / 2.0;
        let rough = self.surface.rough();
        view.initial_depth = Some(DepthMap::from_fn(SIZE, SIZE, |x, y| {
            let step = self.lean(x as f64, y as f64) * (x as f64 - centre) / self.surface.focal;
            rough.at(x, y) * step.exp() as f32
        }));
        view
    }

    fn mean_angle(&self, view: &SolvedView) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for y in 0..SIZE {
            for x in 0..SIZE {
                if let Some(n) = view.normal.normal(x, y) {
                    let truth = self.normal(x as f64, y as f64);
                    sum += n.dot(&truth).clamp(-1.0, 1.0).acos().to_degrees();
                    count += 1;
                }
            }
        }
        sum / f64::from(count)
    }
}

#[test]
fn a_smooth_surface_does_not_break_however_noisy() {
    let surface = Surface::new(SIZE);
    for noise in NOISES {
        let mut view = surface.view(3);
        view.image = Arc::new(noisy(&view.image, noise));
        let solution = solved(view, &PaperOptions::default());
        let facts = &solution.report.views[0];
        let share = facts.num_depth_breaks as f64 / facts.num_pixels as f64;
        assert!(share < 1e-3, "noise {noise}: {share} of the pixels");
    }
}

#[test]
fn a_break_is_found_however_noisy() {
    let cut = Cut {
        surface: Surface::new(SIZE),
    };
    for noise in NOISES {
        let mut view = cut.view();
        view.image = Arc::new(noisy(&view.image, noise));
        let solution = solved(view.clone(), &PaperOptions::default());
        let whole = solved(
            view,
            &PaperOptions {
                depth_edges: false,
                ..PaperOptions::default()
            },
        );
        let num = solution.report.views[0].num_depth_breaks;
        let cutting = cut.mean_angle(&solution.views[0]);
        let bending = cut.mean_angle(&whole.views[0]);
        println!("noise {noise}: {num} breaks, {cutting:.3} deg, without {bending:.3} deg");
        // The line is 144 pixels long; noise hides where the step is low.
        assert!((100..5000).contains(&num), "noise {noise}: {num} breaks");
        let gain = if noise < 0.015 { 0.75 } else { 0.95 };
        assert!(
            cutting < gain * bending,
            "noise {noise}: {cutting} against {bending}"
        );
    }
}
