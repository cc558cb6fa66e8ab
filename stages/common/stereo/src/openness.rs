//! The share of its light that the relief around a pixel leaves it.
//!
//! Rays through a grid of voxels start above the surface and miss what is lower: pores, tool marks, the
//! foot of a fold. There the horizon of each azimuth, read from the depth map, hides `sin² h` of what an
//! even sky sends from that side, `h` the horizon's elevation over the tangent plane, and the share left is
//! `1 − mean sin² h`. Under soft light that changes intensities as much as the tilt of fine relief does.

use crate::level::{NEIGHBOURS, ViewGrid};
use rayon::prelude::*;

/// Distances at which the horizon is looked for, pixels along a row or column. Farther occluders stand out
/// enough for the rays.
const STEPS: [i32; 6] = [1, 2, 3, 4, 6, 8];

/// Smallest share: a crack is lit by its own walls.
const LEAST: f64 = 0.3;

/// Share of the light that is left to every masked pixel, .3 to 1, at log depths `depth` with unit
/// `normals` (camera frame).
pub fn openness(view: &ViewGrid, depth: &[f64], normals: &[[f64; 3]]) -> Vec<f32> {
    let ray = |p: usize| {
        let ((x, y), camera) = (view.xy(p), &view.camera);
        [
            (x - camera.cx) / camera.fx,
            (y - camera.cy) / camera.fy,
            1.0,
        ]
    };
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    (0..depth.len())
        .into_par_iter()
        .with_min_len(512)
        .map(|p| {
            let own = ray(p);
            let hidden: f64 = NEIGHBOURS
                .iter()
                .map(|(dx, dy)| {
                    STEPS
                        .iter()
                        .filter_map(|step| view.pixels.neighbour(p, step * dx, step * dy))
                        .map(|q| {
                            // Both points in units of the pixel's own depth.
                            let (far, there) = ((depth[q] - depth[p]).exp(), ray(q));
                            let to = [0, 1, 2].map(|k| far * there[k] - own[k]);
                            let up = dot(to, normals[p]).max(0.0);
                            up * up / dot(to, to)
                        })
                        .fold(0.0, f64::max)
                })
                .sum();
            (1.0 - hidden / NEIGHBOURS.len() as f64).max(LEAST) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;
    use crate::plate;

    /// Openness in the middle of a view far away, whose footprints are one unit: `height` towards the camera.
    fn in_the_middle(height: impl Fn(f64, f64) -> f64) -> f64 {
        let focal = 1e5;
        let view = flat_view(41, 41, focal);
        let depth: Vec<f64> = (0..view.pixels.len())
            .map(|p| {
                let (x, y) = view.xy(p);
                (1.0 - height(x - 20.0, y - 20.0) / focal).ln()
            })
            .collect();
        let normals = plate::normals(&view, &depth);
        let middle = view.pixels.number[20 * view.pixels.width + 20] as usize;
        f64::from(openness(&view, &depth, &normals)[middle])
    }

    #[test]
    fn a_plane_a_slope_and_a_ridge_are_open() {
        for height in [
            |_: f64, _: f64| 3.0,
            |x: f64, y: f64| 0.7 * x - 0.4 * y,
            |x: f64, _: f64| -0.5 * x.abs(),
        ] {
            let share = in_the_middle(height);
            assert!((share - 1.0).abs() < 1e-4, "{share}");
        }
    }

    /// A pit whose walls rise by `s` on all sides hides `s²/(1 + s²)`; of a groove the same walls rise by
    /// `s |cos φ|` at azimuth `φ`.
    #[test]
    fn a_pit_and_a_groove_hide_what_their_walls_do() {
        let s = 0.4_f64;
        let sin2 = |s: f64| s * s / (1.0 + s * s);
        let pit = in_the_middle(|x, y| s * x.hypot(y));
        assert!((pit - (1.0 - sin2(s))).abs() < 1e-3, "{pit}");
        let groove = in_the_middle(|x, _| s * x.abs());
        let hidden = (2.0 * sin2(s) + 4.0 * sin2(s * 0.5_f64.sqrt())) / 8.0;
        assert!((groove - (1.0 - hidden)).abs() < 1e-3, "{groove}");
    }

    #[test]
    fn the_deepest_crack_keeps_some_light() {
        let share = in_the_middle(|x, y| if x == 0.0 && y == 0.0 { 0.0 } else { 100.0 });
        assert!((share - LEAST).abs() < 1e-6, "{share}");
    }
}
