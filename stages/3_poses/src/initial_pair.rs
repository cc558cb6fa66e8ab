//! Choice of the first pair.
//!
//! Each match in front of both cameras counts `min(1, angle / 16°)`; the sum is multiplied by
//! `1 − ½ h` with `h` the share that a homography explains, so that many, well-conditioned points
//! off a plane win. Pairs under `min_initial_angle_deg` take part only where there is no wider one.

use crate::error::PosesError;
use crate::options::PosesOptions;
use crate::relative_pose::{self, RelativePose};
use crate::scene::Scene;
use nalgebra::Point2;
use rayon::prelude::*;
use rilievo_numerics::robust::median;

/// Angle beyond which a wider one does not improve a point any more, degrees.
const SATURATION_ANGLE_DEG: f64 = 16.0;
/// Homography share from which a pair counts as a pure rotation or a flat scene.
const MAX_HOMOGRAPHY_SHARE: f64 = 0.97;
/// Median angle of a pair over the smallest angle of a point, below which the pair is no start even
/// where there is no wider one: most of its points would be dropped.
const LEAST_ANGLE_OVER_POINTS: f64 = 2.0;

/// A pair to start from.
pub struct InitialPair {
    /// First photo.
    pub first: usize,
    /// Second photo.
    pub second: usize,
    /// Relative pose.
    pub pose: RelativePose,
    /// The larger the better.
    pub score: f64,
}

/// Pairs to start from, best first.
///
/// # Errors
/// A named reason when there is none.
pub fn candidates(
    scene: &Scene<'_>,
    available: &[bool],
    options: &PosesOptions,
) -> Result<Vec<InitialPair>, PosesError> {
    let usable: Vec<_> = scene
        .matches
        .pairs
        .iter()
        .filter(|p| available[p.first.0] && available[p.second.0])
        .collect();
    let enough: Vec<_> = usable
        .iter()
        .filter(|p| p.matches.len() >= options.min_num_initial_inliers)
        .collect();
    if enough.is_empty() {
        return Err(PosesError::NoMatches {
            num_photos: scene.num_photos(),
            best: usable.iter().map(|p| p.matches.len()).max().unwrap_or(0),
            needed: options.min_num_initial_inliers,
        });
    }
    let spatial: Vec<_> = enough
        .iter()
        .filter(|p| p.homography_share < MAX_HOMOGRAPHY_SHARE)
        .collect();
    if spatial.is_empty() {
        let least = enough
            .iter()
            .map(|p| p.homography_share)
            .fold(1.0, f64::min);
        return Err(PosesError::OnlyHomographies {
            num_pairs: enough.len(),
            least_share: 100.0 * least,
        });
    }
    let posed: Vec<(InitialPair, f64)> = spatial
        .par_iter()
        .filter_map(|pair| {
            let (first, second) = (pair.first.0, pair.second.0);
            let normalized = |photo: usize, side: usize| -> Vec<Point2<f64>> {
                let camera = &scene.cameras[scene.camera_of[photo]].initial;
                pair.matches
                    .iter()
                    .map(|m| camera.normalized(&scene.pixels[photo][m[side] as usize]))
                    .collect()
            };
            let pose = relative_pose::from_essential(
                &pair.essential?,
                &normalized(first, 0),
                &normalized(second, 1),
            )?;
            let saturation = SATURATION_ANGLE_DEG.to_radians();
            let sum: f64 = pose
                .angles_rad
                .iter()
                .map(|a| (a / saturation).min(1.0))
                .sum();
            let angle = median(&mut pose.angles_rad.clone()).unwrap_or(0.0);
            let score = sum * (1.0 - 0.5 * pair.homography_share);
            let candidate = InitialPair {
                first,
                second,
                pose,
                score,
            };
            Some((candidate, angle.to_degrees()))
        })
        .collect();
    // Poses hold under much smaller angles than depth would like; only where no pair is wide
    // enough may a narrow one begin.
    let enough_points =
        |p: &InitialPair| p.pose.angles_rad.len() >= options.min_num_initial_inliers;
    let least_angle_deg = (LEAST_ANGLE_OVER_POINTS * options.min_triangulation_angle_deg)
        .min(options.min_initial_angle_deg);
    let is_wide = |(p, angle): &(InitialPair, f64)| {
        enough_points(p) && *angle >= options.min_initial_angle_deg
    };
    let needed_angle_deg = if posed.iter().any(is_wide) {
        options.min_initial_angle_deg
    } else {
        least_angle_deg
    };
    let (best_points, best_angle_deg) = best_of(&posed, options.min_num_initial_inliers);
    let mut good: Vec<InitialPair> = posed
        .into_iter()
        .filter(|(p, angle)| enough_points(p) && *angle >= needed_angle_deg)
        .map(|(p, _)| p)
        .collect();
    if good.is_empty() {
        return Err(PosesError::NoInitialPair {
            num_pairs: spatial.len(),
            best_points,
            best_angle_deg,
            needed_points: options.min_num_initial_inliers,
            needed_angle_deg,
        });
    }
    good.sort_by(|a, b| {
        b.score
            .total_cmp(&a.score)
            .then((a.first, a.second).cmp(&(b.first, b.second)))
    });
    Ok(good)
}

/// Points and angle of the pair that is told when there is no start: the widest of those with enough
/// points, else that with the most points, since the angle of a few says little.
fn best_of(posed: &[(InitialPair, f64)], enough: usize) -> (usize, f64) {
    posed
        .iter()
        .map(|(pair, angle)| (pair.pose.angles_rad.len(), *angle))
        .max_by(|a, b| {
            let points = a.0.min(enough).cmp(&b.0.min(enough));
            points.then(a.1.total_cmp(&b.1))
        })
        .unwrap_or((0, 0.0))
}
