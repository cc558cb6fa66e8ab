//! Start surface: what the views' dense depths agree on, continued by a robust thin plate.

use super::level::{Level, LevelView};
use super::patchmatch::Planes;
use super::plate;
use rayon::prelude::*;
use rilievo_numerics::plate_system::{OUTSIDE, PlateError, PlateSolver, PlateSystem};

/// Agreement of every masked pixel of every view with its sources.
#[derive(Clone, Debug)]
pub(crate) struct Agreement {
    /// Number of sources whose depth agrees.
    pub count: Vec<u8>,
    /// Bit `k` is set where the `k`-th source agrees.
    pub which: Vec<u8>,
}

/// Compares log depths between the views; `tolerance` is relative depth.
pub(crate) fn agreement(level: &Level, depths: &[Vec<f64>], tolerance: f64) -> Vec<Agreement> {
    level
        .views
        .par_iter()
        .enumerate()
        .map(|(i, view)| {
            let n = view.pixels.len();
            let mut out = Agreement {
                count: vec![0; n],
                which: vec![0; n],
            };
            for (p, &depth) in depths[i].iter().enumerate() {
                let (x, y) = view.xy(p);
                for (k, (j, warp)) in level.sources[i].iter().enumerate() {
                    let Some(landing) = warp.land(x, y, depth) else {
                        continue;
                    };
                    let other = &level.views[*j].pixels;
                    let (u, v) = (landing.u.round(), landing.v.round());
                    if u < 0.0 || v < 0.0 || u >= other.width as f64 || v >= other.height as f64 {
                        continue;
                    }
                    let q = other.number[v as usize * other.width + u as usize];
                    if q != OUTSIDE && (landing.zeta - depths[*j][q as usize]).abs() < tolerance {
                        out.count[p] += 1;
                        out.which[p] |= 1 << k;
                    }
                }
            }
            out
        })
        .collect()
}

/// Log depths of planes.
pub(crate) fn log_depths(planes: &Planes) -> Vec<f64> {
    planes
        .inverse_depth
        .iter()
        .map(|&w| -f64::from(w.max(1e-9)).ln())
        .collect()
}

/// Robust thin plate through weighted log depths: `Σ w ρ(ζ − ζ₀) + α |D² ζ|²`, slopes in units of
/// the focal length; points farther than `knee` (log depth) from the plate lose their weight.
pub(crate) fn fill(
    view: &LevelView,
    solver: &PlateSolver,
    depth: &[f64],
    weight: &[f64],
    sigma: f64,
    plate_weight: f64,
) -> Result<Vec<f64>, PlateError> {
    // Re-weightings: the plate settles within a few.
    const NUM_ITERATIONS: usize = 4;
    let n = view.pixels.len();
    let base = {
        let mut known: Vec<f64> = depth
            .iter()
            .zip(weight)
            .filter(|&(_, &w)| w > 0.0)
            .map(|(&d, _)| d)
            .collect();
        rilievo_numerics::robust::median(&mut known).unwrap_or(0.0)
    };
    let mut system = PlateSystem::new(n);
    let mut current = weight
        .iter()
        .map(|w| w / (sigma * sigma))
        .collect::<Vec<_>>();
    let mut plate = Vec::new();
    for _ in 0..NUM_ITERATIONS {
        system.clear();
        plate::add_plate(view, &mut system, plate_weight, None);
        for i in 0..n {
            system.add_point(i, current[i] + 1e-9, depth[i] - base);
        }
        plate = solver.solve(&system)?;
        for i in 0..n {
            let r = (plate[i] + base - depth[i]).abs() * weight[i].sqrt() / sigma;
            let robust = if r < 1.0 { 1.0 } else { 1.0 / (r * r) };
            current[i] = weight[i] / (sigma * sigma) * robust;
        }
    }
    for value in &mut plate {
        *value += base;
    }
    Ok(plate)
}
