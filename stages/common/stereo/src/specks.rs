//! Pixels whose normals stand out from all around them: what is left of false depths beside outlines and in folds.

use crate::level::{MAX_STEP_PX, NEIGHBOURS, ViewGrid};
use crate::plate;
use rayon::prelude::*;
use rilievo_numerics::robust::median;

/// Angle to the median normal of the neighbourhood beyond which a pixel is a speck, degrees.
const SPECK_DEG: f64 = 40.0;

/// Pixels from the middle of a neighbourhood to its side.
const REACH: i32 = 2;

/// Rounds in which a cluster is replaced from its rim inwards.
const NUM_ROUNDS: usize = 6;

/// Pixels of one side from which that side can be continued; a smaller patch joins what surrounds it.
const FEWEST: usize = 8;

/// Whether the normal of each masked pixel lies more than 40° from the median (per component) of its
/// 5×5 neighbourhood on the same side of a depth edge. Unit `normals`, camera frame; log depths `depth`.
pub fn find(view: &ViewGrid, depth: &[f64], normals: &[[f64; 3]]) -> Vec<bool> {
    let (sine, least) = SPECK_DEG.to_radians().sin_cos();
    let alike = sine / 3.0_f64.sqrt();
    (0..depth.len())
        .into_par_iter()
        .with_min_len(512)
        .map_init(
            || [const { Vec::new() }; 3],
            |columns: &mut [Vec<f64>; 3], p| {
                columns.iter_mut().for_each(Vec::clear);
                let mut largest = 0.0_f64;
                for q in same_side(view, depth, p) {
                    for (column, (value, own)) in columns
                        .iter_mut()
                        .zip(normals[q].into_iter().zip(normals[p]))
                    {
                        largest = largest.max((value - own).abs());
                        column.push(value);
                    }
                }
                // No component of the median is farther off than that of any neighbour.
                if largest < alike {
                    return false;
                }
                let middle = [0, 1, 2].map(|k| median(&mut columns[k]).unwrap_or(normals[p][k]));
                let length = middle.iter().map(|v| v * v).sum::<f64>().sqrt();
                let along: f64 = middle.iter().zip(normals[p]).map(|(a, b)| a * b).sum();
                along < least * length
            },
        )
        .collect()
}

/// A surface without its specks.
pub struct Cleaned {
    /// Log depths.
    pub depth: Vec<f64>,
    /// Share of the pixels that are specks, before and after.
    pub shares: [f64; 2],
}

/// The surface with every speck, and the pixels that touch one and lie off by more than a
/// footprint, moved onto the plane that the other pixels around it agree on (medians of depth and
/// slope); what has no such neighbour stays.
pub fn remove(view: &ViewGrid, depth: &[f64]) -> Cleaned {
    let footprint = 1.0 / view.camera.focal();
    let mut surface = depth.to_vec();
    let mut shares = [0.0; 2];
    for round in 0..=NUM_ROUNDS {
        let normals = plate::normals(view, &surface);
        let is_speck = find(view, &surface, &normals);
        let num_specks = is_speck.iter().filter(|&&is| is).count();
        shares[1] = num_specks as f64 / is_speck.len().max(1) as f64;
        if round == 0 {
            shares[0] = shares[1];
        }
        if num_specks == 0 || round == NUM_ROUNDS {
            break;
        }
        // Slopes reach one pixel: the depth that is wrong may be a neighbour's, which then lies off the plane.
        let moves: Vec<bool> = (0..surface.len())
            .map(|p| {
                is_speck[p]
                    || NEIGHBOURS.iter().any(|&(dx, dy)| {
                        view.pixels
                            .neighbour(p, dx, dy)
                            .is_some_and(|q| is_speck[q])
                    })
            })
            .collect();
        let moved: Vec<(usize, f64)> = (0..surface.len())
            .into_par_iter()
            .with_min_len(512)
            .filter(|&p| moves[p])
            .filter_map(|p| Some((p, continued(view, &surface, &moves, p)?)))
            .filter(|&(p, value)| is_speck[p] || (value - surface[p]).abs() > footprint)
            .collect();
        for (p, value) in moved {
            surface[p] = value;
        }
    }
    Cleaned {
        depth: surface,
        shares,
    }
}

/// Log depth at `pixel` of the plane through the pixels around it that stay.
fn continued(view: &ViewGrid, depth: &[f64], moves: &[bool], pixel: usize) -> Option<f64> {
    let mut around: Vec<usize> = same_side(view, depth, pixel)
        .filter(|&q| !moves[q])
        .collect();
    if around.len() < FEWEST {
        around = neighbourhood(view, pixel).filter(|&q| !moves[q]).collect();
    }
    let slopes: Vec<[f64; 2]> = around
        .iter()
        .map(|&q| {
            let (p, q) = plate::slopes(view, q, depth);
            [p.of(depth), q.of(depth)]
        })
        .collect();
    let slope = |k: usize| median(&mut slopes.iter().map(|s| s[k]).collect::<Vec<_>>());
    let slope = [slope(0)?, slope(1)?];
    let (x, y) = view.xy(pixel);
    let mut depths: Vec<f64> = around
        .iter()
        .map(|&q| {
            let (from_x, from_y) = view.xy(q);
            depth[q]
                + slope[0] * (x - from_x) / view.camera.fx
                + slope[1] * (y - from_y) / view.camera.fy
        })
        .collect();
    median(&mut depths)
}

/// The masked pixels within [`REACH`] rows and columns, the pixel itself among them.
fn neighbourhood(view: &ViewGrid, pixel: usize) -> impl Iterator<Item = usize> {
    (-REACH..=REACH).flat_map(move |dy| {
        (-REACH..=REACH).filter_map(move |dx| view.pixels.neighbour(pixel, dx, dy))
    })
}

/// Those of the [`neighbourhood`] that no depth edge separates from the pixel.
fn same_side(view: &ViewGrid, depth: &[f64], pixel: usize) -> impl Iterator<Item = usize> {
    let step = MAX_STEP_PX / view.camera.focal();
    neighbourhood(view, pixel).filter(move |&q| (depth[q] - depth[pixel]).abs() <= step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::flat_view;

    const FOCAL: f64 = 100.0;

    /// Log depths of a height in footprints.
    fn surface(view: &ViewGrid, height: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        (0..view.pixels.len())
            .map(|p| height(view.xy(p).0, view.xy(p).1) / FOCAL)
            .collect()
    }

    fn num_specks(view: &ViewGrid, depth: &[f64]) -> usize {
        let found = find(view, depth, &plate::normals(view, depth));
        found.iter().filter(|&&is| is).count()
    }

    #[test]
    fn slopes_relief_creases_and_depth_edges_stay_as_they_are() {
        let view = flat_view(48, 40, FOCAL);
        let shapes: [&dyn Fn(f64, f64) -> f64; 4] = [
            &|x, y| 0.9 * x - 0.4 * y,
            &|x, y| (0.7 * x).sin() * (0.6 * y).cos(),
            &|x, _| (x - 24.2).abs(),
            &|x, y| if x < 20.0 { 0.2 * y } else { 30.0 + 0.5 * x },
        ];
        for (k, shape) in shapes.into_iter().enumerate() {
            let depth = surface(&view, shape);
            assert_eq!(num_specks(&view, &depth), 0, "shape {k}");
            assert_eq!(remove(&view, &depth).depth, depth, "shape {k}");
        }
    }

    #[test]
    fn single_pixels_and_clusters_return_to_the_surface() {
        let view = flat_view(48, 40, FOCAL);
        let plane = |x: f64, y: f64| 0.3 * x - 0.2 * y;
        let truth = surface(&view, plane);
        let is_rough = |x: f64, y: f64| {
            let cluster = (30.0..34.0).contains(&x) && (20.0..23.0).contains(&y);
            cluster || (x == 10.0 && y == 10.0)
        };
        let depth = surface(&view, |x, y| {
            let rough = 4.0 * (5.1 * x + 3.3 * y * y).sin();
            plane(x, y) + if is_rough(x, y) { rough } else { 0.0 }
        });
        assert!(num_specks(&view, &depth) > 4);
        let cleaned = remove(&view, &depth).depth;
        assert_eq!(num_specks(&view, &cleaned), 0);
        for p in 0..truth.len() {
            let (x, y) = view.xy(p);
            let largest = if is_rough(x, y) { 1.0 } else { 1e-9 };
            assert!((cleaned[p] - truth[p]).abs() * FOCAL <= largest);
        }
    }
}
