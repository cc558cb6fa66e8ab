//! First and second differences of log depth on the masked grid, and the thin-plate term.
//!
//! Slopes are dimensionless, `p = fx ∂ζ/∂x`, `q = fy ∂ζ/∂y`: central where both neighbours are
//! masked, one-sided at the mask's edge, zero where a pixel stands alone.

use super::level::LevelView;
use rilievo_numerics::plate_system::{Functional, PlateSystem};

/// The two slopes of a pixel.
#[inline]
pub(crate) fn slopes(view: &LevelView, pixel: usize) -> (Functional, Functional) {
    let one = |dx: i32, dy: i32, focal: f64| {
        let mut f = Functional::default();
        let back = view.pixels.neighbour(pixel, -dx, -dy);
        let ahead = view.pixels.neighbour(pixel, dx, dy);
        match (back, ahead) {
            (Some(a), Some(b)) => {
                f.push(a, -0.5 * focal);
                f.push(b, 0.5 * focal);
            }
            (Some(a), None) => {
                f.push(a, -focal);
                f.push(pixel, focal);
            }
            (None, Some(b)) => {
                f.push(pixel, -focal);
                f.push(b, focal);
            }
            (None, None) => {}
        }
        f
    };
    (one(1, 0, view.camera.fx), one(0, 1, view.camera.fy))
}

/// Visits the second differences (times the focal length) that are complete inside the mask:
/// xx and yy at every pixel, and the mixed one, times √2, of every 2×2 block.
#[inline]
pub(crate) fn for_each_bend(view: &LevelView, mut visit: impl FnMut(&Functional)) {
    let focal = view.camera.focal();
    let mixed = std::f64::consts::SQRT_2 * focal;
    for i in 0..view.pixels.len() {
        for (dx, dy) in [(1, 0), (0, 1)] {
            if let (Some(a), Some(b)) = (
                view.pixels.neighbour(i, -dx, -dy),
                view.pixels.neighbour(i, dx, dy),
            ) {
                let mut f = Functional::default();
                f.push(a, focal);
                f.push(i, -2.0 * focal);
                f.push(b, focal);
                visit(&f);
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
            visit(&f);
        }
    }
}

/// How a bend is weighed around the current surface.
pub(crate) struct RobustPlate<'a> {
    /// Current log depths; the system is for their increment.
    pub depth: &'a [f64],
    /// Bend (slope per pixel) above which the penalty grows only linearly.
    pub knee: f64,
}

/// Adds `weight |bends|²`; cut bends keep a trace of it, so that no pixel is left without a hold.
pub(crate) fn add_plate(
    view: &LevelView,
    system: &mut PlateSystem,
    weight: f64,
    is_cut: impl Fn(&Functional) -> bool,
) {
    // Far below what any depth weighs, far above the rounding of the factorisation.
    const TRACE: f64 = 1e-6;
    for_each_bend(view, |f| {
        let weight = if is_cut(f) { TRACE * weight } else { weight };
        system.add_square(&view.pixels, f, weight, 0.0);
    });
}

/// Adds `weight |bends|²` for the increment of a surface, linear beyond the knee.
pub(crate) fn add_robust_plate(
    view: &LevelView,
    system: &mut PlateSystem,
    weight: f64,
    robust: &RobustPlate,
) {
    for_each_bend(view, |f| {
        let bend = f.of(robust.depth);
        let w = weight / (bend.abs() / robust.knee).max(1.0);
        system.add_square(&view.pixels, f, w, -bend);
    });
}

/// Unit normal (camera frame, towards the camera) of a pixel with slopes `p`, `q`, and its
/// derivatives along them: `n ∝ (p, q, −1 − X p − Y q)`, `(X, Y, 1)` the pixel's ray.
#[inline]
pub(crate) fn normal_with_derivatives(
    view: &LevelView,
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

/// Mean distance between two surfaces of a view, log depth.
pub(crate) fn mean_move(from: &[f64], to: &[f64]) -> f64 {
    let sum: f64 = to.iter().zip(from).map(|(a, b)| (a - b).abs()).sum();
    sum / from.len().max(1) as f64
}

/// Mean angle between the normals of two surfaces of a view, radians.
pub(crate) fn mean_turn(view: &LevelView, from: &[f64], to: &[f64]) -> f64 {
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
pub(crate) fn normals(view: &LevelView, depth: &[f64]) -> Vec<[f64; 3]> {
    (0..view.pixels.len())
        .map(|i| {
            let (p, q) = slopes(view, i);
            normal_with_derivatives(view, i, p.of(depth), q.of(depth)).0
        })
        .collect()
}
