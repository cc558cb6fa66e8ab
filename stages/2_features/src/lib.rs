//! Stage 2: linear photos to keypoints and verified matches.
//!
//! Per photo: SIFT keypoints over the whole frame with a low contrast threshold, spread over a
//! grid, RootSIFT descriptors in bytes ([`detect`]). Per pair: mutual nearest neighbours, among
//! bright blobs and among dark ones, that pass the ratio test find an essential matrix; those, and
//! less distinctive ones, that agree with it are kept ([`match_photos`]), but for those that stand
//! still in the frame while others move (module `standing`). Which pairs are matched, [`PairChoice`]
//! says.

mod candidates;
mod descriptors;
mod detect;
mod error;
mod matching;
mod options;
mod polarity;
mod report;
mod retention;
mod standing;
mod two_view;

pub use detect::detect;
pub use error::FeaturesError;
pub use options::{FeaturesOptions, KeypointRegion, PairChoice, PairLimits, RETIRED_KEYS};
pub use report::{FeaturesReport, PairReport, PhotoFeatures};

use candidates::Pair;
use matching::{DescriptorMatch, PhotoDescriptors, match_descriptors};
use nalgebra::Point2;
use rayon::prelude::*;
use rilievo_scene::{
    DividedStep, FeatureMatches, Flow, Observer, PairMatches, Photo, PhotoIdx, PhotoKeypoints,
    PhotoSet, StageId, check_descriptors, check_keypoints, divided, first_and_more,
    motion_in_frame,
};
use standing::StandingKeypoints;
use std::collections::BTreeSet;
use two_view::TwoViewGeometry;

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 5;

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
    let mut matched = matcher.pairs(&matcher.alike(&begun, observer)?, 0, None, observer)?;
    if matcher.has_previews() {
        let mut tried: BTreeSet<Pair> = begun.iter().copied().collect();
        loop {
            let strong: Vec<Pair> = matched.iter().filter_map(strong).collect();
            let next = candidates::beyond(keypoints.len(), &strong, &tried);
            if next.is_empty() {
                break;
            }
            let alike = matcher.alike(&next, observer)?;
            matched.extend(matcher.pairs(&alike, matched.len(), None, observer)?);
            tried.extend(next);
        }
        let refused = refused_of_lonely(&begun, &matched, keypoints.len());
        matched.extend(matcher.pairs(&refused, matched.len(), None, observer)?);
    }
    leave_out_standing(&matcher, &mut matched, observer)?;
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
    keypoints: &'a [PhotoKeypoints],
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
        keypoints: &'a [PhotoKeypoints],
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
            keypoints,
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

    /// Matches of many pairs, after `num_before` others, without those of keypoints that are known to stand still.
    fn pairs(
        &self,
        pairs: &[Pair],
        num_before: usize,
        standing: Option<&StandingKeypoints>,
        observer: &dyn Observer,
    ) -> Result<Vec<PairMatches>, FeaturesError> {
        let step = DividedStep::new(observer, StageId::Features, "matching pairs");
        let interrupted = || FeaturesError::Interrupted;
        step.after(num_before)
            .run(pairs.len(), usize::MAX, interrupted, |idx| {
                self.pair(pairs[idx], standing)
            })
    }

    /// Matches of two photos that agree with a two-view geometry; none where nothing agrees.
    fn pair(
        &self,
        pair @ (first, second): Pair,
        known: Option<&StandingKeypoints>,
    ) -> Result<PairMatches, FeaturesError> {
        let widest_ratio = self.options.max_ratio.max(MAX_VERIFIED_RATIO);
        let [a, b] = [first, second].map(|photo| &self.descriptors[photo]);
        let mut matches = match_descriptors(a, b, widest_ratio);
        let is_near = |m: &DescriptorMatch| standing::is_near(self.motion(pair, m.pair));
        let mut standing = Vec::new();
        if let Some(known) = known {
            let stands = |m: &DescriptorMatch| is_near(m) && known.has([first, second], m.pair);
            standing.extend(matches.iter().filter(|m| stands(m)).map(|m| m.pair));
            matches.retain(|m| !stands(m));
        }
        let distinctive = matches.iter().filter(|m| self.is_distinctive(m));
        let num_putative = distinctive.clone().count();
        let motions = distinctive.map(|m| self.motion(pair, m.pair));
        let mut found = None;
        if known.is_none() && standing::have_peak(motions) {
            let (near, moving): (Vec<_>, Vec<_>) = matches.iter().copied().partition(is_near);
            // False matches agree by chance with few of their like.
            let num_moving = moving.iter().filter(|m| self.is_distinctive(m)).count();
            let agree = |g: &TwoViewGeometry| {
                let agreeing = g.inliers.iter().map(|&k| &moving[k]);
                2 * agreeing.filter(|m| self.is_distinctive(m)).count() >= num_moving
            };
            found = self.geometry(pair, &moving)?.filter(agree);
            if found.is_some() {
                standing = near.iter().map(|m| m.pair).collect();
                matches = moving;
            }
        }
        if found.is_none() {
            found = self.geometry(pair, &matches)?;
        }
        Ok(PairMatches {
            first: PhotoIdx(first),
            second: PhotoIdx(second),
            matches: found.as_ref().map_or(Vec::new(), |g| {
                g.inliers.iter().map(|&k| matches[k].pair).collect()
            }),
            essential: found.as_ref().map(|g| g.essential),
            homography_share: found.as_ref().map_or(0.0, |g| g.homography_share),
            num_putative,
            standing,
        })
    }

    fn is_distinctive(&self, found: &DescriptorMatch) -> bool {
        found.ratio < self.options.max_ratio
    }

    /// As of [`motion_in_frame`].
    fn motion(&self, (first, second): Pair, [i, j]: [u32; 2]) -> f64 {
        let keypoint = |photo: usize, k: u32| &self.keypoints[photo].keypoints[k as usize];
        let cameras = [first, second].map(|photo| &self.photos.photos[photo].intrinsics);
        motion_in_frame([keypoint(first, i), keypoint(second, j)], cameras)
    }

    /// The two-view geometry that matches agree with, if any.
    fn geometry(
        &self,
        (first, second): Pair,
        matches: &[DescriptorMatch],
    ) -> Result<Option<TwoViewGeometry>, FeaturesError> {
        let pick = |side: usize, photo: usize| -> Vec<Point2<f64>> {
            let ends = matches.iter().map(|m| m.pair[side] as usize);
            ends.map(|k| self.normalized[photo][k]).collect()
        };
        let focal_px = |photo: usize| self.photos.photos[photo].intrinsics.focal_px();
        let distinctive: Vec<usize> = (0..matches.len())
            .filter(|&k| self.is_distinctive(&matches[k]))
            .collect();
        two_view::verify(
            &pick(0, first),
            &pick(1, second),
            &distinctive,
            0.5 * (focal_px(first) + focal_px(second)),
        )
    }
}

/// Matches pairs once more that have matches of keypoints which other pairs show to stand still, without these; a
/// warning.
fn leave_out_standing(
    matcher: &Matcher<'_>,
    matched: &mut [PairMatches],
    observer: &dyn Observer,
) -> Result<(), FeaturesError> {
    let standing = StandingKeypoints::of(matched, matcher.keypoints);
    // Fewer hold no geometry of their own.
    if standing.num < two_view::MIN_NUM_INLIERS {
        return Ok(());
    }
    let is_doubtful = |pair: &PairMatches| {
        let photos = [pair.first.0, pair.second.0];
        let mut matches = pair.matches.iter();
        let stands = |m: [u32; 2]| standing::is_near(matcher.motion(photos.into(), m));
        pair.standing.is_empty() && matches.any(|&m| standing.has(photos, m) && stands(m))
    };
    let doubtful: Vec<usize> = (0..matched.len())
        .filter(|&k| is_doubtful(&matched[k]))
        .collect();
    let pairs = doubtful.iter().map(|&k| &matched[k]);
    let pairs: Vec<Pair> = pairs.map(|p| (p.first.0, p.second.0)).collect();
    let again = matcher.pairs(&pairs, matched.len(), Some(&standing), observer)?;
    for (k, pair) in doubtful.into_iter().zip(again) {
        matched[k] = pair;
    }
    let counts = matched.iter().map(|pair| pair.standing.len());
    let counts = counts.filter(|&num| num > 0);
    let message = format!(
        "{} matches of {} pairs stand still in the frame while others move: a caption, a time stamp, dust on the sensor, \
         or a background that does not turn with the object; they are left out",
        counts.clone().sum::<usize>(),
        counts.count()
    );
    let flow = observer.warn(StageId::Features, message);
    flow.ok_or(FeaturesError::Interrupted)
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
