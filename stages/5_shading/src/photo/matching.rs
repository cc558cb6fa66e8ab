//! The photos' agreement: intensities of a surface point in two views.
//!
//! For pixel `x` of view i and a source j that sees its point at `x'(ζ)`, per channel
//! `r = (m I_j(x') − I_i(x)) / (σ ½ (m I_j + I_i))`, `∂r/∂ζ = m ∇I_j · ∂x'/∂ζ / (σ ½ (…))`,
//! with Huber's weight on the channels' RMS. `m` is a smooth field of gains between the two photos
//! (ratio of means over a Gaussian): it takes up what the photos' own gains leave, such as gloss and
//! inter-reflections, and costs next to nothing where brightness is constant.
//! A source counts where its own depth agrees with the point's (no occluder), and where neither
//! pixel is clipped.

use rayon::prelude::*;
use rilievo_numerics::robust::RobustLoss;
use rilievo_scene::Raster;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::sampling;
use rilievo_stereo::sightings::Sighting;
use serde::{Deserialize, Serialize};

/// How the photos are compared.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MatchOptions {
    /// Standard deviation of an intensity difference, relative to the intensity.
    pub sigma: f64,
    /// Residual (in σ) beyond which the penalty grows only linearly.
    pub threshold: f64,
    /// Largest relative depth difference to a source that sees the point.
    pub visible_tolerance: f64,
    /// Standard deviation of the Gaussian of the gain field, pixels; 0 turns it off.
    pub gain_field_px: f64,
    /// A source to leave out (cross-validation).
    pub left_out: Option<usize>,
}

/// Diagonal normal equations of the increment of `ζ`, per masked pixel.
#[derive(Clone, Debug)]
pub(crate) struct MatchTerms {
    pub hessian: Vec<f64>,
    pub rhs: Vec<f64>,
    /// Sources that see the pixel.
    pub num_visible: Vec<u8>,
    /// Sources whose photos are compared with the pixel: those that see it, both unclipped.
    num_compared: Vec<u8>,
    /// RMS of the residual over them and over channels, relative (not divided by σ).
    pub residual: Vec<f32>,
    /// How alike the signed residuals of neighbouring pixels are.
    pub likeness: Likeness,
}

/// Sums over neighbours in a row from which the correlation of a quantity between them follows.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Likeness {
    squares: f64,
    products: f64,
}

impl Likeness {
    pub fn add(&mut self, other: Self) {
        self.squares += other.squares;
        self.products += other.products;
    }

    /// Correlation of a pixel with its neighbour, 0 to 1; none where no two neighbours were seen.
    pub fn correlation(self) -> Option<f64> {
        (self.squares > 0.0).then(|| (self.products / self.squares).clamp(0.0, 1.0))
    }
}

/// Side of the square whose residuals are alike, pixels: `(1 + ρ) / (1 - ρ)` of the correlation `ρ` of neighbours.
pub(crate) fn alike_px(correlation: f64) -> f64 {
    (1.0 + correlation) / (1.0 - correlation).max(f64::EPSILON)
}

impl MatchTerms {
    /// Residuals of some of the pixels that are compared, spread evenly.
    pub fn some_residuals(&self) -> impl Iterator<Item = f64> + '_ {
        self.residual
            .iter()
            .zip(&self.num_compared)
            .step_by(7)
            .filter(|&(_, &n)| n > 0)
            .map(|(&r, _)| f64::from(r))
    }
}

#[derive(Clone, Copy, Default)]
struct Sample {
    /// Whether the source sees the pixel.
    visible: bool,
    /// Whether both photos are unclipped there, so that they are compared.
    compared: bool,
    value: [f32; 3],
    /// `∂I_j/∂ζ`.
    slope: [f32; 3],
}

impl Sample {
    /// Of a source that sees the pixel.
    #[inline]
    fn new(seen: &Sighting, is_usable: bool) -> Self {
        let compared = is_usable && seen.is_unclipped();
        if !compared {
            return Self {
                visible: true,
                ..Self::default()
            };
        }
        let at = seen.at;
        let (value, gx, gy) = sampling::bicubic(&seen.view.image, at.u, at.v);
        Self {
            visible: true,
            compared,
            value,
            slope: [0, 1, 2].map(|c| gx[c] * at.du as f32 + gy[c] * at.dv as f32),
        }
    }
}

/// Residual, in σ, as which larger ones enter the likeness of neighbours.
const LARGEST_LIKENED: f64 = 5.0;

/// Compares view `index` with its sources at the given log depths.
pub(crate) fn terms(
    level: &Level,
    index: usize,
    depth: &[f64],
    rasters: &[Raster<f32>],
    options: &MatchOptions,
) -> MatchTerms {
    let view = &level.views[index];
    let n = view.pixels.len();
    let mut out = MatchTerms {
        hessian: vec![0.0; n],
        rhs: vec![0.0; n],
        num_visible: vec![0; n],
        num_compared: vec![0; n],
        residual: vec![0.0; n],
        likeness: Likeness::default(),
    };
    let here: Vec<[f32; 3]> = (0..n).map(|p| view.intensity(p)).collect();
    let loss = RobustLoss::Huber(options.threshold);
    for (k, (j, _)) in level.sources[index].iter().enumerate() {
        if options.left_out == Some(*j) {
            continue;
        }
        let samples: Vec<Sample> = (0..n)
            .into_par_iter()
            .with_min_len(1024)
            .map(|p| {
                let seen = level.sighting(rasters, index, k, (p, depth[p]));
                let seen = seen.filter(|s| s.is_within(options.visible_tolerance));
                seen.map_or_else(Sample::default, |s| Sample::new(&s, view.is_usable(p)))
            })
            .collect();
        let gains = gain_field(view, &here, &samples, options.gain_field_px);
        // The last pixel that was compared, and its difference.
        let mut last: Option<(usize, f64)> = None;
        for p in 0..n {
            let sample = &samples[p];
            out.num_visible[p] += u8::from(sample.visible);
            if !sample.compared {
                continue;
            }
            let (mut rr, mut jj, mut jr, mut relative, mut signed) = (0.0, 0.0, 0.0, 0.0, 0.0_f64);
            for c in 0..3 {
                let gain = f64::from(gains[p][c]);
                let (a, b) = (f64::from(here[p][c]), gain * f64::from(sample.value[c]));
                let mean = (0.5 * (a + b)).max(f64::from(view.dark));
                let scale = 1.0 / (options.sigma * mean);
                let r = (b - a) * scale;
                let d = gain * f64::from(sample.slope[c]) * scale;
                rr += r * r / 3.0;
                jj += d * d / 3.0;
                jr += d * r / 3.0;
                relative += ((b - a) / mean).powi(2) / 3.0;
                signed += r / 3.0;
            }
            // Single gross errors shall not decide.
            let signed = signed.clamp(-LARGEST_LIKENED, LARGEST_LIKENED);
            if let Some((before, value)) = last
                && view.pixels.ys[before] == view.pixels.ys[p]
                && view.pixels.xs[before] + 1 == view.pixels.xs[p]
            {
                out.likeness.squares += 0.5 * (signed * signed + value * value);
                out.likeness.products += signed * value;
            }
            last = Some((p, signed));
            let weight = loss.weight(rr.sqrt());
            out.hessian[p] += weight * jj;
            out.rhs[p] -= weight * jr;
            out.num_compared[p] += 1;
            out.residual[p] += relative as f32;
        }
    }
    for (residual, &count) in out.residual.iter_mut().zip(&out.num_compared) {
        *residual = (*residual / f32::from(count.max(1))).sqrt();
    }
    out
}

fn gain_field(
    view: &LevelView,
    here: &[[f32; 3]],
    samples: &[Sample],
    sigma_px: f64,
) -> Vec<[f32; 3]> {
    if sigma_px <= 0.0 {
        return vec![[1.0; 3]; here.len()];
    }
    let weights: Vec<f32> = samples
        .iter()
        .map(|s| f32::from(u8::from(s.compared)))
        .collect();
    let both: Vec<[f32; 6]> = here
        .iter()
        .zip(samples)
        .map(|(a, s)| {
            let b = s.value.map(|v| v.max(0.0));
            [a[0], a[1], a[2], b[0], b[1], b[2]]
        })
        .collect();
    sampling::smooth(&view.pixels, &both, &weights, sigma_px)
        .iter()
        .map(|m| [0, 1, 2].map(|c| ((m[c] + view.dark) / (m[c + 3] + view.dark)).clamp(0.5, 2.0)))
        .collect()
}
