//! Stage 2: linear photos to keypoints and verified matches.
//!
//! Per photo: SIFT keypoints over the whole frame with a low contrast threshold, spread over a
//! grid, RootSIFT descriptors in bytes ([`detect`]). Per pair: mutual nearest neighbours, among
//! bright blobs and among dark ones, that pass the ratio test find an essential matrix; those, and
//! less distinctive ones, that agree with it are kept ([`match_photos`]). Pairs are all pairs of
//! small sets, candidates of large ones.

mod candidates;
mod descriptors;
mod detect;
pub mod error;
mod matching;
pub mod options;
mod polarity;
pub mod report;
mod retention;
mod two_view;

pub use detect::detect;
pub use error::FeaturesError;
pub use options::{FeaturesOptions, KeypointRegion};
pub use report::{FeaturesReport, PairReport, PhotoFeatures};

use matching::{PhotoDescriptors, match_descriptors};
use nalgebra::Point2;
use rayon::prelude::*;
use rilievo_scene::{
    FeatureMatches, Flow, Observer, PairMatches, PhotoIdx, PhotoKeypoints, PhotoSet, StageId,
    check_descriptors, check_keypoints,
};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 3;

/// A photo with fewer keypoints than this deserves a warning.
const FEW_KEYPOINTS: usize = 100;

/// Matches the keypoints of all photos and keeps what agrees with a two-view geometry.
///
/// # Errors
/// When keypoints and photos do not belong together, OpenCV fails, or the observer asked to stop.
pub fn match_photos(
    photos: &PhotoSet,
    keypoints: Vec<PhotoKeypoints>,
    options: &FeaturesOptions,
    observer: &dyn Observer,
) -> Result<(FeatureMatches, FeaturesReport), FeaturesError> {
    options.validate()?;
    photos.check()?;
    check_keypoints(&keypoints, photos)?;
    check_descriptors(&keypoints, photos)?;
    let descriptors: Vec<PhotoDescriptors> =
        keypoints.par_iter().map(PhotoDescriptors::new).collect();
    let normalized: Vec<Vec<Point2<f64>>> = keypoints
        .par_iter()
        .zip(&photos.photos)
        .map(|(list, photo)| {
            list.keypoints
                .iter()
                .map(|k| {
                    photo
                        .intrinsics
                        .normalized(&Point2::new(f64::from(k.x), f64::from(k.y)))
                })
                .collect()
        })
        .collect();
    let tried = candidates::pairs(&keypoints, options);
    let widest_ratio = options.max_ratio.max(options.max_verified_ratio);
    let num_done = AtomicUsize::new(0);
    let matched: Vec<(PairMatches, PairReport)> = tried
        .par_iter()
        .map(|&(first, second)| {
            if observer.flow() == Flow::Stop {
                return Err(FeaturesError::Interrupted);
            }
            let putative =
                match_descriptors(&descriptors[first], &descriptors[second], widest_ratio);
            let pick = |side: usize, photo: usize| -> Vec<Point2<f64>> {
                putative
                    .iter()
                    .map(|m| normalized[photo][m.pair[side] as usize])
                    .collect()
            };
            let focal_px = 0.5
                * (photos.photos[first].intrinsics.focal_px()
                    + photos.photos[second].intrinsics.focal_px());
            let distinctive: Vec<usize> = (0..putative.len())
                .filter(|&k| putative[k].ratio < options.max_ratio)
                .collect();
            let geometry = two_view::verify(
                &pick(0, first),
                &pick(1, second),
                &distinctive,
                focal_px,
                options,
            )?;
            let pair = PairMatches {
                first: PhotoIdx(first),
                second: PhotoIdx(second),
                matches: geometry.as_ref().map_or(Vec::new(), |g| {
                    g.inliers.iter().map(|&k| putative[k].pair).collect()
                }),
                essential: geometry.as_ref().map(|g| g.essential),
                homography_share: geometry.as_ref().map_or(0.0, |g| g.homography_share),
                num_putative: distinctive.len(),
            };
            let report = PairReport {
                first: pair.first,
                second: pair.second,
                num_putative: pair.num_putative,
                num_verified: pair.matches.len(),
                homography_share: pair.homography_share,
            };
            let done = num_done.fetch_add(1, Ordering::Relaxed) + 1;
            let flow = observer.progress(StageId::Features, "matching pairs", (done, tried.len()));
            flow.ok_or(FeaturesError::Interrupted)?;
            Ok((pair, report))
        })
        .collect::<Result<_, _>>()?;
    let (pairs, pair_reports): (Vec<_>, Vec<_>) = matched.into_iter().unzip();
    let pairs: Vec<PairMatches> = pairs
        .into_iter()
        .filter(|p: &PairMatches| !p.matches.is_empty())
        .collect();
    let report = summarize(photos, &keypoints, &pairs, pair_reports);
    for photo in &report.photos {
        if let Some(message) = unmatched(photo) {
            let flow = observer.warn(StageId::Features, message);
            flow.ok_or(FeaturesError::Interrupted)?;
        }
    }
    Ok((
        FeatureMatches {
            photos: keypoints,
            pairs,
        },
        report,
    ))
}

/// Counts per photo.
fn summarize(
    photos: &PhotoSet,
    keypoints: &[PhotoKeypoints],
    pairs: &[PairMatches],
    pair_reports: Vec<PairReport>,
) -> FeaturesReport {
    let photos = photos
        .photos
        .iter()
        .zip(keypoints)
        .enumerate()
        .map(|(idx, (photo, list))| {
            let num_pairs = pairs
                .iter()
                .filter(|p| p.first.0 == idx || p.second.0 == idx)
                .count();
            PhotoFeatures {
                file_name: photo.file_name.clone(),
                num_keypoints: list.keypoints.len(),
                num_on_object: list.keypoints.iter().filter(|k| k.on_object).count(),
                num_pairs,
            }
        })
        .collect();
    FeaturesReport {
        photos,
        pairs: pair_reports,
    }
}

/// Why a photo cannot be posed.
fn unmatched(photo: &PhotoFeatures) -> Option<String> {
    let PhotoFeatures {
        file_name,
        num_keypoints,
        num_pairs,
        ..
    } = photo;
    if *num_keypoints < FEW_KEYPOINTS {
        return Some(format!(
            "{file_name}: only {num_keypoints} keypoints; is it sharp and well exposed?"
        ));
    }
    (*num_pairs == 0).then(|| {
        format!(
            "{file_name}: matches no other photo; it shows something else or is too far from its neighbours"
        )
    })
}
