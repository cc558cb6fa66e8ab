//! How far a result can be relied on, and why: the findings of all stages, and those that only the
//! whole run shows.

use super::facts::{Facts, Stages};
use crate::pipeline::{MaskOrigin, StageState};
use rilievo_features::FeaturesReport;
use rilievo_photometry::surface_check::missed_photos;
use rilievo_photos::PhotosReport;
use rilievo_poses::PosesReport;
use rilievo_scene::{Finding, FindingCode, FocalSource, PhotoIdx, Verdict};
use serde::Serialize;

/// The verdict, everything that made it worse, and what the run has mended itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judgement {
    /// The worst of the findings' severities.
    #[serde(rename = "level")]
    pub verdict: Verdict,
    /// The sentences of those that made it worse.
    pub reasons: Vec<String>,
    /// Those of the others.
    pub notes: Vec<String>,
}

impl Judgement {
    /// Judges a run by its findings.
    pub fn of(findings: &[Finding]) -> Self {
        let (notes, reasons): (Vec<_>, Vec<_>) = findings
            .iter()
            .partition(|finding| finding.severity() == Verdict::Good);
        let sentences = |found: Vec<&Finding>| found.into_iter().map(Finding::sentence).collect();
        Self {
            verdict: Verdict::of(findings),
            reasons: sentences(reasons),
            notes: sentences(notes),
        }
    }

    /// The verdict and its reasons, a line each.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let verdict = format!("verdict: {}", self.verdict.words());
        let reasons = self.reasons.iter().map(|reason| format!("  - {reason}"));
        let notes = self.notes.iter().map(|note| format!("  note: {note}"));
        std::iter::once(verdict).chain(reasons).chain(notes)
    }
}

/// Everything that speaks against the result of a run.
pub fn findings(facts: &Facts) -> Vec<Finding> {
    let error = facts.outcome.error.as_deref();
    let mut findings: Vec<Finding> = Finding::about(error, FindingCode::RunFailed)
        .into_iter()
        .collect();
    findings.extend(of_stages(&facts.stages));
    if facts.request.masks_from == MaskOrigin::Proposed {
        findings.push(FindingCode::MasksProposed.into());
    }
    findings
}

fn of_stages(stages: &Stages) -> Vec<Finding> {
    let mut findings = Vec::new();
    let fusion = stages.fusion.as_ref();
    findings.extend(match fusion.map(|fusion| &fusion.state) {
        None => Some(FindingCode::NotFused.into()),
        Some(Some(StageState::Stale { .. })) => Some(FindingCode::FusionStale.into()),
        Some(Some(StageState::Damaged { reason })) => {
            Finding::about([reason.as_str()], FindingCode::FusionDamaged)
        }
        Some(_) => None,
    });
    let photos = stages.photos.as_ref().map(|photos| &photos.report);
    findings.extend(photos.into_iter().flat_map(PhotosReport::findings));
    if let Some(poses) = &stages.poses {
        let features = stages.features.as_ref();
        let kept = features.map(|features| kept_shares(&features.report, &poses.report));
        let num_photos = photos.map_or(0, |photos| photos.photos.len());
        let is_guess = |group| photos.is_some_and(|photos| is_guessed(photos, group));
        let kept = kept.unwrap_or_default();
        findings.extend(poses.report.findings(num_photos, &kept, is_guess));
    }
    let lighting = stages.lighting.as_ref().map(|lighting| &lighting.report);
    findings.extend(lighting.into_iter().flat_map(|report| report.findings()));
    match stages.shading.as_ref().map(|shading| &shading.report) {
        None => findings.extend(lighting.and_then(|report| report.fit_finding())),
        Some(shading) => {
            let light = &shading.light_on_surface;
            findings.extend(light.findings());
            match &shading.solver.photo {
                Some(photo) => findings.extend(photo.findings()),
                None => {
                    let views = light.views.iter();
                    let residuals = views.map(|view| (view.name.as_str(), view.used_rms));
                    findings.extend(missed_photos(residuals));
                }
            }
        }
    }
    findings.extend(fusion.into_iter().flat_map(|f| f.report.findings()));
    findings
}

/// Whether nothing was known of a camera group's focal length.
fn is_guessed(photos: &PhotosReport, group: usize) -> bool {
    photos.camera_groups.get(group).is_some_and(|group| {
        let of_group = |name| group.photos.contains(name);
        let guessed = |source| source == FocalSource::Guess;
        let mut photos = photos.photos.iter();
        photos.any(|photo| of_group(&photo.file_name) && guessed(photo.focal_source))
    })
}

/// Posed views by file name with the points that they keep of all matches with other posed views.
fn kept_shares<'a>(features: &FeaturesReport, poses: &'a PosesReport) -> Vec<(&'a str, f64)> {
    let index_of = |name: &str| {
        let mut photos = features.photos.iter();
        photos.position(|p| p.file_name == name).map(PhotoIdx)
    };
    let indices: Vec<Option<PhotoIdx>> =
        poses.views.iter().map(|v| index_of(&v.file_name)).collect();
    let posed = features.pairs.iter().filter(|pair| {
        [pair.first, pair.second]
            .iter()
            .all(|photo| indices.contains(&Some(*photo)))
    });
    let posed: Vec<_> = posed.collect();
    let views = poses.views.iter().zip(&indices);
    let shares = views.filter_map(|(view, index)| {
        let index = (*index)?;
        let pairs = posed.iter();
        let own = pairs.filter(|pair| pair.first == index || pair.second == index);
        let matches: usize = own.map(|pair| pair.num_verified).sum();
        let share = view.num_points as f64 / matches as f64;
        (matches > 0).then_some((view.file_name.as_str(), share))
    });
    shares.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_a_mesh_is_not_finished() {
        let findings = of_stages(&Stages::default());
        assert_eq!(findings, [FindingCode::NotFused.into()]);
        assert_eq!(Verdict::of(&findings), Verdict::NotFinished);
    }

    #[test]
    fn what_the_run_has_mended_is_a_note() {
        let mended = FindingCode::StatedFocalContradicted {
            stated_px: 1000.0,
            found_px: 1520.0,
        };
        let alone = Judgement::of(&[mended.into()]);
        assert_eq!((alone.verdict, alone.reasons.len()), (Verdict::Good, 0));
        let lines: Vec<String> = alone.lines().collect();
        assert!(
            lines[1].starts_with("  note: the photos contradict the focal length"),
            "{lines:?}"
        );
        let both = Judgement::of(&[mended.into(), FindingCode::OnlyTwoPosed.into()]);
        assert_eq!((both.reasons.len(), both.notes.len()), (1, 1));
        assert_eq!(both.verdict, Verdict::Usable);
    }

    #[test]
    fn programs_read_one_of_three_levels() {
        let level = |verdict| {
            serde_json::json!(Judgement {
                verdict,
                reasons: Vec::new(),
                notes: Vec::new(),
            })
        };
        assert_eq!(level(Verdict::Good)["level"], "good");
        assert_eq!(level(Verdict::Usable)["level"], "usable");
        assert_eq!(level(Verdict::NotFinished)["level"], "usable");
        assert_eq!(level(Verdict::NotToBeTrusted)["level"], "untrusted");
    }

    #[test]
    fn programs_read_a_finding_by_its_code_and_numbers() {
        let found = |finding: Finding| serde_json::json!(finding);
        let expected = serde_json::json!({
            "code": "photos_rejected", "severity": "usable", "subject": [], "numbers": { "photos": 2.0 },
            "sentence": "2 photo(s) could not be used",
        });
        assert_eq!(
            found(FindingCode::PhotosRejected { photos: 2.0 }.into()),
            expected
        );
        assert_eq!(found(FindingCode::NotFused.into())["severity"], "usable");
        let failed = Finding::about(["full disk"], FindingCode::RunFailed).unwrap();
        assert_eq!(failed.sentence(), "the run did not end: full disk");
        assert_eq!(found(failed)["severity"], "untrusted");
    }
}
