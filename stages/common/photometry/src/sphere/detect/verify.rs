//! A candidate against what only a sphere shows.
//!
//! 1. Outline: the edge follows one cone around most of the visible outline.
//! 2. Shading: nine harmonics over the exact normals of that cone explain the pixels inside it.
//!    Flat things, faces and textured patches leave several times the residual of a sphere.

use super::votes::Circle;
use crate::harmonics::{FitOptions, fit_robust};
use crate::sphere::cone::OutlineCone;
use crate::sphere::mark::{cone_from_points, outline_of_mark};
use crate::sphere::options::SphereOptions;
use crate::sphere::refine::{Effort, refine_outline};
use nalgebra::{Point2, Vector3};
use rilievo_scene::{Intrinsics, LinearImage, Mask, SphereMark};

/// A verified candidate in one photo.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub cone: OutlineCone,
    pub outline: Vec<Point2<f64>>,
    /// Share of the searched outline that lies on the cone.
    pub support: f64,
    /// Share of the outline inside the frame and not hidden by the object.
    pub visible: f64,
    /// Relative residual of nine harmonics, and what they explain.
    pub shading: Shading,
    /// Whether a proposal has used it.
    pub is_spent: bool,
}

impl Candidate {
    /// Higher is better; both terms lie between 0 and about 1.
    pub fn score(&self, options: &SphereOptions) -> f64 {
        self.support
            * self.visible.sqrt()
            * (1.0 - 0.5 * (self.shading.residual / options.max_shading_residual).min(2.0))
    }
}

/// A photo that is searched.
pub(in crate::sphere) struct Photo<'a> {
    pub image: &'a LinearImage,
    pub intrinsics: &'a Intrinsics,
    pub object: Option<&'a Mask>,
    pub clip_level: f32,
}

/// Refines a circle to a cone and measures it; `None` where no edge follows it.
pub(super) fn verify(photo: &Photo, circle: &Circle, options: &SphereOptions) -> Option<Candidate> {
    let mark = SphereMark::Circle {
        center_px: circle.center,
        radius_px: circle.radius,
    };
    let start = cone_from_points(&outline_of_mark(&mark), photo.intrinsics, options).ok()?;
    let loose = SphereOptions {
        min_inlier_share: 0.3,
        ..options.clone()
    };
    let mut cone = start.cone;
    let mut best = None;
    // From the tenth of the radius that voting leaves open down to the width of the edge.
    for search_px in [
        (0.12 * circle.radius).max(4.0),
        (0.06 * circle.radius).max(3.0),
        3.0,
        2.0,
    ] {
        let found = refine_outline(
            photo.image,
            photo.intrinsics,
            &cone.sphere(1.0),
            search_px,
            photo.object,
            Effort::Quick,
        );
        if found.visible_share() < 0.3 {
            return None;
        }
        let fit = cone_from_points(&found.points, photo.intrinsics, &loose).ok()?;
        cone = fit.cone;
        let support = fit.inliers.len() as f64 / found.num_searched.max(1) as f64;
        // Most circles follow no edge at all: they need no second look.
        if support < 0.5 * options.min_edge_support {
            return None;
        }
        best = Some((fit, support, found.visible_share()));
    }
    let (fit, support, visible) = best?;
    if support < options.min_edge_support {
        return None;
    }
    let shading = shading(photo, &cone)?;
    Some(Candidate {
        cone,
        outline: fit.inliers,
        support,
        visible,
        shading,
        is_spent: false,
    })
}

/// Share of samples that may be shadowed, dirty or hidden without counting against a candidate.
const TOLERATED: f64 = 0.1;

/// How nine harmonics over the exact normals of a cone explain the pixels inside it.
#[derive(Clone, Copy, Debug)]
pub(in crate::sphere) struct Shading {
    /// Relative residual, root mean square over all but the worst tenth of the pixels.
    pub residual: f64,
    /// Share of the variance of brightness that is explained. A flat patch of background has a
    /// small residual because it has little to explain; a sphere is shaded.
    pub explained: f64,
}

impl Shading {
    /// Smallest explained share of a sphere; noise and compression leave more than this of the
    /// shading of any light with a direction.
    const MIN_EXPLAINED: f64 = 0.8;

    /// Whether a matte sphere looks like this.
    pub fn is_sphere(&self, max_residual: f64) -> bool {
        self.residual <= max_residual && self.explained >= Self::MIN_EXPLAINED
    }
}

/// Measures it; `None` with too few unclipped pixels.
pub(in crate::sphere) fn shading(photo: &Photo, cone: &OutlineCone) -> Option<Shading> {
    let sphere = cone.sphere(1.0);
    let radius_px = sphere.radius_px(photo.intrinsics);
    let pixels = sphere.pixels(photo.intrinsics, 2.0_f64.min(0.2 * radius_px));
    // A few thousand pixels tell as much as all.
    let stride = pixels.len().div_ceil(1500).max(1);
    let (mut normals, mut values): (Vec<Vector3<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
    for pixel in pixels.iter().step_by(stride) {
        let hidden = photo
            .object
            .is_some_and(|mask| mask.contains(pixel.x as isize, pixel.y as isize));
        let channels = photo.image.pixel(pixel.x, pixel.y);
        let clipped = channels.iter().any(|&v| v >= 0.97 * photo.clip_level);
        if hidden || clipped || pixel.cos_view < 0.1 {
            continue;
        }
        normals.push(pixel.normal_in_cam);
        values.push(f64::from(channels.iter().sum::<f32>()) / channels.len() as f64);
    }
    if normals.len() < 80 {
        return None;
    }
    let options = FitOptions {
        start_left_out: 0.0,
        max_condition: FitOptions::ANY_CONDITION,
        ..FitOptions::default()
    };
    let fit = fit_robust(&normals, &values, None, &options).ok()?;
    let mut residuals: Vec<f64> = normals
        .iter()
        .zip(&values)
        .map(|(n, v)| (fit.coefficients.evaluate(n) - v).powi(2))
        .collect();
    residuals.sort_by(f64::total_cmp);
    let kept = ((1.0 - TOLERATED) * residuals.len() as f64) as usize;
    let num = values.len() as f64;
    let mean = values.iter().sum::<f64>() / num;
    let size = values.iter().map(|v| v * v).sum::<f64>() / num;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / num;
    let square = residuals[..kept].iter().sum::<f64>() / kept.max(1) as f64;
    (size > 0.0 && variance > 0.0).then(|| Shading {
        residual: (square / size).sqrt(),
        explained: 1.0 - square / variance,
    })
}
