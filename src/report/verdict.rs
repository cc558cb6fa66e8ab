//! How far a result can be relied on, and why.

use super::facts::{Facts, Stages};
use crate::pipeline::{MaskOrigin, ShadingFacts, StageState};
use rilievo_features::FeaturesReport;
use rilievo_fusion::Layering;
use rilievo_lighting::LightingReport;
use rilievo_numerics::robust::median;
use rilievo_photos::{MaskOutline, PhotosReport};
use rilievo_poses::PosesReport;
use rilievo_scene::{FocalSource, Orientation, PhotoIdx, first_and_more};
use serde::Serialize;

/// How far a result can be relied on, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Verdict {
    #[serde(rename = "good")]
    Good,
    #[serde(rename = "usable")]
    Usable,
    /// For programs a usable one: what there is of it is no worse, and the reasons say what is missing.
    #[serde(rename = "usable")]
    NotFinished,
    #[serde(rename = "untrusted")]
    NotToBeTrusted,
}

impl Verdict {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable => "usable, with care",
            Self::NotFinished => "not finished",
            Self::NotToBeTrusted => "not to be trusted",
        }
    }

    /// Class of the page's style.
    pub fn class(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable | Self::NotFinished => "usable",
            Self::NotToBeTrusted => "bad",
        }
    }
}

/// Reprojection error above which poses are doubtful, pixels: twice what keypoints allow.
const DOUBTFUL_REPROJECTION_PX: f64 = 1.0;
/// Points below which a view that has less than [`FEW_POINTS_SHARE`] of the median number hangs by a thread. Views at the
/// end of an arc share points with one side only and keep a quarter, or a seventh of very many.
const FEW_POINTS: usize = 100;
const FEW_POINTS_SHARE: f64 = 1.0 / 6.0;
/// Share of the median number below which it does whatever the number: a wrong focal length leaves less.
const VERY_FEW_POINTS_SHARE: f64 = 0.1;
/// Points that a view keeps of its matches, over what the median view keeps, below which its matches
/// contradict its pose. Good sets have .7 and more; one photo cropped 1.4 times has .37.
const FEW_KEPT_SHARE: f64 = 0.5;
/// Relative change of a stated focal length by the adjustment above which one of both is wrong. Focal
/// lengths of EXIF data are rounded to some per cent.
const DOUBTFUL_FOCAL_CHANGE: f64 = 0.1;
/// Relative difference of a photo and what shape and light explain, above which they contradict each
/// other: nine distant harmonics (model paper) leave 10 to 12 % on real objects, half-hidden light up to 20 %.
const DOUBTFUL_LIGHT: f64 = 0.2;
/// What light and pigment leave of the usual photo at the level where they are fitted, from which on the surface shines, is
/// stained or moved: matte objects leave .012 to .03, one with a sheen of .4 leaves .049 and its normals err half as
/// much again.
const MATTE_LIGHT: f64 = 0.04;
/// Pixels over which the photos' residuals are alike, from which the photos are out of focus or enlarged. Sharp JPEG photos
/// have 2 to 7; blurred by three pixels all of them have 17.
const BLURRED_PX: f64 = 10.0;
/// More is not told: residuals are alike without end where nothing differs.
const MOST_BLURRED_PX: f64 = 50.0;
/// Where the usual photo differs by more, what was solved is not what the photos show.
const UNTRUSTED_LIGHT: f64 = 0.4;
/// Share of a view that no other view sees, above which the shape has too little to check it.
const DOUBTFUL_SEEN_ALONE: f64 = 0.4;
/// Share of the surface that several views confirm, below which most of it is a guess.
const DOUBTFUL_CONFIRMED: f64 = 0.6;
const UNTRUSTED_CONFIRMED: f64 = 0.3;
/// Share of a view's surface that other views confirm, over that of the usual view, below which it shows something else
/// than they do. Views at the ends of an arc have .9 and more; one photo of an object that was moved by six degrees has .3.
const CONTRADICTED_SHARE: f64 = 0.6;
/// Disagreement of a photo with the others about the brightness of one place from which, where it is so many times that of
/// the photo that agrees best, something moved between them. Good sets have up to .02 and 1.3 times; an object that was
/// moved by six degrees has .065 in some and .022 in others.
const DISAGREEMENT: f64 = 0.04;
const UNEVEN_DISAGREEMENT: f64 = 2.5;
/// Distance between overlapping views, in pixel footprints, above which they form layers.
const DOUBTFUL_LAYERING_PX: f64 = 2.0;

/// The verdict, and everything that made it worse.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judgement {
    #[serde(rename = "level")]
    pub verdict: Verdict,
    pub reasons: Vec<String>,
}

impl Judgement {
    /// Judges a run.
    pub fn of(facts: &Facts) -> Self {
        let mut judgement = Self::nothing_against();
        if let Some(error) = &facts.outcome.error {
            judgement.note(
                Verdict::NotToBeTrusted,
                format!("the run did not end: {error}"),
            );
        }
        judgement.judge(&facts.stages);
        if facts.request.masks_from == MaskOrigin::Proposed {
            judgement.note(
                Verdict::Usable,
                "the masks were proposed by the program: look at masks-overlays/ in the run directory, correct what is \
                 wrong in masks/, and give them with --masks",
            );
        }
        judgement
    }

    /// The verdict and its reasons, a line each.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let verdict = format!("verdict: {}", self.verdict.words());
        std::iter::once(verdict).chain(self.reasons.iter().map(|reason| format!("  - {reason}")))
    }

    fn nothing_against() -> Self {
        Self {
            verdict: Verdict::Good,
            reasons: Vec::new(),
        }
    }

    fn note(&mut self, verdict: Verdict, reason: impl Into<String>) {
        self.verdict = self.verdict.max(verdict);
        self.reasons.push(reason.into());
    }

    fn judge(&mut self, stages: &Stages) {
        match stages.fusion.as_ref().map(|fusion| &fusion.state) {
            None => self.note(
                Verdict::NotFinished,
                "there is no point cloud and no mesh yet",
            ),
            Some(Some(StageState::Stale { .. })) => self.note(
                Verdict::NotFinished,
                "point cloud and mesh are stale: they were made from something else than what is \
                 asked for now",
            ),
            Some(Some(StageState::Damaged { reason })) => self.note(
                Verdict::NotToBeTrusted,
                format!("point cloud and mesh are damaged: {reason}"),
            ),
            Some(_) => {}
        }
        let photos = stages.photos.as_ref().map(|photos| &photos.report);
        if let Some(photos) = photos {
            self.judge_photos(photos);
        }
        if let Some(poses) = &stages.poses {
            self.judge_poses(
                &poses.report,
                photos.map_or(0, |photos| photos.photos.len()),
            );
            if let Some(features) = &stages.features {
                self.judge_kept(&kept_shares(&features.report, &poses.report));
            }
            if let Some(photos) = photos {
                self.judge_focals(&poses.report, photos);
            }
        }
        if let Some(lighting) = &stages.lighting {
            self.judge_light(&lighting.report);
        }
        match (&stages.shading, &stages.lighting) {
            (Some(shading), _) => self.judge_shape(&shading.report),
            (None, Some(lighting)) => self.judge_light_fit(&lighting.report),
            (None, None) => {}
        }
        if let Some(fusion) = &stages.fusion {
            self.judge_layering(&fusion.report.layering);
        }
    }

    fn judge_photos(&mut self, photos: &PhotosReport) {
        let orientations = photos.photos.iter();
        self.judge_orientations(orientations.map(|f| (f.file_name.as_str(), f.orientation)));
        let num_rejected = photos.rejected.len();
        if num_rejected > 0 {
            self.note(
                Verdict::Usable,
                format!("{num_rejected} photo(s) could not be used"),
            );
        }
        self.judge_masks(photos.num_masks, photos.photos.len());
        let outlines = photos.photos.iter();
        self.judge_mask_outlines(outlines.map(|f| (f.file_name.as_str(), f.mask_outline)));
    }

    fn judge_orientations<'a>(&mut self, photos: impl IntoIterator<Item = (&'a str, Orientation)>) {
        let photos = photos.into_iter();
        let mirrored = photos.filter(|(_, orientation)| orientation.is_mirrored());
        if let Some(names) = first_and_more(mirrored.map(|(name, _)| name)) {
            self.note(
                Verdict::NotToBeTrusted,
                format!(
                    "{names}: EXIF says that the stored pixels are the scene's mirror image, and so is the model; \
                     store them unmirrored"
                ),
            );
        }
    }

    fn judge_masks(&mut self, num_masks: usize, num_photos: usize) {
        if num_masks < num_photos {
            let which = match num_masks {
                0 => "no photo has an object mask".to_owned(),
                n => format!(
                    "{} of {num_photos} photos have no object mask",
                    num_photos - n
                ),
            };
            self.note(
                Verdict::Usable,
                format!(
                    "{which}: what stands around the object was taken for a part of it; `rilievo \
                     mask` proposes masks, --masks uses them"
                ),
            );
        }
    }

    fn judge_mask_outlines<'a>(
        &mut self,
        outlines: impl IntoIterator<Item = (&'a str, Option<MaskOutline>)>,
    ) {
        let outlines = outlines.into_iter();
        let harmful =
            outlines.filter(|(_, outline)| outline.is_some_and(|outline| outline.is_harmful()));
        if let Some(names) = first_and_more(harmful.map(|(name, _)| name)) {
            self.note(
                Verdict::Usable,
                format!(
                    "{names}: the mask reaches beyond the object's outline along most of its border, and what stands \
                     behind became a part of the model; draw it tighter"
                ),
            );
        }
    }

    fn judge_poses(&mut self, poses: &PosesReport, num_photos: usize) {
        let num_posed = poses.views.len();
        if num_posed < num_photos {
            let verdict = if 2 * num_posed < num_photos {
                Verdict::NotToBeTrusted
            } else {
                Verdict::Usable
            };
            self.note(
                verdict,
                format!("only {num_posed} of {num_photos} photos got a pose"),
            );
        }
        if num_posed == 2 {
            self.note(
                Verdict::Usable,
                "two photos confirm each other, and nothing confirms both: take a third from another \
                 side",
            );
        }
        let error = poses.mean_reprojection_error_px;
        if error > DOUBTFUL_REPROJECTION_PX {
            self.note(
                Verdict::Usable,
                format!("the mean reprojection error is {error:.2} px; good poses are below 1 px"),
            );
        }
        let mut counts: Vec<usize> = poses.views.iter().map(|view| view.num_points).collect();
        counts.sort_unstable();
        let usual = counts.get(counts.len() / 2).copied().unwrap_or(0);
        for view in &poses.views {
            let share = view.num_points as f64 / usual.max(1) as f64;
            let few = view.num_points < FEW_POINTS && share < FEW_POINTS_SHARE;
            if few || share < VERY_FEW_POINTS_SHARE {
                self.note(
                    Verdict::Usable,
                    format!(
                        "{} is held by {} points where a usual photo has {usual}: its pose may be \
                         wrong (a zoom or a crop, or too far from its neighbours); leave it out, or \
                         take photos between",
                        view.file_name, view.num_points
                    ),
                );
            }
        }
    }

    /// Names views that keep far less of their matches than the others.
    fn judge_kept(&mut self, kept: &[(&str, f64)]) {
        let mut shares: Vec<f64> = kept.iter().map(|(_, share)| *share).collect();
        let usual = median(&mut shares).unwrap_or(0.0);
        for (file_name, share) in kept {
            if *share < FEW_KEPT_SHARE * usual {
                self.note(
                    Verdict::Usable,
                    format!(
                        "{file_name} keeps {:.0} points of 100 matches where a usual photo keeps {:.0}: \
                         its matches contradict its camera (a zoom, a crop, a mirrored photo, or \
                         something moved), and its shape and its neighbours' may be wrong; leave it out, \
                         or give its focal length with --cameras",
                        100.0 * share,
                        100.0 * usual
                    ),
                );
            }
        }
    }

    fn judge_focals(&mut self, poses: &PosesReport, photos: &PhotosReport) {
        for &(group, stated, found) in &poses.refined_focals_px {
            let guessed = photos.camera_groups.get(group).is_some_and(|group| {
                photos.photos.iter().any(|photo| {
                    group.photos.contains(&photo.file_name)
                        && photo.focal_source == FocalSource::Guess
                })
            });
            if !guessed {
                self.judge_focal(stated, found);
            }
        }
        if let Some(focal) = &poses.contradicted_focal {
            self.note(Verdict::Usable, focal.advice());
        }
    }

    fn judge_focal(&mut self, stated: f64, found: f64) {
        if (found / stated - 1.0).abs() > DOUBTFUL_FOCAL_CHANGE {
            self.note(
                Verdict::Usable,
                format!(
                    "the photos contradict the stated focal length: {stated:.0} px stated, {found:.0} px \
                     found (a crop, or EXIF data of another photo); give the right one with --cameras"
                ),
            );
        }
    }

    fn judge_light(&mut self, lighting: &LightingReport) {
        if lighting.uncalibrated {
            self.note(
                Verdict::Usable,
                "the light is uncalibrated: no sphere, file or shape was given",
            );
        }
        if lighting
            .kind_check
            .as_ref()
            .is_some_and(|check| check.contradicts)
        {
            self.note(
                Verdict::Usable,
                "the photos contradict the way that the light was said to stand (still in the world, \
                 or turning with the camera): see the lighting's table",
            );
        }
    }

    /// Where no shape was solved yet, by what the light of stage 4 leaves of its own samples.
    fn judge_light_fit(&mut self, lighting: &LightingReport) {
        let views = lighting.views.iter();
        self.judge_residuals(views.filter_map(|v| Some((v.name.as_str(), v.relative_rms?))));
    }

    fn judge_shape(&mut self, shading: &ShadingFacts) {
        let advice = &shading.light_on_surface.advice;
        advice
            .iter()
            .for_each(|advice| self.note(Verdict::Usable, advice.clone()));
        let Some(photo) = &shading.solver.photo else {
            let views = shading.light_on_surface.views.iter();
            self.judge_residuals(views.map(|view| (view.name.as_str(), view.used_rms)));
            return;
        };
        let views = photo.views.iter();
        self.judge_residuals(views.filter_map(|v| Some((v.name.as_str(), v.light_residual?))));
        let left = photo.views.iter().filter_map(|v| v.light_residual);
        self.judge_matte(median(&mut left.collect::<Vec<_>>()));
        self.judge_sharpness(photo.alike_px());
        for view in &photo.views {
            if view.light_residual.is_none() {
                self.note(
                    Verdict::Usable,
                    format!(
                        "the shading of {} told nothing: its shape is what photos agree on, without \
                         fine relief",
                        view.name
                    ),
                );
            }
            if view.seen_alone > DOUBTFUL_SEEN_ALONE {
                self.note(
                    Verdict::Usable,
                    format!(
                        "{:.0} % of {} is seen by no other photo: take photos closer together",
                        100.0 * view.seen_alone,
                        view.name
                    ),
                );
            }
        }
        self.judge_confirmed(photo.views.iter().map(|v| (v.num_pixels, v.confirmed)));
        let found = photo.views.iter();
        let found = found.map(|v| (v.name.as_str(), v.confirmed, v.disagreement));
        let found: Vec<_> = found.collect();
        self.judge_agreement(&found);
    }

    /// By what light and pigment leave of the usual photo.
    fn judge_matte(&mut self, left: Option<f64>) {
        if let Some(left) = left.filter(|left| (MATTE_LIGHT..=DOUBTFUL_LIGHT).contains(left)) {
            self.note(
                Verdict::Usable,
                format!(
                    "light and pigment leave {:.1} % of the photos' brightness unexplained, where matte objects leave 1 \
                     to 3 %: a sheen, stains, or something moved; normals err more than usual. Dull it with powder or \
                     spray where that is allowed, and take larger, softer light",
                    100.0 * left
                ),
            );
        }
    }

    /// By the pixels over which residuals between the photos are alike.
    fn judge_sharpness(&mut self, alike_px: Option<f64>) {
        if let Some(side) = alike_px.filter(|&side| side > BLURRED_PX) {
            self.note(
                Verdict::Usable,
                format!(
                    "the photos hold no detail finer than about {:.0} px (sharp ones: 2 to 7): they are out of focus, \
                     were moved, or were enlarged; relief is lost and normals err more. Focus, close the aperture, use a \
                     tripod",
                    side.min(MOST_BLURRED_PX)
                ),
            );
        }
    }

    /// Names photos that show something else than the others: name, share that others confirm, disagreement.
    fn judge_agreement(&mut self, views: &[(&str, f64, f64)]) {
        let mut shares: Vec<f64> = views.iter().map(|(_, confirmed, _)| *confirmed).collect();
        let usual = median(&mut shares).unwrap_or(0.0);
        for (name, confirmed, _) in views {
            if *confirmed < CONTRADICTED_SHARE * usual {
                self.note(
                    Verdict::Usable,
                    format!(
                        "other photos confirm only {:.0} % of what {name} shows, where a usual photo has {:.0} %: the \
                         object or the lamp was moved, or its pose is wrong; leave it out",
                        100.0 * confirmed,
                        100.0 * usual
                    ),
                );
            }
        }
        let least = views
            .iter()
            .fold(f64::INFINITY, |least, view| least.min(view.2));
        let worst = views.iter().max_by(|a, b| a.2.total_cmp(&b.2));
        if let Some((name, _, most)) = worst.filter(|view| view.2 > DISAGREEMENT)
            && *most > UNEVEN_DISAGREEMENT * least
        {
            self.note(
                Verdict::Usable,
                format!(
                    "the photos disagree unevenly about how bright one place is, by {:.1} % in {name} and by {:.1} % in \
                     another: the object or the lamp was moved between them",
                    100.0 * most,
                    100.0 * least
                ),
            );
        }
    }

    fn judge_confirmed(&mut self, views: impl Iterator<Item = (usize, f64)>) {
        let (num_pixels, num_confirmed) = views.fold((0.0, 0.0), |(all, sum), (pixels, share)| {
            (all + pixels as f64, sum + pixels as f64 * share)
        });
        let confirmed = num_confirmed / num_pixels;
        if num_pixels > 0.0 && confirmed < DOUBTFUL_CONFIRMED {
            let verdict = if confirmed < UNTRUSTED_CONFIRMED {
                Verdict::NotToBeTrusted
            } else {
                Verdict::Usable
            };
            self.note(
                verdict,
                format!(
                    "several photos confirm only {:.0} % of the surface: it moved, it shines, or the \
                     photos are too far apart",
                    100.0 * confirmed
                ),
            );
        }
    }

    /// Names the photos that differ too much from what shape and light explain.
    fn judge_residuals<'a>(&mut self, views: impl Iterator<Item = (&'a str, f64)>) {
        let views: Vec<_> = views.collect();
        let mut residuals: Vec<f64> = views.iter().map(|(_, rms)| *rms).collect();
        let usual = median(&mut residuals).unwrap_or(0.0);
        let doubtful = views.into_iter().filter(|(_, rms)| *rms > DOUBTFUL_LIGHT);
        let doubtful: Vec<_> = doubtful.collect();
        if doubtful.is_empty() {
            return;
        }
        let names: Vec<&str> = doubtful.iter().map(|(name, _)| *name).collect();
        let largest = doubtful.iter().fold(0.0_f64, |max, (_, rms)| max.max(*rms));
        let verdict = if usual > UNTRUSTED_LIGHT {
            Verdict::NotToBeTrusted
        } else {
            Verdict::Usable
        };
        self.note(
            verdict,
            format!(
                "shape and light miss the brightness of {} by up to {:.0} % (well-lit matte objects: \
                 below {:.0} %): masks beside the object, gloss, stains, a lamp that moved, or light from \
                 nearby; softer light from several sides helps",
                names.join(", "),
                100.0 * largest,
                100.0 * DOUBTFUL_LIGHT
            ),
        );
    }

    fn judge_layering(&mut self, layering: &Layering) {
        let apart = layering.median / layering.footprint;
        if layering.footprint > 0.0 && apart > DOUBTFUL_LAYERING_PX {
            self.note(
                Verdict::NotToBeTrusted,
                format!(
                    "overlapping views lie {apart:.1} pixel footprints apart: their surfaces form \
                     layers"
                ),
            );
        }
    }
}

/// Posed views by file name with the points that they keep of all matches with other posed views.
fn kept_shares<'a>(features: &FeaturesReport, poses: &'a PosesReport) -> Vec<(&'a str, f64)> {
    let index_of = |name: &str| {
        let mut photos = features.photos.iter();
        photos.position(|p| p.file_name == name).map(PhotoIdx)
    };
    let indices: Vec<Option<PhotoIdx>> =
        poses.views.iter().map(|v| index_of(&v.file_name)).collect();
    let shares = poses
        .views
        .iter()
        .zip(&indices)
        .filter_map(|(view, index)| {
            let index = (*index)?;
            let matches: usize = features
                .pairs
                .iter()
                .filter(|pair| pair.first == index || pair.second == index)
                .filter(|pair| indices.contains(&Some(pair.first)))
                .filter(|pair| indices.contains(&Some(pair.second)))
                .map(|pair| pair.num_verified)
                .sum();
            (matches > 0).then(|| {
                (
                    view.file_name.as_str(),
                    view.num_points as f64 / matches as f64,
                )
            })
        });
    shares.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_lighting::ViewLightReport;
    use rilievo_poses::ViewReport;
    use rilievo_shading::photo::{PhotoReport, StepReport};

    fn verdict(change: impl FnOnce(&mut Judgement)) -> Verdict {
        let mut judgement = Judgement::nothing_against();
        change(&mut judgement);
        judgement.verdict
    }

    #[test]
    fn the_verdict_follows_the_facts() {
        let layering = |median| Layering {
            median,
            footprint: 2e-4,
            ..Layering::default()
        };
        assert_eq!(
            verdict(|j| j.judge_layering(&layering(1e-4))),
            Verdict::Good
        );
        let layers = verdict(|j| j.judge_layering(&layering(1e-3)));
        assert_eq!(layers, Verdict::NotToBeTrusted);

        let poses = |mean_reprojection_error_px| PosesReport {
            mean_reprojection_error_px,
            ..PosesReport::default()
        };
        assert_eq!(verdict(|j| j.judge_poses(&poses(0.3), 0)), Verdict::Good);
        assert_eq!(verdict(|j| j.judge_poses(&poses(1.3), 0)), Verdict::Usable);
        let none = verdict(|j| j.judge_poses(&poses(0.3), 2));
        assert_eq!(none, Verdict::NotToBeTrusted);

        let light = |residual| LightingReport {
            views: vec![ViewLightReport {
                relative_rms: Some(residual),
                ..ViewLightReport::default()
            }],
            ..LightingReport::default()
        };
        assert_eq!(verdict(|j| j.judge_light_fit(&light(0.1))), Verdict::Good);
        assert_eq!(verdict(|j| j.judge_light_fit(&light(0.3))), Verdict::Usable);
        let nothing_fits = verdict(|j| j.judge_light_fit(&light(0.5)));
        assert_eq!(nothing_fits, Verdict::NotToBeTrusted);

        let nothing = verdict(|j| j.judge(&Stages::default()));
        assert_eq!(nothing, Verdict::NotFinished);
    }

    #[test]
    fn a_photo_that_hangs_by_a_thread_is_named() {
        let poses = |counts: &[usize]| PosesReport {
            views: counts
                .iter()
                .enumerate()
                .map(|(index, &num_points)| ViewReport {
                    file_name: format!("IMG_{index}.jpg"),
                    num_points,
                    mean_error_px: 0.1,
                    rotation_sigma_deg: None,
                    center_sigma: None,
                })
                .collect(),
            ..PosesReport::default()
        };
        let ends_of_an_arc = poses(&[403, 2079, 2302, 1101]);
        assert_eq!(
            verdict(|j| j.judge_poses(&ends_of_an_arc, 4)),
            Verdict::Good
        );
        let ends_of_many = poses(&[448, 3179, 3300, 3179, 518]);
        assert_eq!(verdict(|j| j.judge_poses(&ends_of_many, 5)), Verdict::Good);
        let mut judgement = Judgement::nothing_against();
        judgement.judge_poses(&poses(&[1100, 2900, 91, 1500]), 4);
        assert_eq!(judgement.verdict, Verdict::Usable);
        assert_eq!(judgement.reasons.len(), 1);
        assert!(judgement.reasons[0].starts_with("IMG_2.jpg is held by 91 points"));
        let two = poses(&[800, 800]);
        assert_eq!(verdict(|j| j.judge_poses(&two, 2)), Verdict::Usable);
    }

    #[test]
    fn a_photo_whose_matches_contradict_its_camera_is_named() {
        let kept = |shares: [f64; 4]| {
            let mut judgement = Judgement::nothing_against();
            let names = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"];
            let kept: Vec<_> = names.into_iter().zip(shares).collect();
            judgement.judge_kept(&kept);
            judgement
        };
        assert_eq!(kept([0.83, 0.73, 0.55, 0.77]).verdict, Verdict::Good);
        let cropped = kept([0.48, 0.38, 0.14, 0.46]);
        assert_eq!(cropped.verdict, Verdict::Usable);
        assert_eq!(cropped.reasons.len(), 1);
        assert!(cropped.reasons[0].starts_with("c.jpg keeps 14 points of 100 matches"));
    }

    #[test]
    fn mirrored_photos_make_a_mirrored_model() {
        let level = |number| {
            let orientation = Orientation::of_exif(number).unwrap();
            verdict(|j| j.judge_orientations([("a.jpg", orientation)]))
        };
        assert_eq!(level(6), Verdict::Good);
        assert_eq!(level(5), Verdict::NotToBeTrusted);
    }

    #[test]
    fn missing_masks_and_contradicted_focal_lengths_are_told() {
        assert_eq!(verdict(|j| j.judge_masks(4, 4)), Verdict::Good);
        assert_eq!(verdict(|j| j.judge_masks(3, 4)), Verdict::Usable);
        assert_eq!(verdict(|j| j.judge_masks(0, 4)), Verdict::Usable);
        let outline = |beyond_px| MaskOutline {
            beyond_px,
            share_on_outline: 0.1,
            tolerance_px: 2.0,
        };
        for (beyond, expected) in [
            (6.0, Verdict::Usable),
            (3.0, Verdict::Good),
            (-6.0, Verdict::Good),
        ] {
            let found = [("a.jpg", None), ("b.jpg", Some(outline(beyond)))];
            assert_eq!(verdict(|j| j.judge_mask_outlines(found)), expected);
        }
        assert_eq!(verdict(|j| j.judge_focal(1000.0, 1030.0)), Verdict::Good);
        assert_eq!(verdict(|j| j.judge_focal(1000.0, 1400.0)), Verdict::Usable);
        let poses = PosesReport {
            contradicted_focal: Some(rilievo_poses::ContradictedFocal {
                file_name: "a.jpg".to_owned(),
                given_px: 1000.0,
                found_px: 1050.0,
            }),
            ..PosesReport::default()
        };
        let given = verdict(|j| j.judge_focals(&poses, &PhotosReport::default()));
        assert_eq!(given, Verdict::Usable);
    }

    #[test]
    fn a_surface_that_no_second_photo_confirms_is_not_good() {
        let confirmed =
            |share| verdict(|j| j.judge_confirmed([(100, share), (300, share)].into_iter()));
        assert_eq!(confirmed(0.9), Verdict::Good);
        assert_eq!(confirmed(0.5), Verdict::Usable);
        assert_eq!(confirmed(0.2), Verdict::NotToBeTrusted);
        assert_eq!(
            verdict(|j| j.judge_confirmed(std::iter::empty())),
            Verdict::Good
        );
    }

    #[test]
    fn gloss_and_blur_are_told() {
        let matte = |left| verdict(|j| j.judge_matte(left));
        assert_eq!(matte(None), Verdict::Good);
        assert_eq!(matte(Some(0.03)), Verdict::Good);
        assert_eq!(matte(Some(0.049)), Verdict::Usable);
        let sharp = |correlation| {
            let mut photo = PhotoReport::default();
            photo.steps.push(StepReport {
                level: 0,
                match_correlation: correlation,
                ..Default::default()
            });
            verdict(|j| j.judge_sharpness(photo.alike_px()))
        };
        assert_eq!(sharp(None), Verdict::Good);
        assert_eq!(sharp(Some(0.74)), Verdict::Good);
        assert_eq!(sharp(Some(0.89)), Verdict::Usable);
        assert_eq!(sharp(Some(1.0)), Verdict::Usable);
    }

    #[test]
    fn photos_that_show_something_else_are_named() {
        let judged = |views: &[(f64, f64)]| {
            let names = ["IMG_0", "IMG_1", "IMG_2", "IMG_3"];
            let named = names.into_iter().zip(views);
            let views: Vec<_> = named
                .map(|(name, &(confirmed, disagreement))| (name, confirmed, disagreement))
                .collect();
            let mut judgement = Judgement::nothing_against();
            judgement.judge_agreement(&views);
            judgement
        };
        let good = [(0.92, 0.019), (0.98, 0.02), (0.99, 0.018), (0.93, 0.019)];
        assert_eq!(judged(&good).verdict, Verdict::Good);
        let one_moved = judged(&[(0.92, 0.028), (0.97, 0.022), (0.3, 0.059), (0.98, 0.02)]);
        assert!(one_moved.reasons[0].contains("only 30 % of what IMG_2 shows"));
        let half_moved = judged(&[(0.89, 0.024), (0.94, 0.066), (0.93, 0.067), (0.93, 0.022)]);
        assert_eq!(half_moved.verdict, Verdict::Usable);
        assert!(half_moved.reasons[0].contains("6.7 % in IMG_2 and by 2.2 %"));
    }

    #[test]
    fn programs_read_one_of_three_levels() {
        let level = |verdict| {
            serde_json::json!(Judgement {
                verdict,
                reasons: Vec::new()
            })
        };
        assert_eq!(level(Verdict::Good)["level"], "good");
        assert_eq!(level(Verdict::Usable)["level"], "usable");
        assert_eq!(level(Verdict::NotFinished)["level"], "usable");
        assert_eq!(level(Verdict::NotToBeTrusted)["level"], "untrusted");
    }
}
