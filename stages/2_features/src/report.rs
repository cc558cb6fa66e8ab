//! Facts about a run of stage 2.

use rilievo_scene::{PairMatches, PhotoIdx};
use serde::{Deserialize, Serialize};

/// Keypoints of one photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoFeatures {
    /// The photo's file name.
    pub file_name: String,
    /// Keypoints kept.
    pub num_keypoints: usize,
    /// Of these, on the object.
    pub num_on_object: usize,
    /// Pairs in which the photo has verified matches.
    pub num_pairs: usize,
}

/// Matches of one pair that was matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairReport {
    /// First photo.
    pub first: PhotoIdx,
    /// Second photo.
    pub second: PhotoIdx,
    /// Matches after ratio and mutual test.
    pub num_putative: usize,
    /// Matches that agree with the pair's geometry; 0 where the pair was dropped.
    pub num_verified: usize,
    /// Matches that were left out since they stand still in the frame while others move.
    #[serde(default)]
    pub num_standing: usize,
    /// Share of the verified matches that a homography explains as well.
    pub homography_share: f64,
}

impl PairReport {
    /// The facts of a pair's matches.
    pub(crate) fn of(pair: &PairMatches) -> Self {
        Self {
            first: pair.first,
            second: pair.second,
            num_putative: pair.num_putative,
            num_verified: pair.matches.len(),
            num_standing: pair.standing.len(),
            homography_share: pair.homography_share,
        }
    }
}

/// Facts about a run of stage 2.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeaturesReport {
    /// One entry per photo.
    pub photos: Vec<PhotoFeatures>,
    /// One entry per pair that was matched; pairs that few keypoints ruled out have none.
    pub pairs: Vec<PairReport>,
}
