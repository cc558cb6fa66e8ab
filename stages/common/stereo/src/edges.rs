//! Where the surface breaks: gaps beside a nearer surface that other views cannot look into.
//!
//! A view at angle `θ` from this one loses sight of the background beside an edge over a width of
//! `tan θ` times the jump of depth. A gap between confirmed pixels of log depths `ζ₁ < ζ₂`, `d` pixels
//! apart, is such a gap when `f (ζ₂ − ζ₁) / d` is steeper than any surface that those views would
//! have confirmed; then it continues the farther side.

use crate::level::{LevelView, NEIGHBOURS};
use rilievo_numerics::plate_system::Functional;

/// Widest gap, pixels.
const MAX_REACH: usize = 60;
/// Confirmed pixels that make a rim: fewer are stray.
const RIM_LENGTH: usize = 3;
/// Neighbours of like depth that a confirmed pixel needs, or else it is stray.
const MIN_LIKE: usize = 4;
/// Largest step of depth between like neighbours, pixel footprints.
const MAX_STEP: f64 = 4.0;
/// Slope (log depth times focal length, per pixel) of a gap that hides something: about 55°.
const MIN_SLOPE: f64 = 1.4;
/// Smallest jump, pixel footprints.
const MIN_JUMP: f64 = 5.0;

/// Log depth of the farther rim for every pixel in a hidden gap, `None` elsewhere. A pixel whose depth is not a number
/// lies in no gap: there the photo shows nothing, whoever looks. `footprint` is a pixel's relative footprint.
pub(crate) fn hidden_gaps(
    view: &LevelView,
    depth: &[f64],
    weight: &[f64],
    footprint: f64,
) -> Vec<Option<f64>> {
    let confirmed = |p: usize| weight[p] > 0.0;
    let kept: Vec<bool> = (0..depth.len())
        .map(|p| {
            confirmed(p)
                && NEIGHBOURS
                    .iter()
                    .filter_map(|&(dx, dy)| view.pixels.neighbour(p, dx, dy))
                    .filter(|&q| confirmed(q) && (depth[q] - depth[p]).abs() < MAX_STEP * footprint)
                    .count()
                    >= MIN_LIKE
        })
        .collect();
    (0..depth.len())
        .map(|p| {
            if kept[p] || depth[p].is_nan() {
                return None;
            }
            let rims = NEIGHBOURS
                .iter()
                .filter_map(|&step| rim(view, depth, &kept, p, step));
            let (mut near, mut far) = (None::<(f64, usize)>, None::<(f64, usize)>);
            for (zeta, distance) in rims {
                if near.is_none_or(|(z, _)| zeta < z) {
                    near = Some((zeta, distance));
                }
                if far.is_none_or(|(z, _)| zeta > z) {
                    far = Some((zeta, distance));
                }
            }
            let ((near, to_near), (far, to_far)) = (near?, far?);
            let jump = (far - near) / footprint;
            (jump > MIN_JUMP && jump > MIN_SLOPE * (to_near + to_far) as f64).then_some(far)
        })
        .collect()
}

/// Whether a difference joins a hidden gap with the surface that hides it, `surface` being the log
/// depths of the pixels outside gaps.
pub(crate) fn is_cut(
    f: &Functional,
    gaps: &[Option<f64>],
    surface: &[f64],
    footprint: f64,
) -> bool {
    f.terms().iter().any(|&(a, _)| {
        gaps[a as usize].is_some_and(|far| {
            f.terms().iter().any(|&(b, _)| {
                let b = b as usize;
                gaps[b].is_none() && surface[b] < far - MIN_JUMP * footprint
            })
        })
    })
}

/// Mean log depth of the first confirmed pixels in a direction, and how far away they are.
fn rim(
    view: &LevelView,
    depth: &[f64],
    kept: &[bool],
    pixel: usize,
    (dx, dy): (i32, i32),
) -> Option<(f64, usize)> {
    let (mut at, mut sum, mut count) = (pixel, 0.0, 0);
    for distance in 1..=MAX_REACH {
        at = view.pixels.neighbour(at, dx, dy)?;
        if kept[at] {
            sum += depth[at];
            count += 1;
            if count == RIM_LENGTH {
                return Some((sum / count as f64, distance));
            }
        } else {
            (sum, count) = (0.0, 0);
        }
    }
    None
}
