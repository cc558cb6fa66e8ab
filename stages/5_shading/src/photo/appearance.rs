//! What the final shape, light and pigment make of each pixel: the image that they explain.
//!
//! `a_c = p_c · exp(gaussian(ln Ĩ_c − ln(p_c S_c)))`: pigment `p`, and the slow ratio between photo and
//! light over a Gaussian, which holds what changes more slowly than relief. `a_c S_c` times the photo's
//! gain is the rendered image, in the photo's own linear units; what it leaves of the photo is what
//! shape and light do not explain. Clipped and dark pixels take the albedo of their neighbours.

use super::light::Light;
use super::shading::{self, PixelHarmonics};
use rilievo_scene::Raster;
use rilievo_stereo::level::Level;
use rilievo_stereo::{plate, sampling};

/// Standard deviation of the Gaussian, pixels.
const GAUSSIAN_PX: f64 = 12.0;
/// Largest slow ratio: a factor of two is no pigment of a plain object, but a light that is wrong.
const MAX_LOG: f32 = 0.7;

/// Images of one view, per masked pixel of a level.
#[derive(Clone, Debug, Default)]
pub(crate) struct Appearance {
    /// Light times albedo, gains divided out.
    pub rendered: Vec<[f32; 3]>,
    /// Relative to the mean albedo that the light contains.
    pub albedo: Vec<[f32; 3]>,
}

/// Renders view `index` of a level at log depths `depth`, under the light whose coefficients at its pixels are
/// `harmonics`.
pub(crate) fn render(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    light: &Light,
    harmonics: &[PixelHarmonics],
) -> Appearance {
    let view = &level.views[index];
    let target = shading::mean_intensities(level, index, depth, rasters, light.mean_tolerance);
    let normals = plate::normals(view, depth);
    let pigment = light.pigment_of(index);
    let pigment = |p: usize| pigment.map_or([1.0; 3], |of_view| of_view[p]);
    let light: Vec<[f32; 3]> = (0..target.len())
        .map(|p| shading::render(&harmonics[p], normals[p]).map(|v| (v as f32).max(0.0)))
        .collect();
    let mut weight = vec![0.0_f32; target.len()];
    let ratio: Vec<[f32; 3]> = (0..target.len())
        .map(|p| {
            let dark = light[p].iter().chain(&target[p]).any(|&v| v < view.dark);
            if dark || !view.is_usable(p) {
                return [0.0; 3];
            }
            weight[p] = 1.0;
            let known = pigment(p);
            std::array::from_fn(|c| {
                (target[p][c] / (light[p][c] * known[c]))
                    .ln()
                    .clamp(-MAX_LOG, MAX_LOG)
            })
        })
        .collect();
    let slow = sampling::smooth(&view.pixels, &ratio, &weight, GAUSSIAN_PX);
    let albedo: Vec<[f32; 3]> = (0..target.len())
        .map(|p| {
            let known = pigment(p);
            std::array::from_fn(|c| known[c] * slow[p][c].exp())
        })
        .collect();
    let rendered = light
        .iter()
        .zip(&albedo)
        .map(|(s, a)| std::array::from_fn(|c| s[c] * a[c]))
        .collect();
    Appearance { rendered, albedo }
}
