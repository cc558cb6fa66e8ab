//! Stage 2: linear photos to keypoints and verified matches.
//!
//! Per photo: SIFT keypoints over the whole frame with a low contrast threshold, spread over a
//! grid, RootSIFT descriptors in bytes ([`detect`]). Per pair: mutual nearest neighbours, among
//! bright blobs and among dark ones, that pass the ratio test find an essential matrix; those, and
//! less distinctive ones, that agree with it are kept ([`match_photos`]). Which pairs are matched, [`PairChoice`] says.

mod candidates;
mod descriptors;
mod detect;
mod error;
mod matching;
mod options;
mod polarity;
mod report;
mod retention;
mod two_view;

pub use detect::detect;
pub use error::FeaturesError;
pub use options::{FeaturesOptions, KeypointRegion, PairChoice, PairLimits, RETIRED_KEYS};
pub use report::{FeaturesReport, PairReport, PhotoFeatures};

use candidates::Pair;
use matching::{PhotoDescriptors, match_descriptors};
use nalgebra::Point2;
use rayon::prelude::*;
use rilievo_scene::{
    DividedStep, FeatureMatches, Flow, Observer, PairMatches, Photo, PhotoIdx, PhotoKeypoints,
    PhotoSet, StageId, check_descriptors, check_keypoints, divided, first_and_more,
};
use std::collections::BTreeSet;

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 4;

/// A photo with fewer keypoints than this deserves a warning.
const FEW_KEYPOINTS: usize = 100;
/// Largest ratio of the best to the second-best descriptor distance of matches that join where they
/// agree with the geometry that more distinctive ones found. Wide baselines live on them.
const MAX_VERIFIED_RATIO: f64 = 0.9;
/// Keypoints of a photo that are compared before a pair of a large set is matched, and the matches among them without
/// which it is not.
const NUM_PREVIEWED: usize = 512;
const MIN_PREVIEW_MATCHES: usize = 4;

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
    let matcher = Matcher::new(photos, &keypoints, options);
    let unknown = candidates::unknown_names(photos, options);
    if !unknown.is_empty() {
        let names: Vec<&str> = unknown.into_iter().collect();
        let message = format!(
            "listed pairs are left out for names that are none of the photos: {}",
            first_and_more(names).unwrap_or_default()
        );
        let flow = observer.warn(StageId::Features, message);
        flow.ok_or(FeaturesError::Interrupted)?;
    }
    let begun = candidates::first(photos, &keypoints, options)?;
    let mut matched = matcher.pairs(&matcher.alike(&begun, observer)?, 0, observer)?;
    if matcher.has_previews() {
        let mut tried: BTreeSet<Pair> = begun.iter().copied().collect();
        loop {
            let strong: Vec<Pair> = matched.iter().filter_map(strong).collect();
            let next = candidates::beyond(keypoints.len(), &strong, &tried);
            if next.is_empty() {
                break;
            }
            let alike = matcher.alike(&next, observer)?;
            matched.extend(matcher.pairs(&alike, matched.len(), observer)?);
            tried.extend(next);
        }
        let refused = refused_of_lonely(&begun, &matched, keypoints.len());
        matched.extend(matcher.pairs(&refused, matched.len(), observer)?);
    }
    matched.sort_by_key(|pair| (pair.first, pair.second));
    let pair_reports = matched.iter().map(PairReport::of).collect();
    let pairs: Vec<PairMatches> = matched
        .into_iter()
        .filter(|p| !p.matches.is_empty())
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

/// What every pair of photos is matched from.
struct Matcher<'a> {
    photos: &'a PhotoSet,
    options: &'a FeaturesOptions,
    descriptors: Vec<PhotoDescriptors>,
    /// Those of the largest keypoints, where pairs are looked at before they are matched; else none.
    previews: Vec<PhotoDescriptors>,
    /// Keypoints as viewing rays `(x/z, y/z)`.
    normalized: Vec<Vec<Point2<f64>>>,
}

impl<'a> Matcher<'a> {
    fn new(
        photos: &'a PhotoSet,
        keypoints: &[PhotoKeypoints],
        options: &'a FeaturesOptions,
    ) -> Self {
        let normalized = |(list, photo): (&PhotoKeypoints, &Photo)| {
            let pixels = list.keypoints.iter();
            let pixels = pixels.map(|k| Point2::new(f64::from(k.x), f64::from(k.y)));
            pixels.map(|p| photo.intrinsics.normalized(&p)).collect()
        };
        let preview = |photo| PhotoDescriptors::largest(photo, NUM_PREVIEWED);
        let is_auto = options.pairs == PairChoice::Auto;
        let has_previews = is_auto && !candidates::is_exhaustive(keypoints.len(), options);
        Self {
            photos,
            options,
            descriptors: keypoints.par_iter().map(PhotoDescriptors::new).collect(),
            previews: if has_previews {
                keypoints.par_iter().map(preview).collect()
            } else {
                Vec::new()
            },
            normalized: keypoints
                .par_iter()
                .zip(&photos.photos)
                .map(normalized)
                .collect(),
        }
    }

    fn has_previews(&self) -> bool {
        !self.previews.is_empty()
    }

    /// The pairs whose largest keypoints match often enough; all, where there are no previews.
    fn alike(&self, pairs: &[Pair], observer: &dyn Observer) -> Result<Vec<Pair>, FeaturesError> {
        if !self.has_previews() {
            return Ok(pairs.to_vec());
        }
        let looked_at = |idx: usize| {
            if observer.flow() == Flow::Stop {
                return Err(FeaturesError::Interrupted);
            }
            let (i, j) = pairs[idx];
            let [a, b] = [&self.previews[i], &self.previews[j]];
            let num = match_descriptors(a, b, self.options.max_ratio).len();
            Ok(num >= MIN_PREVIEW_MATCHES)
        };
        let are_alike = divided(observer.team(), pairs.len(), usize::MAX, looked_at)?;
        let alike = pairs.iter().zip(are_alike).filter(|&(_, is)| is);
        Ok(alike.map(|(&pair, _)| pair).collect())
    }

    /// Matches of many pairs, after `num_before` others.
    fn pairs(
        &self,
        pairs: &[Pair],
        num_before: usize,
        observer: &dyn Observer,
    ) -> Result<Vec<PairMatches>, FeaturesError> {
        let step = DividedStep::new(observer, StageId::Features, "matching pairs");
        let interrupted = || FeaturesError::Interrupted;
        step.after(num_before)
            .run(pairs.len(), usize::MAX, interrupted, |idx| {
                let (first, second) = pairs[idx];
                self.pair(first, second)
            })
    }

    /// Matches of two photos that agree with a two-view geometry; none where nothing agrees.
    fn pair(&self, first: usize, second: usize) -> Result<PairMatches, FeaturesError> {
        let options = self.options;
        let widest_ratio = options.max_ratio.max(MAX_VERIFIED_RATIO);
        let [a, b] = [first, second].map(|photo| &self.descriptors[photo]);
        let putative = match_descriptors(a, b, widest_ratio);
        let pick = |side: usize, photo: usize| -> Vec<Point2<f64>> {
            putative
                .iter()
                .map(|m| self.normalized[photo][m.pair[side] as usize])
                .collect()
        };
        let focal_px = |photo: usize| self.photos.photos[photo].intrinsics.focal_px();
        let distinctive: Vec<usize> = (0..putative.len())
            .filter(|&k| putative[k].ratio < options.max_ratio)
            .collect();
        let geometry = two_view::verify(
            &pick(0, first),
            &pick(1, second),
            &distinctive,
            0.5 * (focal_px(first) + focal_px(second)),
        )?;
        Ok(PairMatches {
            first: PhotoIdx(first),
            second: PhotoIdx(second),
            matches: geometry.as_ref().map_or(Vec::new(), |g| {
                g.inliers.iter().map(|&k| putative[k].pair).collect()
            }),
            essential: geometry.as_ref().map(|g| g.essential),
            homography_share: geometry.as_ref().map_or(0.0, |g| g.homography_share),
            num_putative: distinctive.len(),
        })
    }
}

/// The pair, where it matches well enough to suggest other pairs.
fn strong(pair: &PairMatches) -> Option<Pair> {
    let is_strong = pair.matches.len() >= 2 * two_view::MIN_NUM_INLIERS;
    is_strong.then_some((pair.first.0, pair.second.0))
}

/// Of the pairs to begin with, those that were not matched of photos that match no other: few keypoints may be too few
/// to decide.
fn refused_of_lonely(begun: &[Pair], matched: &[PairMatches], num_photos: usize) -> Vec<Pair> {
    let mut is_lonely = vec![true; num_photos];
    for pair in matched.iter().filter(|pair| !pair.matches.is_empty()) {
        is_lonely[pair.first.0] = false;
        is_lonely[pair.second.0] = false;
    }
    let known: BTreeSet<Pair> = matched.iter().map(|p| (p.first.0, p.second.0)).collect();
    let refused = begun.iter().filter(|pair| !known.contains(pair));
    let refused = refused.filter(|&&(i, j)| is_lonely[i] || is_lonely[j]);
    refused.copied().collect()
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
