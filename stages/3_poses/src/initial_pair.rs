//! Choice of the first pair.
//!
//! Each match in front of both cameras counts `min(1, angle / 16°)`; the sum is multiplied by
//! `1 − ½ h` with `h` the share that a homography explains, so that many, well-conditioned points
//! off a plane win. Pairs under [`MIN_ANGLE_DEG`] take part only where there is no wider one.

use crate::error::PosesError;
use crate::matched::MatchedPhotos;
use crate::relative_pose::{self, RelativePose};
use crate::triangulation::MIN_TRIANGULATION_ANGLE_DEG;
use nalgebra::Point2;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::PairMatches;

/// Least inliers of the first pair.
const MIN_NUM_INLIERS: usize = 30;
/// Median triangulation angle that the first pair should have, degrees. Where no pair has it, the
/// model begins with a narrower one, and a warning states what that costs depth (`narrow`).
pub(crate) const MIN_ANGLE_DEG: f64 = 8.0;
/// The same where no pair is wide: twice the smallest angle of a point, below which most points
/// would be dropped.
const LEAST_ANGLE_DEG: f64 = 2.0 * MIN_TRIANGULATION_ANGLE_DEG;
/// Angle beyond which a wider one does not improve a point any more, degrees.
const SATURATION_ANGLE_DEG: f64 = 16.0;
/// Homography share from which a pair counts as a pure rotation or a flat scene.
const MAX_HOMOGRAPHY_SHARE: f64 = 0.97;

pub(crate) struct InitialPair {
    pub first: usize,
    pub second: usize,
    pub pose: RelativePose,
    /// The larger the better.
    score: f64,
    /// Median angle between the rays of a match, degrees.
    angle_deg: f64,
}

impl InitialPair {
    /// A pair of photos with its relative pose; `None` without an essential matrix.
    fn of(matched: &MatchedPhotos<'_>, pair: &PairMatches) -> Option<Self> {
        let normalized = |photo: usize, side: usize| -> Vec<Point2<f64>> {
            let camera = &matched.cameras[matched.camera_of[photo]].initial;
            let pixels = pair
                .matches
                .iter()
                .map(|m| &matched.pixels[photo][m[side] as usize]);
            pixels.map(|pixel| camera.normalized(pixel)).collect()
        };
        let (first, second) = (pair.first.0, pair.second.0);
        let (x1, x2) = (normalized(first, 0), normalized(second, 1));
        let pose = relative_pose::from_essential(&pair.essential?, &x1, &x2)?;
        let saturation = SATURATION_ANGLE_DEG.to_radians();
        let angles = pose.angles_rad.iter();
        let sum: f64 = angles.map(|a| (a / saturation).min(1.0)).sum();
        let angle = median(&mut pose.angles_rad.clone()).unwrap_or(0.0);
        Some(Self {
            first,
            second,
            score: sum * (1.0 - 0.5 * pair.homography_share),
            angle_deg: angle.to_degrees(),
            pose,
        })
    }

    /// Matches in front of both cameras.
    fn num_points(&self) -> usize {
        self.pose.angles_rad.len()
    }
}

/// Pairs to start from, best first.
///
/// # Errors
/// A named reason when there is none.
pub(crate) fn candidates(
    matched: &MatchedPhotos<'_>,
    available: &[bool],
) -> Result<Vec<InitialPair>, PosesError> {
    let usable = || {
        let pairs = matched.matches.pairs.iter();
        pairs.filter(|p| available[p.first.0] && available[p.second.0])
    };
    let enough = || usable().filter(|p| p.matches.len() >= MIN_NUM_INLIERS);
    if enough().next().is_none() {
        return Err(PosesError::NoMatches {
            num_photos: matched.num_photos(),
            best: usable().map(|p| p.matches.len()).max().unwrap_or(0),
            needed: MIN_NUM_INLIERS,
        });
    }
    let is_spatial = |p: &&PairMatches| p.homography_share < MAX_HOMOGRAPHY_SHARE;
    let spatial: Vec<&PairMatches> = enough().filter(is_spatial).collect();
    if spatial.is_empty() {
        let least = enough().map(|p| p.homography_share).fold(1.0, f64::min);
        return Err(PosesError::OnlyHomographies {
            num_pairs: enough().count(),
            least_share: 100.0 * least,
        });
    }
    let posed = spatial.par_iter();
    let posed: Vec<InitialPair> = posed.filter_map(|p| InitialPair::of(matched, p)).collect();
    // Poses hold under much smaller angles than depth would like; only where no pair is wide
    // enough may a narrow one begin.
    let is_start =
        |p: &InitialPair, angle_deg| p.num_points() >= MIN_NUM_INLIERS && p.angle_deg >= angle_deg;
    let is_any_wide = posed.iter().any(|p| is_start(p, MIN_ANGLE_DEG));
    let needed_angle_deg = if is_any_wide {
        MIN_ANGLE_DEG
    } else {
        LEAST_ANGLE_DEG
    };
    let (best_points, best_angle_deg) = best_of(&posed);
    let good = posed.into_iter().filter(|p| is_start(p, needed_angle_deg));
    let mut good: Vec<InitialPair> = good.collect();
    if good.is_empty() {
        return Err(PosesError::NoInitialPair {
            num_pairs: spatial.len(),
            best_points,
            best_angle_deg,
            needed_points: MIN_NUM_INLIERS,
            needed_angle_deg,
        });
    }
    let place = |p: &InitialPair| (p.first, p.second);
    good.sort_by(|a, b| b.score.total_cmp(&a.score).then(place(a).cmp(&place(b))));
    Ok(good)
}

/// Points and angle of the pair that the error names when there is no start: the widest of those
/// with enough points, else that with the most points, since the angle of a few says little.
fn best_of(posed: &[InitialPair]) -> (usize, f64) {
    let posed = posed.iter().map(|p| (p.num_points(), p.angle_deg));
    let best = posed.max_by(|a, b| {
        let points = a.0.min(MIN_NUM_INLIERS).cmp(&b.0.min(MIN_NUM_INLIERS));
        points.then(a.1.total_cmp(&b.1))
    });
    best.unwrap_or((0, 0.0))
}
