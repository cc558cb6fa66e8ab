//! How much of the light that relief hides the photos show missing.
//!
//! Openness ([`rilievo_stereo::openness`]) is what an even sky would leave a pixel. How far the real light
//! follows it depends on where it comes from and on what the walls send back, so that a run measures the
//! exponent `β` of `Ĩ ≈ l·h(n) · openness^β` on its own photos.

use super::albedo::Albedo;
use super::shading::{self, HarmonicsOf};
use rayon::prelude::*;
use rilievo_stereo::level::LevelView;
use rilievo_stereo::openness::openness;
use rilievo_stereo::plate;
use rilievo_stereo::sampling;

/// Standard deviation of the Gaussian whose means are taken off, pixels: on a larger scale the light knows of
/// hollows through its rays.
const WIDE_SIGMA_PX: f64 = 8.0;

/// Largest misfit of log brightness that counts in full: cast shadows and gloss are neither pores nor tool marks.
const LARGEST_MISFIT: f32 = 0.4;

/// The exponent of openness, 0 (the photos show nothing hidden) to 1: slope of the misfit of log brightness over
/// log openness, both without what is wider than a few pixels, over all views.
pub(crate) fn exponent(
    views: &[LevelView],
    depths: &[Vec<f64>],
    harmonics: &HarmonicsOf<'_>,
    pigment: Option<&Albedo>,
) -> f32 {
    let sums: Vec<(f64, f64)> = views
        .par_iter()
        .enumerate()
        .map(|(i, view)| {
            let normals = plate::normals(view, &depths[i]);
            let open = openness(view, &depths[i], &normals);
            let usable: Vec<f32> = (0..normals.len())
                .map(|p| f32::from(u8::from(view.shows_surface(p))))
                .collect();
            let pigment = pigment.map(|p| &p.relative[i]);
            let harmonics = harmonics(i);
            let rows: Vec<[f32; 2]> = (0..normals.len())
                .map(|p| {
                    let model = shading::render(&harmonics[p], normals[p]);
                    let (mut seen, mut expected) = (0.0, 0.0);
                    for (c, value) in view.intensity(p).into_iter().enumerate() {
                        seen += value;
                        expected += model[c] as f32 * pigment.map_or(1.0, |a| a[p][c]);
                    }
                    let misfit = (seen.max(1e-6) / expected.max(1e-6)).ln();
                    let misfit = misfit.clamp(-LARGEST_MISFIT, LARGEST_MISFIT);
                    [misfit, open[p].ln()]
                })
                .collect();
            let wide = sampling::smooth(&view.pixels, &rows, &usable, WIDE_SIGMA_PX);
            let mut sums = (0.0, 0.0);
            for ((row, wide), usable) in rows.iter().zip(&wide).zip(&usable) {
                let [y, x] = [0, 1].map(|k| f64::from(row[k] - wide[k]));
                sums.0 += f64::from(*usable) * x * y;
                sums.1 += f64::from(*usable) * x * x;
            }
            sums
        })
        .collect();
    let (xy, xx) = sums.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    if xx > 0.0 {
        (xy / xx).clamp(0.0, 1.0) as f32
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::{Intrinsics, LinearImage, Raster, RigidTransform};
    use rilievo_stereo::camera::Camera;
    use std::borrow::Cow;

    /// A surface of pits under light from the camera's side, its photo darkened by openness to the power `beta`.
    fn measured(beta: f32, brightness_noise: f32) -> f32 {
        let (width, height) = (96, 80);
        let intrinsics = Intrinsics::pinhole(width, height, 1e4, 47.5, 39.5);
        let camera = Camera::new(&intrinsics, &RigidTransform::identity());
        let image = LinearImage::filled(width, height, 3, 0.5);
        let mask = Raster::filled(width, height, true);
        let mut view = LevelView::from_photo(&camera, &image, &mask, 1.0).0;
        let depth: Vec<f64> = (0..view.pixels.len())
            .map(|p| {
                let (x, y) = view.xy(p);
                (1.0_f64 - 1.2e-4 * (0.7 * x).sin() * (0.6 * y).cos()).ln()
            })
            .collect();
        let harmonics = [vec![
            [[0.1, -0.2, -0.5, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0]; 3];
            depth.len()
        ]];
        let normals = plate::normals(&view, &depth);
        let open = openness(&view, &depth, &normals);
        for p in 0..depth.len() {
            let noise = 1.0 + brightness_noise * (((p * 7919) % 17) as f32 / 8.0 - 1.0);
            let (x, y) = view.xy(p);
            let at = 3 * (y as usize * view.image.width + x as usize);
            let model = shading::render(&harmonics[0][p], normals[p]);
            for (c, value) in model.iter().enumerate() {
                view.image.data[at + c] = *value as f32 * open[p].powf(beta) * noise;
            }
        }
        let of_view = |i: usize| Cow::Borrowed(harmonics[i].as_slice());
        exponent(std::slice::from_ref(&view), &[depth], &of_view, None)
    }

    #[test]
    fn the_exponent_is_read_from_the_photos() {
        for beta in [0.0, 0.3, 0.8] {
            let found = measured(beta, 0.0);
            assert!((found - beta).abs() < 1e-3, "{beta}: {found}");
            let found = measured(beta, 0.05);
            assert!((found - beta).abs() < 0.1, "{beta} with noise: {found}");
        }
    }

    #[test]
    fn hollows_that_are_bright_hide_nothing_and_nothing_is_more_than_an_even_sky() {
        assert_eq!(measured(-0.5, 0.0), 0.0);
        assert_eq!(measured(1.6, 0.0), 1.0);
    }
}
