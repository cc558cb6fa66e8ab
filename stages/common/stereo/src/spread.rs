//! Per-pixel values at a finer level: bilinear over the masked parents, the nearest one where there
//! is none.

use crate::level::ViewGrid;
use rayon::prelude::*;
use rilievo_numerics::plate_system::OUTSIDE;
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

/// Number of the nearest masked pixel of every raster position (two chamfer sweeps).
fn nearest_pixels(view: &ViewGrid) -> Raster<u32> {
    let (w, h) = (view.pixels.width as i64, view.pixels.height as i64);
    let mut number = view.pixels.number.clone();
    let mut distance: Vec<i64> = number
        .iter()
        .map(|&n| if n == OUTSIDE { i64::MAX / 4 } else { 0 })
        .collect();
    let mut sweep = |forward: bool| {
        let offsets: [(i64, i64, i64); 4] = [(-1, 0, 2), (0, -1, 2), (-1, -1, 3), (1, -1, 3)];
        for k in 0..w * h {
            let k = if forward { k } else { w * h - 1 - k };
            let (x, y) = (k % w, k / w);
            for (dx, dy, cost) in offsets {
                let (dx, dy) = if forward { (dx, dy) } else { (-dx, -dy) };
                let (ax, ay) = (x + dx, y + dy);
                if ax < 0 || ay < 0 || ax >= w || ay >= h {
                    continue;
                }
                let a = (ay * w + ax) as usize;
                if distance[a] + cost < distance[k as usize] {
                    distance[k as usize] = distance[a] + cost;
                    number[k as usize] = number[a];
                }
            }
        }
    };
    sweep(true);
    sweep(false);
    for n in &mut number {
        if *n == OUTSIDE {
            *n = 0;
        }
    }
    Raster {
        width: view.pixels.width,
        height: view.pixels.height,
        data: number,
    }
}
