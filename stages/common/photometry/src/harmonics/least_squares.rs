//! Weighted least squares of `N` harmonics, four or nine, of one channel: `min over l of Σ_i w_i r_i²`.

use nalgebra::{DMatrix, DVector, SMatrix, Vector3};

/// One pixel's normal and intensity.
pub(super) struct Sample {
    pub normal: Vector3<f64>,
    /// The harmonics of the normal.
    pub basis: [f64; 9],
    pub value: f64,
    pub weight: f64,
}

/// How noise depends on brightness.
#[derive(Clone, Copy)]
pub(super) struct Noise {
    /// Mean intensity.
    pub mean: f64,
    /// Brightness, as a share of the mean, below which noise does not fall with it.
    pub floor: f64,
}

impl Noise {
    /// Scale of a residual where the light predicts a brightness, 1 at the mean.
    #[inline]
    pub fn scale(self, predicted: f64) -> f64 {
        (predicted / self.mean).max(self.floor)
    }
}

/// The first `N` coefficients.
pub(super) type SVector<const N: usize> = SMatrix<f64, N, 1>;

/// Intensity that coefficients give a sample.
#[inline]
pub(super) fn predict<const N: usize>(l: &SVector<N>, sample: &Sample) -> f64 {
    (0..N).map(|k| l[k] * sample.basis[k]).sum()
}

/// Normal matrix and solution of the weighted least squares.
pub(super) fn solve<const N: usize>(
    samples: &[Sample],
    weight: impl Fn(usize) -> f64,
) -> Option<(SMatrix<f64, N, N>, SVector<N>)> {
    let mut matrix = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<N>::zeros();
    for (k, sample) in samples.iter().enumerate() {
        let w = weight(k);
        if w == 0.0 {
            continue;
        }
        for row in 0..N {
            let scaled = w * sample.basis[row];
            right[row] += scaled * sample.value;
            for column in 0..=row {
                matrix[(row, column)] += scaled * sample.basis[column];
            }
        }
    }
    for row in 0..N {
        for column in row + 1..N {
            matrix[(row, column)] = matrix[(column, row)];
        }
    }
    // The symmetric eigen-decomposition copes with near-singular problems (few normals), which
    // the condition number then rejects; a Cholesky factor would fail without a reason.
    let dense = DMatrix::from_fn(N, N, |r, c| matrix[(r, c)]);
    let eigen = dense.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    if largest.is_nan() || largest <= 0.0 {
        return None;
    }
    let projected = eigen.eigenvectors.transpose() * DVector::from_column_slice(right.as_slice());
    let scaled = projected.zip_map(&eigen.eigenvalues, |p, e| {
        if e > 1e-14 * largest { p / e } else { 0.0 }
    });
    let solution = eigen.eigenvectors * scaled;
    Some((matrix, SVector::<N>::from_fn(|k, _| solution[k])))
}
