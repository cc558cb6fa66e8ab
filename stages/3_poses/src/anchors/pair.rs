//! Geometry between two working views.
//!
//! A pixel `x` of the reference at inverse depth `q` is seen by the source at
//! `h = A (x, y, 1)ᵀ + q b`, `u = h₁/h₃`, `v = h₂/h₃` ([`Warp`]). Inverse depth of a plane is affine in the pixel,
//! `q(x₀ + d) = q₀ + q_x d_x + q_y d_y`, so the patch maps by the homography
//! `H = [A₁ + q_x b, A₂ + q_y b, A x₀ + q₀ b]` of the offset `(d_x, d_y, 1)`.

use super::working::WorkingView;
use nalgebra::Point3;
use rilievo_stereo::camera::Warp;

/// Sources used for one patch at most.
pub(super) const MAX_SOURCES: usize = 4;

/// What is known of the offset between two log images, the logarithm of a gain in exposure.
#[derive(Clone, Copy, Debug)]
pub(super) struct OffsetPrior {
    pub mean: f64,
    /// Its standard deviation from patch to patch.
    pub sigma: f64,
}

/// Maps pixels of a reference with inverse depth into a source view.
#[derive(Clone, Debug)]
pub(super) struct PairGeometry {
    /// Index of the source among the working views.
    pub source: usize,
    /// The warp into it.
    pub warp: Warp,
    /// Offset of the source's log image against the reference's; unknown at first.
    pub offset: Option<OffsetPrior>,
}

impl PairGeometry {
    /// Geometry from a reference to a source view; `None` for a camera without a focal length.
    pub fn new(reference: &WorkingView, source_idx: usize, source: &WorkingView) -> Option<Self> {
        Some(Self {
            source: source_idx,
            warp: Warp::between(&reference.camera, &source.camera)?,
            offset: None,
        })
    }

    /// Length of the source pixel's derivative by the inverse depth: pixels of disparity per unit.
    pub fn px_per_inverse_depth(&self, x: f64, y: f64, inverse_depth: f64) -> f64 {
        let (h, b) = (self.warp.at(x, y, inverse_depth), &self.warp.b);
        let (u, v) = (h.x / h.z, h.y / h.z);
        (b.x - u * b.z).hypot(b.y - v * b.z) / h.z.abs()
    }
}

/// Angle at a point between the rays to two camera centres, radians.
pub(super) fn ray_angle(point: &Point3<f64>, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
    let (to_a, to_b) = (a - point, b - point);
    (to_a.dot(&to_b) / (to_a.norm() * to_b.norm()))
        .clamp(-1.0, 1.0)
        .acos()
}
