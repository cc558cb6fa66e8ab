//! Exposure of each photo, and how far photos disagree where they see the same point.
//!
//! At pixels whose depth two views agree on, `ln I_j(x') − ln I_i(x) = g_j − g_i + noise` per channel.
//! The medians of all pairs determine the log gains `g` (least squares, weights from the pairs'
//! spread, largest gain 1); the median absolute deviation that is left is the photos' disagreement,
//! from which every photometric weight follows.

use crate::level::Level;
use crate::sampling;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};

/// Exposure gains and the disagreement that they leave.
#[derive(Clone, Debug)]
pub struct Exposure {
    /// Gain of every photo and channel; dividing by it makes brightness constant.
    pub gains: Vec<[f64; 3]>,
    /// Standard deviation of the log ratio between views at the same point, after the gains.
    pub disagreement: f64,
    /// The same per view: median over its pairs.
    pub per_view: Vec<f64>,
}

/// Fewest common points of a pair.
const MIN_POINTS: usize = 100;

struct Pair {
    from: usize,
    to: usize,
    log_ratio: [f64; 3],
    spread: f64,
    count: usize,
}

/// Compares all pairs of views at the points on which they agree.
pub fn estimate(level: &Level, depths: &[Vec<f64>], agreement: &[Vec<u8>]) -> Exposure {
    let num_views = level.views.len();
    let pairs: Vec<Pair> = (0..num_views)
        .into_par_iter()
        .flat_map_iter(|i| {
            (0..level.sources[i].len())
                .filter_map(move |k| compare(level, depths, &agreement[i], i, k))
        })
        .collect();
    let mut gains = vec![[1.0; 3]; num_views];
    for channel in 0..3 {
        let ratios = pairs.iter().map(|pair| LogRatio {
            from: pair.from,
            to: pair.to,
            ratio: pair.log_ratio[channel],
            weight: pair.count as f64 / pair.spread.max(0.005).powi(2),
        });
        for (gain, log) in gains.iter_mut().zip(joined(num_views, ratios)) {
            gain[channel] = log.exp();
        }
    }
    // One factor for all photos is free: the brightest keeps its intensities.
    let largest = gains.iter().flatten().copied().fold(0.0, f64::max);
    for gain in gains.iter_mut().flatten() {
        *gain /= largest.max(1e-9);
    }
    let mut spreads: Vec<f64> = pairs.iter().map(|p| p.spread).collect();
    let disagreement = median(&mut spreads).unwrap_or(0.05);
    let per_view = (0..num_views)
        .map(|i| {
            let mut own: Vec<f64> = pairs
                .iter()
                .filter(|p| p.from == i || p.to == i)
                .map(|p| p.spread)
                .collect();
            median(&mut own).unwrap_or(disagreement)
        })
        .collect();
    Exposure {
        gains,
        disagreement,
        per_view,
    }
}

/// Logarithm of what view `to` shows over what view `from` shows of the same points.
pub(crate) struct LogRatio {
    pub from: usize,
    pub to: usize,
    pub ratio: f64,
    pub weight: f64,
}

/// Logarithms of the views' values from the ratios of pairs, by least squares; one constant over all views is free, and
/// near zero.
pub(crate) fn joined(num_views: usize, ratios: impl Iterator<Item = LogRatio>) -> Vec<f64> {
    let mut normal = DMatrix::<f64>::identity(num_views, num_views) * 1e-6;
    let mut rhs = DVector::<f64>::zeros(num_views);
    for pair in ratios {
        let LogRatio {
            from,
            to,
            ratio,
            weight,
        } = pair;
        normal[(to, to)] += weight;
        normal[(from, from)] += weight;
        normal[(to, from)] -= weight;
        normal[(from, to)] -= weight;
        rhs[to] += weight * ratio;
        rhs[from] -= weight * ratio;
    }
    normal.cholesky().map_or_else(
        || vec![0.0; num_views],
        |factor| factor.solve(&rhs).iter().copied().collect(),
    )
}

fn compare(
    level: &Level,
    depths: &[Vec<f64>],
    agreement: &[u8],
    i: usize,
    k: usize,
) -> Option<Pair> {
    let j = level.sources[i][k].0;
    let (view, other) = (&level.views[i], &level.views[j]);
    let mut ratios: [Vec<f64>; 3] = Default::default();
    let mut grey = Vec::new();
    for (p, &depth) in depths[i].iter().enumerate() {
        if agreement[p] & (1 << k) == 0 || !view.is_usable(p) {
            continue;
        }
        let landing = level.landing(i, k, p, depth).filter(|at| {
            sampling::inside(&other.mask, at.u, at.v) && other.is_unclipped_at(at.u, at.v)
        });
        let Some(landing) = landing else { continue };
        let here = view.intensity(p);
        let (there, _, _) = sampling::bicubic(&other.image, landing.u, landing.v);
        for c in 0..3 {
            ratios[c].push((f64::from(there[c]).max(1e-4) / f64::from(here[c]).max(1e-4)).ln());
        }
        let (a, b) = (here.iter().sum::<f32>(), there.iter().sum::<f32>());
        grey.push((f64::from(b).max(1e-4) / f64::from(a).max(1e-4)).ln());
    }
    if grey.len() < MIN_POINTS {
        return None;
    }
    let centre = median(&mut grey)?;
    let mut deviations: Vec<f64> = grey.iter().map(|g| (g - centre).abs()).collect();
    let spread = SIGMA_FROM_MAD * median(&mut deviations)?;
    let mut log_ratio = [0.0; 3];
    for c in 0..3 {
        log_ratio[c] = median(&mut ratios[c])?;
    }
    Some(Pair {
        from: i,
        to: j,
        log_ratio,
        spread,
        count: grey.len(),
    })
}
