//! What speaks against the poses.

use crate::report::{ContradictedFocal, PosesReport};
use rilievo_numerics::robust::median;
use rilievo_scene::{Finding, FindingCode};

/// Reprojection error above which poses are doubtful, pixels: twice what keypoints allow.
const DOUBTFUL_REPROJECTION_PX: f64 = 1.0;
/// Points below which a view that has less than [`FEW_POINTS_SHARE`] of the median number hangs by
/// a thread. Views at the end of an arc share points with one side only and keep a quarter, or a
/// seventh of very many.
const FEW_POINTS: usize = 100;
const FEW_POINTS_SHARE: f64 = 1.0 / 6.0;
/// Share of the median number below which it does whatever the number: a wrong focal length leaves
/// less.
const VERY_FEW_POINTS_SHARE: f64 = 0.1;
/// Points that a view keeps of its matches, over what the median view keeps, below which its
/// matches contradict its pose. Good sets have .7 and more; one photo cropped 1.4 times has .37.
const FEW_KEPT_SHARE: f64 = 0.5;
/// Relative change of a focal length of EXIF data by the adjustment above which it is another
/// photo's: such data are rounded to some per cent. Given ones are held against the photos by
/// `lens.rs`, to its `MIN_FOCAL_CHANGE`.
const DOUBTFUL_FOCAL_CHANGE: f64 = 0.1;

impl PosesReport {
    /// What the user should know of the poses of `num_photos` photos. `kept`: views by name with
    /// the points that they keep of their matches; `is_guess`: whether nothing was known of a
    /// camera group's focal length.
    pub fn findings(
        &self,
        num_photos: usize,
        kept: &[(&str, f64)],
        is_guess: impl Fn(usize) -> bool,
    ) -> Vec<Finding> {
        let changed = self.refined_focals_px.iter();
        let changed = changed.filter(|(group, ..)| !is_guess(*group));
        let num_viewpoints = self.views.len() - self.same_place.len();
        let posed = [
            not_posed(self.views.len(), num_photos),
            (1..=2)
                .contains(&num_viewpoints)
                .then(|| FindingCode::OnlyTwoPosed.into()),
            large_error(self.mean_reprojection_error_px),
            self.few_points(),
            few_kept(kept),
        ];
        let focals = changed.filter_map(|&(_, stated, found)| focal_change(stated, found));
        let given = self.contradicted_focal.as_ref();
        let found = posed.into_iter().flatten().chain(focals);
        found.chain(given.map(ContradictedFocal::finding)).collect()
    }

    fn few_points(&self) -> Option<Finding> {
        let mut counts: Vec<usize> = self.views.iter().map(|view| view.num_points).collect();
        counts.sort_unstable();
        let usual = counts.get(counts.len() / 2).copied().unwrap_or(0);
        let few = self.views.iter().filter(|view| {
            let share = view.num_points as f64 / usual.max(1) as f64;
            view.num_points < FEW_POINTS && share < FEW_POINTS_SHARE
                || share < VERY_FEW_POINTS_SHARE
        });
        let few = few.map(|view| (view.file_name.as_str(), view.num_points as f64));
        Finding::smallest(few, |points| FindingCode::FewPoints {
            points,
            usual: usual as f64,
        })
    }
}

impl ContradictedFocal {
    /// What the user should know of it.
    pub fn finding(&self) -> Finding {
        let code = FindingCode::GivenFocalContradicted {
            given_px: self.given_px,
            found_px: self.found_px,
            change_percent: 100.0 * (self.found_px / self.given_px - 1.0),
        };
        Finding {
            code,
            subject: vec![self.file_name.clone()],
        }
    }
}

fn not_posed(num_posed: usize, num_photos: usize) -> Option<Finding> {
    let (posed, photos) = (num_posed as f64, num_photos as f64);
    let code = if 2 * num_posed < num_photos {
        FindingCode::MostNotPosed { posed, photos }
    } else {
        FindingCode::SomeNotPosed { posed, photos }
    };
    (num_posed < num_photos).then(|| code.into())
}

fn large_error(error_px: f64) -> Option<Finding> {
    let code = FindingCode::ReprojectionError { error_px };
    (error_px > DOUBTFUL_REPROJECTION_PX).then(|| code.into())
}

fn few_kept(kept: &[(&str, f64)]) -> Option<Finding> {
    let usual = median(&mut kept.iter().map(|(_, share)| *share).collect::<Vec<_>>())?;
    let few = kept.iter().copied();
    let few = few.filter(|(_, share)| *share < FEW_KEPT_SHARE * usual);
    Finding::smallest(few, |share| FindingCode::FewMatchesKept {
        percent: 100.0 * share,
        usual_percent: 100.0 * usual,
    })
}

fn focal_change(stated_px: f64, found_px: f64) -> Option<Finding> {
    let code = FindingCode::StatedFocalContradicted {
        stated_px,
        found_px,
    };
    ((found_px / stated_px - 1.0).abs() > DOUBTFUL_FOCAL_CHANGE).then(|| code.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::ViewReport;
    use rilievo_scene::Verdict;

    fn verdict(found: Option<Finding>) -> Verdict {
        Verdict::of(found.as_slice())
    }

    fn poses(counts: &[usize]) -> PosesReport {
        let view = |(index, &num_points): (usize, &usize)| ViewReport {
            file_name: format!("IMG_{index}.jpg"),
            num_points,
            mean_error_px: 0.1,
            rotation_sigma_deg: None,
            center_sigma: None,
        };
        PosesReport {
            views: counts.iter().enumerate().map(view).collect(),
            ..PosesReport::default()
        }
    }

    fn found(counts: &[usize], num_photos: usize) -> Vec<Finding> {
        poses(counts).findings(num_photos, &[], |_| false)
    }

    #[test]
    fn missing_poses_and_large_errors_are_found() {
        let report = |error_px| PosesReport {
            mean_reprojection_error_px: error_px,
            ..PosesReport::default()
        };
        let of = |error_px, num| Verdict::of(&report(error_px).findings(num, &[], |_| false));
        assert_eq!(of(0.3, 0), Verdict::Good);
        assert_eq!(of(1.3, 0), Verdict::Usable);
        assert_eq!(of(0.3, 2), Verdict::NotToBeTrusted);
        assert_eq!(Verdict::of(&found(&[800, 800, 800], 4)), Verdict::Usable);
        let same = |photo, of| (format!("IMG_{photo}.jpg"), format!("IMG_{of}.jpg"));
        let twice = PosesReport {
            same_place: vec![same(1, 0), same(3, 2)],
            ..poses(&[800, 800, 800, 800])
        };
        assert_eq!(twice.findings(4, &[], |_| false), found(&[800, 800], 2));
    }

    #[test]
    fn a_photo_that_hangs_by_a_thread_is_named() {
        let ends_of_an_arc = found(&[403, 2079, 2302, 1101], 4);
        assert_eq!(Verdict::of(&ends_of_an_arc), Verdict::Good);
        let ends_of_many = found(&[448, 3179, 3300, 3179, 518], 5);
        assert_eq!(Verdict::of(&ends_of_many), Verdict::Good);
        let code = FindingCode::FewPoints {
            points: 91.0,
            usual: 1500.0,
        };
        let few = Finding::about(["IMG_2.jpg"], code).unwrap();
        assert_eq!(few.severity(), Verdict::Usable);
        assert_eq!(found(&[1100, 2900, 91, 1500], 4), [few]);
        assert_eq!(Verdict::of(&found(&[800, 800], 2)), Verdict::Usable);
    }

    #[test]
    fn a_photo_whose_matches_contradict_its_camera_is_named() {
        let kept = |shares: [f64; 4]| {
            let names = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
            few_kept(&names.into_iter().zip(shares).collect::<Vec<_>>())
        };
        assert_eq!(kept([0.83, 0.73, 0.55, 0.77]), None);
        let cropped = kept([0.48, 0.38, 0.14, 0.46]).unwrap();
        assert_eq!(cropped.severity(), Verdict::Usable);
        assert_eq!(cropped.subject, ["c.jpg"]);
        let percents = |code| match code {
            FindingCode::FewMatchesKept { percent, .. } => percent,
            other => panic!("{other:?}"),
        };
        assert!((percents(cropped.code) - 14.0).abs() < 1e-9);
    }

    #[test]
    fn contradicted_focal_lengths_are_found() {
        assert_eq!(verdict(focal_change(1000.0, 1030.0)), Verdict::Good);
        // Found and used: a note.
        assert_eq!(verdict(focal_change(1000.0, 1400.0)), Verdict::Good);
        assert!(focal_change(1000.0, 1400.0).is_some());
        let refined = PosesReport {
            refined_focals_px: vec![(0, 1000.0, 1400.0)],
            ..PosesReport::default()
        };
        assert_eq!(refined.findings(0, &[], |_| true), []);
        let given = PosesReport {
            contradicted_focal: Some(ContradictedFocal {
                file_name: "a.jpg".to_owned(),
                given_px: 1000.0,
                found_px: 1050.0,
            }),
            ..PosesReport::default()
        };
        assert_eq!(
            Verdict::of(&given.findings(0, &[], |_| false)),
            Verdict::Usable
        );
    }
}
