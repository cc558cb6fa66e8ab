//! The set: order, camera groups, spreads over the photos, warnings.

use crate::error::PhotosError;
use crate::exposure::{self, Exposed};
use crate::focal::cropped_from;
use crate::measures::ratio;
use crate::options::PhotosOptions;
use crate::outline::MaskOutline;
use crate::prepare::PreparedPhoto;
use crate::report::{AppliedEncoding, CameraGroup, CutOut, PhotoFacts, PhotosReport};
use rilievo_numerics::robust::median;
use rilievo_scene::{FocalSource, Observer, Orientation, Photo, PhotoSet, StageId, first_and_more};
use std::sync::Arc;

/// Noise over level from which the user is warned: at a tenth of the shading's own range.
const NOISE_WARNING: f64 = 0.05;

/// Clipped share of the object (or of the frame without mask) from which the user is warned.
const CLIPPED_WARNING: f64 = 0.02;

/// Sharpness over the middle one of the set below which a photo is likely blurred.
const BLUR_WARNING: f64 = 0.5;

/// Photos from which on a set has a middle to compare with.
const MIN_SET: usize = 4;

/// Darkest level of all photos, where samples were taken as linear, from which a pedestal that was
/// not subtracted is likely.
const PEDESTAL_WARNING: f64 = 0.02;

/// Corners over sides, over a whole set, below which vignetting is likely.
const FALLOFF_WARNING: f64 = 0.7;

/// Figures that a warning names of photos with one and the same trouble.
const MAX_NUM_FIGURES: usize = 3;

/// Orders photos by file name, groups them by camera, and reports on the set.
///
/// # Errors
/// When no photo is left, two have the same name, grey and colour photos are mixed, or the observer
/// asked to stop.
pub fn assemble(
    mut photos: Vec<PreparedPhoto>,
    options: &PhotosOptions,
    observer: &dyn Observer,
) -> Result<(PhotoSet, PhotosReport), PhotosError> {
    options.validate()?;
    photos.sort_by(|a, b| a.facts.file_name.cmp(&b.facts.file_name));
    check_set(&photos)?;

    let mut groups: Vec<(GroupKey, CameraGroup)> = Vec::new();
    let mut set = PhotoSet::default();
    for prepared in &photos {
        let facts = &prepared.facts;
        let key = GroupKey::of(facts);
        let camera_group = groups
            .iter()
            .position(|(known, _)| *known == key)
            .unwrap_or_else(|| {
                let description = describe(facts);
                groups.push((
                    key,
                    CameraGroup {
                        description,
                        photos: Vec::new(),
                    },
                ));
                groups.len() - 1
            });
        groups[camera_group].1.photos.push(facts.file_name.clone());
        set.photos.push(Photo {
            file_name: facts.file_name.clone(),
            name: facts.name.clone(),
            pixels: prepared.pixels.clone(),
            intrinsics: facts.intrinsics,
            focal_source: facts.focal_source,
            camera_group,
            orientation: facts.orientation,
            mask: prepared.mask.clone(),
            clip_level: facts.clip_level,
            given_cam_from_world: facts.given_cam_from_world,
        });
    }

    let facts: Vec<PhotoFacts> = photos.into_iter().map(|photo| photo.facts).collect();
    let gains = match options.normalize_exposure {
        true => exposure::gains(&facts).unwrap_or_default(),
        false => Vec::new(),
    };
    for (photo, &gain) in set.photos.iter_mut().zip(&gains) {
        let pixels = photo.pixels.clone();
        let gain = gain as f32;
        photo.pixels = Arc::new(Exposed { pixels, gain });
        // Floating-point photos clip nowhere, at any exposure.
        photo.clip_level = (photo.clip_level * gain).min(f32::MAX);
    }
    let level = |(i, f): (usize, &PhotoFacts)| f.median_level * gains.get(i).unwrap_or(&1.0);
    let levels: Vec<f64> = facts.iter().enumerate().map(level).collect();
    let coverages: Vec<f64> = facts.iter().filter_map(|f| f.mask_coverage).collect();
    let report = PhotosReport {
        rejected: Vec::new(),
        camera_groups: groups.into_iter().map(|(_, group)| group).collect(),
        num_masks: coverages.len(),
        mean_mask_coverage: (!coverages.is_empty())
            .then(|| coverages.iter().sum::<f64>() / coverages.len() as f64),
        exposure_spread_ev: facts
            .iter()
            .map(|f| f.exif.relative_exposure())
            .collect::<Option<Vec<f64>>>()
            .and_then(|values| ratio(&values))
            .map(f64::log2),
        level_spread_ev: ratio(&levels).map_or(0.0, f64::log2),
        exposure_gains: gains,
        white_balance_spread: white_balance_spread(&facts),
        corner_falloff: middle(facts.iter().map(|f| f.corner_falloff)),
        photos: facts,
    };
    check_levels(&report, options)?;
    for message in warnings(&report) {
        let flow = observer.warn(StageId::Photos, message);
        flow.ok_or(PhotosError::Interrupted)?;
    }
    Ok((set, report))
}

fn check_set(photos: &[PreparedPhoto]) -> Result<(), PhotosError> {
    let first = &photos.first().ok_or(PhotosError::NoPhotos)?.facts;
    let mut by_name: Vec<&PhotoFacts> = photos.iter().map(|photo| &photo.facts).collect();
    by_name.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(pair) = by_name.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return Err(PhotosError::DuplicateName {
            name: pair[0].name.clone(),
            first: pair[0].file_name.clone(),
            second: pair[1].file_name.clone(),
        });
    }
    let other = photos
        .iter()
        .map(|photo| &photo.facts)
        .find(|facts| facts.channels != first.channels);
    if let Some(other) = other {
        let (grey, color) = if first.channels == 1 {
            (first, other)
        } else {
            (other, first)
        };
        return Err(PhotosError::MixedChannels {
            grey: grey.file_name.clone(),
            color: color.file_name.clone(),
        });
    }
    Ok(())
}

/// Refuses photos that differ by more than one light and one exposure can explain.
fn check_levels(report: &PhotosReport, options: &PhotosOptions) -> Result<(), PhotosError> {
    let is_known = report.exposure_spread_ev.is_some();
    if is_known || report.level_spread_ev <= options.max_level_spread_ev {
        return Ok(());
    }
    let level = |a: &&PhotoFacts, b: &&PhotoFacts| a.median_level.total_cmp(&b.median_level);
    let name = |facts: Option<&PhotoFacts>| facts.map_or_else(String::new, |f| f.file_name.clone());
    Err(PhotosError::Exposure {
        spread_ev: report.level_spread_ev,
        dark: name(report.photos.iter().min_by(level)),
        bright: name(report.photos.iter().max_by(level)),
    })
}

fn middle(values: impl Iterator<Item = f64>) -> f64 {
    median(&mut values.collect::<Vec<_>>()).unwrap_or(0.0)
}

/// What photos of one camera group have in common.
#[derive(Clone, Debug, PartialEq)]
enum GroupKey {
    /// Intrinsics given by the user.
    Given([u64; 18]),
    /// Body, lens and zoom, by EXIF; photos without any of it and of one size are one group.
    Exif {
        texts: [Option<String>; 4],
        focal: [Option<u64>; 2],
        size: (usize, usize),
    },
}

impl GroupKey {
    fn of(facts: &PhotoFacts) -> Self {
        if facts.focal_source == FocalSource::CameraFile {
            return Self::Given(facts.intrinsics.key());
        }
        let exif = &facts.exif;
        Self::Exif {
            texts: [
                exif.make.clone(),
                exif.model.clone(),
                exif.serial.clone(),
                exif.lens.clone(),
            ],
            focal: [
                exif.focal_mm.map(f64::to_bits),
                exif.focal_35mm.map(f64::to_bits),
            ],
            size: (facts.width, facts.height),
        }
    }
}

fn describe(facts: &PhotoFacts) -> String {
    let exif = &facts.exif;
    let mut parts: Vec<String> = [&exif.model, &exif.lens]
        .into_iter()
        .flatten()
        .cloned()
        .collect();
    parts.extend(exif.focal_mm.map(|focal| format!("{focal} mm")));
    parts.push(format!("{} x {}", facts.width, facts.height));
    parts.push(format!(
        "f = {:.1} px ({})",
        facts.intrinsics.focal_px(),
        facts.focal_note
    ));
    parts.join(", ")
}

fn white_balance_spread(facts: &[PhotoFacts]) -> Option<f64> {
    let ratios = facts
        .iter()
        .map(|f| f.color_ratios)
        .collect::<Option<Vec<_>>>()?;
    let spread = |c: usize| ratio(&ratios.iter().map(|r| r[c]).collect::<Vec<_>>());
    Some(spread(0)?.max(spread(1)?))
}

/// What a photo is compared with.
struct Comparison {
    /// Whether any photo has a mask.
    has_masks: bool,
    /// Encoding of the first photo.
    encoding: Option<AppliedEncoding>,
    /// Median sharpness; zero in a set too small to have one.
    sharpness: f64,
}

type Condition = fn(&PhotoFacts, &Comparison) -> bool;

/// Share of an object beyond which what its straightened photo loses is told: some rows of pixels at its rim.
const BEYOND_WARNING: f64 = 0.02;

/// What the user should know of single photos: the condition, and what the warning says after their
/// names.
const ABOUT_PHOTOS: [(Condition, &str); 14] = [
    (
        |f, _| f.mask_coverage.is_some() && f.beyond_pinhole > BEYOND_WARNING,
        "the lens bends so much that a part of the object lies outside the straightened photo, a pinhole of the same focal \
         length and size: it gets no surface from this photo; keep the object in the middle",
    ),
    (
        |f, _| f.cut_out == Some(CutOut::Taken),
        "the surroundings are exactly black or white up to the frame, as programs cut objects out: what they leave is \
         taken for the mask, as an alpha channel is; --masks none takes the whole frame",
    ),
    (
        |f, _| f.cut_out == Some(CutOut::Unsure),
        "the surroundings are exactly black or white, as programs cut objects out, but the object itself is as black or \
         white along its outline: they are not taken for its mask; give one with --masks",
    ),
    (
        |f, _| f.focal_source == FocalSource::Guess,
        "focal length unknown, guessed and then refined with the poses; depth and normals depend \
         on it, give --cameras or a photo with EXIF",
    ),
    (
        |f, _| f.clipped_share_on_object.unwrap_or(f.clipped_share) > CLIPPED_WARNING,
        "many clipped pixels, which say nothing of the shape; expose less",
    ),
    (
        |f, _| {
            let is_known = f.focal_source == FocalSource::CameraFile;
            !is_known && cropped_from(f.width, f.height, &f.exif).is_some()
        },
        "EXIF says that it was cropped, and not where: the optical axis is taken to meet its middle, and \
         shape and size are off where it does not; give the whole photo, or its camera (--cameras)",
    ),
    (
        |f, _| f.num_invalid_px > 0,
        "has pixels that are not numbers; they were set to zero",
    ),
    (
        |f, _| f.orientation != Orientation::UPRIGHT,
        "EXIF asks to turn it for display; it is used as stored, and so are cameras, maps and exports",
    ),
    (
        |f, _| f.orientation.is_mirrored(),
        "EXIF says that the stored pixels are the scene's mirror image, and so would be the model; store it \
         unmirrored (exiftran -a, or an image editor)",
    ),
    (
        |f, _| f.mask_was_upright,
        "the mask was drawn over the photo as EXIF turns it; it was turned back to the pixels as stored",
    ),
    (
        |f, _| {
            f.encoding == AppliedEncoding::Linear && f.encoding_reason.contains("without colour")
        },
        "16 bit without colour metadata, taken as linear; say --encoding srgb if it is not",
    ),
    (
        |f, set| set.encoding.is_some_and(|first| f.encoding != first),
        "encoded otherwise than the first photo; say --encoding if that is wrong",
    ),
    (
        |f, set| f.mask_coverage.is_none() && set.has_masks,
        "has no mask though others have",
    ),
    (
        |f, set| f.sharpness < BLUR_WARNING * set.sharpness,
        "much less sharp than the others; blurred or out of focus? Leave it out if so",
    ),
];

/// One line for what concerns several photos.
fn about<'a>(photos: impl Iterator<Item = &'a PhotoFacts>, text: &str) -> Option<String> {
    let names = first_and_more(photos.map(|photo| photo.file_name.as_str()))?;
    Some(format!("{names}: {text}"))
}

/// What the user should know, each with the photo and what to try.
fn warnings(report: &PhotosReport) -> Vec<String> {
    let photos = || report.photos.iter();
    let is_set = report.photos.len() >= MIN_SET;
    let comparison = Comparison {
        has_masks: report.num_masks > 0,
        encoding: report.photos.first().map(|first| first.encoding),
        sharpness: match is_set {
            true => middle(photos().map(|f| f.sharpness)),
            false => 0.0,
        },
    };
    let mut warnings: Vec<String> = ABOUT_PHOTOS
        .iter()
        .filter_map(|(holds, text)| about(photos().filter(|f| holds(f, &comparison)), text))
        .collect();
    warnings.extend(about_masks(report));
    let is_noisy = |f: &&PhotoFacts| f.noise_sigma > NOISE_WARNING * f.median_level.max(1e-4);
    warnings.extend(about(
        photos().filter(is_noisy),
        "noisy; shoot at the lowest ISO, from a tripod, or with more light",
    ));
    if report.num_masks == 0 {
        warnings.push(
            "no photo has a mask (--masks, or an alpha channel): the whole frame is taken for the \
             object, which is slower and lets what stands around it into the model, unless masks are \
             proposed and sure; `rilievo mask` proposes them to be looked at and corrected"
                .to_owned(),
        );
    }
    let black = photos()
        .map(|f| f.black_level)
        .fold(f64::INFINITY, f64::min);
    let is_linear = |f: &PhotoFacts| f.encoding == AppliedEncoding::Linear && f.bits < 32;
    if is_set && black > PEDESTAL_WARNING && photos().all(is_linear) {
        warnings.push(format!(
            "nothing in any photo is darker than {black:.3}: was the black level subtracted when \
             the photos were made linear?"
        ));
    }
    if is_set && report.corner_falloff < FALLOFF_WARNING {
        warnings.push(format!(
            "brightness falls towards the corners over the whole set, to {:.0} % of the sides': if the lens \
             darkens them, use a smaller aperture or correct vignetting while developing",
            100.0 * report.corner_falloff
        ));
    }
    if let Some(spread) = report.exposure_spread_ev
        && spread > exposure::EXPOSURE_SPREAD_EV
    {
        warnings.push(format!(
            "exposure varies by {spread:.2} EV between the photos{}; shoot with fixed exposure",
            if report.exposure_gains.is_empty() {
                ""
            } else {
                " and was evened out by EXIF (photos.normalize_exposure)"
            }
        ));
    }
    warnings
}

/// What the user should know of masks whose border is not the object's outline.
fn about_masks(report: &PhotosReport) -> impl Iterator<Item = String> {
    // The photos with such an outline, its median distance and the share of the border that lies on
    // it.
    let apart = |is_apart: fn(&MaskOutline) -> bool| {
        let outlines = report.photos.iter();
        let outlines = outlines.filter_map(|f| Some((f, f.mask_outline.filter(is_apart)?)));
        let (photos, outlines): (Vec<&PhotoFacts>, Vec<MaskOutline>) = outlines.unzip();
        let distance = middle(outlines.iter().map(|outline| outline.beyond_px.abs()));
        let share = 100.0 * middle(outlines.iter().map(|outline| outline.share_on_outline));
        (photos, format!("{distance:.0} px"), format!("{share:.0} %"))
    };
    let (photos, distance, share) = apart(MaskOutline::is_too_large);
    let too_large = about(
        photos.into_iter(),
        &format!(
            "the mask reaches {distance} beyond the object's outline along most of its border ({share} lie on it), and \
             what stands behind becomes the model's rim; draw it tighter"
        ),
    );
    let (photos, distance, share) = apart(MaskOutline::is_too_small);
    let too_small = about(
        photos.into_iter(),
        &format!(
            "the mask ends {distance} inside the object's outline along most of its border ({share} lie on it): the \
             rim is left out"
        ),
    );
    // Of a mask that is too large or too small it is known where its border should lie.
    let off_edges = || {
        report.photos.iter().filter_map(|f| {
            let is_apart = f.mask_outline.is_some_and(|outline| outline.is_apart());
            let ratio = f
                .mask_edge_ratio
                .filter(|&ratio| !is_apart && ratio < 1.0)?;
            Some((f, format!("{ratio:.2}")))
        })
    };
    let figures: Vec<String> = off_edges().take(MAX_NUM_FIGURES).map(|off| off.1).collect();
    let elsewhere = about(
        off_edges().map(|off| off.0),
        &format!(
            "the mask's border lies on no edge of the photo: brightness changes {} times as much along it \
             as along the same border shifted by 3 or 6 % of the diagonal, along an object's own outline \
             about twice as much; is it the mask of another photo, or shifted?",
            figures.join(", ")
        ),
    );
    [too_large, too_small, elsewhere].into_iter().flatten()
}
