//! Cross-validation of shading: does it predict a photo that it has not seen?
//!
//! From one surface, every view takes a few Gauss-Newton steps without one of its source photos,
//! once on agreement alone and once with shading. The photo that was left out judges: with
//! `r = ln I_j(x') − ln I_i(x)`, less its mean over a Gaussian, at either depth,
//!
//! `z(x) = mean(r₀² − r₁²) / (sd(r₀² − r₁²)/√n)`
//!
//! over a wider Gaussian of `n` independent pixels measures how surely shading helps (`z > 0`) or
//! harms there. Trust falls linearly from 1 at `z = −1` to 0 at `z = −3`; a mean over the whole
//! object below −3 ends shading altogether. Where the light misses the photo by several times its
//! usual residual, trust falls as well: there it explains nothing.
//!
//! With two views nothing can be left out; the light's residual alone decides then.

use super::light::Light;
use super::shading;
use super::shading::{ShadingTerm, ShadingWeights};
use super::step::{self, StepOptions};
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_numerics::plate_system::PlateError;
use rilievo_numerics::robust::median;
use rilievo_numerics::solver_set::SolverSet;
use rilievo_scene::team::divided;
use rilievo_scene::{Raster, Team};
use rilievo_stereo::level::Level;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_stereo::{plate, sampling};
use serde::{Deserialize, Serialize};

/// Steps of either kind: most of the way that an outer iteration goes.
const NUM_STEPS: usize = 3;
/// Gaussian of the brightness difference that counts as exposure, pixels.
const GAIN_SIGMA_PX: f64 = 8.0;
/// Gaussian of the judgement, pixels.
const TRUST_SIGMA_PX: f64 = 10.0;
/// Pixels over which residuals are correlated.
const CORRELATED_PIXELS: f64 = 25.0;
/// Largest log ratio that counts, in units of the median one: occluders are no evidence.
const MAX_RATIO: f32 = 4.0;
/// Light residual, in units of the object's usual one, at which trust is one half.
const HALF_RESIDUAL: f32 = 3.0;

/// What was found, over all views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ValidationReport {
    /// Mean squared log ratio to the left-out photos, without and with shading.
    pub squared_residual: [f64; 2],
    /// How surely shading helps, in standard deviations; negative when it harms.
    pub significance: f64,
    /// Pixels that a left-out photo sees.
    pub num_pixels: usize,
}

/// Trust per view and masked pixel, and the facts.
pub(crate) struct Validation {
    pub trust: Vec<Vec<f32>>,
    pub report: ValidationReport,
}

/// Judges shading at the surface `depths`; `None` where no photo can be left out.
///
/// # Errors
/// What `failed` makes of a view whose system could not be solved.
pub(crate) fn validate(
    level: &Level,
    solvers: &SolverSet,
    depths: &[Vec<f64>],
    light: &Light,
    (weights, options): (&ShadingWeights, &StepOptions),
    (team, at_once): (&dyn Team, usize),
    failed: impl Fn(usize, &PlateError) -> ShadingError + Sync,
) -> Result<Option<Validation>, ShadingError> {
    // Without consensus only the depths count, for visibility; how they are read between pixels does not.
    let surfaces = Surfaces::new(level, depths, Reading::Bilinear);
    let rasters = &surfaces.rasters;
    let evidence = divided(team, level.views.len(), at_once, |i| {
        let judged = || -> Result<Evidence, PlateError> {
            // Every source is left out by some view, whatever their order.
            let count = level.sources[i].len();
            if count < 2 {
                return Ok(Evidence::none(level.views[i].pixels.len()));
            }
            let (left_out, _) = level.sources[i][i % count];
            let solver = solvers.of(i, &level.views[i].pixels)?;
            let of_view = light.of(i, light.own(i));
            let solve = |shaded: bool| -> Result<Vec<f64>, PlateError> {
                let mut trial = depths[i].clone();
                let mut options = *options;
                options.matching.left_out = Some(left_out);
                options.sigma_consensus = 0.0;
                for _ in 0..NUM_STEPS {
                    let term = shaded
                        .then(|| ShadingTerm::new(level, i, &trial, rasters, &of_view, weights));
                    let outcome =
                        step::improve(&surfaces, i, &solver, &trial, term.as_ref(), &options)?;
                    trial = outcome.depth;
                }
                Ok(trial)
            };
            let (plain, shaded) = (solve(false)?, solve(true)?);
            let tolerance = options.matching.visible_tolerance;
            Ok(Evidence::compare(
                level,
                i,
                left_out,
                [&plain, &shaded],
                rasters,
                tolerance,
            ))
        };
        judged().map_err(|error| failed(i, &error))
    })?;
    let report = summarise(&evidence);
    if report.num_pixels == 0 {
        return Ok(None);
    }
    let trust = (0..level.views.len())
        .into_par_iter()
        .map(|i| trust(level, i, &depths[i], light, &evidence[i], &report))
        .collect();
    Ok(Some(Validation { trust, report }))
}

/// Squared residuals against the left-out photo, without and with shading.
#[derive(Serialize, Deserialize)]
struct Evidence {
    squares: Vec<[f32; 2]>,
    seen: Vec<f32>,
}

impl Evidence {
    fn none(n: usize) -> Self {
        Self {
            squares: vec![[0.0; 2]; n],
            seen: vec![0.0; n],
        }
    }

    fn compare(
        level: &Level,
        index: usize,
        left_out: usize,
        depths: [&[f64]; 2],
        rasters: &[Raster<f32>],
        tolerance: f64,
    ) -> Self {
        let view = &level.views[index];
        let n = view.pixels.len();
        let mut out = Self::none(n);
        let mut sources = level.sources[index].iter();
        let Some(k) = sources.position(|(j, _)| *j == left_out) else {
            return out;
        };
        let ratios: Vec<Option<[f32; 2]>> = (0..n)
            .into_par_iter()
            .with_min_len(1024)
            .map(|p| {
                let own = view.intensity(p).iter().sum::<f32>();
                if !view.is_usable(p) || own < 1e-4 {
                    return None;
                }
                let mut ratio = [0.0; 2];
                for (r, depth) in ratio.iter_mut().zip(depths) {
                    let seen = level.sighting(rasters, index, k, (p, depth[p]))?;
                    if !seen.is_within(2.0 * tolerance) || !seen.is_unclipped() {
                        return None;
                    }
                    let (value, _, _) = sampling::bicubic(&seen.view.image, seen.at.u, seen.at.v);
                    *r = (value.iter().sum::<f32>().max(1e-4) / own).ln();
                }
                Some(ratio)
            })
            .collect();
        out.seen = ratios
            .iter()
            .map(|r| f32::from(u8::from(r.is_some())))
            .collect();
        let ratios: Vec<[f32; 2]> = ratios.into_iter().map(Option::unwrap_or_default).collect();
        let slow = sampling::smooth(&view.pixels, &ratios, &out.seen, GAIN_SIGMA_PX);
        let mut sizes: Vec<f64> = (0..n)
            .filter(|&p| out.seen[p] > 0.0)
            .map(|p| f64::from((ratios[p][0] - slow[p][0]).abs()))
            .collect();
        let limit = MAX_RATIO * median(&mut sizes).unwrap_or(0.0).max(1e-4) as f32;
        for p in 0..n {
            out.squares[p] =
                [0, 1].map(|k| (ratios[p][k] - slow[p][k]).clamp(-limit, limit).powi(2));
        }
        out
    }
}

fn summarise(evidence: &[Evidence]) -> ValidationReport {
    let (mut sum, mut difference, mut square, mut count) = ([0.0; 2], 0.0, 0.0, 0usize);
    for view in evidence {
        for (s, &seen) in view.squares.iter().zip(&view.seen) {
            if seen > 0.0 {
                let [a, b] = s.map(f64::from);
                sum[0] += a;
                sum[1] += b;
                difference += a - b;
                square += (a - b).powi(2);
                count += 1;
            }
        }
    }
    let n = count.max(1) as f64;
    let mean = difference / n;
    let deviation = (square / n - mean * mean).max(0.0).sqrt();
    ValidationReport {
        squared_residual: sum.map(|s| s / n),
        significance: mean / (deviation / (n / CORRELATED_PIXELS).sqrt()).max(1e-12),
        num_pixels: count,
    }
}

/// Trust from a significance.
fn earned(z: f32) -> f32 {
    ((z + 3.0) / 2.0).clamp(0.0, 1.0)
}

fn trust(
    level: &Level,
    index: usize,
    depth: &[f64],
    light: &Light,
    evidence: &Evidence,
    report: &ValidationReport,
) -> Vec<f32> {
    let view = &level.views[index];
    let n = view.pixels.len();
    let overall = earned(report.significance as f32);
    // Difference, its square, and the light's residual.
    let normals = plate::normals(view, depth);
    let values: Vec<[f32; 2]> = evidence
        .squares
        .iter()
        .map(|s| [s[0] - s[1], (s[0] - s[1]).powi(2)])
        .collect();
    let mean = sampling::smooth(&view.pixels, &values, &evidence.seen, TRUST_SIGMA_PX);
    let cover: Vec<[f32; 1]> = evidence.seen.iter().map(|&s| [s]).collect();
    let cover = sampling::smooth(&view.pixels, &cover, &vec![1.0; n], TRUST_SIGMA_PX);
    let usable: Vec<f32> = (0..n)
        .map(|p| f32::from(u8::from(view.is_usable(p))))
        .collect();
    let missed: Vec<[f32; 1]> = (0..n)
        .map(|p| {
            let s = shading::render(&light.harmonics[index][p], normals[p]);
            let own = view.intensity(p);
            let known = light.pigment_of(index).map_or([1.0; 3], |a| a[p]);
            let sum: f64 = (0..3)
                .map(|c| {
                    let target = f64::from(own[c] / known[c]);
                    ((s[c] - target) / target.max(1e-4))
                        .clamp(-1.0, 1.0)
                        .powi(2)
                })
                .sum();
            [(sum / 3.0) as f32]
        })
        .collect();
    let missed = sampling::smooth(&view.pixels, &missed, &usable, TRUST_SIGMA_PX);
    let mut usual: Vec<f64> = missed.iter().map(|m| f64::from(m[0])).collect();
    let usual = median(&mut usual).unwrap_or(1.0).max(1e-8) as f32;
    let independent =
        (4.0 * std::f64::consts::PI * TRUST_SIGMA_PX * TRUST_SIGMA_PX / CORRELATED_PIXELS) as f32;
    (0..n)
        .map(|p| {
            let variance = (mean[p][1] - mean[p][0].powi(2)).max(0.0);
            let z = mean[p][0]
                / (variance / (independent * cover[p][0]).max(1.0))
                    .sqrt()
                    .max(1e-12);
            // Where the left-out photo sees little, the others' verdict holds.
            let local = if cover[p][0] > 0.2 { earned(z) } else { 1.0 };
            let ratio = missed[p][0] / (usual * HALF_RESIDUAL * HALF_RESIDUAL);
            overall * local / (1.0 + ratio * ratio)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trust_is_lost_by_significant_harm_only() {
        assert_eq!(
            [2.0, 0.0, -1.0, -2.0, -3.0, -9.0].map(earned),
            [1.0, 1.0, 1.0, 0.5, 0.0, 0.0]
        );
        let evidence = |worse: f32| {
            let squares = (0..5000)
                .map(|i| {
                    let base = 1e-4 * (1.0 + (i % 17) as f32);
                    [base, base * worse]
                })
                .collect();
            vec![Evidence {
                squares,
                seen: vec![1.0; 5000],
            }]
        };
        let helps = summarise(&evidence(0.9));
        let harms = summarise(&evidence(1.2));
        assert!(helps.significance > 5.0, "{helps:?}");
        assert!(harms.significance < -5.0, "{harms:?}");
    }
}
