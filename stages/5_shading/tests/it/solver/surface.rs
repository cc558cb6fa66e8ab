//! A smooth surface with waves, its image under three colours of light, and a rough start.

use nalgebra::Vector3;
use rilievo_scene::{DepthMap, Intrinsics, Lighting, LinearImage, Mask, SphericalHarmonics};
use rilievo_shading::paper::{ShadingSolution, ShadingView, ViewLight};
use rilievo_synthetic::testing::PAPER_LIGHT;
use std::sync::Arc;

/// A smooth surface: depth relative to the reference as a function of the viewing ray, and slopes by
/// differences far below a pixel.
pub struct Surface {
    pub size: usize,
    pub focal: f64,
    pub scale: f64,
    pub intensity: f64,
}

impl Surface {
    pub fn new(size: usize) -> Self {
        Self {
            size,
            focal: 1.5 * size as f64,
            scale: 2.0,
            intensity: 1.0,
        }
    }

    pub fn camera(&self) -> Intrinsics {
        let centre = (self.size as f64 - 1.0) / 2.0;
        Intrinsics::pinhole(self.size, self.size, self.focal, centre, centre)
    }

    pub fn ln_depth(&self, x: f64, y: f64) -> f64 {
        // Image coordinates from −1 to 1.
        let half = self.size as f64 / 2.0;
        let centre = (self.size as f64 - 1.0) / 2.0;
        let (u, v) = ((x - centre) / half, (y - centre) / half);
        let bump = 0.5 * (u * u + 0.8 * v * v) + 0.06 * (5.0 * u).sin() * (4.0 * v + 0.5).cos();
        self.scale.ln() + bump * half / self.focal
    }

    pub fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let h = 1e-4;
        let p = self.focal * (self.ln_depth(x + h, y) - self.ln_depth(x - h, y)) / (2.0 * h);
        let q = self.focal * (self.ln_depth(x, y + h) - self.ln_depth(x, y - h)) / (2.0 * h);
        let camera = self.camera();
        let (u, v) = ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
        Vector3::new(p, q, -1.0 - u * p - v * q).normalize()
    }

    pub fn mask(&self) -> Mask {
        let centre = (self.size as f64 - 1.0) / 2.0;
        let radius = 0.45 * self.size as f64;
        Mask::from_fn(self.size, self.size, |x, y| {
            (x as f64 - centre).hypot(y as f64 - centre) < radius
        })
    }

    pub fn lighting(&self, channels: usize) -> Lighting {
        Lighting {
            channels: PAPER_LIGHT[..channels]
                .iter()
                .map(|row| SphericalHarmonics(row.map(|l| l * self.intensity)))
                .collect(),
        }
    }

    pub fn image(&self, lighting: &Lighting) -> LinearImage {
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

    pub fn depth(&self) -> DepthMap {
        DepthMap::from_fn(self.size, self.size, |x, y| {
            self.ln_depth(x as f64, y as f64).exp() as f32
        })
    }

    /// The surface without its waves, 3 to 6 degrees off.
    pub fn rough(&self) -> DepthMap {
        let half = self.size as f64 / 2.0;
        let centre = (self.size as f64 - 1.0) / 2.0;
        DepthMap::from_fn(self.size, self.size, |x, y| {
            let (u, v) = ((x as f64 - centre) / half, (y as f64 - centre) / half);
            let bump = 0.45 * (u * u + 0.8 * v * v);
            (self.scale * (bump * half / self.focal).exp()) as f32
        })
    }

    pub fn view(&self, channels: usize) -> ShadingView {
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

    pub fn mean_angle(&self, solution: &ShadingSolution) -> f64 {
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
