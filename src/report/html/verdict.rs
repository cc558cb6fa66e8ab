//! How far a result can be relied on, and why.

use crate::pipeline::StageState;
use crate::report::facts::{Facts, Stages};
use rilievo_fusion::Layering;

/// How far a result can be relied on, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    Good,
    Usable,
    NotFinished,
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
/// Light residual above which shading contradicts the photos: nine distant harmonics leave 10 to
/// 12 % on real objects, half-hidden light up to 20 %.
const DOUBTFUL_LIGHT: f64 = 0.2;
/// Distance between overlapping views, in pixel footprints, above which they form layers.
const DOUBTFUL_LAYERING_PX: f64 = 2.0;

/// The verdict, and everything that made it worse.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    pub verdict: Verdict,
    pub reasons: Vec<String>,
}

impl Judgement {
    /// Judges a run.
    pub fn of(facts: &Facts) -> Self {
        let mut judgement = Self {
            verdict: Verdict::Good,
            reasons: Vec::new(),
        };
        if let Some(error) = &facts.outcome.error {
            judgement.note(
                Verdict::NotToBeTrusted,
                format!("the run did not end: {error}"),
            );
        }
        judgement.judge(&facts.stages);
        judgement
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
        let num_rejected = photos.map_or(0, |photos| photos.rejected.len());
        if num_rejected > 0 {
            self.note(
                Verdict::Usable,
                format!("{num_rejected} photo(s) could not be used"),
            );
        }
        if let Some(poses) = &stages.poses {
            let num_photos = photos.map_or(0, |photos| photos.photos.len());
            self.judge_poses(&poses.report, num_photos);
        }
        if let Some(lighting) = &stages.lighting {
            self.judge_light(&lighting.report);
        }
        if let Some(fusion) = &stages.fusion {
            self.judge_layering(&fusion.report.layering_after);
        }
    }

    fn judge_poses(&mut self, poses: &rilievo_poses::PosesReport, num_photos: usize) {
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
        let error = poses.mean_reprojection_error_px;
        if error > DOUBTFUL_REPROJECTION_PX {
            self.note(
                Verdict::Usable,
                format!("the mean reprojection error is {error:.2} px; good poses are below 1 px"),
            );
        }
    }

    fn judge_light(&mut self, lighting: &rilievo_lighting::LightingReport) {
        if lighting.uncalibrated {
            self.note(
                Verdict::Usable,
                "the light is uncalibrated: no sphere, file or shape was given",
            );
        }
        for view in &lighting.views {
            let doubtful = |residual: &f64| *residual > DOUBTFUL_LIGHT;
            if let Some(residual) = view.relative_rms.filter(doubtful) {
                let reason = format!(
                    "the light explains {} only to {:.0} %",
                    view.name,
                    100.0 * residual
                );
                self.note(Verdict::Usable, reason);
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_lighting::{LightingReport, ViewLightReport};
    use rilievo_poses::PosesReport;

    fn verdict(change: impl FnOnce(&mut Judgement)) -> Verdict {
        let mut judgement = Judgement {
            verdict: Verdict::Good,
            reasons: Vec::new(),
        };
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
        assert_eq!(verdict(|j| j.judge_light(&light(0.1))), Verdict::Good);
        assert_eq!(verdict(|j| j.judge_light(&light(0.3))), Verdict::Usable);

        let nothing = verdict(|j| j.judge(&Stages::default()));
        assert_eq!(nothing, Verdict::NotFinished);
    }
}
