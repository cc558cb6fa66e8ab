//! Normal equations of one source with offset and gain eliminated.
//!
//! With `y = (1, T, R, J, J d_x, J d_y)` per sample, `R = I_s − T` and `J = ∂I_s/∂q`, one pass sums all
//! weighted products of `y`. Offset, then gain with its prior, are removed by Schur complements:
//! `⟨a, b⟩ → ⟨a, b⟩ − ⟨a, 1⟩⟨1, b⟩/⟨1, 1⟩`, then `⟨a, b⟩ − ⟨a, T⟩⟨T, b⟩/(⟨T, T⟩ + λ)`. That is Gauss-Newton on
//! the variable projection.
//!
//! Weights are the window's times 1/(1 + (e/c)²), `c` a multiple of the source's RMS of the iteration
//! before: speckle of the sensor and an edge that comes into view lose their pull, the bulk of a
//! patch keeps it. Sums run over eight lanes (they vectorise) in f32 around the patch's own mean;
//! elimination in f64.

use super::sampling::{LANES, Workspace};
use nalgebra::{Matrix3, Vector3};

/// Weighted sums of products of `1, T, R, J, J dx, J dy`.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    one: f64,
    t: f64,
    r: f64,
    j: [f64; 3],
    tt: f64,
    tr: f64,
    rr: f64,
    tj: [f64; 3],
    rj: [f64; 3],
    jj: [f64; 6],
}

/// Accumulates the sums of one source; `inv_c2` is 1/c² of the weights, 0 for none.
pub(super) fn accumulate(ws: &Workspace, source: usize, inv_c2: f32) -> Sums {
    let padded = ws.len.next_multiple_of(LANES);
    let (offset, gain) = ws.brightness[source];
    let (offset, gain) = (offset as f32, gain as f32);
    let mut acc = [[0.0_f32; LANES]; 21];
    let lanes = |buffer: &[f32], at: usize| -> [f32; LANES] {
        let mut out = [0.0; LANES];
        out.copy_from_slice(&buffer[at..at + LANES]);
        out
    };
    for at in (0..padded).step_by(LANES) {
        let dx = lanes(&ws.dx, at);
        let dy = lanes(&ws.dy, at);
        let t = lanes(&ws.template, at);
        let r = lanes(&ws.residual[source], at);
        let j = lanes(&ws.slope, at);
        let w = lanes(&ws.weight, at);
        for l in 0..LANES {
            let e = r[l] - offset - gain * t[l];
            let w = w[l] / (1.0 + e * e * inv_c2);
            let (j1, j2) = (j[l] * dx[l], j[l] * dy[l]);
            let (wt, wr, wj, wj1, wj2) = (w * t[l], w * r[l], w * j[l], w * j1, w * j2);
            acc[0][l] += w;
            acc[1][l] += wt;
            acc[2][l] += wr;
            acc[3][l] += wj;
            acc[4][l] += wj1;
            acc[5][l] += wj2;
            acc[6][l] += wt * t[l];
            acc[7][l] += wt * r[l];
            acc[8][l] += wr * r[l];
            acc[9][l] += wt * j[l];
            acc[10][l] += wt * j1;
            acc[11][l] += wt * j2;
            acc[12][l] += wr * j[l];
            acc[13][l] += wr * j1;
            acc[14][l] += wr * j2;
            acc[15][l] += wj * j[l];
            acc[16][l] += wj * j1;
            acc[17][l] += wj * j2;
            acc[18][l] += wj1 * j1;
            acc[19][l] += wj1 * j2;
            acc[20][l] += wj2 * j2;
        }
    }
    let s = acc.map(|lanes| lanes.iter().map(|&v| f64::from(v)).sum::<f64>());
    Sums {
        one: s[0],
        t: s[1],
        r: s[2],
        j: [s[3], s[4], s[5]],
        tt: s[6],
        tr: s[7],
        rr: s[8],
        tj: [s[9], s[10], s[11]],
        rj: [s[12], s[13], s[14]],
        jj: [s[15], s[16], s[17], s[18], s[19], s[20]],
    }
}

/// A source's share of the normal equations after offset and gain are eliminated.
#[derive(Clone, Copy, Default)]
pub(super) struct Reduced {
    /// Of the unknowns `q, q_x, q_y`, half the second derivative of the squares.
    pub hessian: Matrix3<f64>,
    /// Half the derivative of the squares.
    pub gradient: Vector3<f64>,
    /// Weighted squares of the residuals.
    pub squares: f64,
    /// Sum of the weights.
    pub weight: f64,
    /// Zero-mean correlation of template and source.
    pub correlation: f64,
    pub offset: f64,
    /// Gain of the source above 1.
    pub gain: f64,
}

impl Sums {
    /// Adds a prior on the offset as a sample of weight `precision` (in units of squared residuals)
    /// that sees the offset alone, at `expected`.
    pub fn expect_offset(&mut self, expected: f64, precision: f64) {
        self.one += precision;
        self.r += precision * expected;
        self.rr += precision * expected * expected;
    }

    /// Eliminates the offset, then the gain with its prior `gain_precision` (in units of squared
    /// residuals). `None` for a template or image without contrast.
    pub fn eliminate(&self, gain_precision: f64) -> Option<Reduced> {
        if self.one <= 0.0 {
            return None;
        }
        let inv = 1.0 / self.one;
        let tt = self.tt - self.t * self.t * inv;
        let tr = self.tr - self.t * self.r * inv;
        let rr = self.rr - self.r * self.r * inv;
        let j = self.j;
        let tj: [f64; 3] = std::array::from_fn(|k| self.tj[k] - self.t * j[k] * inv);
        let rj: [f64; 3] = std::array::from_fn(|k| self.rj[k] - self.r * j[k] * inv);
        // Source image I = T + R up to its offset.
        let variance_source = tt + 2.0 * tr + rr;
        let product = tt * variance_source;
        if product.is_nan() || product <= 0.0 {
            return None;
        }
        let correlation = (tt + tr) / product.sqrt();
        let denominator = tt + gain_precision;
        let gain = tr / denominator;
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        let mut hessian = Matrix3::zeros();
        for (k, &(a, b)) in pairs.iter().enumerate() {
            let value = self.jj[k] - j[a] * j[b] * inv - tj[a] * tj[b] / denominator;
            hessian[(a, b)] = value;
            hessian[(b, a)] = value;
        }
        Some(Reduced {
            hessian,
            gradient: Vector3::from_fn(|k, _| rj[k] - tj[k] * gain),
            squares: (rr - tr * gain).max(0.0),
            weight: self.one,
            correlation,
            offset: (self.r - gain * self.t) * inv,
            gain,
        })
    }
}
