//! Geometric verification of a pair: essential matrix and homography.
//!
//! On undistorted normalised coordinates `x1`, `x2` of the matches, RANSAC over five-point samples
//! (Nistér, PAMI 2004; OpenCV's classic RANSAC with its fixed seed) gives `E` with `x2ᵀ E x1 = 0`.
//! It is then refined over all inliers by Cauchy-weighted least squares of the Sampson distance
//! `s = x2ᵀ E x1 / √g`, `g = (E x1)₁² + (E x1)₂² + (Eᵀ x2)₁² + (Eᵀ x2)₂²`, on the manifold
//! `E = U diag(1,1,0) Vᵀ`, which five rotation parameters move: three of `U`, two of `V` (the
//! rotation about the third axis is common). Inliers are counted again, twice. Samples are drawn
//! from the distinctive matches only, where wrong ones are few; the others are then held against
//! the matrix that was found, and join in its refinement.
//!
//! The homography is fitted to the inliers of `E`; the share that it explains distinguishes flat
//! scenes and pure rotations from pairs with parallax.

use crate::error::FeaturesError;
use nalgebra::{Matrix3, Point2, Rotation3, SMatrix, SVector, Vector3};
use opencv::calib3d;
use opencv::core::{Mat, Point2d, Vector};
use opencv::prelude::MatTraitConstManual;
use rilievo_numerics::least_squares::{LeastSquaresOptions, LeastSquaresProblem, minimize};
use rilievo_numerics::robust::RobustLoss;

/// Verified geometry of a pair.
pub(crate) struct TwoViewGeometry {
    /// Essential matrix, Frobenius norm √2.
    pub essential: Matrix3<f64>,
    /// Indices of the matches that agree with it, ascending.
    pub inliers: Vec<usize>,
    /// Share of the inliers that a homography explains as well.
    pub homography_share: f64,
}

/// Samples that are drawn of every pair, unless a good one is found before.
const MIN_NUM_SAMPLES: usize = 100;

/// Most samples per pair.
const MAX_NUM_RANSAC_SAMPLES: usize = 2000;

/// Pairs with fewer verified matches are dropped.
pub(crate) const MIN_NUM_INLIERS: usize = 15;

/// Largest distance from the epipolar line, pixels.
const MAX_EPIPOLAR_ERROR_PX: f64 = 3.0;

/// Confidence at which RANSAC may stop early.
const RANSAC_CONFIDENCE: f64 = 0.9999;

/// Verifies the matches `(x1[k], x2[k])`, in normalised coordinates; `None` when too few of the
/// distinctive ones agree.
///
/// `distinctive` are ascending indices of matches; `focal_px` turns pixel thresholds into normalised ones.
///
/// # Errors
/// When OpenCV refuses a call.
pub(crate) fn verify(
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
    distinctive: &[usize],
    focal_px: f64,
) -> Result<Option<TwoViewGeometry>, FeaturesError> {
    if distinctive.len() < MIN_NUM_INLIERS {
        return Ok(None);
    }
    let threshold = MAX_EPIPOLAR_ERROR_PX / focal_px;
    let pick =
        |x: &[Point2<f64>]| -> Vec<Point2<f64>> { distinctive.iter().map(|&k| x[k]).collect() };
    let Some(mut essential) = ransac_essential(&pick(x1), &pick(x2), threshold)? else {
        return Ok(None);
    };
    let mut inliers = sampson_inliers(&essential, x1, x2, threshold);
    for _ in 0..2 {
        // Many indistinctive matches agree with any matrix by chance: they do not count here.
        let num_distinctive = inliers
            .iter()
            .filter(|&k| distinctive.binary_search(k).is_ok())
            .count();
        if num_distinctive < MIN_NUM_INLIERS {
            return Ok(None);
        }
        if let Some(refined) = refine_essential(&essential, x1, x2, &inliers, threshold) {
            let agreeing = sampson_inliers(&refined, x1, x2, threshold);
            if agreeing.len() >= inliers.len() {
                essential = refined;
                inliers = agreeing;
            }
        }
    }
    let homography_share = homography_share(x1, x2, &inliers, threshold)?;
    Ok(Some(TwoViewGeometry {
        essential,
        inliers,
        homography_share,
    }))
}

fn to_opencv(points: impl Iterator<Item = Point2<f64>>) -> Vector<Point2d> {
    points.map(|p| Point2d::new(p.x, p.y)).collect()
}

fn matrix3(mat: &Mat) -> Option<Matrix3<f64>> {
    // Several solutions would be stacked; RANSAC returns one.
    let values = mat.data_typed::<f64>().ok()?;
    (values.len() >= 9).then(|| Matrix3::from_row_slice(&values[..9]))
}

/// Samples after which a pair that would be accepted has been found with [`RANSAC_CONFIDENCE`].
///
/// A pair of `n` matches counts from `m` = [`MIN_NUM_INLIERS`] on, so a share `w ≥ m/n` of them
/// must agree; `ln(1 − p) / ln(1 − w⁵)` samples of five then hold a clean one with probability `p`
/// (Fischler and Bolles, 1981). Pairs without overlap, whose few matches all disagree, would
/// otherwise take [`MAX_NUM_RANSAC_SAMPLES`]. A clean sample is not yet a good one: points close
/// together magnify noise, so that a hundred are drawn at least.
fn num_useful_samples(num_matches: usize) -> usize {
    let share = (MIN_NUM_INLIERS as f64 / num_matches.max(1) as f64).min(1.0);
    let all_clean = share.powi(5);
    let needed = (1.0 - RANSAC_CONFIDENCE).ln() / (-all_clean).ln_1p();
    (needed.ceil() as usize).clamp(MIN_NUM_SAMPLES, MAX_NUM_RANSAC_SAMPLES)
}

fn ransac_essential(
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
    threshold: f64,
) -> Result<Option<Matrix3<f64>>, FeaturesError> {
    let num_samples = num_useful_samples(x1.len());
    let mut mask = Mat::default();
    let found = calib3d::find_essential_mat_1(
        &to_opencv(x1.iter().copied()),
        &to_opencv(x2.iter().copied()),
        1.0,
        Point2d::new(0.0, 0.0),
        calib3d::RANSAC,
        RANSAC_CONFIDENCE,
        threshold,
        num_samples as i32,
        &mut mask,
    )
    .map_err(|source| FeaturesError::OpenCv {
        action: "estimate an essential matrix",
        source,
    })?;
    Ok(matrix3(&found).and_then(|e| project_to_essential(&e)))
}

/// Nearest matrix with singular values (1, 1, 0).
fn project_to_essential(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * v_t)
}

/// Sampson distance, normalised coordinates.
fn sampson(essential: &Matrix3<f64>, x1: &Point2<f64>, x2: &Point2<f64>) -> f64 {
    let (h1, h2) = (x1.to_homogeneous(), x2.to_homogeneous());
    let (line2, line1) = (essential * h1, essential.tr_mul(&h2));
    let g = line2.x * line2.x + line2.y * line2.y + line1.x * line1.x + line1.y * line1.y;
    h2.dot(&line2) / g.max(f64::MIN_POSITIVE).sqrt()
}

fn sampson_inliers(
    essential: &Matrix3<f64>,
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
    threshold: f64,
) -> Vec<usize> {
    (0..x1.len())
        .filter(|&k| sampson(essential, &x1[k], &x2[k]).abs() <= threshold)
        .collect()
}

/// `E = U diag(1,1,0) Vᵀ`.
#[derive(Clone)]
struct EssentialState {
    u: Matrix3<f64>,
    v: Matrix3<f64>,
}

impl EssentialState {
    fn matrix(&self) -> Matrix3<f64> {
        self.u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)) * self.v.transpose()
    }
}

struct SampsonProblem<'a> {
    x1: &'a [Point2<f64>],
    x2: &'a [Point2<f64>],
    inliers: &'a [usize],
    loss: RobustLoss,
}

impl SampsonProblem<'_> {
    /// Derivatives of `E` by the five parameters.
    fn tangents(state: &EssentialState) -> [Matrix3<f64>; 5] {
        let d = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0));
        let cross = |axis: usize| Vector3::ith(axis, 1.0).cross_matrix();
        let v_t = state.v.transpose();
        [
            state.u * cross(0) * d * v_t,
            state.u * cross(1) * d * v_t,
            state.u * cross(2) * d * v_t,
            -(state.u * d * cross(0) * v_t),
            -(state.u * d * cross(1) * v_t),
        ]
    }
}

impl LeastSquaresProblem<5> for SampsonProblem<'_> {
    type State = EssentialState;

    fn linearize(&self, state: &EssentialState) -> (SMatrix<f64, 5, 5>, SVector<f64, 5>) {
        let e = state.matrix();
        let tangents = Self::tangents(state);
        let (mut hessian, mut gradient) = (SMatrix::zeros(), SVector::zeros());
        for &k in self.inliers {
            let (h1, h2) = (self.x1[k].to_homogeneous(), self.x2[k].to_homogeneous());
            let (a, b) = (e * h1, e.tr_mul(&h2));
            let g = a.x * a.x + a.y * a.y + b.x * b.x + b.y * b.y;
            let root = g.max(f64::MIN_POSITIVE).sqrt();
            let c = h2.dot(&a);
            let r = c / root;
            let mut j = SVector::<f64, 5>::zeros();
            for (entry, tangent) in j.iter_mut().zip(&tangents) {
                let (da, db) = (tangent * h1, tangent.tr_mul(&h2));
                let dg = 2.0 * (a.x * da.x + a.y * da.y + b.x * db.x + b.y * db.y);
                *entry = h2.dot(&da) / root - 0.5 * c * dg / (g * root);
            }
            let weight = self.loss.weight(r);
            hessian += j * j.transpose() * weight;
            gradient += j * (weight * r);
        }
        (hessian, gradient)
    }

    fn cost(&self, state: &EssentialState) -> f64 {
        let e = state.matrix();
        self.inliers
            .iter()
            .map(|&k| self.loss.cost(sampson(&e, &self.x1[k], &self.x2[k])))
            .sum()
    }

    fn retract(&self, state: &EssentialState, step: &SVector<f64, 5>) -> EssentialState {
        EssentialState {
            u: state.u * Rotation3::new(Vector3::new(step[0], step[1], step[2])).matrix(),
            v: state.v * Rotation3::new(Vector3::new(step[3], step[4], 0.0)).matrix(),
        }
    }
}

fn refine_essential(
    essential: &Matrix3<f64>,
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
    inliers: &[usize],
    threshold: f64,
) -> Option<Matrix3<f64>> {
    let svd = essential.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    let problem = SampsonProblem {
        x1,
        x2,
        inliers,
        loss: RobustLoss::Cauchy(0.3 * threshold),
    };
    let options = LeastSquaresOptions {
        max_num_iterations: 20,
        relative_cost_change: 1e-6,
        ..LeastSquaresOptions::default()
    };
    let (state, _) = minimize(&problem, EssentialState { u, v }, &options).ok()?;
    Some(state.matrix())
}

fn homography_share(
    x1: &[Point2<f64>],
    x2: &[Point2<f64>],
    inliers: &[usize],
    threshold: f64,
) -> Result<f64, FeaturesError> {
    let mut mask = Mat::default();
    calib3d::find_homography_ext(
        &to_opencv(inliers.iter().map(|&k| x1[k])),
        &to_opencv(inliers.iter().map(|&k| x2[k])),
        calib3d::RANSAC,
        threshold,
        &mut mask,
        500,
        0.99,
    )
    .map_err(|source| FeaturesError::OpenCv {
        action: "estimate a homography",
        source,
    })?;
    let explained = mask
        .data_typed::<u8>()
        .map_or(0, |m| m.iter().filter(|&&inside| inside != 0).count());
    Ok(explained as f64 / inliers.len().max(1) as f64)
}

#[cfg(test)]
mod tests;
