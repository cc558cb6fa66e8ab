//! One pixel's term, its Gauss-Newton model, and a damped step: the version to read.

#[cfg(test)]
use super::problem::ThetaTerms;
use crate::paper::model::Facet;

/// Damping of the first Gauss-Newton step, in squared intensity units of the Jacobian.
pub(super) const FIRST_DAMPING: f32 = 1e-4;

/// Value, and Gauss-Newton's model, of a term in two slopes.
#[derive(Clone, Copy)]
pub(crate) struct Quadratic {
    pub(crate) value: f32,
    pub(crate) gradient: [f32; 2],
    /// Upper triangle.
    pub(crate) hessian: [f32; 3],
}

/// The term of one pixel: everything but its slopes.
pub(super) struct Pixel<const C: usize> {
    pub(super) light: [[f32; 9]; C],
    pub(super) intensity: [f32; C],
    pub(super) weight: f32,
    pub(super) ray: [f32; 2],
    pub(super) target: [f32; 2],
    /// β times the pixel's stiffness.
    pub(super) beta: f32,
    /// Weight ν of the area.
    pub(super) area: f32,
}

impl<const C: usize> Pixel<C> {
    /// The term at some slopes.
    #[inline(always)]
    pub(super) fn quadratic(&self, slopes: [f32; 2]) -> Quadratic {
        let (ray, target, weight) = (self.ray, self.target, self.weight);
        let half = 0.5 * self.beta;
        let facet = Facet::new(ray, slopes);
        let away = [slopes[0] - target[0], slopes[1] - target[1]];
        let mut value = half * (away[0] * away[0] + away[1] * away[1]);
        let mut g = [half * away[0], half * away[1]];
        let mut h = [half, 0.0, half];
        let mut c = 0;
        while c < C {
            let (shade, j) = facet.shade(&self.light[c]);
            let r = shade - self.intensity[c];
            value += weight * r * r;
            g[0] += weight * j[0] * r;
            g[1] += weight * j[1] * r;
            h[0] += weight * j[0] * j[0];
            h[1] += weight * j[0] * j[1];
            h[2] += weight * j[1] * j[1];
            c += 1;
        }
        if self.area > 0.0 {
            // ∇²d = (I + ray rayᵀ − ∇d ∇dᵀ)/d is positive semi-definite.
            let (d, e) = (facet.length(), facet.length_gradient());
            let scale = 0.5 * self.area;
            value += self.area * d;
            g[0] += scale * e[0];
            g[1] += scale * e[1];
            let by = scale / d;
            h[0] += by * (1.0 + ray[0] * ray[0] - e[0] * e[0]);
            h[1] += by * (ray[0] * ray[1] - e[0] * e[1]);
            h[2] += by * (1.0 + ray[1] * ray[1] - e[1] * e[1]);
        }
        Quadratic {
            value,
            gradient: g,
            hessian: h,
        }
    }
}

/// Slopes after one damped Gauss-Newton step.
#[inline(always)]
pub(super) fn trial_step(slopes: [f32; 2], model: &Quadratic, damping: f32) -> [f32; 2] {
    let (a, b, d) = (
        model.hessian[0] + damping,
        model.hessian[1],
        model.hessian[2] + damping,
    );
    let inverse = 1.0 / (a * d - b * b);
    let [g0, g1] = model.gradient;
    [
        slopes[0] - (d * g0 - b * g1) * inverse,
        slopes[1] - (a * g1 - b * g0) * inverse,
    ]
}

/// `new` where a step is accepted, else `old`.
#[inline(always)]
pub(super) fn pick(accept: bool, new: f32, old: f32) -> f32 {
    if accept { new } else { old }
}

/// Damping after a step.
#[inline(always)]
pub(super) fn next_damping(accept: bool, damping: f32) -> f32 {
    pick(accept, 0.3 * damping, 10.0 * damping + FIRST_DAMPING)
}

/// Slopes after `num_steps` damped Gauss-Newton steps; one that does not lower the term is undone.
pub(crate) fn descend(
    start: [f32; 2],
    num_steps: usize,
    evaluate: impl Fn([f32; 2]) -> Quadratic,
) -> [f32; 2] {
    let (mut slopes, mut damping) = (start, FIRST_DAMPING);
    let mut model = evaluate(slopes);
    for _ in 0..num_steps {
        let trial = trial_step(slopes, &model, damping);
        let at_trial = evaluate(trial);
        let accept = at_trial.value <= model.value;
        if accept {
            (slopes, model) = (trial, at_trial);
        }
        damping = next_damping(accept, damping);
    }
    slopes
}

/// The θ-step of one pixel: the oracle of the tests.
#[cfg(test)]
pub(super) fn scalar_step(
    pixels: &crate::paper::pixels::Pixels,
    k: usize,
    target: [f32; 2],
    start: [f32; 2],
    terms: &ThetaTerms<'_>,
) -> [f32; 2] {
    fn solve<const C: usize>(
        pixels: &crate::paper::pixels::Pixels,
        k: usize,
        target: [f32; 2],
        start: [f32; 2],
        terms: &ThetaTerms<'_>,
    ) -> [f32; 2] {
        let pixel = Pixel::<C> {
            light: std::array::from_fn(|c| pixels.light(c, k)),
            intensity: std::array::from_fn(|c| pixels.intensity[c * pixels.padded + k]),
            weight: pixels.weight[k],
            ray: [pixels.ray_x[k], pixels.ray_y[k]],
            target,
            beta: terms.beta * terms.stiffness.get(k).copied().unwrap_or(1.0),
            area: terms.area,
        };
        descend(start, terms.num_steps, |slopes| pixel.quadratic(slopes))
    }
    if pixels.channels == 1 {
        solve::<1>(pixels, k, target, start, terms)
    } else {
        solve::<3>(pixels, k, target, start, terms)
    }
}
