//! What a θ-step is asked to do.

use super::search::Candidates;
use super::terms::ThetaTerms;
use crate::paper::pixels::Pixels;

/// The θ-step of a whole image. All arrays have the padded length of `pixels`.
#[derive(Clone, Copy)]
pub(crate) struct ThetaProblem<'a> {
    pub(crate) pixels: &'a Pixels,
    /// `t`, along x and along y.
    pub(crate) target: (&'a [f32], &'a [f32]),
    pub(crate) terms: ThetaTerms<'a>,
    /// Normals that a far start is replaced from.
    pub(crate) candidates: Option<&'a Candidates>,
}
