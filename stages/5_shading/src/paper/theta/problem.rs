//! What a θ-step is asked to do.

use super::search::Candidates;
use crate::paper::pixels::{Pixels, Slopes};

/// The θ-step of a whole image. All arrays have the padded length of `pixels`.
#[derive(Clone, Copy)]
pub(crate) struct ThetaProblem<'a> {
    pub(crate) pixels: &'a Pixels,
    /// `t`, along x and along y.
    pub(crate) target: &'a Slopes,
    pub(crate) terms: ThetaTerms<'a>,
    /// Normals that a far start is replaced from.
    pub(crate) candidates: Option<&'a Candidates>,
}

/// What the θ-step minimises, beside the pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThetaTerms<'a> {
    /// Penalty β.
    pub(crate) beta: f32,
    /// Its factor at every pixel, of padded length; empty for 1 everywhere.
    pub(crate) stiffness: &'a [f32],
    /// Weight ν of the area.
    pub(crate) area: f32,
    /// Gauss-Newton steps.
    pub(crate) num_steps: usize,
}
