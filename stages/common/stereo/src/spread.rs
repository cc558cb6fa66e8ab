//! Per-pixel values at a finer level: bilinear over the masked parents, the nearest one where there
//! is none.

use crate::level::ViewGrid;
use rayon::prelude::*;
use rilievo_numerics::{distance, plate_system::OUTSIDE};
use rilievo_scene::Raster;

/// Interpolates `N` values a pixel from a level to the next finer one (or the same).
pub fn spread<const N: usize>(
    coarse: &ViewGrid,
    fine: &ViewGrid,
    values: &[[f32; N]],
) -> Vec<[f32; N]> {
    if fine.mask.width == coarse.mask.width {
        return values.to_vec();
    }
    let parents = Parents::new(coarse);
    (0..fine.pixels.len())
        .into_par_iter()
        .with_min_len(512)
        .map(|i| {
            let (x, y) = fine.xy(i);
            let (x, y) = (0.5 * (x + 0.5) - 0.5, 0.5 * (y + 0.5) - 0.5);
            parents.at(x, y, |parent| values[parent])
        })
        .collect()
}

/// A level's pixels, to be read between them.
pub struct Parents<'a> {
    view: &'a ViewGrid,
    nearest: Raster<u32>,
}

impl<'a> Parents<'a> {
    /// The pixels of a view.
    pub fn new(view: &'a ViewGrid) -> Self {
        Self {
            view,
            nearest: nearest_pixels(view),
        }
    }

    /// The `value`s of the pixels around a position of the view, interpolated.
    #[inline]
    pub fn at<const N: usize>(
        &self,
        x: f64,
        y: f64,
        value: impl Fn(usize) -> [f32; N],
    ) -> [f32; N] {
        let pixels = &self.view.pixels;
        let (x0, y0) = (x.floor(), y.floor());
        let (mut out, mut total) = ([0.0_f32; N], 0.0_f32);
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let weight = ((1.0 - (x - x0 - dx).abs()) * (1.0 - (y - y0 - dy).abs())) as f32;
            let (px, py) = (x0 + dx, y0 + dy);
            if weight <= 0.0 || px < 0.0 || py < 0.0 {
                continue;
            }
            let (px, py) = (px as usize, py as usize);
            if px >= pixels.width || py >= pixels.height {
                continue;
            }
            let number = pixels.number[py * pixels.width + px];
            if number == OUTSIDE {
                continue;
            }
            for (o, v) in out.iter_mut().zip(value(number as usize)) {
                *o += weight * v;
            }
            total += weight;
        }
        if total > 0.0 {
            return out.map(|v| v / total);
        }
        let px = (x.round().max(0.0) as usize).min(pixels.width - 1);
        let py = (y.round().max(0.0) as usize).min(pixels.height - 1);
        value(*self.nearest.at(px, py) as usize)
    }
}

/// Number of the nearest masked pixel of every raster position, 0 where there is none.
fn nearest_pixels(view: &ViewGrid) -> Raster<u32> {
    let (width, height) = (view.pixels.width, view.pixels.height);
    let mut number = view.pixels.number.clone();
    let distance_at = |&n: &u32| if n == OUTSIDE { distance::FAR } else { 0.0 };
    let mut squared: Vec<f32> = number.iter().map(distance_at).collect();
    distance::transform(&mut squared, &mut number, [width, height, 1]);
    for n in &mut number {
        *n = if *n == OUTSIDE { 0 } else { *n };
    }
    Raster {
        width,
        height,
        data: number,
    }
}
