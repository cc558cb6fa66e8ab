//! Symmetric positive definite systems on a masked grid with the thirteen-point stencil of a thin
//! plate, `H x = b`; [`crate::plate_solver`] solves them.
//!
//! Every pixel couples with the pixels at `|dx| + |dy| ≤ 2`: what squared second differences and
//! squared combinations of central first differences need. Only the upper half is stored, seven
//! coefficients a pixel, in the order of [`OFFSETS`]; with pixels numbered row by row these are at
//! once the sorted rows of a column of the lower triangle.

use rilievo_scene::Mask;

/// Offsets `(dx, dy)` of the stored half of the stencil, in order of the pixel's number.
pub const OFFSETS: [(i32, i32); 7] = [(0, 0), (1, 0), (2, 0), (-1, 1), (0, 1), (1, 1), (0, 2)];

/// No pixel.
pub const OUTSIDE: u32 = u32::MAX;

/// Why a system could not be solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlateError {
    /// The factorisation could not be set up.
    #[error("a system of {num_unknowns} unknowns cannot be analysed: {reason}")]
    Symbolic {
        /// Number of unknowns.
        num_unknowns: usize,
        /// What the factorisation says.
        reason: String,
    },
    /// The matrix is not positive definite.
    #[error("the matrix of {num_unknowns} unknowns is not positive definite")]
    NotPositiveDefinite {
        /// Number of unknowns.
        num_unknowns: usize,
    },
}

/// The masked pixels, numbered row by row.
#[derive(Clone, Debug)]
pub struct PixelNumbering {
    /// Column of every pixel.
    pub xs: Vec<u32>,
    /// Row of every pixel.
    pub ys: Vec<u32>,
    /// Number of the pixel at `y * width + x`, [`OUTSIDE`] where the mask is not set.
    pub number: Vec<u32>,
    /// Columns of the raster.
    pub width: usize,
    /// Rows of the raster.
    pub height: usize,
}

impl PixelNumbering {
    /// Numbers the pixels of a mask.
    pub fn new(mask: &Mask) -> Self {
        let (mut xs, mut ys) = (Vec::new(), Vec::new());
        let mut number = vec![OUTSIDE; mask.data.len()];
        for y in 0..mask.height {
            for x in 0..mask.width {
                if *mask.at(x, y) {
                    number[y * mask.width + x] = xs.len() as u32;
                    xs.push(x as u32);
                    ys.push(y as u32);
                }
            }
        }
        Self {
            xs,
            ys,
            number,
            width: mask.width,
            height: mask.height,
        }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.xs.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.xs.is_empty()
    }

    /// The pixel at an offset from pixel `index`, where it exists.
    #[inline]
    pub fn neighbour(&self, index: usize, dx: i32, dy: i32) -> Option<usize> {
        let (x, y) = (self.xs[index] as i32 + dx, self.ys[index] as i32 + dy);
        if x < 0 || y < 0 || x >= self.width as i32 || y >= self.height as i32 {
            return None;
        }
        let number = self.number[y as usize * self.width + x as usize];
        (number != OUTSIDE).then_some(number as usize)
    }
}

/// Position of an offset in [`OFFSETS`], and whether it had to be mirrored.
#[inline]
fn slot(dx: i32, dy: i32) -> Option<(usize, bool)> {
    let mirrored = dy < 0 || (dy == 0 && dx < 0);
    let (dx, dy) = if mirrored { (-dx, -dy) } else { (dx, dy) };
    let slot = match (dx, dy) {
        (0, 0) => 0,
        (1, 0) => 1,
        (2, 0) => 2,
        (-1, 1) => 3,
        (0, 1) => 4,
        (1, 1) => 5,
        (0, 2) => 6,
        _ => return None,
    };
    Some((slot, mirrored))
}

/// A linear functional `Σ c x[pixel]` of a few pixels of one stencil.
#[derive(Clone, Copy, Debug, Default)]
pub struct Functional {
    /// Pixels and coefficients; only the first `len` count.
    pub terms: [(u32, f64); 4],
    /// Number of terms.
    pub len: usize,
}

impl Functional {
    /// Adds a term.
    #[inline]
    pub fn push(&mut self, pixel: usize, coefficient: f64) {
        if self.len < self.terms.len() {
            self.terms[self.len] = (pixel as u32, coefficient);
            self.len += 1;
        }
    }

    /// The terms.
    #[inline]
    pub fn terms(&self) -> &[(u32, f64)] {
        &self.terms[..self.len]
    }

    /// Its value.
    #[inline]
    pub fn of(&self, x: &[f64]) -> f64 {
        self.terms().iter().map(|&(i, c)| c * x[i as usize]).sum()
    }
}

/// The normal equations `H x = b` under assembly.
#[derive(Clone, Debug)]
pub struct PlateSystem {
    /// Seven coefficients a pixel, see [`OFFSETS`].
    pub coefficients: Vec<[f64; 7]>,
    /// Right-hand side.
    pub rhs: Vec<f64>,
}

impl PlateSystem {
    /// An empty system.
    pub fn new(num_unknowns: usize) -> Self {
        Self {
            coefficients: vec![[0.0; 7]; num_unknowns],
            rhs: vec![0.0; num_unknowns],
        }
    }

    /// Sets everything to zero.
    pub fn clear(&mut self) {
        self.coefficients.fill([0.0; 7]);
        self.rhs.fill(0.0);
    }

    /// Adds `weight · (x[pixel] − target)²/2`.
    #[inline]
    pub fn add_point(&mut self, pixel: usize, weight: f64, target: f64) {
        self.coefficients[pixel][0] += weight;
        self.rhs[pixel] += weight * target;
    }

    /// Adds `weight · (functional(x) − target)²/2`.
    #[inline]
    pub fn add_square(
        &mut self,
        numbering: &PixelNumbering,
        functional: &Functional,
        weight: f64,
        target: f64,
    ) {
        self.add_product(numbering, functional, functional, 0.5 * weight);
        for &(i, c) in functional.terms() {
            self.rhs[i as usize] += weight * c * target;
        }
    }

    /// Adds `(aa a(x)² + 2 ab a(x) b(x) + bb b(x)²)/2 − ra a(x) − rb b(x)`: what a residual of two functionals, as of both
    /// slopes of a pixel, comes to.
    #[inline]
    pub fn add_pair(
        &mut self,
        numbering: &PixelNumbering,
        [a, b]: [&Functional; 2],
        [aa, ab, bb]: [f64; 3],
        rhs: [f64; 2],
    ) {
        self.add_product(numbering, a, a, 0.5 * aa);
        self.add_product(numbering, b, b, 0.5 * bb);
        self.add_product(numbering, a, b, ab);
        for (functional, value) in [a, b].into_iter().zip(rhs) {
            for &(i, c) in functional.terms() {
                self.rhs[i as usize] += value * c;
            }
        }
    }

    /// Adds `weight · a(x) b(x)` to the energy `½ xᵀHx`'s matrix: `weight (a bᵀ + b aᵀ)`.
    #[inline]
    pub fn add_product(
        &mut self,
        numbering: &PixelNumbering,
        a: &Functional,
        b: &Functional,
        weight: f64,
    ) {
        for &(i, ci) in a.terms() {
            for &(j, cj) in b.terms() {
                let value = weight * ci * cj;
                let dx = numbering.xs[j as usize] as i32 - numbering.xs[i as usize] as i32;
                let dy = numbering.ys[j as usize] as i32 - numbering.ys[i as usize] as i32;
                if let Some((slot, mirrored)) = slot(dx, dy) {
                    let row = if mirrored { j } else { i } as usize;
                    // The mirrored entry of the symmetric sum falls on the same stored place.
                    self.coefficients[row][slot] += if slot == 0 { 2.0 * value } else { value };
                }
            }
        }
    }

    /// `H x`.
    pub fn multiply(&self, numbering: &PixelNumbering, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; x.len()];
        for (i, row) in self.coefficients.iter().enumerate() {
            out[i] += row[0] * x[i];
            for (slot, &(dx, dy)) in OFFSETS.iter().enumerate().skip(1) {
                if row[slot] != 0.0
                    && let Some(j) = numbering.neighbour(i, dx, dy)
                {
                    out[i] += row[slot] * x[j];
                    out[j] += row[slot] * x[i];
                }
            }
        }
        out
    }
}
