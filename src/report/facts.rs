//! What a run's manifests hold, with the types of the stages' reports. Its JSON is `report.json`.

use super::outcome::Outcome;
use crate::cost::{Cost, Estimate};
use crate::pipeline::{Plan, Request, ShadingFacts, StageState};
use crate::store::{Look, Manifest, RunDir};
use crate::system;
use rilievo_features::FeaturesReport;
use rilievo_fusion::FusionReport;
use rilievo_lighting::LightingReport;
use rilievo_photos::PhotosReport;
use rilievo_poses::PosesReport;
use rilievo_scene::{ScaleSource, StageId, Unit};
use serde::de::DeserializeOwned;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

/// Everything that is known of a run.
#[derive(Debug, Serialize)]
pub struct Facts {
    /// Program and version that wrote the report.
    pub program: &'static str,
    /// How the command ended.
    pub outcome: Outcome,
    /// What was asked for.
    pub request: Request,
    /// The committed stages.
    pub stages: Stages,
    /// What the user should know.
    pub warnings: Vec<Warning>,
    /// Threads of the last stage.
    pub threads: Option<usize>,
    /// Largest memory of any stage, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// What the whole run was expected to cost, where that was estimated.
    pub expected: Option<Estimate>,
    /// What the stages did cost, where all are there and report it.
    pub cost: Option<Cost>,
    /// What to cite.
    pub citation: &'static str,
}

/// A stage's warning.
#[derive(Debug, Serialize)]
pub struct Warning {
    /// The stage.
    pub stage: StageId,
    /// What it said.
    pub message: String,
}

/// The stages that have a result.
#[derive(Debug, Default, Serialize)]
pub struct Stages {
    #[serde(rename = "1_photos", skip_serializing_if = "Option::is_none")]
    pub photos: Option<Stage<PhotosReport>>,
    #[serde(rename = "2_features", skip_serializing_if = "Option::is_none")]
    pub features: Option<Stage<FeaturesReport>>,
    #[serde(rename = "3_poses", skip_serializing_if = "Option::is_none")]
    pub poses: Option<Stage<PosesReport>>,
    #[serde(rename = "4_lighting", skip_serializing_if = "Option::is_none")]
    pub lighting: Option<Stage<LightingReport>>,
    #[serde(rename = "5_shading", skip_serializing_if = "Option::is_none")]
    pub shading: Option<Stage<ShadingFacts>>,
    #[serde(rename = "6_fusion", skip_serializing_if = "Option::is_none")]
    pub fusion: Option<Stage<FusionReport>>,
}

impl Stages {
    /// Lengths of the box around the mesh, what a pixel covers, and what the size rests on, in a
    /// line.
    pub fn size(&self) -> Option<String> {
        let fusion = &self.fusion.as_ref()?.report;
        let scale = &self.poses.as_ref()?.report.scale;
        let [low, high] = fusion.mesh.as_ref()?.bounds?;
        let lengths = [0, 1, 2].map(|k| f64::from(high[k] - low[k]));
        let footprint = fusion.layering.footprint;
        if scale.unit == Unit::Arbitrary {
            let [x, y, z] = lengths.map(|length| format!("{length:.3}"));
            return Some(format!(
                "{x} x {y} x {z} {} along the world's axes, an arbitrary unit (nothing gave the size); {footprint:.2e} \
                 a pixel",
                scale.unit.words()
            ));
        }
        let [x, y, z] = lengths.map(|length| format!("{:.1}", 1e3 * length));
        let source = match scale.source {
            ScaleSource::Sphere => "the stated radius of the sphere",
            ScaleSource::GivenPoses => "the given cameras",
            ScaleSource::KnownDistance => "the stated distance",
            ScaleSource::Gauge => "nothing",
        };
        Some(format!(
            "{x} x {y} x {z} mm along the world's axes, by {source}; {:.3} mm a pixel",
            1e3 * footprint
        ))
    }
}

/// A committed stage.
#[derive(Debug)]
pub struct Stage<R> {
    /// Whether it still is what would be made now, where that is known.
    pub state: Option<StageState>,
    /// What it was made from, and when, less what only the stage understands.
    pub manifest: Manifest,
    /// What it found.
    pub report: R,
}

impl<R: Serialize> Serialize for Stage<R> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let manifest = &self.manifest;
        let mut map = to.serialize_map(None)?;
        map.serialize_entry("state", &self.state)?;
        map.serialize_entry("seconds", &manifest.seconds)?;
        map.serialize_entry("fingerprint", &manifest.fingerprint)?;
        map.serialize_entry("program", &manifest.program)?;
        map.serialize_entry("options", &manifest.ingredients.options)?;
        map.serialize_entry("inputs", &manifest.ingredients.inputs)?;
        map.serialize_entry("files", &manifest.files)?;
        map.serialize_entry("report", &self.report)?;
        map.serialize_entry("peak_memory_bytes", &manifest.peak_memory_bytes)?;
        map.end()
    }
}

impl Stages {
    fn manifests(&self) -> impl Iterator<Item = &Manifest> {
        fn of<R>(stage: Option<&Stage<R>>) -> Option<&Manifest> {
            Some(&stage?.manifest)
        }
        let manifests = [
            of(self.photos.as_ref()),
            of(self.features.as_ref()),
            of(self.poses.as_ref()),
            of(self.lighting.as_ref()),
            of(self.shading.as_ref()),
            of(self.fusion.as_ref()),
        ];
        manifests.into_iter().flatten()
    }

    /// What all of them did cost; `None` where one is missing or does not report it.
    fn cost(&self) -> Option<Cost> {
        if self.manifests().count() < StageId::ALL.len() {
            return None;
        }
        let files = self
            .manifests()
            .flat_map(|manifest| manifest.files.values());
        let seconds = self.manifests().map(|manifest| manifest.cpu_seconds);
        Some(Cost {
            cpu_seconds: seconds.sum::<Option<f64>>()?,
            peak_memory_bytes: self.peak_memory_bytes()? as f64,
            disk_bytes: files.map(|file| file.bytes).sum::<u64>() as f64,
        })
    }

    fn peak_memory_bytes(&self) -> Option<u64> {
        self.manifests()
            .filter_map(|manifest| manifest.peak_memory_bytes)
            .max()
    }
}

impl Facts {
    /// Gathers the facts from the stages' manifests; a stage whose manifest is damaged is left out.
    ///
    /// # Errors
    /// When a stage's files cannot be looked at, or its report is not one.
    pub fn gather(
        run: &RunDir,
        request: &Request,
        outcome: &Outcome,
        plan: Option<&Plan>,
    ) -> anyhow::Result<Self> {
        let mut warnings = Vec::new();
        let stages = Stages {
            photos: stage(run, plan, StageId::Photos, &mut warnings)?,
            features: stage(run, plan, StageId::Features, &mut warnings)?,
            poses: stage(run, plan, StageId::Poses, &mut warnings)?,
            lighting: stage(run, plan, StageId::Lighting, &mut warnings)?,
            shading: stage(run, plan, StageId::Shading, &mut warnings)?,
            fusion: stage(run, plan, StageId::Fusion, &mut warnings)?,
        };
        Ok(Self {
            program: system::PROGRAM,
            outcome: outcome.clone(),
            request: request.clone(),
            warnings,
            threads: stages.manifests().last().map(|manifest| manifest.threads),
            peak_memory_bytes: stages.peak_memory_bytes(),
            expected: stages
                .manifests()
                .filter_map(|manifest| manifest.expected)
                .last(),
            cost: stages.cost(),
            stages,
            citation: "Queau, Melou, Durou, Cremers: Dense Multi-view 3D-reconstruction Without \
                       Dense Correspondences. ICCV 2017",
        })
    }
}

/// A committed stage; its warnings go to `warnings`.
fn stage<R: DeserializeOwned>(
    run: &RunDir,
    plan: Option<&Plan>,
    id: StageId,
    warnings: &mut Vec<Warning>,
) -> anyhow::Result<Option<Stage<R>>> {
    let Ok(Some(mut manifest)) = run.manifest(id) else {
        return Ok(None);
    };
    let messages = manifest.warnings.drain(..);
    warnings.extend(messages.map(|message| Warning { stage: id, message }));
    let state = plan
        .map(|plan| plan.state(run, id, Look::Sizes))
        .transpose()?;
    match serde_json::from_value(manifest.report.take()) {
        Ok(report) => Ok(Some(Stage {
            state,
            manifest,
            report,
        })),
        // JSON has no number that is not finite: the results stand, the findings cannot be shown.
        Err(error) => {
            let message = format!("the findings of {id} cannot be shown: {error}");
            warnings.push(Warning { stage: id, message });
            Ok(None)
        }
    }
}
