//! Options of stage 2.

use rilievo_scene::{OptionError, RetiredKey, check_ranges};
use serde::{Deserialize, Serialize};

/// Which keypoints tell the poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeypointRegion {
    /// The whole photo: the surroundings stand still together with the object.
    #[default]
    Photo,
    /// The object's mask only: the object turns before a background that does not (a turntable).
    Object,
}

/// Which pairs of photos are matched.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairChoice {
    /// All pairs of small sets. Of larger ones those that look alike, and those that follow from what matched.
    #[default]
    Auto,
    /// All pairs.
    All,
    /// Each photo with its neighbours in the order of names; the last ones with the first.
    Sequential,
    /// These pairs, by the photos' file names.
    Listed(Vec<[String; 2]>),
}

/// Keys that the table `[features]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[];

/// How keypoints are found and matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FeaturesOptions {
    /// Which keypoints are used; `object` needs masks, photos without one use all.
    pub region: KeypointRegion,
    /// Keypoints kept per photo; more cost matching time (quadratic), fewer lose weak anchors.
    pub max_num_keypoints: usize,
    /// Contrast below which SIFT drops a keypoint (OpenCV's scale, its default is 0.04). Plain
    /// objects need a low one; below 0.005 only the cost grows.
    pub contrast_threshold: f64,
    /// Ratio of principal curvatures above which a keypoint counts as an edge; larger keeps more.
    pub edge_threshold: f64,
    /// Cells along the longer side of the photo; keypoints are kept evenly per cell, so that one
    /// busy corner does not use up the budget.
    pub num_grid_cells: usize,
    /// Photos with more megapixels are halved before detection; bounds memory (about 180 bytes
    /// per pixel).
    pub max_detection_mpx: f64,
    /// Largest ratio of the best to the second-best descriptor distance of the matches that find a
    /// pair's geometry; nearer to 1 admits ambiguous ones, and RANSAC takes long.
    pub max_ratio: f64,
    /// The same for further matches, which are taken where they agree with the geometry found.
    /// Wide baselines live on them; below `max_ratio` there are none.
    pub max_verified_ratio: f64,
    /// Largest distance from the epipolar line, pixels.
    pub max_epipolar_error_px: f64,
    /// Pairs with fewer verified matches are dropped.
    pub min_num_inliers: usize,
    /// Which pairs are matched.
    pub pairs: PairChoice,
    /// Up to this many photos `auto` tries all pairs.
    pub max_num_exhaustive_photos: usize,
    /// Neighbours in the order of names, before and after each photo, that `sequential` and `auto` pair it with.
    pub num_sequential_neighbors: usize,
    /// Most similar photos that `auto` pairs each photo with at first.
    pub num_similar_neighbors: usize,
    /// Largest number of RANSAC samples per pair.
    pub max_num_ransac_samples: usize,
}

impl Default for FeaturesOptions {
    fn default() -> Self {
        Self {
            region: KeypointRegion::Photo,
            max_num_keypoints: 8000,
            contrast_threshold: 0.01,
            edge_threshold: 15.0,
            num_grid_cells: 16,
            max_detection_mpx: 8.0,
            max_ratio: 0.8,
            max_verified_ratio: 0.9,
            max_epipolar_error_px: 3.0,
            min_num_inliers: 15,
            pairs: PairChoice::Auto,
            max_num_exhaustive_photos: 20,
            num_sequential_neighbors: 8,
            num_similar_neighbors: 12,
            max_num_ransac_samples: 2000,
        }
    }
}

impl FeaturesOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        check_ranges!(
            self;
            max_num_keypoints in 8..=1_000_000,
            contrast_threshold in 1e-6..=0.99,
            edge_threshold in 1.01..=1e6,
            num_grid_cells in 1..=1000,
            max_detection_mpx in 0.001..=1e4,
            max_ratio in 0.01..=1.0,
            max_verified_ratio in 0.01..=1.0,
            max_epipolar_error_px in 0.01..=1000.0,
            min_num_inliers in 8..=1_000_000,
            max_num_exhaustive_photos in 0..=1_000_000,
            num_sequential_neighbors in 1..=1_000_000,
            num_similar_neighbors in 0..=1_000_000,
            max_num_ransac_samples in 1..=10_000_000,
        )
    }
}
