//! Lighting as second-order spherical harmonics (eq. 1 of the paper).

use nalgebra::{RealField, Vector3};
use serde::{Deserialize, Serialize};

/// Nine coefficients `l` with `intensity = l · h(n)` and the basis
/// `h(n) = [n1, n2, n3, 1, n1n2, n1n3, n2n3, n1²−n2², 3n3²−1]` (un-normalised).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SphericalHarmonics(pub [f64; 9]);

impl SphericalHarmonics {
    /// The basis in words, as written into `lighting.json`.
    pub const BASIS: &'static str = "n1 n2 n3 1 n1n2 n1n3 n2n3 n1^2-n2^2 3n3^2-1";

    /// The basis functions at a unit normal.
    #[inline]
    pub fn basis<T: RealField + Copy>(n: &Vector3<T>) -> [T; 9] {
        let one = T::one();
        [
            n.x,
            n.y,
            n.z,
            one,
            n.x * n.y,
            n.x * n.z,
            n.y * n.z,
            n.x * n.x - n.y * n.y,
            (one + one + one) * n.z * n.z - one,
        ]
    }

    /// Intensity of a surface with unit normal `n` (albedo as contained in the coefficients).
    #[inline]
    pub fn evaluate(&self, n: &Vector3<f64>) -> f64 {
        Self::basis(n).iter().zip(&self.0).map(|(h, l)| h * l).sum()
    }
}

/// Lighting of one view: one row of harmonics per colour channel (1 or 3).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Lighting {
    /// One row per channel.
    pub channels: Vec<SphericalHarmonics>,
}
