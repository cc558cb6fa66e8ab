//! Options of stage 2.

use rilievo_scene::{OptionError, RetiredKey, check_ranges};
use serde::{Deserialize, Serialize};

/// Which keypoints determine the poses.
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

/// How many pairs are tried.
#[derive(Clone, Debug, PartialEq)]
pub struct PairLimits {
    /// Up to this many photos `auto` tries all pairs.
    pub max_num_exhaustive_photos: usize,
    /// Neighbours in the order of names, before and after each photo, that `sequential` and `auto`
    /// pair it with.
    pub num_sequential_neighbors: usize,
    /// Most similar photos that `auto` pairs each photo with at first.
    pub num_similar_neighbors: usize,
}

/// Of a ring of photos, 10 to 20 degrees apart, each matches the few on either side; all pairs of
/// twenty photos are 190.
impl Default for PairLimits {
    fn default() -> Self {
        Self {
            max_num_exhaustive_photos: 20,
            num_sequential_neighbors: 8,
            num_similar_neighbors: 12,
        }
    }
}

/// Keys that the table `[features]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    RetiredKey::new(
        &["edge_threshold"],
        "it is fixed at 15; `features.contrast_threshold` decides how many keypoints there are",
    ),
    RetiredKey::new(&["num_grid_cells"], "it is fixed at 16"),
    RetiredKey::new(
        &["max_verified_ratio"],
        "it is fixed at 0.9, or `features.max_ratio` where that is larger",
    ),
    RetiredKey::new(&["max_epipolar_error_px"], "it is fixed at 3 px"),
    RetiredKey::new(&["min_num_inliers"], "it is fixed at 15"),
    RetiredKey::new(
        &["max_num_exhaustive_photos"],
        "it is fixed at 20; say which pairs are matched by `features.pairs` or --pairs",
    ),
    RetiredKey::new(
        &["num_sequential_neighbors"],
        "it is fixed at 8; list the pairs by --pairs FILE",
    ),
    RetiredKey::new(
        &["num_similar_neighbors"],
        "it is fixed at 12; list the pairs by --pairs FILE",
    ),
    RetiredKey::new(&["max_num_ransac_samples"], "it is fixed at 2000"),
];

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
    /// Photos with more megapixels are halved before detection; bounds memory (about 180 bytes
    /// per pixel).
    pub max_detection_mpx: f64,
    /// Largest ratio of the best to the second-best descriptor distance of the matches that find a
    /// pair's geometry; nearer to 1 admits ambiguous ones, and RANSAC takes long.
    pub max_ratio: f64,
    /// Which pairs are matched.
    pub pairs: PairChoice,
    /// How many they are.
    #[serde(skip)]
    pub pair_limits: PairLimits,
}

impl Default for FeaturesOptions {
    fn default() -> Self {
        Self {
            region: KeypointRegion::Photo,
            max_num_keypoints: 8000,
            contrast_threshold: 0.01,
            max_detection_mpx: 8.0,
            max_ratio: 0.8,
            pairs: PairChoice::Auto,
            pair_limits: PairLimits::default(),
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
            max_detection_mpx in 0.001..=1e4,
            max_ratio in 0.01..=1.0,
        )
    }
}
