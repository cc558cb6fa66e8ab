//! How much a lens darkens the corners, from one photo of anything.
//!
//! # Equations
//! With `ρ` the distance from the centre over half the diagonal, a lens multiplies by about
//! `exp(a ρ²)`. Between neighbouring blocks of pixels `Δ ln I / Δρ²` is `a` wherever the scene is
//! even; edges, texture and the scene's own shading are outliers. The median over each of eight
//! sectors of the frame, weighted by `|Δρ²|`, and the median of these: light that falls off to one
//! side has opposite signs in opposite sectors, and what stands in one corner stays in its sector.
//! The object is left out where there is a mask: round bodies darken towards their limbs.
//!
//! Comparing the corners' own level with the sides' would compare what stands there: a bright mat
//! below a dark room has corners of a third of the brightness without any lens.

use rilievo_numerics::robust::median;
use rilievo_scene::{Mask, Raster};
use std::f64::consts::PI;

/// Blocks along the frame's shorter side: small enough to lie between edges, large enough to
/// average noise and the steps of 8 bits away.
const BLOCKS: usize = 48;
/// Sectors of the frame.
const SECTORS: usize = 8;
/// Fewest differences that say anything of a sector.
const MIN_DIFFERENCES: usize = 20;
/// Fewest sectors that say anything of the lens.
const MIN_SECTORS: usize = 5;

/// Brightness of the corners over that of the sides' middles as the lens alone would make them; 1
/// where too little is seen.
pub(crate) fn corner_falloff(grey: &Raster<f32>, mask: Option<&Mask>, clip_level: f32) -> f64 {
    let side = (grey.width.min(grey.height) / BLOCKS).max(1);
    let (columns, rows) = (grey.width / side, grey.height / side);
    let (half_width, half_height) = (0.5 * grey.width as f64, 0.5 * grey.height as f64);
    let diagonal = half_width.powi(2) + half_height.powi(2);
    let logs = Raster::from_fn(columns, rows, |x, y| {
        ln_mean(grey, mask, clip_level, (x * side, y * side, side))
    });
    let place = |x: usize, y: usize| {
        let at = |index: usize, half: f64| (index as f64 + 0.5) * side as f64 - half;
        (at(x, half_width), at(y, half_height))
    };
    let mut sectors: [Vec<(f64, f64)>; SECTORS] = Default::default();
    for y in 0..rows {
        for x in 0..columns {
            for (x2, y2) in [(x + 1, y), (x, y + 1)] {
                if x2 >= columns || y2 >= rows {
                    continue;
                }
                let (Some(here), Some(there)) = (*logs.at(x, y), *logs.at(x2, y2)) else {
                    continue;
                };
                let ((ax, ay), (bx, by)) = (place(x, y), place(x2, y2));
                let change = (bx * bx + by * by - ax * ax - ay * ay) / diagonal;
                if change.abs() < 1e-9 {
                    continue;
                }
                let turn = ((ay + by).atan2(ax + bx) + PI) / (2.0 * PI);
                let sector = ((turn * SECTORS as f64) as usize).min(SECTORS - 1);
                sectors[sector].push(((there - here) / change, change.abs()));
            }
        }
    }
    let mut slopes: Vec<f64> = sectors
        .iter_mut()
        .filter_map(|values| weighted_median(values))
        .collect();
    if slopes.len() < MIN_SECTORS {
        return 1.0;
    }
    // The sides' middles lie at ρ² of w² and h² over the diagonal's, one half on average.
    median(&mut slopes).map_or(1.0, |slope| (0.5 * slope).exp())
}

/// Logarithm of a block's mean, if it is all of the background and nowhere clipped.
fn ln_mean(
    grey: &Raster<f32>,
    mask: Option<&Mask>,
    clip_level: f32,
    (x0, y0, side): (usize, usize, usize),
) -> Option<f64> {
    let mut sum = 0.0;
    for y in y0..y0 + side {
        for x in x0..x0 + side {
            let value = *grey.at(x, y);
            if value >= clip_level || mask.is_some_and(|mask| *mask.at(x, y)) {
                return None;
            }
            sum += f64::from(value);
        }
    }
    (sum > 0.0).then(|| (sum / (side * side) as f64).ln())
}

/// The value on either side of which half of the weight lies.
fn weighted_median(values: &mut [(f64, f64)]) -> Option<f64> {
    if values.len() < MIN_DIFFERENCES {
        return None;
    }
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| v.1).sum::<f64>();
    let mut weight = 0.0;
    values
        .iter()
        .find(|v| {
            weight += v.1;
            weight >= half
        })
        .map(|v| v.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (320, 240);

    /// A dark room over a bright mat with printed dots, light from the left, a round object that
    /// darkens towards its limbs, and its mask; the lens leaves `corner` of the light in the
    /// corners.
    fn photo(corner: f64) -> (Raster<f32>, Mask) {
        let centred = |x: usize, y: usize| (x as f64 - 159.5, y as f64 - 119.5);
        let mask = Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
            let (x, y) = centred(x, y);
            (x + 10.0).hypot(y - 10.0) < 80.0
        });
        let grey = Raster::from_fn(SIZE.0, SIZE.1, |column, row| {
            let (x, y) = centred(column, row);
            let light = 1.0 - 0.002 * x;
            let paint = if *mask.at(column, row) {
                (1.0 - ((x + 10.0).hypot(y - 10.0) / 80.0).powi(2)).sqrt()
            } else if row < 90 {
                0.1
            } else if (column / 13 * 7 + row / 11 * 5) % 9 == 0 {
                0.15
            } else {
                0.6
            };
            let rho2 = (x * x + y * y) / (160.0f64.powi(2) + 120.0f64.powi(2));
            // Noise of a per cent, from a hash of the place.
            let noise = ((column * 7919 + row * 104_729) % 1009) as f64 / 1009.0 - 0.5;
            (light * paint * corner.powf(rho2) * (1.0 + 0.03 * noise)) as f32
        });
        (grey, mask)
    }

    #[test]
    fn what_stands_in_the_corners_is_no_vignetting() {
        let (grey, mask) = photo(1.0);
        let masked = corner_falloff(&grey, Some(&mask), f32::MAX);
        assert!((masked - 1.0).abs() < 0.05, "{masked}");
        // Without a mask the object's limbs count, in a quarter of the frame.
        let all = corner_falloff(&grey, None, f32::MAX);
        assert!((0.85..1.15).contains(&all), "{all}");
    }

    #[test]
    fn a_lens_that_darkens_the_corners_is_measured() {
        for corner in [0.75, 0.5, 0.35] {
            let (grey, mask) = photo(corner);
            let found = corner_falloff(&grey, Some(&mask), f32::MAX);
            let over_sides = f64::sqrt(corner);
            assert!(
                (found / over_sides - 1.0).abs() < 0.06,
                "{found} {over_sides}"
            );
        }
    }

    #[test]
    fn a_photo_full_of_object_says_nothing() {
        let (grey, _) = photo(0.5);
        let mask = Raster::from_fn(SIZE.0, SIZE.1, |_, _| true);
        assert_eq!(corner_falloff(&grey, Some(&mask), f32::MAX), 1.0);
        let clipped = corner_falloff(&grey, None, 0.0);
        assert_eq!(clipped, 1.0);
    }
}
