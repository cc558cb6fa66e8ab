//! First and second differences of log depth on the masked grid, and the thin-plate term.
//!
//! Slopes are dimensionless, `p = fx ∂ζ/∂x`, `q = fy ∂ζ/∂y`: central where the surface is smooth,
//! one-sided where it breaks and at the mask's edge, zero where a pixel stands alone.

use crate::level::ViewGrid;
use rayon::prelude::*;
use rilievo_numerics::plate_system::{Functional, PlateSystem};
use rilievo_numerics::robust::median;

/// Change of slope from a pixel to the next, from which the surface breaks between them; from half of
/// it on a slope leans to one side.
const BREAK: f64 = 1.0;

/// The two slopes of a pixel of the surface `depth`.
///
/// With differences `u` to the pixel before and `v` to the one behind, the slope is `a u + (1 − a) v`,
/// `a = ½` on a smooth surface, `a = v⁴/(u⁴ + v⁴)` where it breaks: beside an edge of depth the
/// difference on the pixel's own side counts (Harten, Engquist, Osher, Chakravarthy 1987, with smooth
/// weights, so that no pixel swaps sides for ever). The shares are those of `depth`: a step holds them fixed.
#[inline]
pub fn slopes(view: &ViewGrid, pixel: usize, depth: &[f64]) -> (Functional, Functional) {
    let one = |dx: i32, dy: i32, focal: f64| {
        let before = view.pixels.neighbour(pixel, -dx, -dy);
        let behind = view.pixels.neighbour(pixel, dx, dy);
        let share = match (before, behind) {
            (Some(a), Some(b)) => share_before(
                focal * (depth[pixel] - depth[a]),
                focal * (depth[b] - depth[pixel]),
            ),
            (Some(_), None) => 1.0,
            _ => 0.0,
        };
        let mut f = Functional::default();
        if let Some(a) = before {
            f.push(a, -focal * share);
        }
        // A central difference leaves the pixel itself out.
        if share != 0.5 && before.or(behind).is_some() {
            f.push(pixel, focal * (2.0 * share - 1.0));
        }
        if let Some(b) = behind {
            f.push(b, focal * (1.0 - share));
        }
        f
    };
    (one(1, 0, view.camera.fx), one(0, 1, view.camera.fy))
}

/// Share `a` of the difference to the pixel before.
#[inline]
fn share_before(u: f64, v: f64) -> f64 {
    let broken = (2.0 * (u - v).abs() / BREAK - 1.0).clamp(0.0, 1.0);
    if broken == 0.0 {
        return 0.5;
    }
    let (u4, v4) = (u.powi(4), v.powi(4));
    0.5 * (1.0 - broken) + broken * v4 / (u4 + v4)
}

/// A second difference of log depth.
#[derive(Clone, Copy)]
pub(crate) enum Bend {
    AlongX,
    AlongY,
    Mixed,
}

/// Visits the second differences (times the focal length) that are complete inside the mask: xx and
/// yy at every pixel, and the mixed one, times √2, of every 2×2 block, under its first pixel.
#[inline]
pub(crate) fn for_each_bend(view: &ViewGrid, mut visit: impl FnMut(usize, Bend, &Functional)) {
    let focal = view.camera.focal();
    let mixed = std::f64::consts::SQRT_2 * focal;
    for i in 0..view.pixels.len() {
        for (kind, dx, dy) in [(Bend::AlongX, 1, 0), (Bend::AlongY, 0, 1)] {
            if let (Some(a), Some(b)) = (
                view.pixels.neighbour(i, -dx, -dy),
                view.pixels.neighbour(i, dx, dy),
            ) {
                let mut f = Functional::default();
                f.push(a, focal);
                f.push(i, -2.0 * focal);
                f.push(b, focal);
                visit(i, kind, &f);
            }
        }
        if let (Some(a), Some(b), Some(c)) = (
            view.pixels.neighbour(i, 1, 0),
            view.pixels.neighbour(i, 0, 1),
            view.pixels.neighbour(i, 1, 1),
        ) {
            let mut f = Functional::default();
            f.push(i, mixed);
            f.push(a, -mixed);
            f.push(b, -mixed);
            f.push(c, mixed);
            visit(i, Bend::Mixed, &f);
        }
    }
}

/// How a bend is weighed around the current surface.
pub struct RobustPlate<'a> {
    /// Current log depths; the system is for their increment.
    pub depth: &'a [f64],
    /// Turn of the normal from a pixel to the next, radians, above which the penalty grows only linearly.
    pub threshold: f64,
}

/// Adds `weight |bends|²`; cut bends keep a trace of it, so that no pixel is left without a hold.
pub(crate) fn add_plate(
    view: &ViewGrid,
    system: &mut PlateSystem,
    weight: f64,
    is_cut: impl Fn(&Functional) -> bool,
) {
    // Far below what any depth weighs, far above the rounding of the factorisation.
    const TRACE: f64 = 1e-6;
    for_each_bend(view, |_, _, f| {
        let weight = if is_cut(f) { TRACE * weight } else { weight };
        system.add_square(&view.pixels, f, weight, 0.0);
    });
}

/// Bend beyond which the surface counts as torn, and the share of the plate's hold that is left there:
/// with less of it false depths that no neighbour shares stay where they are.
const TEAR: f64 = 2.0;
const HOLD: f64 = 0.25;

/// Adds `weight |turns|²` of the normals for the increment of a surface, linear beyond the Huber threshold, and weak where the
/// surface is torn, as beside an edge of depth.
pub fn add_robust_plate(
    view: &ViewGrid,
    system: &mut PlateSystem,
    weight: f64,
    robust: &RobustPlate,
) {
    let shares = turn_shares(view, robust.depth);
    for_each_bend(view, |pixel, kind, f| {
        let share = f64::from(shares[pixel][kind as usize]);
        let bend = f.of(robust.depth);
        let torn = (1.0 / (1.0 + (bend / TEAR).powi(4))).max(HOLD);
        let linear = (share * bend.abs() / robust.threshold).max(1.0);
        let w = weight * share * share * torn / linear;
        system.add_square(&view.pixels, f, w, -bend);
    });
}

/// How far each kind of bend at a pixel of slopes `p`, `q` turns the normal, over its own size: `√(1+q²) / (1+p²+q²)` for one
/// of `p`, likewise for one of `q`, the root mean square of both for the mixed one. The steeper the surface, the larger
/// the bend that is the same relief. Products of different kinds are left out.
fn turn_shares(view: &ViewGrid, depth: &[f64]) -> Vec<[f32; 3]> {
    (0..view.pixels.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|pixel| {
            let (p, q) = slopes(view, pixel, depth);
            let [pp, qq] = [p, q].map(|slope| slope.of(depth).powi(2));
            let all = 1.0 / (1.0 + pp + qq);
            [1.0 + qq, 1.0 + pp, 1.0 + 0.5 * (pp + qq)].map(|v| (v.sqrt() * all) as f32)
        })
        .collect()
}

/// Unit normal (camera frame, towards the camera) of a pixel with slopes `p`, `q`, and its
/// derivatives along them: `n ∝ (p, q, −1 − X p − Y q)`, `(X, Y, 1)` the pixel's ray.
#[inline]
pub fn normal_with_derivatives(
    view: &ViewGrid,
    pixel: usize,
    p: f64,
    q: f64,
) -> ([f64; 3], [f64; 3], [f64; 3]) {
    let (x, y) = view.xy(pixel);
    let (x, y) = (
        (x - view.camera.cx) / view.camera.fx,
        (y - view.camera.cy) / view.camera.fy,
    );
    let m = [p, q, -1.0 - x * p - y * q];
    let inverse = 1.0 / (m[0] * m[0] + m[1] * m[1] + m[2] * m[2]).sqrt();
    let n = m.map(|v| v * inverse);
    let along = |e: [f64; 3]| {
        let d = n[0] * e[0] + n[1] * e[1] + n[2] * e[2];
        [0, 1, 2].map(|k| (e[k] - n[k] * d) * inverse)
    };
    (n, along([1.0, 0.0, -x]), along([0.0, 1.0, -y]))
}

/// Median over a surface's bends of how far each turns the normal from a pixel to the next, radians; none where no
/// three pixels lie in a row.
pub fn typical_turn(view: &ViewGrid, depth: &[f64]) -> Option<f64> {
    let shares = turn_shares(view, depth);
    let mut turns = Vec::new();
    for_each_bend(view, |pixel, kind, f| {
        turns.push(f64::from(shares[pixel][kind as usize]) * f.of(depth).abs());
    });
    median(&mut turns)
}

/// Mean distance between two surfaces of a view, log depth.
pub fn mean_move(from: &[f64], to: &[f64]) -> f64 {
    let sum: f64 = to.iter().zip(from).map(|(a, b)| (a - b).abs()).sum();
    sum / from.len().max(1) as f64
}

/// Mean angle between the normals of two surfaces of a view, radians.
pub fn mean_turn(view: &ViewGrid, from: &[f64], to: &[f64]) -> f64 {
    let sum: f64 = normals(view, from)
        .iter()
        .zip(normals(view, to))
        .map(|(a, b)| {
            // By half the chord, which is exact for small angles.
            let chord2: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            2.0 * (0.5 * chord2.sqrt()).min(1.0).asin()
        })
        .sum();
    sum / view.pixels.len().max(1) as f64
}

/// Normals of a whole view.
pub fn normals(view: &ViewGrid, depth: &[f64]) -> Vec<[f64; 3]> {
    (0..view.pixels.len())
        .map(|i| {
            let (p, q) = slopes(view, i, depth);
            normal_with_derivatives(view, i, p.of(depth), q.of(depth)).0
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    #[test]
    fn slopes_are_central_where_smooth_and_the_own_sides_beside_a_step() {
        let view = flat_view(40, 20, 100.0);
        let focal = view.camera.focal();
        // A parabola, and beyond a step of 30 footprints a plane.
        let height = |x: f64| {
            if x < 20.0 {
                0.01 * x * x
            } else {
                30.0 - 0.4 * x
            }
        };
        let depth: Vec<f64> = (0..view.pixels.len())
            .map(|p| height(view.xy(p).0) / focal)
            .collect();
        for p in 0..depth.len() {
            let (x, y) = view.xy(p);
            if x == 0.0 || x == 39.0 || y == 0.0 || y == 19.0 {
                continue;
            }
            let (along_x, along_y) = slopes(&view, p, &depth);
            let expected = if x == 19.0 {
                height(19.0) - height(18.0)
            } else if x < 20.0 {
                0.02 * x
            } else {
                -0.4
            };
            assert!(
                (along_x.of(&depth) - expected).abs() < 1e-3,
                "{} at {x}, {expected} expected",
                along_x.of(&depth)
            );
            assert!(along_y.of(&depth).abs() < 1e-12);
        }
    }

    /// On a tilted surface the plate's squares sum to how far the normal turns to the pixels beside and below; a saddle,
    /// since products of different kinds of bends are left out, and cancel there.
    #[test]
    fn squares_of_the_plate_are_the_turns_of_the_normal() {
        // Long, so that rays through neighbouring pixels hardly differ.
        let view = flat_view(31, 31, 1e5);
        let depth: Vec<f64> = (0..view.pixels.len())
            .map(|p| {
                let (x, y) = view.xy(p);
                let (x, y) = (x - 15.0, y - 15.0);
                let bent = 0.006 * (x * x - y * y) + 0.008 * x * y;
                (0.8 * x - 1.7 * y + bent) / view.camera.focal()
            })
            .collect();
        let middle = 15 * 31 + 15;
        let shares = turn_shares(&view, &depth);
        let mut squares = 0.0;
        for_each_bend(&view, |pixel, kind, f| {
            if pixel == middle {
                squares += (f64::from(shares[pixel][kind as usize]) * f.of(&depth)).powi(2);
            }
        });
        let normals = normals(&view, &depth);
        let turned = |step: usize| {
            let [a, b] = [middle - step, middle + step].map(|p| normals[p]);
            (0..3).map(|k| (0.5 * (b[k] - a[k])).powi(2)).sum::<f64>()
        };
        let expected = turned(1) + turned(31);
        assert!(
            (squares / expected - 1.0).abs() < 0.02,
            "{squares:e} {expected:e}"
        );
    }
}
