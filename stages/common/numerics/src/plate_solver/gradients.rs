//! Conjugate gradients, preconditioned by symmetric Gauss-Seidel.
//!
//! Scaled to a unit diagonal, `H = L + I + Lᵀ`, the preconditioner is `M = (I + L)(I + Lᵀ)`: positive definite with
//! `H`, no parameter. Where every pixel's value is measured a plate couples over a few pixels only, so that the number
//! of iterations does not grow with the image.
//!
//! With `t = (I + Lᵀ)⁻¹ p` the preconditioned product is `(I + L)⁻¹ H t = t + (I + L)⁻¹ (p − t)`: two triangular
//! solves an iteration, and no product with `H`. Source: Eisenstat, "Efficient implementation of a class of
//! preconditioned conjugate gradient methods", SIAM J. Sci. Stat. Comput. 2 (1981), section 2.
//!
//! Pixels lie on a raster with a margin, so that neighbours are at fixed distances, and each row is worked on from its
//! first pixel to its last. Holes in between have no coupling and stay zero.

use crate::plate_system::{OFFSETS, PixelNumbering, PlateError, PlateSystem};
use std::ops::Range;

/// Norm of the residual, in that of the preconditioner and relative to the right-hand side's, that
/// ends the iteration.
const TOLERANCE: f64 = 1e-2;
/// Iterations at most: regions without any measured value are left unfinished then.
const MAX_NUM_ITERATIONS: usize = 200;
/// Rows and columns around the raster: as far as the stencil reaches.
const MARGIN: usize = 2;

/// Where the pixels lie on the raster.
#[derive(Debug)]
pub(super) struct ConjugateGradients {
    /// Place of each pixel.
    places: Vec<u32>,
    /// Places from each row's first pixel to its last, rows without any left out.
    rows: Vec<Range<usize>>,
    /// Columns of the raster with a margin; the right one is the left one of the next row.
    stride: usize,
    /// Places in all.
    len: usize,
}

/// Coefficients at `OFFSETS[1..]` of the scaled matrix, each at the place of the earlier pixel.
type Couplings = [Vec<f64>; 6];

impl ConjugateGradients {
    pub(super) fn new(numbering: &PixelNumbering) -> Self {
        let stride = numbering.width + MARGIN;
        let place = |x: u32, y: u32| (y as usize + MARGIN) * stride + x as usize + MARGIN;
        let pixels = numbering.xs.iter().zip(&numbering.ys);
        let places: Vec<u32> = pixels.map(|(&x, &y)| place(x, y) as u32).collect();
        let mut rows: Vec<Range<usize>> = Vec::new();
        let mut last_row = None;
        for (&at, &y) in places.iter().zip(&numbering.ys) {
            let at = at as usize;
            match rows.last_mut().filter(|_| last_row == Some(y)) {
                Some(row) => row.end = at + 1,
                None => rows.push(at..at + 1),
            }
            last_row = Some(y);
        }
        Self {
            places,
            rows,
            stride,
            len: (numbering.height + 2 * MARGIN) * stride + MARGIN,
        }
    }

    /// Distance of a pixel from its neighbour `OFFSETS[1 + k]`.
    fn distance(&self, k: usize) -> usize {
        let (dx, dy) = OFFSETS[1 + k];
        (dx as isize + dy as isize * self.stride as isize) as usize
    }

    /// Values of the pixels put on the raster.
    fn spread(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut raster = vec![0.0; self.len];
        for (&place, value) in self.places.iter().zip(values) {
            raster[place as usize] = value;
        }
        raster
    }

    /// Solves `H x = b` from zero.
    pub(super) fn solve(&self, system: &PlateSystem) -> Result<Vec<f64>, PlateError> {
        let indefinite = PlateError::NotPositiveDefinite {
            num_unknowns: system.rhs.len(),
        };
        let rows = &system.coefficients;
        if !rows.iter().all(|row| row[0] > 0.0) {
            return Err(indefinite);
        }
        let scale = self.spread(rows.iter().map(|row| row[0].sqrt().recip()));
        let couplings: Couplings = std::array::from_fn(|k| {
            let to = self.distance(k);
            let mut couplings = self.spread(rows.iter().map(|row| row[1 + k]));
            // A neighbour that does not exist has no scale.
            for row in &self.rows {
                for i in row.clone() {
                    couplings[i] *= scale[i] * scale[i + to];
                }
            }
            couplings
        });
        let mut rhs = self.spread(system.rhs.iter().copied());
        rhs.iter_mut().zip(&scale).for_each(|(b, s)| *b *= s);
        let Some(x) = self.iterate(&couplings, &rhs) else {
            return Err(indefinite);
        };
        let at = |&place: &u32| x[place as usize] * scale[place as usize];
        let x: Vec<f64> = self.places.iter().map(at).collect();
        if x.iter().all(|v| v.is_finite()) {
            Ok(x)
        } else {
            Err(indefinite)
        }
    }

    /// The solution of the scaled system; `None` where it is not positive definite.
    fn iterate(&self, couplings: &Couplings, rhs: &[f64]) -> Option<Vec<f64>> {
        let zeros = || vec![0.0; self.len];
        let (mut x, mut t, mut direction) = (zeros(), zeros(), zeros());
        // (I + L)⁻¹ of the residual, and of p − t.
        let (mut residual, mut y) = (zeros(), zeros());
        let mut part = vec![0.0; self.stride];
        for row in &self.rows {
            part[..row.len()].copy_from_slice(&rhs[row.clone()]);
            self.forward(couplings, row, &mut part, &mut residual);
        }
        let mut norm2: f64 = residual.iter().map(|r| r * r).sum();
        let target = norm2 * TOLERANCE * TOLERANCE;
        let mut turn = 0.0;
        for _ in 0..MAX_NUM_ITERATIONS {
            if norm2 <= target {
                break;
            }
            for row in self.rows.iter().rev() {
                let from = &residual[row.clone()];
                for (p, r) in direction[row.clone()].iter_mut().zip(from) {
                    *p = r + turn * *p;
                }
                part[..row.len()].copy_from_slice(&direction[row.clone()]);
                self.backward(couplings, row, &mut part, &mut t);
            }
            let mut curvature = 0.0;
            for row in &self.rows {
                let (p, t) = (&direction[row.clone()], &t[row.clone()]);
                for (part, (p, t)) in part.iter_mut().zip(p.iter().zip(t)) {
                    *part = p - t;
                }
                self.forward(couplings, row, &mut part, &mut y);
                let product = t.iter().zip(&y[row.clone()]);
                let of_row = p.iter().zip(product).map(|(p, (t, y))| p * (t + y));
                curvature += of_row.sum::<f64>();
            }
            if curvature.is_nan() || curvature <= 0.0 {
                return None;
            }
            let step = norm2 / curvature;
            let mut next = 0.0;
            for row in &self.rows {
                let (x, r) = (&mut x[row.clone()], &mut residual[row.clone()]);
                let (t, y) = (&t[row.clone()], &y[row.clone()]);
                for i in 0..row.len() {
                    x[i] += step * t[i];
                    r[i] -= step * (t[i] + y[i]);
                    next += r[i] * r[i];
                }
            }
            turn = next / norm2;
            norm2 = next;
        }
        Some(x)
    }

    /// A row of `y` in `(I + L) y = g`, where `part` holds `g` of it and the rows above are solved.
    #[inline]
    fn forward(&self, couplings: &Couplings, row: &Range<usize>, part: &mut [f64], y: &mut [f64]) {
        let (above, here) = y.split_at_mut(row.start);
        let part = &mut part[..row.len()];
        for (k, couplings) in couplings.iter().enumerate().skip(2) {
            let from = row.start - self.distance(k)..row.end - self.distance(k);
            let terms = couplings[from.clone()].iter().zip(&above[from]);
            for (part, (c, y)) in part.iter_mut().zip(terms) {
                *part -= c * y;
            }
        }
        let [first, second, ..] = couplings;
        let first = &first[row.start - 1..row.end - 1];
        let second = &second[row.start - 2..row.end - 2];
        let (mut last, mut before) = (0.0, 0.0);
        for (((value, part), c1), c2) in here.iter_mut().zip(part).zip(first).zip(second) {
            let new = (*part - c2 * before) - c1 * last;
            (before, last) = (last, new);
            *value = new;
        }
    }

    /// A row of `t` in `(I + Lᵀ) t = g`, where `part` holds `g` of it and the rows below are solved.
    #[inline]
    fn backward(&self, couplings: &Couplings, row: &Range<usize>, part: &mut [f64], t: &mut [f64]) {
        let (here, below) = t.split_at_mut(row.end);
        let part = &mut part[..row.len()];
        for (k, couplings) in couplings.iter().enumerate().skip(2) {
            let to = row.start + self.distance(k) - row.end..;
            let terms = couplings[row.clone()].iter().zip(&below[to]);
            for (part, (c, t)) in part.iter_mut().zip(terms) {
                *part -= c * t;
            }
        }
        let [first, second, ..] = couplings;
        let (first, second) = (&first[row.clone()], &second[row.clone()]);
        let (mut last, mut before) = (0.0, 0.0);
        let values = here[row.clone()].iter_mut().zip(part);
        for (((value, part), c1), c2) in values.zip(first).zip(second).rev() {
            let new = (*part - c2 * before) - c1 * last;
            (before, last) = (last, new);
            *value = new;
        }
    }
}
