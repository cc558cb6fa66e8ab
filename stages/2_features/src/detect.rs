//! SIFT keypoints of one photo.
//!
//! Linear intensities are encoded as `v = 255 I^{1/2.2}` (8 bit, what OpenCV's SIFT takes), a
//! photo above the memory bound is halved first, and keypoints are kept evenly over a grid.
//!
//! Departure from OpenCV: its SIFT (4.6) doubles the image so that pixel `x` lands on `2x + ½` but
//! maps back by `x/2`; every keypoint is ¼ px too far right and down. That offset is taken out:
//! left in, it acts as a shift of the principal point and bends the poses.

use crate::descriptors::root_sift;
use crate::error::FeaturesError;
use crate::options::{FeaturesOptions, KeypointRegion};
use crate::polarity::{BlobPolarity, halve};
use crate::retention::spread_over_grid;
use opencv::core::{self, KeyPoint, Mat, Vector};
use opencv::features2d::SIFT;
use opencv::prelude::{Feature2DTrait, KeyPointTraitConst, MatTraitConstManual};
use rilievo_scene::{Keypoint, LinearImage, Photo, PhotoKeypoints, Raster};
use std::sync::Once;

/// Shift of OpenCV 4.6's SIFT positions, pixels of the image that it was given.
const OPENCV_SIFT_OFFSET_PX: f32 = 0.25;

/// Exponent of the encoding: lifts the shadows, where a matte object has its faint texture.
const ENCODING_GAMMA: f32 = 1.0 / 2.2;

/// Ratio of principal curvatures above which a keypoint counts as an edge: larger than OpenCV's 10,
/// since a plain object has few keypoints.
const EDGE_THRESHOLD: f64 = 15.0;

/// Cells along the longer side of the photo; keypoints are kept evenly per cell, so that one busy
/// corner does not use up the budget.
const NUM_GRID_CELLS: f32 = 16.0;

/// Finds the keypoints of one photo, over the whole frame.
///
/// # Errors
/// When the pixels cannot be read or OpenCV fails.
pub fn detect(photo: &Photo, options: &FeaturesOptions) -> Result<PhotoKeypoints, FeaturesError> {
    options.validate()?;
    let image = photo.linear()?;
    let (encoded, scale) = encode(&image, options.max_detection_mpx);
    drop(image);
    let (found, descriptors) = sift(&encoded, options)?;
    // Pixel x of a halved image covers 2x and 2x + 1 of the photo.
    let to_photo = |v: f32| (v - OPENCV_SIFT_OFFSET_PX + 0.5) * scale - 0.5;
    let only_object = options.region == KeypointRegion::Object && photo.mask.is_some();
    let all: Vec<Keypoint> = found
        .iter()
        .map(|k| {
            let (x, y) = (to_photo(k.pt().x), to_photo(k.pt().y));
            Keypoint {
                x,
                y,
                size_px: k.size() * scale,
                angle_rad: k.angle().to_radians(),
                response: k.response(),
                // Looked at below, for those that are kept.
                bright: false,
                on_object: photo
                    .mask
                    .as_ref()
                    .is_some_and(|m| m.contains(x.round() as isize, y.round() as isize)),
            }
        })
        .collect();
    let (keypoints, rows): (Vec<Keypoint>, Vec<usize>) = all
        .into_iter()
        .zip(0..)
        .filter(|(k, _)| k.on_object || !only_object)
        .unzip();
    let longer = photo.intrinsics.width.max(photo.intrinsics.height);
    let kept = spread_over_grid(
        &keypoints,
        longer as f32 / NUM_GRID_CELLS,
        options.max_num_keypoints,
    );
    let mut polarity = BlobPolarity::new(&encoded);
    let mut is_bright = |found: &KeyPoint| {
        let at = |v: f32| v - OPENCV_SIFT_OFFSET_PX;
        polarity.is_bright(at(found.pt().x), at(found.pt().y), 0.5 * found.size())
    };
    Ok(PhotoKeypoints {
        descriptors: kept
            .iter()
            .flat_map(|&k| root_sift(&descriptors[rows[k] * 128..(rows[k] + 1) * 128]))
            .collect(),
        keypoints: kept
            .iter()
            .map(|&k| Keypoint {
                bright: is_bright(&found[rows[k]]),
                ..keypoints[k]
            })
            .collect(),
    })
}

/// 8-bit encoding of a linear photo, halved until it fits the bound; with the photo's pixels per
/// pixel of the result.
fn encode(image: &LinearImage, max_mpx: f64) -> (Raster<u8>, f32) {
    let mut grey = image.to_grey();
    let mut scale = 1.0;
    while (grey.width * grey.height) as f64 > max_mpx * 1e6 {
        grey = halve(&grey);
        scale *= 2.0;
    }
    let encoded = Raster {
        width: grey.width,
        height: grey.height,
        data: grey
            .data
            .iter()
            .map(|v| (255.0 * v.clamp(0.0, 1.0).powf(ENCODING_GAMMA)).round() as u8)
            .collect(),
    };
    (encoded, scale)
}

/// OpenCV's SIFT; the only place that holds its matrices.
fn sift(
    image: &Raster<u8>,
    options: &FeaturesOptions,
) -> Result<(Vec<KeyPoint>, Vec<f32>), FeaturesError> {
    let failed = |source| FeaturesError::OpenCv {
        action: "detect SIFT keypoints",
        source,
    };
    // The program runs photos in parallel itself. Setting the number ends and starts OpenCV's threads, which
    // must not happen twice at the same time.
    static ONE_THREAD: Once = Once::new();
    let mut outcome = Ok(());
    ONE_THREAD.call_once(|| outcome = core::set_num_threads(1));
    outcome.map_err(failed)?;
    let input =
        Mat::new_rows_cols_with_data(image.height as i32, image.width as i32, &image.data[..])
            .map_err(failed)?;
    // The grid needs more than it keeps, or busy places crowd out faint ones before it sees them.
    let num_features = i32::try_from(options.max_num_keypoints * 2).unwrap_or(i32::MAX);
    let mut detector = SIFT::create(
        num_features,
        3,
        options.contrast_threshold,
        EDGE_THRESHOLD,
        1.6,
    )
    .map_err(failed)?;
    let mut keypoints = Vector::<KeyPoint>::new();
    let mut descriptors = Mat::default();
    detector
        .detect_and_compute(
            &input,
            &core::no_array(),
            &mut keypoints,
            &mut descriptors,
            false,
        )
        .map_err(failed)?;
    if keypoints.is_empty() {
        return Ok((Vec::new(), Vec::new()));
    }
    let values = descriptors.data_typed::<f32>().map_err(failed)?.to_vec();
    Ok((keypoints.iter().collect(), values))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::{FocalSource, Intrinsics, Mask};
    use std::sync::{Arc, Barrier};

    const BLOBS: [(f64, f64, f64); 4] = [
        (40.3, 37.8, 4.0),
        (90.7, 40.2, 5.0),
        (60.0, 90.5, 7.0),
        (110.4, 95.1, 3.0),
    ];

    fn photo(scale: usize) -> Photo {
        let (width, height) = (150 * scale, 130 * scale);
        let mut image = LinearImage::filled(width, height, 1, 0.2);
        for y in 0..height {
            for x in 0..width {
                // Positions and widths of the small photo; pixel centres at integers.
                let to_small = |v: usize| (v as f64 + 0.5) / scale as f64 - 0.5;
                for (bx, by, sigma) in BLOBS {
                    let r2 = (to_small(x) - bx).powi(2) + (to_small(y) - by).powi(2);
                    image.pixel_mut(x, y)[0] += 0.5 * (-r2 / (2.0 * sigma * sigma)).exp() as f32;
                }
            }
        }
        let camera = Intrinsics::pinhole(width, height, 200.0, 75.0, 65.0);
        Photo {
            focal_source: FocalSource::Guess,
            mask: Some(Arc::new(
                Mask::from_fn(width, height, |x, _| x < 75 * scale).packed(),
            )),
            ..rilievo_synthetic::testing::photo("blobs.png", image, camera)
        }
    }

    fn nearest(found: &PhotoKeypoints, x: f64, y: f64) -> (f64, &Keypoint) {
        let distance = |k: &Keypoint| (f64::from(k.x) - x).hypot(f64::from(k.y) - y);
        let keypoint = found
            .keypoints
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .unwrap();
        (distance(keypoint), keypoint)
    }

    #[test]
    fn blobs_are_found_where_they_are() {
        let found = detect(&photo(1), &FeaturesOptions::default()).unwrap();
        for (x, y, _) in BLOBS {
            let (distance, keypoint) = nearest(&found, x, y);
            assert!(distance < 0.1, "blob at ({x}, {y}): {distance} px off");
            assert_eq!(keypoint.on_object, x < 75.0);
            assert!(keypoint.bright, "blob at ({x}, {y})");
        }
        assert_eq!(found.descriptors.len(), 128 * found.keypoints.len());
    }

    #[test]
    fn photos_are_searched_at_the_same_time() {
        const NUM_THREADS: usize = 8;
        let (photo, options) = (photo(1), FeaturesOptions::default());
        let expected = detect(&photo, &options).unwrap();
        let together = Barrier::new(NUM_THREADS);
        std::thread::scope(|scope| {
            for _ in 0..NUM_THREADS {
                scope.spawn(|| {
                    for _ in 0..25 {
                        together.wait();
                        assert_eq!(detect(&photo, &options).unwrap(), expected);
                    }
                });
            }
        });
    }

    #[test]
    fn the_mask_can_bound_the_keypoints() {
        let options = FeaturesOptions {
            region: KeypointRegion::Object,
            ..FeaturesOptions::default()
        };
        let found = detect(&photo(1), &options).unwrap();
        assert!(!found.keypoints.is_empty());
        assert!(found.keypoints.iter().all(|k| k.on_object));
        assert_eq!(found.descriptors.len(), 128 * found.keypoints.len());
        let all = detect(&photo(1), &FeaturesOptions::default()).unwrap();
        let same = all
            .keypoints
            .iter()
            .position(|k| *k == found.keypoints[0])
            .unwrap();
        assert_eq!(
            all.descriptors[same * 128..(same + 1) * 128],
            found.descriptors[..128]
        );
    }

    #[test]
    fn a_halved_photo_keeps_positions_in_the_frame_of_the_full_one() {
        let options = FeaturesOptions {
            max_detection_mpx: 0.02,
            ..FeaturesOptions::default()
        };
        let found = detect(&photo(2), &options).unwrap();
        for (x, y, _) in BLOBS {
            let (distance, _) = nearest(&found, 2.0 * x + 0.5, 2.0 * y + 0.5);
            assert!(distance < 0.2, "blob at ({x}, {y}): {distance} px off");
        }
    }
}
