//! Errors of stage 3.

use rilievo_scene::{Inconsistent, Observer, OptionError, PixelError, StageId, TeamError};

/// Why stage 3 failed.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// An option is out of range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// What an earlier stage left contradicts itself.
    #[error(transparent)]
    Inconsistent(#[from] Inconsistent),
    /// Poses need at least two photos.
    #[error(
        "{num_photos} usable photo(s), at least 2 are needed; add photos from other directions"
    )]
    TooFewPhotos {
        /// Usable photos.
        num_photos: usize,
    },
    /// No two photos have enough matches in common.
    #[error(
        "no two of {num_photos} photos match (best pair: {best} matches, {needed} needed); take photos closer together, 10 to 20 degrees apart, put a printed mat under the object, or have fainter texture used (features.contrast_threshold = 0.005 in the file of --config)"
    )]
    NoMatches {
        /// Photos in the set.
        num_photos: usize,
        /// Matches of the best pair.
        best: usize,
        /// Matches needed.
        needed: usize,
    },
    /// Most matches do not move in the frame.
    #[error(
        "{percent:.0} % of all matches stand still in the frame: where the object turns before a background that stands \
         still (a turntable), give masks (--masks) with features.region = \"object\" in the file of --config, or cover \
         the background, or put a printed mat under the object that turns with it; where the camera stood still, or \
         photos are copies of one, take them 10 to 20 degrees apart"
    )]
    StandsStill {
        /// Share of the matches, per cent.
        percent: f64,
    },
    /// Every pair that matches is explained by a homography.
    #[error(
        "all {num_pairs} matching pairs show a pure rotation or a flat scene (a homography explains {least_share:.0} % or more of their matches); move the camera sideways between photos, or give poses that are known (--cameras)"
    )]
    OnlyHomographies {
        /// Pairs with enough matches.
        num_pairs: usize,
        /// Smallest homography share, per cent.
        least_share: f64,
    },
    /// No pair gives enough well-conditioned points to start from.
    #[error(
        "none of {num_pairs} matching pairs gives a start: best has {best_points} points at {best_angle_deg:.1} degrees, needed are {needed_points} at {needed_angle_deg:.1}; {}, or give poses that are known (--cameras)",
        pair_advice(*.best_points >= *.needed_points, *.best_angle_deg >= *.needed_angle_deg)
    )]
    NoInitialPair {
        /// Pairs tried.
        num_pairs: usize,
        /// Points of the best pair: the widest of those with enough points, else that with the most.
        best_points: usize,
        /// Its median triangulation angle, degrees.
        best_angle_deg: f64,
        /// Points needed.
        needed_points: usize,
        /// Angle needed, degrees.
        needed_angle_deg: f64,
    },
    /// Pairs began well, but their points do not hold.
    #[error(
        "none of {num_pairs} pairs to start from holds: at most {best_points} of their points agree with the cameras' poses, {needed_points} are needed; take photos closer together, 10 to 20 degrees apart, with more texture in the picture, and give the focal length where it is known (--cameras, photos.focal_35mm)"
    )]
    NoStableStart {
        /// Pairs tried.
        num_pairs: usize,
        /// Most points that stayed.
        best_points: usize,
        /// Points needed.
        needed_points: usize,
    },
    /// Given poses contradict the photos.
    #[error(
        "the given cameras do not explain the matches ({share_consistent:.0} % agree); {hint}; or have the poses found \
         from the photos (poses.given_poses = \"ignore\" in the file of --config)"
    )]
    GivenPosesInconsistent {
        /// Share of verified matches consistent with the given poses, per cent.
        share_consistent: f64,
        /// Which convention explains them, or what to try.
        hint: String,
    },
    /// Given poses without a baseline.
    #[error(
        "the given cameras all stand at one place ({:.4}, {:.4}, {:.4}): cameras at one place determine no \
         depth, whatever they see; check the camera centres, or have the poses found from the \
         photos (poses.given_poses = \"ignore\" in the file of --config)", place[0], place[1], place[2]
    )]
    GivenPosesAtOnePlace {
        /// Their common centre.
        place: [f64; 3],
    },
    /// The measured distance cannot be found in the model.
    #[error("the known distance cannot be used: {reason} (--known-distance)")]
    KnownDistance {
        /// Which photo or point, and why.
        reason: String,
    },
    /// A photo could not be read.
    #[error(transparent)]
    Pixels(#[from] PixelError),
    /// The bundle adjustment broke down.
    #[error("bundle adjustment of {num_views} views failed: {reason}")]
    Adjustment {
        /// Views in the problem.
        num_views: usize,
        /// What happened.
        reason: String,
    },
    /// Another process of the run failed.
    #[error(transparent)]
    Team(#[from] TeamError),
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// What to do where the best pair is no start: which condition failed decides it, for photos too far
/// apart and photos too close together fail alike.
fn pair_advice(enough_points: bool, wide_enough: bool) -> &'static str {
    match (enough_points, wide_enough) {
        (true, _) => "move further between photos, 10 to 20 degrees",
        (false, true) => {
            "too few points are in both photos: take photos closer together, 10 to 20 degrees apart, \
             or put a printed mat under the object"
        }
        (false, false) => {
            "the match is poor, so that neither its points nor their angle can be trusted: take photos \
             10 to 20 degrees apart, with more texture in the picture (a printed mat)"
        }
    }
}

/// Warns; the stage goes on.
pub(crate) fn warn(observer: &dyn Observer, message: String) -> Result<(), PosesError> {
    let flow = observer.warn(StageId::Poses, message);
    flow.ok_or(PosesError::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(best_points: usize, best_angle_deg: f64) -> String {
        let error = PosesError::NoInitialPair {
            num_pairs: 3,
            best_points,
            best_angle_deg,
            needed_points: 30,
            needed_angle_deg: 3.0,
        };
        error.to_string()
    }

    #[test]
    fn every_message_names_the_option_that_helps() {
        let known = "cameras".to_owned();
        let cases = [
            (
                PosesError::NoMatches {
                    num_photos: 3,
                    best: 2,
                    needed: 30,
                },
                "features.contrast_threshold",
            ),
            (
                PosesError::StandsStill { percent: 90.0 },
                "features.region = \"object\"",
            ),
            (
                PosesError::OnlyHomographies {
                    num_pairs: 3,
                    least_share: 98.0,
                },
                "--cameras",
            ),
            (
                PosesError::NoStableStart {
                    num_pairs: 3,
                    best_points: 4,
                    needed_points: 15,
                },
                "photos.focal_35mm",
            ),
            (
                PosesError::GivenPosesInconsistent {
                    share_consistent: 20.0,
                    hint: known.clone(),
                },
                "poses.given_poses = \"ignore\"",
            ),
            (
                PosesError::GivenPosesAtOnePlace { place: [0.0; 3] },
                "poses.given_poses = \"ignore\"",
            ),
            (
                PosesError::KnownDistance { reason: known },
                "--known-distance",
            ),
        ];
        for (error, option) in cases {
            assert!(error.to_string().contains(option), "{error}");
        }
        assert!(told(200, 0.4).contains("--cameras"));
    }

    #[test]
    fn the_advice_follows_from_the_condition_that_failed() {
        assert!(told(200, 0.4).contains("move further"));
        assert!(told(27, 20.0).contains("closer together"));
        // Under so few points an angle is a guess: which way to go cannot be said.
        let poor = told(27, 1.7);
        assert!(
            poor.contains("match is poor") && !poor.contains("further"),
            "{poor}"
        );
    }
}
