//! Seeds: search along the epipolar lines, all sources at once.
//!
//! At the centre of every few cells, inverse depth is stepped through the hull's range by one
//! pixel of the reduced image, and a patch of constant inverse depth is compared with all
//! sources by zero-mean correlation `ρ_s(q)`; the score is their mean. Comparing with several views
//! at once makes a false maximum in one of them harmless, which pairwise keypoint matching cannot.
//!
//! Images are normalised first: `D = (I − mean) / (deviation + floor)` in a window of about 16 px of
//! standard deviation. On a plain object the shading's slow change correlates at any depth; what
//! remains after normalisation is the weak texture.
//!
//! A maximum becomes a seed when its score is high and the best score two or more steps away leaves
//! clearly more unexplained, `(1 − ρ₁)/(1 − ρ₂) ≤ 0.8`.

use super::filter::box_sum;
use super::grid::Grid;
use super::pair::{MAX_SOURCES, PairGeometry};
use super::sampling::LANES;
use super::working::WorkingView;
use rilievo_scene::Raster;

/// Radius of the disc compared, reduced pixels.
const RADIUS: i32 = 5;
/// Half-width of the normalising window, reduced pixels.
const WINDOW: usize = 13;
/// Floor of the deviation in units of the object's median: keeps noise from being blown up.
const DEVIATION_FLOOR: f32 = 0.5;
/// Smallest share of a disc on the object.
const MIN_SHARE: f32 = 0.7;
/// Smallest mean correlation of a seed.
const MIN_SCORE: f64 = 0.5;
/// Largest ratio of what the best and the second-best depth leave unexplained; that of keypoint
/// matching.
const MAX_RATIO: f64 = 0.8;

/// Half-size normalised image with a flag that a pixel is on the object.
#[derive(Clone, Debug, Default)]
pub(super) struct DetailImage {
    /// Working pixels per pixel of this image.
    pub reduction: usize,
    pub width: usize,
    pub height: usize,
    /// Normalised value and flag (1 on the object).
    pub data: Vec<[f32; 2]>,
}

impl DetailImage {
    /// The detail of a working view.
    pub fn new(view: &WorkingView, reduction: usize) -> Self {
        let (width, height) = (
            view.camera.width / reduction,
            view.camera.height / reduction,
        );
        let scale = 1.0 / (reduction * reduction) as f32;
        let at = |x: usize, y: usize, c: usize| {
            let mut sum = 0.0;
            for v in 0..reduction {
                for u in 0..reduction {
                    sum += view.texel(reduction * x + u, reduction * y + v)[c];
                }
            }
            sum * scale
        };
        let flag = Raster::from_fn(width, height, |x, y| {
            if at(x, y, 3) >= 0.999 { 1.0_f32 } else { 0.0 }
        });
        let masked = Raster::from_fn(width, height, |x, y| at(x, y, 0) * flag.at(x, y));
        let weights = box_sum(&flag, WINDOW);
        let means = box_sum(&masked, WINDOW);
        let deviation = Raster::from_fn(width, height, |x, y| {
            (masked.at(x, y) - means.at(x, y) / weights.at(x, y).max(1.0)) * flag.at(x, y)
        });
        let squares = Raster {
            width,
            height,
            data: deviation.data.iter().map(|d| d * d).collect(),
        };
        let variances = box_sum(&squares, WINDOW);
        let sigma: Vec<f32> = variances
            .data
            .iter()
            .zip(&weights.data)
            .map(|(&v, &w)| (v.max(0.0) / w.max(1.0)).sqrt())
            .collect();
        let mut inside: Vec<f64> = sigma
            .iter()
            .zip(&flag.data)
            .filter(|&(_, &f)| f > 0.5)
            .map(|(&s, _)| f64::from(s))
            .collect();
        let median = rilievo_numerics::robust::median(&mut inside).unwrap_or(0.0) as f32;
        let floor = (DEVIATION_FLOOR * median).max(1e-6);
        let data = deviation
            .data
            .iter()
            .zip(&sigma)
            .zip(&flag.data)
            .map(|((&d, &s), &f)| [d / (s + floor), f])
            .collect();
        Self {
            reduction,
            width,
            height,
            data,
        }
    }
}

/// Eight samples of a template: offsets (working pixels), values without their mean, and 1 for each
/// that counts, 0 for padding.
#[derive(Clone, Copy, Debug, Default)]
struct Samples {
    dx: [f32; LANES],
    dy: [f32; LANES],
    value: [f32; LANES],
    used: [f32; LANES],
}

#[derive(Clone, Debug, Default)]
pub(super) struct SweepScratch {
    offsets: Vec<(i32, i32)>,
    template: Vec<Samples>,
    num_samples: usize,
    scores: Vec<f32>,
}

/// Inverse depth at a pixel by epipolar search; `None` where nothing stands out.
pub(super) fn search(
    details: &[DetailImage],
    reference: usize,
    sources: &[&PairGeometry],
    (x, y): (usize, usize),
    range: (f64, f64),
    scratch: &mut SweepScratch,
) -> Option<f64> {
    if sources.is_empty() {
        return None;
    }
    let detail = &details[reference];
    let reduction = detail.reduction;
    load_template(detail, x / reduction, y / reduction, scratch)?;
    let q_mid = 0.5 * (range.0 + range.1);
    // Reduced pixels of disparity per inverse depth, in the most sensitive source.
    let px_per_q = sources
        .iter()
        .map(|pair| pair.px_per_inverse_depth(x as f64, y as f64, q_mid) / reduction as f64)
        .fold(0.0, f64::max);
    let num_steps = ((range.1 - range.0) * px_per_q).ceil().clamp(2.0, 600.0) as usize;
    let step = (range.1 - range.0) / num_steps as f64;
    scratch.scores.clear();
    for k in 0..=num_steps {
        let q = range.0 + k as f64 * step;
        let (mut sum, mut count) = (0.0, 0);
        for pair in sources.iter().take(MAX_SOURCES) {
            let score = correlation(&details[pair.source], pair, (x, y), q, scratch);
            if let Some(score) = score {
                sum += score;
                count += 1;
            }
        }
        let needed = sources.len().min(2);
        scratch.scores.push(if count >= needed {
            sum / count as f32
        } else {
            -1.0
        });
    }
    let scores = &scratch.scores;
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    let rival = (0..scores.len())
        .filter(|&k| k.abs_diff(best) > 2)
        .map(|k| scores[k])
        .fold(-1.0_f32, f32::max);
    let (first, second) = (f64::from(scores[best]), f64::from(rival));
    if first < MIN_SCORE || (1.0 - first) > MAX_RATIO * (1.0 - second) {
        return None;
    }
    // Vertex of the parabola through the maximum and its neighbours.
    let mut offset = 0.0;
    if best > 0 && best + 1 < scores.len() {
        let (a, b, c) = (
            f64::from(scores[best - 1]),
            first,
            f64::from(scores[best + 1]),
        );
        let curvature = a - 2.0 * b + c;
        if curvature < 0.0 {
            offset = (0.5 * (a - c) / curvature).clamp(-0.5, 0.5);
        }
    }
    Some(range.0 + (best as f64 + offset) * step)
}

/// Offsets and values of the usable samples around a reduced pixel.
fn load_template(
    detail: &DetailImage,
    x: usize,
    y: usize,
    scratch: &mut SweepScratch,
) -> Option<()> {
    if scratch.offsets.is_empty() {
        for dy in -RADIUS..=RADIUS {
            for dx in -RADIUS..=RADIUS {
                if dx * dx + dy * dy <= RADIUS * RADIUS + 1 && (dx + dy) % 2 == 0 {
                    scratch.offsets.push((dx, dy));
                }
            }
        }
    }
    scratch.template.clear();
    let scale = detail.reduction as f32;
    let (mut sum, mut n) = (0.0, 0);
    for &(dx, dy) in &scratch.offsets {
        let (px, py) = (x as i32 + dx, y as i32 + dy);
        if px < 0 || py < 0 || px >= detail.width as i32 || py >= detail.height as i32 {
            continue;
        }
        let [value, flag] = detail.data[py as usize * detail.width + px as usize];
        if flag < 0.5 {
            continue;
        }
        let lane = n % LANES;
        if lane == 0 {
            scratch.template.push(Samples::default());
        }
        if let Some(samples) = scratch.template.last_mut() {
            samples.dx[lane] = scale * dx as f32;
            samples.dy[lane] = scale * dy as f32;
            samples.value[lane] = value;
            samples.used[lane] = 1.0;
        }
        sum += value;
        n += 1;
    }
    if (n as f32) < MIN_SHARE * scratch.offsets.len() as f32 {
        return None;
    }
    scratch.num_samples = n;
    let mean = sum / n as f32;
    for samples in &mut scratch.template {
        for l in 0..LANES {
            samples.value[l] = samples.used[l] * (samples.value[l] - mean);
        }
    }
    Some(())
}

/// Zero-mean correlation of the template with its image in a source at one inverse depth.
fn correlation(
    detail: &DetailImage,
    pair: &PairGeometry,
    (x, y): (usize, usize),
    q: f64,
    scratch: &SweepScratch,
) -> Option<f32> {
    let h0 = pair.warp.at(x as f64, y as f64, q);
    if h0.z.is_nan() || h0.z <= 0.0 || detail.width < 2 || detail.height < 2 {
        return None;
    }
    let (u0, v0) = (h0.x / h0.z, h0.y / h0.z);
    let shrink = 1.0 / detail.reduction as f64;
    // Affine part of the warp: enough for a search.
    let by = |column: usize| {
        let h = pair.warp.a.column(column);
        (
            (shrink * (h.x - u0 * h.z) / h0.z) as f32,
            (shrink * (h.y - v0 * h.z) / h0.z) as f32,
        )
    };
    let ((ux, vx), (uy, vy)) = (by(0), by(1));
    // A reduced pixel's centre lies in the middle of its block.
    let middle = 0.5 * (1.0 - shrink);
    let (uh, vh) = ((shrink * u0 - middle) as f32, (shrink * v0 - middle) as f32);
    let (max_x, max_y) = (detail.width as f32 - 1.001, detail.height as f32 - 1.001);
    // Σ w, w i, w i², w i t, w t, w t² in lanes, so that positions and sums vectorise.
    let mut sums = [[0.0_f32; LANES]; 6];
    for samples in &scratch.template {
        let (mut u, mut v, mut weight) = ([0.0_f32; LANES], [0.0_f32; LANES], samples.used);
        for l in 0..LANES {
            u[l] = uh + ux * samples.dx[l] + uy * samples.dy[l];
            v[l] = vh + vx * samples.dx[l] + vy * samples.dy[l];
            let (inside_u, inside_v) = (u[l].clamp(0.0, max_x), v[l].clamp(0.0, max_y));
            weight[l] = if inside_u == u[l] && inside_v == v[l] {
                weight[l]
            } else {
                0.0
            };
            (u[l], v[l]) = (inside_u, inside_v);
        }
        let (mut value, mut flag) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for l in 0..LANES {
            let (ix, iy) = (u[l] as i32, v[l] as i32);
            let (tx, ty) = (u[l] - ix as f32, v[l] - iy as f32);
            let at = iy as usize * detail.width + ix as usize;
            let rows = &detail.data[at..at + detail.width + 2];
            let mix = |c: usize| {
                let a = rows[0][c] + (rows[1][c] - rows[0][c]) * tx;
                let (left, right) = (rows[detail.width][c], rows[detail.width + 1][c]);
                let b = left + (right - left) * tx;
                a + (b - a) * ty
            };
            value[l] = mix(0);
            flag[l] = mix(1);
        }
        for l in 0..LANES {
            let w = if flag[l] >= 0.999 { weight[l] } else { 0.0 };
            let (i, t) = (value[l], samples.value[l]);
            sums[0][l] += w;
            sums[1][l] += w * i;
            sums[2][l] += w * i * i;
            sums[3][l] += w * i * t;
            sums[4][l] += w * t;
            sums[5][l] += w * t * t;
        }
    }
    let [n, si, sii, sit, st, stt] = sums.map(|lanes| lanes.iter().sum::<f32>());
    if n < MIN_SHARE * scratch.num_samples as f32 {
        return None;
    }
    let covariance = sit - si * st / n;
    let product = (sii - si * si / n) * (stt - st * st / n);
    (product > 1e-12).then(|| covariance / product.sqrt())
}

/// Cells at which seeds are searched: every `stride`-th column and row.
pub(super) fn search_cells(grid: &Grid, stride: usize) -> impl Iterator<Item = usize> {
    let columns = grid.columns;
    (0..grid.len()).filter(move |cell| {
        (cell % columns).is_multiple_of(stride) && (cell / columns).is_multiple_of(stride)
    })
}
