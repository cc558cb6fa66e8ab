//! Depth edges: where an integrable surface and shading cannot agree.
//!
//! From the middle of each level on, or of its first 40 iterations, where pixels determine their normals, slopes are freed
//! several times: `θ' = argmin E(θ) + β'/2 |θ − ∇y|²` with a penalty `β'` of the pixel's own accuracy.
//!
//! **Test.** With the conflict `c² = |θ' − ∇y|² / (1 + |∇y|²)` and the squared residual `r²` of the
//! image at the surface's slopes, a pixel keeps the stiffness
//!
//! ```text
//! s = 1 / (1 + e²),   e = min(c²/c₀², r²/r₀²),
//! ```
//!
//! `c₀` a few degrees, `r₀` from the noise that the freed slopes leave. Below a quarter it counts as a
//! break: both steps then let go of it, so that its θ follows its shading and `y` may step. `c₀` starts
//! at the largest conflicts and falls, since a surface that is still bent over a break disagrees with
//! shading all around it.
//!
//! Source: rilievo's own; the weights are those of a graduated, redescending loss on `∇y − θ`.

use super::levels::Level;
use super::pixels::Slopes;
use super::theta::{ThetaProblem, ThetaTerms, theta_step};
use rilievo_numerics::robust::quantile;

/// Conflict between shading and surface, as a tangent, at which the surface is taken to break: three
/// degrees. Smaller gains a little more on exact images, but would soften noise.
const BREAK_CONFLICT: f32 = 0.05;
/// While the surface still bends over a break, it disagrees with shading all around it: at first only
/// the largest conflicts are breaks, of about this quantile, and then ever smaller ones.
const LARGE_CONFLICT: f64 = 0.99;
/// Squared residual that is no noise, in units of the median squared residual that is left when slopes
/// are free: that of one degree of freedom (three channels, two slopes), against 9 times the median
/// of three.
const NOISE_LIMIT: f32 = 9.0 * 2.37 / 0.455;
/// Slope from which a facet is a wall, which hardly any light distinguishes from a
/// step: 76 degrees.
const MAX_SLOPE: f32 = 4.0;
/// How often the breaks are looked for, at equal distances over iterations 20 to 40, or the second half where a level has
/// fewer: while it bends over a break, a surface disagrees with shading all around it.
const NUM_BREAK_SEARCHES: usize = 5;
/// Iterations of a level after which no more breaks are looked for.
const LAST_BREAK_SEARCH: usize = 40;

/// Whether breaks are looked for at an iteration, and then the share of the largest squared conflict
/// that makes one.
pub(crate) fn break_search(iteration: usize, num_iterations: usize) -> Option<f32> {
    let half = num_iterations.min(LAST_BREAK_SEARCH) / 2;
    let every = (half / NUM_BREAK_SEARCHES).max(1);
    let since = iteration.checked_sub(half)?;
    (since.is_multiple_of(every) && iteration < LAST_BREAK_SEARCH)
        .then(|| 0.5 * 0.25_f32.powi((since / every) as i32))
}

/// Sets the stiffness low where shading alone asks for other slopes than an integrable surface can
/// have: there the surface breaks. Returns the number of such pixels.
pub(crate) fn soften_breaks(
    level: &Level,
    [sp, sq]: &Slopes,
    theta: &mut Slopes,
    beta: f32,
    share_of_largest: f32,
    stiffness: &mut [f32],
) -> usize {
    let terms = ThetaTerms {
        beta,
        stiffness: &[],
        area: 0.0,
        num_steps: 4,
    };
    // Where the surface stands up like a wall, shading is asked without it.
    let mut freed = theta.clone();
    let mut target = [sp.clone(), sq.clone()];
    for k in 0..level.pixels.len {
        let by = MAX_SLOPE / sp[k].hypot(sq[k]);
        if by < 1.0 {
            for (axis, slope) in [by * sp[k], by * sq[k]].into_iter().enumerate() {
                target[axis][k] = slope;
                freed[axis][k] = slope;
            }
        }
    }
    let problem = ThetaProblem {
        pixels: &level.pixels,
        target: &target,
        terms,
        candidates: None,
    };
    theta_step(&problem, &mut freed);
    let [p, q] = &freed;
    // Steep facets may differ by more for the same angle.
    let conflict = |k: usize| {
        let away = (p[k] - sp[k]).powi(2) + (q[k] - sq[k]).powi(2);
        away / (1.0 + sp[k].powi(2) + sq[k].powi(2))
    };
    let pixels = &level.pixels;
    let residual =
        |k: usize, slopes: [f32; 2]| pixels.residuals(k, slopes).map(|r| r * r).sum::<f32>();
    let quantile_of = |share: f64, of: &dyn Fn(usize) -> f32| {
        let every = 1 + pixels.len / 20_000;
        let indices = (0..pixels.len).step_by(every);
        let mut sample: Vec<f64> = indices.map(|k| f64::from(of(k))).collect();
        quantile(&mut sample, share).unwrap_or(0.0) as f32
    };
    let largest = quantile_of(LARGE_CONFLICT, &conflict);
    let angle_limit = (BREAK_CONFLICT * BREAK_CONFLICT).max(share_of_largest * largest);
    let noise_limit = NOISE_LIMIT * quantile_of(0.5, &|k| residual(k, [p[k], q[k]]));
    let mut count = 0;
    for (k, stiffness) in stiffness.iter_mut().enumerate().take(pixels.len) {
        let unexplained = residual(k, [sp[k], sq[k]]) / noise_limit.max(f32::MIN_POSITIVE);
        let excess = (conflict(k) / angle_limit).min(unexplained);
        let factor = 1.0 / (1.0 + excess * excess);
        *stiffness = factor.max(1e-3);
        if factor < 0.25 {
            count += 1;
            (theta[0][k], theta[1][k]) = (p[k], q[k]);
        }
    }
    count
}
