//! Log depths from one level of the pyramid to the next.

use crate::level::{MAX_STEP_PX, NEIGHBOURS, ViewGrid};
use crate::plate;
use crate::sampling;
use crate::surfaces::CUBIC_RANGE_PX;
use rilievo_numerics::plate_system::Functional;

/// Log depth at the next coarser level, or the same: mean of the four children (all are masked).
pub fn reduce(fine: &ViewGrid, coarse: &ViewGrid, depth: &[f64]) -> Vec<f64> {
    if fine.mask.width == coarse.mask.width {
        return depth.to_vec();
    }
    (0..coarse.pixels.len())
        .map(|p| {
            let children = children(fine, coarse, p);
            children.iter().map(|&child| 0.25 * depth[child]).sum()
        })
        .collect()
}

/// Numbers of the four pixels of the next finer level that a masked pixel covers.
pub fn children(fine: &ViewGrid, coarse: &ViewGrid, pixel: usize) -> [usize; 4] {
    let (x, y) = (
        2 * coarse.pixels.xs[pixel] as usize,
        2 * coarse.pixels.ys[pixel] as usize,
    );
    [(0, 0), (1, 0), (0, 1), (1, 1)]
        .map(|(dx, dy)| fine.pixels.number[(y + dy) * fine.pixels.width + x + dx] as usize)
}

/// Log depth of a finer level from a coarser one: cubic, so that slopes have no steps, bilinear
/// beside borders and breaks, where the sixteen parents are not all of one surface, and known where
/// all four are masked; between parents of different surfaces the nearest one's tangent plane, so
/// that no pixel hangs between both. Returns the values and where they are known.
pub fn upsample(coarse: &ViewGrid, fine: &ViewGrid, values: &[f64]) -> (Vec<f64>, Vec<bool>) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let centred: Vec<f64> = values.iter().map(|v| v - mean).collect();
    let raster = coarse.spread(&centred, 0.0);
    let max_range = CUBIC_RANGE_PX / coarse.camera.focal();
    let mut out = Vec::with_capacity(fine.pixels.len());
    let mut known = Vec::with_capacity(fine.pixels.len());
    for i in 0..fine.pixels.len() {
        let (x, y) = fine.xy(i);
        let (x, y) = (0.5 * (x + 0.5) - 0.5, 0.5 * (y + 0.5) - 0.5);
        let is_known = sampling::inside(&coarse.mask, x, y);
        known.push(is_known);
        out.push(if !is_known {
            mean
        } else if !coarse.is_one_surface(&raster, x, y) {
            on_nearest_plane(coarse, values, x, y)
        } else {
            let cubic = sampling::cubic_with_slope(&raster, &coarse.mask, x, y, max_range);
            mean + cubic.map_or_else(|| f64::from(sampling::bilinear(&raster, x, y)), |(z, ..)| z)
        });
    }
    (out, known)
}

/// [`upsample`] of values of which some are not known, continued over the rim that has no parents.
/// Returns the values and where they are known.
pub fn continued(
    coarse: &ViewGrid,
    fine: &ViewGrid,
    (values, known): (&[f64], &[bool]),
) -> (Vec<f64>, Vec<bool>) {
    let (mut values, mut is_known) = upsample(coarse, fine, values);
    for (p, is) in is_known.iter_mut().enumerate().filter(|(_, is)| **is) {
        // Where all four parents are masked, the nearest is one of them.
        let (x, y) = (fine.pixels.xs[p] / 2, fine.pixels.ys[p] / 2);
        let nearest = y as usize * coarse.pixels.width + x as usize;
        *is = known[coarse.pixels.number[nearest] as usize];
    }
    extend(fine, &mut values, &mut is_known);
    (values, is_known)
}

/// Fills pixels without a value with the mean of their known neighbours, ring by ring.
fn extend(view: &ViewGrid, values: &mut [f64], known: &mut [bool]) {
    // The rim is two pixels wide; specks without any parent take a few rings more.
    const NUM_RINGS: usize = 12;
    let mut missing: Vec<usize> = (0..values.len()).filter(|&p| !known[p]).collect();
    for _ in 0..NUM_RINGS {
        let found: Vec<(usize, f64)> = missing
            .iter()
            .filter_map(|&p| {
                let (mut depth, mut count) = (0.0, 0.0);
                for (dx, dy) in NEIGHBOURS {
                    if let Some(q) = view.pixels.neighbour(p, dx, dy)
                        && known[q]
                    {
                        depth += values[q];
                        count += 1.0;
                    }
                }
                (count > 0.0).then(|| (p, depth / count))
            })
            .collect();
        if found.is_empty() {
            break;
        }
        for (p, depth) in found {
            values[p] = depth;
            known[p] = true;
        }
        missing.retain(|&p| !known[p]);
    }
}

/// Log depth at a position on the tangent plane of the nearest pixel, which must be masked.
fn on_nearest_plane(view: &ViewGrid, depth: &[f64], x: f64, y: f64) -> f64 {
    let (px, py) = (x.round(), y.round());
    let nearest = view.pixels.number[py as usize * view.pixels.width + px as usize] as usize;
    let (along_x, along_y) = plate::slopes(view, nearest, depth);
    let slope = |along: &Functional| along.of(depth).clamp(-MAX_STEP_PX, MAX_STEP_PX);
    depth[nearest]
        + slope(&along_x) / view.camera.fx * (x - px)
        + slope(&along_y) / view.camera.fy * (y - py)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    /// Waves of 12 coarse pixels keep their slopes to a thirtieth of the steepest; straight lines between parents
    /// miss an eighth.
    #[test]
    fn slopes_are_as_smooth_as_the_surface() {
        let fine = flat_view(96, 48, 1000.0);
        let coarse = fine.halved();
        let focal = coarse.camera.focal();
        let turn = std::f64::consts::TAU / 12.0;
        let values: Vec<f64> = (0..coarse.pixels.len())
            .map(|p| (turn * coarse.xy(p).0).sin() / focal)
            .collect();
        let (finer, known) = upsample(&coarse, &fine, &values);
        let mut worst = 0.0_f64;
        for p in (0..finer.len()).filter(|&p| known[p]) {
            let (x, y) = fine.xy(p);
            let is_inner = |v: f64, size: f64| v > 5.0 && v < size - 6.0;
            if !is_inner(x, 96.0) || !is_inner(y, 48.0) {
                continue;
            }
            let slope = (finer[p + 1] - finer[p]) * fine.camera.focal();
            let middle = 0.5 * (x + 1.0) - 0.5;
            worst = worst.max((slope - turn * (turn * middle).cos()).abs() / turn);
        }
        assert!(worst > 0.0 && worst < 0.03, "{worst}");
    }

    /// Two planes with a step between them: no pixel of the finer level lies between both.
    #[test]
    fn a_step_stays_a_step_at_the_finer_level() {
        let fine = flat_view(64, 32, 100.0);
        let coarse = fine.halved();
        let focal = coarse.camera.focal();
        let surface = |x: f64| if x < 16.0 { 0.3 * x } else { 40.0 - 0.2 * x } / focal;
        let values: Vec<f64> = (0..coarse.pixels.len())
            .map(|p| surface(coarse.xy(p).0))
            .collect();
        let (finer, known) = upsample(&coarse, &fine, &values);
        let mut num_known = 0;
        for p in (0..finer.len()).filter(|&p| known[p]) {
            let x = 0.5 * (fine.xy(p).0 + 0.5) - 0.5;
            // Beyond the middle between two parents the farther surface begins.
            let expected = if x < 15.5 { 0.3 * x } else { 40.0 - 0.2 * x } / focal;
            assert!(
                (finer[p] - expected).abs() < 1e-6,
                "{} at {x}, {expected} expected",
                finer[p]
            );
            num_known += 1;
        }
        assert!(num_known > 1500, "{num_known}");
    }
}
