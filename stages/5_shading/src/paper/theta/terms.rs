//! Weights of the θ-step's terms.

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
