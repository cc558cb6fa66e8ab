//! The common sphere by least squares over the outline points of several views, and how sure it is.
//!
//! With `d_i` the rays of the points and `s_i` pixels per radian there,
//! ```text
//! min over C, r of Σ_v Σ_i ρ( s_i (angle(d_i, C_v) − asin(r / |C_v|)) ),   C_v = R_v C + t_v,
//! ```
//! `ρ` Huber's loss, by Levenberg–Marquardt; or over `C` alone, where the radius is kept.

use super::cone::SphereInCamera;
use super::error::SphereError;
use super::known::{Known, State};
use super::mark::px_per_radian;
use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};
use rilievo_numerics::least_squares::{LeastSquaresOptions, LeastSquaresProblem, minimize};
use rilievo_numerics::robust::RobustLoss;

/// The fitted sphere with standard deviations.
pub(super) struct Refined {
    pub state: State,
    pub center_sigma: [f64; 3],
    /// Standard deviation of the radius; 0 where it was kept.
    pub radius_sigma: f64,
}

/// Derivatives of `angle(d, C) − asin(r/|C|)` by `C` (camera frame) and `r`, with its value.
pub(super) fn residual(
    sphere: &SphereInCamera,
    ray: &Vector3<f64>,
) -> Option<(f64, Vector3<f64>, f64)> {
    let c = sphere.center.coords;
    let rho = c.norm();
    let axis = c / rho;
    let along = ray.dot(&axis);
    let across = ray - axis * along;
    let sin = across.norm();
    let tangent = (rho * rho - sphere.radius * sphere.radius).sqrt();
    if !(tangent > 0.0 && sin > 0.0) {
        return None;
    }
    let value = sin.atan2(along) - (sphere.radius / rho).asin();
    // Moving C towards the ray lessens the angle; moving it away shrinks the cone.
    let by_center = -across / (sin * rho) + axis * (sphere.radius / (rho * tangent));
    Some((value, by_center, -1.0 / tangent))
}

/// Half a pixel off, an outline point's pull no longer grows.
const LOSS: RobustLoss = RobustLoss::Huber(0.5);

/// Sums over all points at a state. Matrices are over the centre and the radius.
#[derive(Default)]
struct Sums {
    matrix: Matrix4<f64>,
    gradient: Vector4<f64>,
    cost: f64,
    square: f64,
    weight: f64,
    /// Outer products of summed rows: what offsets common to a whole outline do. Each view's
    /// outline is moved by an offset of its own. All are wider by one: what makes a matte sphere
    /// seem larger or smaller (its falling brightness, blur, gamma, the ground) is the same in all
    /// views and does not average out.
    bias: Matrix4<f64>,
}

/// The fit over `N` parameters: the centre, and with 4 the radius.
struct OutlineProblem<'a, 'b, const N: usize> {
    known: &'a [&'b Known<'b>],
    /// Standard deviation of an offset of a whole outline, pixels.
    bias_px: f64,
}

impl<const N: usize> OutlineProblem<'_, '_, N> {
    /// `None` where the sphere contains a camera or lies behind one.
    fn sums(&self, state: &State) -> Option<Sums> {
        let mut sums = Sums::default();
        let mut wider = Vector4::zeros();
        for k in self.known {
            let sphere = k.in_camera(state);
            let axis = sphere.cone()?.axis;
            let to_world = k.view.cam_from_world.rotation.inverse();
            let mut bias_rows = [Vector4::zeros(); 3];
            for ray in &k.rays {
                let (value, by_center, by_radius) = residual(&sphere, ray)?;
                let px = px_per_radian(ray, &k.view.intrinsics);
                let r = px * value;
                let w = k.point_weight * LOSS.weight(r);
                let row = (to_world * by_center).push(by_radius) * px;
                sums.matrix += row * row.transpose() * w;
                sums.gradient += row * (w * r);
                sums.cost += k.point_weight * LOSS.cost(r);
                sums.square += w * r * r;
                sums.weight += w;
                // An offset of the whole outline: wider, or moved along either axis.
                let around = (ray - axis * ray.dot(&axis)).xy().normalize();
                for (bias, amplitude) in bias_rows.iter_mut().zip([1.0, around.x, around.y]) {
                    *bias += row * (w * amplitude);
                }
            }
            wider += bias_rows[0];
            for moved in &bias_rows[1..] {
                sums.bias += moved * moved.transpose();
            }
        }
        sums.bias += wider * wider.transpose();
        Some(sums)
    }

    fn fit(&self, start: State) -> Option<Refined> {
        // Beyond this no digit of a position changes that its deviation leaves.
        let options = LeastSquaresOptions {
            relative_cost_change: 1e-12,
            ..LeastSquaresOptions::default()
        };
        let (state, _) = minimize::<N, _>(self, start, &options).ok()?;
        let sums = self.sums(&state)?;
        let inverse = block::<N>(&sums.matrix).cholesky()?.inverse();
        let variance = sums.square / (sums.weight - 4.0).max(1.0);
        let bias = inverse * block::<N>(&sums.bias) * inverse * self.bias_px.powi(2);
        let covariance = inverse * variance + bias;
        let sigma = |k: usize| {
            covariance
                .diagonal()
                .get(k)
                .map_or(0.0, |v| v.max(0.0).sqrt())
        };
        Some(Refined {
            state,
            center_sigma: [0, 1, 2].map(sigma),
            radius_sigma: sigma(3),
        })
    }
}

impl<const N: usize> LeastSquaresProblem<N> for OutlineProblem<'_, '_, N> {
    type State = State;

    fn linearize(&self, state: &State) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
        let sums = self.sums(state).unwrap_or_default();
        let gradient = SVector::from_fn(|k, _| sums.gradient[k]);
        (block(&sums.matrix), gradient)
    }

    fn cost(&self, state: &State) -> f64 {
        self.sums(state).map_or(f64::INFINITY, |sums| sums.cost)
    }

    fn retract(&self, state: &State, step: &SVector<f64, N>) -> State {
        State {
            center: state.center + Vector3::new(step[0], step[1], step[2]),
            radius: state.radius + step.get(3).unwrap_or(&0.0),
        }
    }
}

/// The part over the first `N` parameters.
fn block<const N: usize>(matrix: &Matrix4<f64>) -> SMatrix<f64, N, N> {
    SMatrix::from_fn(|row, column| matrix[(row, column)])
}

/// Fits centre and, where it is free, radius.
///
/// # Errors
/// [`SphereError::Impossible`].
pub(super) fn refine(
    start: State,
    known: &[&Known],
    free_radius: bool,
    bias_px: f64,
) -> Result<Refined, SphereError> {
    let found = if free_radius {
        OutlineProblem::<4> { known, bias_px }.fit(start)
    } else {
        OutlineProblem::<3> { known, bias_px }.fit(start)
    };
    found.ok_or(SphereError::Impossible)
}
