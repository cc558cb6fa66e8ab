//! From node values and slopes to maps.

use super::levels::Level;
use super::model::Facet;
use super::pixels::Pixels;
use super::prepare::Geometry;
use super::solution::SolvedView;
use rilievo_scene::{DepthMap, LinearImage, NormalMap};

/// RMS difference between image and model at given slopes, over the pixels that are used.
pub(crate) fn rms_residual(pixels: &Pixels, p: &[f32], q: &[f32]) -> f64 {
    let (mut sum, mut count) = (0.0, 0_usize);
    for k in 0..pixels.len {
        if pixels.weight[k] > 0.0 {
            let facet = Facet::new([pixels.ray_x[k], pixels.ray_y[k]], [p[k], q[k]]);
            for c in 0..pixels.channels {
                let (shade, _) = facet.shade(&pixels.light(c, k));
                sum += f64::from(shade - pixels.intensity[c * pixels.padded + k]).powi(2);
            }
            count += pixels.channels;
        }
    }
    (sum / count.max(1) as f64).sqrt()
}

/// Depth, normals and re-rendered image of a view.
pub(crate) fn maps(
    name: &str,
    (width, height): (usize, usize),
    level: &Level,
    geometry: &Geometry,
    y: &[f32],
    slopes: (&[f32], &[f32]),
) -> SolvedView {
    let pixels = &level.pixels;
    let mut values = vec![0.0; pixels.padded];
    level.grid.values(y, &mut values);
    let mut depth = DepthMap::filled(width, height, 0.0);
    let mut normal = NormalMap::filled(width, height, [0.0; 3]);
    let mut rendered = LinearImage::filled(width, height, pixels.channels, 0.0);
    for (k, (x, row)) in level.grid.pixels().enumerate() {
        *depth.at_mut(x, row) = geometry.depth(f64::from(values[k])) as f32;
        let facet = Facet::new(
            [pixels.ray_x[k], pixels.ray_y[k]],
            [slopes.0[k], slopes.1[k]],
        );
        *normal.at_mut(x, row) = facet.normal;
        for (c, value) in rendered.pixel_mut(x, row).iter_mut().enumerate() {
            *value = facet.shade(&pixels.light(c, k)).0;
        }
    }
    SolvedView {
        name: name.to_owned(),
        depth,
        normal,
        rendered,
        confidence: None,
    }
}
