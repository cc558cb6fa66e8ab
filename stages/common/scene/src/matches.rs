//! Output of stage 2: keypoints and geometrically verified matches.

use crate::camera::Intrinsics;
use crate::ids::PhotoIdx;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// A SIFT keypoint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Keypoint {
    /// Column, pixels (centres at integers).
    pub x: f32,
    /// Row, pixels.
    pub y: f32,
    /// Diameter of the meaningful neighbourhood, pixels.
    pub size_px: f32,
    /// Orientation, radians from +x towards +y.
    pub angle_rad: f32,
    /// Detector response.
    pub response: f32,
    /// Whether the blob is brighter than its surroundings.
    pub bright: bool,
    /// Whether it lies on the object's mask.
    pub on_object: bool,
}

/// Motion in the frame up to which a match stands still, of the photo's longer side: at 480 pixels JPEG moves 19 of 20
/// keypoints of a picture that is the same by less than this pixel.
const STILL_SHARE: f64 = 1.0 / 500.0;
/// The same in pixels, at least.
const MIN_STILL_PX: f64 = 1.0;

/// How far a match moves in the frame, over how far one that stands still seems to move at most; infinite between
/// photos of different sizes.
pub fn motion_in_frame(
    [first, second]: [&Keypoint; 2],
    [first_camera, second_camera]: [&Intrinsics; 2],
) -> f64 {
    let (width, height) = (first_camera.width, first_camera.height);
    if (width, height) != (second_camera.width, second_camera.height) {
        return f64::INFINITY;
    }
    let still_px = (STILL_SHARE * width.max(height) as f64).max(MIN_STILL_PX);
    f64::from((first.x - second.x).hypot(first.y - second.y)) / still_px
}

/// Keypoints of one photo with their descriptors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotoKeypoints {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// `128 * keypoints.len()` RootSIFT values, quantised to 0..=255.
    pub descriptors: Vec<u8>,
}

/// Verified matches of one pair of photos.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairMatches {
    /// First photo, the smaller index.
    pub first: PhotoIdx,
    /// Second photo.
    pub second: PhotoIdx,
    /// Keypoint indices `(in first, in second)` that agree with the pair's geometry.
    pub matches: Vec<[u32; 2]>,
    /// Essential matrix `x2ᵀ E x1 = 0` on normalised coordinates, where one fits.
    pub essential: Option<Matrix3<f64>>,
    /// Share of the matches that a homography explains as well: near 1 means a planar or
    /// purely rotating pair, a bad start for a reconstruction.
    pub homography_share: f64,
    /// Matches before verification.
    pub num_putative: usize,
    /// Matches that were left out since they stand still in the frame while others move.
    pub standing: Vec<[u32; 2]>,
}

/// Keypoints of all photos and verified matches of all pairs that have any.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeatureMatches {
    /// One entry per photo, in the order of the photo set.
    pub photos: Vec<PhotoKeypoints>,
    /// Pairs ordered by `(first, second)`.
    pub pairs: Vec<PairMatches>,
}
