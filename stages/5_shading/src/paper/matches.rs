//! Matches between posed views become depth anchors of both.
//!
//! **Problem.** A match of pixels `x₁, x₂` of calibrated views determines both depths,
//!
//! ```text
//! min over z₁, z₂ of |z₁ R₁ r₁ + c₁ − z₂ R₂ r₂ − c₂|²,        (eq. 15, three equations)
//! ```
//!
//! `r = [x̃/f, ỹ/f, 1]` the pixel's ray, `R` world from camera, `c` the camera's centre. The gap that
//! remains, in pixels, is free of the surface: its robust spread over all matches is the noise of a
//! match, and a gap beyond four times that marks a false one. Along the ray the noise acts with the
//! triangulation angle `α`: `σ(ln z₁) = σ_px/f · (z₂/z₁) √(1 + cos²α)/sin α`.
//!
//! Source: Quéau et al., ICCV 2017 (`queau2017`), eq. 13–15.

use super::problem::{DepthAnchor, ShadingProblem, ShadingView};
use crate::error::ShadingError;
use nalgebra::{Point2, Vector3};
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};

/// Least noise of a match in pixels: below it, bilinear reading of the surface decides.
const MIN_NOISE_PX: f64 = 0.02;
/// A gap beyond this many deviations, and beyond the floor below, is a false match.
const MAX_DEVIATIONS: f64 = 4.0;
/// Gaps below this many pixels are never false.
const MIN_FALSE_GAP_PX: f64 = 0.2;
/// Sine of the smallest triangulation angle: half a degree.
const MIN_SINE: f64 = 0.0087;

/// Anchors by view, and what became of the matches.
#[derive(Clone, Debug, Default)]
pub(crate) struct MatchAnchors {
    pub(crate) by_view: Vec<Vec<DepthAnchor>>,
    pub(crate) num_matches: usize,
    pub(crate) num_rejected: usize,
    pub(crate) sigma_px: Option<f64>,
}

#[derive(Clone, Debug)]
struct Triangulated {
    views: [usize; 2],
    pixels: [[f64; 2]; 2],
    depths: [f64; 2],
    gap_px: f64,
    // σ(ln z) for one pixel of noise.
    unit_sigma: [f64; 2],
}

fn triangulate(
    views: [usize; 2],
    pair: [&ShadingView; 2],
    poses: [&rilievo_scene::RigidTransform; 2],
    pixel: &[f64; 4],
) -> Option<Triangulated> {
    let pixels = [[pixel[0], pixel[1]], [pixel[2], pixel[3]]];
    let ray = |k: usize| -> Vector3<f64> {
        let camera = &pair[k].intrinsics;
        poses[k].rotation.inverse() * camera.ray(&Point2::new(pixels[k][0], pixels[k][1]))
    };
    let (a, b) = (ray(0), ray(1));
    let baseline = poses[1].center_in_source() - poses[0].center_in_source();
    // Normal equations of z₁ a − z₂ b = baseline.
    let (aa, ab, bb) = (a.dot(&a), a.dot(&b), b.dot(&b));
    let determinant = aa * bb - ab * ab;
    let sine = (determinant / (aa * bb)).max(0.0).sqrt();
    if sine < MIN_SINE {
        return None;
    }
    let (ta, tb) = (a.dot(&baseline), b.dot(&baseline));
    let z1 = (bb * ta - ab * tb) / determinant;
    let z2 = (ab * ta - aa * tb) / determinant;
    if z1.is_nan() || z2.is_nan() || z1 <= 0.0 || z2 <= 0.0 {
        return None;
    }
    let gap = (a * z1 - b * z2 - baseline).norm();
    let (f1, f2) = (pair[0].intrinsics.focal_px(), pair[1].intrinsics.focal_px());
    let footprint = ((z1 / f1).powi(2) + (z2 / f2).powi(2)).sqrt();
    let cosine = ab / (aa * bb).sqrt();
    let spread = (1.0 + cosine * cosine).sqrt() / sine;
    Some(Triangulated {
        views,
        pixels,
        depths: [z1, z2],
        gap_px: gap / footprint,
        unit_sigma: [spread * z2 / (z1 * f2), spread * z1 / (z2 * f1)],
    })
}

/// Triangulates all matches of a problem.
///
/// # Errors
/// Unknown views, or matched views without a pose.
pub(crate) fn anchors(problem: &ShadingProblem) -> Result<MatchAnchors, ShadingError> {
    let num_views = problem.views.len();
    let mut out = MatchAnchors {
        by_view: vec![Vec::new(); num_views],
        ..MatchAnchors::default()
    };
    let mut all = Vec::new();
    for matches in &problem.matches {
        let [i, j] = matches.views;
        for index in [i, j] {
            if index >= num_views {
                return Err(ShadingError::UnknownView {
                    what: "a list of matches",
                    index,
                    num_views,
                });
            }
        }
        let (first, second) = (&problem.views[i], &problem.views[j]);
        let missing = |view: &ShadingView| ShadingError::MissingPose {
            first: first.name.clone(),
            second: second.name.clone(),
            missing: view.name.clone(),
        };
        let first_pose = first
            .cam_from_world
            .as_ref()
            .ok_or_else(|| missing(first))?;
        let second_pose = second
            .cam_from_world
            .as_ref()
            .ok_or_else(|| missing(second))?;
        out.num_matches += matches.pixels.len();
        all.extend(matches.pixels.iter().filter_map(|pixel| {
            triangulate([i, j], [first, second], [first_pose, second_pose], pixel)
        }));
    }
    if all.is_empty() {
        out.num_rejected = out.num_matches;
        return Ok(out);
    }
    // The gap is the distance across the epipolar plane: one-sided, median of |gap|.
    let mut gaps: Vec<f64> = all.iter().map(|t| t.gap_px).collect();
    let estimated = SIGMA_FROM_MAD * median(&mut gaps).unwrap_or(0.0);
    let sigma = estimated.max(MIN_NOISE_PX);
    out.sigma_px = Some(sigma);
    let limit = (MAX_DEVIATIONS * sigma).max(MIN_FALSE_GAP_PX);
    let mut num_used = 0;
    for t in &all {
        if t.gap_px > limit {
            continue;
        }
        num_used += 1;
        for k in 0..2 {
            out.by_view[t.views[k]].push(DepthAnchor {
                pixel: t.pixels[k],
                depth: t.depths[k],
                sigma_ln_depth: sigma * t.unit_sigma[k],
            });
        }
    }
    out.num_rejected = out.num_matches - num_used;
    Ok(out)
}
