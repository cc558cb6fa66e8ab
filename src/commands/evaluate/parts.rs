//! What of a truth has a counterpart in a result: an evaluation without any is none.

use super::comparison::Comparison;
use crate::exit::Failure;
use rilievo_scene::StageId;

/// A part of the truth, and what it is compared with.
struct Part {
    /// The file that holds it.
    file: &'static str,
    /// The stage that makes its counterpart.
    stage: StageId,
    in_truth: bool,
    in_result: bool,
}

impl Comparison {
    /// Why there is nothing to compare: the truth is not of this result, or the result lacks what the
    /// truth has. `None` where some part is on both sides.
    pub fn nothing_in_common(&self) -> Result<Option<Failure>, Failure> {
        let parts = self.parts()?;
        if parts.iter().any(|part| part.in_truth && part.in_result) {
            return Ok(None);
        }
        let known: Vec<&Part> = parts.iter().filter(|part| part.in_truth).collect();
        Ok(Some(if self.estimate.expected.is_empty() {
            Failure::NoResult(format!(
                "there is nothing to compare: {} has no result of any photo yet; `rilievo \
                 reconstruct` makes it",
                self.run.display()
            ))
        } else if known.is_empty() {
            self.foreign_truth(&parts)
        } else {
            self.missing_stages(&known)
        }))
    }

    fn parts(&self) -> Result<[Part; 5], Failure> {
        let Self {
            estimate, truth, ..
        } = self;
        let names = &estimate.expected;
        let poses = truth.poses(names);
        let is_posed = |name: &str| estimate.poses.iter().any(|pose| pose.name == name);
        let is_lit = |file: Option<rilievo_io::LightingFile>| {
            file.is_some_and(|file| names.iter().any(|name| file.for_view(name).is_some()))
        };
        Ok([
            Part {
                file: "cameras.json with poses",
                stage: StageId::Poses,
                in_truth: !poses.is_empty(),
                in_result: poses.iter().any(|pose| is_posed(&pose.name)),
            },
            Part {
                file: "NAME_depth.exr, NAME_normal.exr",
                stage: StageId::Shading,
                in_truth: !self.views.is_empty(),
                in_result: self.views.iter().any(|view| estimate.has_map(&view.name)),
            },
            Part {
                file: "mesh.ply",
                stage: StageId::Fusion,
                in_truth: self.surface.is_some(),
                in_result: self.cloud.is_some(),
            },
            Part {
                file: "lighting.json",
                stage: StageId::Lighting,
                in_truth: is_lit(truth.lighting()?),
                in_result: is_lit(estimate.lighting()?),
            },
            Part {
                file: "NAME_albedo.exr",
                stage: StageId::Shading,
                in_truth: names.iter().any(|name| truth.albedo_file(name).exists()),
                in_result: names.iter().any(|name| estimate.albedo_file(name).exists()),
            },
        ])
    }

    /// No file of the truth is about these photos.
    fn foreign_truth(&self, parts: &[Part]) -> Failure {
        let files: Vec<&str> = parts.iter().map(|part| part.file).collect();
        let example = self.estimate.expected.first().map_or("", String::as_str);
        let inside = self.truth.folder.join("truth");
        let hint = if inside.is_dir() {
            format!("; the truth may be in {}", inside.display())
        } else {
            String::new()
        };
        Failure::input(
            &self.truth.folder,
            format!(
                "holds no truth of {}: looked for {}; NAME and the cameras' images go by the photos' \
                 names, as {example}{hint} (--truth)",
                self.run.display(),
                files.join(", "),
            ),
        )
    }

    /// The result has nothing beside what the truth holds.
    fn missing_stages(&self, known: &[&Part]) -> Failure {
        let mut stages: Vec<&str> = known.iter().map(|part| part.stage.name()).collect();
        stages.sort_unstable();
        stages.dedup();
        let files: Vec<&str> = known.iter().map(|part| part.file).collect();
        Failure::NoResult(format!(
            "there is nothing to compare: the truth holds {}, and {} has no result of {} beside it; \
             `rilievo reconstruct` makes it",
            files.join(", "),
            self.run.display(),
            stages.join(", "),
        ))
    }
}
