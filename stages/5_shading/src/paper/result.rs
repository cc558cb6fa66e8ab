//! From node values and slopes to maps.

use super::levels::Level;
use super::pixels::{Pixels, Slopes};
use super::prepare::Geometry;
use super::problem::ShadingView;
use super::solution::SolvedView;
use rilievo_scene::{ConfidenceMap, DepthMap, LinearImage, NormalMap};

/// RMS difference between image and model at given slopes, over the pixels that are used.
pub(crate) fn rms_residual(pixels: &Pixels, [p, q]: &Slopes) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    for k in (0..pixels.len).filter(|&k| pixels.weight[k] > 0.0) {
        for r in pixels.residuals(k, [p[k], q[k]]) {
            sum += f64::from(r).powi(2);
        }
        count += pixels.channels;
    }
    (sum / count.max(1) as f64).sqrt()
}

/// Depth, normals and re-rendered image of a view.
pub(crate) fn maps(
    view: &ShadingView,
    level: &Level,
    geometry: &Geometry,
    y: &[f32],
    [p, q]: &Slopes,
    confidence: ConfidenceMap,
) -> SolvedView {
    let (width, height) = (view.image.width, view.image.height);
    let pixels = &level.pixels;
    let mut values = vec![0.0; pixels.padded];
    level.grid.values(y, &mut values);
    let mut depth = DepthMap::filled(width, height, 0.0);
    let mut normal = NormalMap::filled(width, height, [0.0; 3]);
    let mut rendered = LinearImage::filled(width, height, pixels.channels, 0.0);
    for (k, (x, row)) in level.grid.pixels().enumerate() {
        *depth.at_mut(x, row) = geometry.depth(f64::from(values[k])) as f32;
        let facet = pixels.facet(k, [p[k], q[k]]);
        *normal.at_mut(x, row) = facet.normal;
        for (c, value) in rendered.pixel_mut(x, row).iter_mut().enumerate() {
            *value = facet.shade(&pixels.light(c, k)).0;
        }
    }
    SolvedView {
        name: view.name.clone(),
        depth,
        normal,
        rendered,
        confidence,
    }
}
