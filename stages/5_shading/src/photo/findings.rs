//! What speaks against the shape that the photo model found.

use super::report::{MOST_BLURRED_PX, PhotoReport, PhotoViewReport};
use rilievo_numerics::robust::median;
use rilievo_photometry::surface_check::{DOUBTFUL_RESIDUAL, missed_photos};
use rilievo_scene::{Finding, FindingCode};

/// What light and pigment leave of the usual photo at the level where they are fitted, from which
/// on the surface shines, is stained or moved: matte objects leave .012 to .03, one with a sheen of
/// .4 leaves .049 and its normals err half as much again.
const NOT_MATTE: f64 = 0.04;
/// Pixels over which the photos' residuals are alike, from which all photos are out of focus or
/// enlarged. Sharp JPEG photos have 2 to 7; blurred by three pixels all of them have 17. A single
/// photo is held against the sharpest one instead, by the `BLURRED` of `solve.rs`.
const BLURRED_PX: f64 = 10.0;
/// Share of a view that no other view sees, above which the shape has too little to check it.
const DOUBTFUL_SEEN_ALONE: f64 = 0.4;
/// Share of the surface that several views confirm, below which most of it is a guess.
const DOUBTFUL_CONFIRMED: f64 = 0.6;
const UNTRUSTED_CONFIRMED: f64 = 0.3;
/// Share of a view's surface that other views confirm, over that of the usual view, below which it
/// shows something else than they do. Views at the ends of an arc have .9 and more; one photo of an
/// object that was moved by six degrees has .3.
const CONTRADICTED_SHARE: f64 = 0.6;
/// Disagreement of a photo with the others about the brightness of one place from which, where it
/// is so many times that of the photo that agrees best, something moved between them. Good sets
/// have up to .02 and 1.3 times; an object that was moved by six degrees has .065 in some and .022
/// in others.
const DISAGREEMENT: f64 = 0.04;
const UNEVEN_DISAGREEMENT: f64 = 2.5;

impl PhotoReport {
    /// What the user should know of the shape.
    pub fn findings(&self) -> Vec<Finding> {
        let named = |of: fn(&PhotoViewReport) -> Option<f64>| {
            let views = self.views.iter();
            views.filter_map(move |view| Some((view.name.as_str(), of(view)?)))
        };
        let left = || named(|view| view.light_residual);
        let dark = self.views.iter().filter(|v| v.light_residual.is_none());
        let alone = named(|v| (v.seen_alone > DOUBTFUL_SEEN_ALONE).then_some(v.seen_alone));
        let found = [
            missed_photos(left()),
            not_matte(median(
                &mut left().map(|(_, left)| left).collect::<Vec<_>>(),
            )),
            not_sharp(self.alike_px()),
            Finding::about(dark.map(|v| v.name.as_str()), FindingCode::WithoutShading),
            Finding::largest(alone, |share| FindingCode::SeenAlone {
                percent: 100.0 * share,
            }),
            not_confirmed(self.views.iter().map(|v| (v.num_pixels, v.confirmed))),
            contradicted(&named(|v| Some(v.confirmed)).collect::<Vec<_>>()),
            uneven(named(|v| Some(v.disagreement)).collect()),
        ];
        found.into_iter().flatten().collect()
    }
}

/// By what light and pigment leave of the usual photo.
fn not_matte(left: Option<f64>) -> Option<Finding> {
    let left = left.filter(|left| (NOT_MATTE..=DOUBTFUL_RESIDUAL).contains(left))?;
    let percent = 100.0 * left;
    Some(FindingCode::NotMatte { percent }.into())
}

/// By the pixels over which residuals between the photos are alike.
fn not_sharp(alike_px: Option<f64>) -> Option<Finding> {
    let side = alike_px.filter(|&side| side > BLURRED_PX)?;
    let finest_px = side.min(MOST_BLURRED_PX);
    Some(FindingCode::NoFineDetail { finest_px }.into())
}

/// By the pixels of views and the shares of them that other views confirm.
fn not_confirmed(views: impl Iterator<Item = (usize, f64)>) -> Option<Finding> {
    let (num_pixels, num_confirmed) = views.fold((0.0, 0.0), |(all, sum), (pixels, share)| {
        (all + pixels as f64, sum + pixels as f64 * share)
    });
    let confirmed = num_confirmed / num_pixels;
    let percent = 100.0 * confirmed;
    let code = if confirmed < UNTRUSTED_CONFIRMED {
        FindingCode::HardlyConfirmed { percent }
    } else {
        FindingCode::PartlyConfirmed { percent }
    };
    (confirmed < DOUBTFUL_CONFIRMED).then(|| code.into())
}

/// Photos that show something else than the others, by the shares of them that the others confirm.
fn contradicted(confirmed: &[(&str, f64)]) -> Option<Finding> {
    let usual = median(
        &mut confirmed
            .iter()
            .map(|(_, share)| *share)
            .collect::<Vec<_>>(),
    )?;
    let odd = confirmed.iter().copied();
    let odd = odd.filter(|(_, share)| *share < CONTRADICTED_SHARE * usual);
    Finding::smallest(odd, |share| FindingCode::PhotoContradicted {
        percent: 100.0 * share,
        usual_percent: 100.0 * usual,
    })
}

/// The photo that disagrees most with the others about brightness, where another does much less.
fn uneven(mut disagreements: Vec<(&str, f64)>) -> Option<Finding> {
    disagreements.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(_, least), .., (name, most)] = disagreements[..] else {
        return None;
    };
    let code = FindingCode::BrightnessUneven {
        most_percent: 100.0 * most,
        least_percent: 100.0 * least,
    };
    let is_uneven = most > DISAGREEMENT && most > UNEVEN_DISAGREEMENT * least;
    Finding::about(is_uneven.then_some(name), code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::{PhotoStep, StepReport};
    use rilievo_scene::Verdict;

    fn verdict(found: Option<Finding>) -> Verdict {
        Verdict::of(found.as_slice())
    }

    #[test]
    fn a_surface_that_no_second_photo_confirms_is_not_good() {
        let confirmed = |share| verdict(not_confirmed([(100, share), (300, share)].into_iter()));
        assert_eq!(confirmed(0.9), Verdict::Good);
        assert_eq!(confirmed(0.5), Verdict::Usable);
        assert_eq!(confirmed(0.2), Verdict::NotToBeTrusted);
        assert_eq!(verdict(not_confirmed(std::iter::empty())), Verdict::Good);
    }

    #[test]
    fn gloss_and_blur_are_found() {
        assert_eq!(verdict(not_matte(None)), Verdict::Good);
        assert_eq!(verdict(not_matte(Some(0.03))), Verdict::Good);
        assert_eq!(verdict(not_matte(Some(0.049))), Verdict::Usable);
        let sharp = |correlation| {
            let mut photo = PhotoReport::default();
            photo.steps.push(StepReport {
                level: 0,
                match_correlation: correlation,
                ..Default::default()
            });
            Verdict::of(&photo.findings())
        };
        assert_eq!(sharp(None), Verdict::Good);
        assert_eq!(sharp(Some(0.74)), Verdict::Good);
        assert_eq!(sharp(Some(0.89)), Verdict::Usable);
        assert_eq!(sharp(Some(1.0)), Verdict::Usable);
        // Relief that ended at half the photos' resolution for want of detail.
        let mut ended = PhotoReport::default();
        ended.steps.push(StepReport {
            level: 1,
            step: PhotoStep::Relief,
            match_correlation: Some(0.85),
            ..Default::default()
        });
        assert_eq!(Verdict::of(&ended.findings()), Verdict::Usable);
        assert!((ended.resolved_px() - 2.0 * 37.0 / 3.0 / 7.0).abs() < 0.01);
        let resolved = |level, correlation| {
            let mut photo = PhotoReport::default();
            photo.steps.push(StepReport {
                level,
                num_rounds: 3,
                match_correlation: correlation,
                ..Default::default()
            });
            photo.resolved_px()
        };
        assert_eq!(PhotoReport::default().resolved_px(), 1.0);
        assert_eq!(resolved(0, Some(0.74)), 1.0);
        // Blurred by three pixels: 17 pixels are alike where sharp photos have 7 at most.
        assert!((resolved(0, Some(0.889)) - 17.0 / 7.0).abs() < 0.01);
        assert_eq!(resolved(2, Some(0.99)), 4.0);
    }

    #[test]
    fn photos_that_show_something_else_are_named() {
        let found = |views: &[(f64, f64)]| {
            let views = views.iter().enumerate();
            let views = views.map(|(k, &(confirmed, disagreement))| PhotoViewReport {
                name: format!("IMG_{k}"),
                num_pixels: 100,
                confirmed,
                disagreement,
                light_residual: Some(0.02),
                ..PhotoViewReport::default()
            });
            let views = views.collect();
            PhotoReport {
                views,
                ..PhotoReport::default()
            }
            .findings()
        };
        let good = [(0.92, 0.019), (0.98, 0.02), (0.99, 0.018), (0.93, 0.019)];
        assert_eq!(found(&good), []);
        let one_moved = found(&[(0.92, 0.028), (0.97, 0.022), (0.3, 0.059), (0.98, 0.02)]);
        assert_eq!(one_moved[0].subject, ["IMG_2"]);
        let FindingCode::PhotoContradicted { percent, .. } = one_moved[0].code else {
            panic!("{one_moved:?}");
        };
        assert!((percent - 30.0).abs() < 1e-9);
        let half_moved = found(&[(0.89, 0.024), (0.94, 0.066), (0.93, 0.067), (0.93, 0.022)]);
        assert_eq!(Verdict::of(&half_moved), Verdict::Usable);
        assert_eq!(half_moved[0].subject, ["IMG_2"]);
        let FindingCode::BrightnessUneven {
            most_percent,
            least_percent,
        } = half_moved[0].code
        else {
            panic!("{half_moved:?}");
        };
        assert!((most_percent - 6.7).abs() < 1e-9 && (least_percent - 2.2).abs() < 1e-9);
    }
}
