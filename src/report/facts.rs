//! What a run's manifests tell, with the types of the stages' reports. Its JSON is `report.json`.

use super::outcome::Outcome;
use crate::cost::{Cost, Estimate};
use crate::pipeline::{Plan, Request, ShadingFacts, StageState};
use crate::store::{Ingredients, Look, Manifest, RunDir};
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
    /// What the whole run was expected to cost, where that was told.
    pub expected: Option<Estimate>,
    /// What the stages did cost, where all are there and tell it.
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
#[derive(Debug, Default)]
pub struct Stages {
    pub photos: Option<Stage<PhotosReport>>,
    pub features: Option<Stage<FeaturesReport>>,
    pub poses: Option<Stage<PosesReport>>,
    pub lighting: Option<Stage<LightingReport>>,
    pub shading: Option<Stage<ShadingFacts>>,
    pub fusion: Option<Stage<FusionReport>>,
}

impl Stages {
    /// Lengths of the box around the mesh, what a pixel covers, and what the size rests on, in a line.
    pub fn size(&self) -> Option<String> {
        let fusion = &self.fusion.as_ref()?.report;
        let scale = &self.poses.as_ref()?.report.scale;
        let [low, high] = fusion.mesh.as_ref()?.bounds?;
        let lengths = [0, 1, 2].map(|k| f64::from(high[k] - low[k]));
        let footprint = fusion.layering.footprint;
        if scale.unit == Unit::Arbitrary {
            let [x, y, z] = lengths.map(|length| format!("{length:.3}"));
            return Some(format!(
                "{x} x {y} x {z} in arbitrary units (nothing gave the size)"
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
    /// What it was made from, and when.
    pub made: Made,
    /// What it found.
    pub report: R,
}

/// How a stage came to be: its manifest, less what only the stage understands.
#[derive(Debug)]
pub struct Made {
    manifest: Manifest,
}

impl Made {
    /// What decided the result.
    pub fn ingredients(&self) -> &Ingredients {
        &self.manifest.ingredients
    }

    /// Name of the result.
    pub fn fingerprint(&self) -> &str {
        &self.manifest.fingerprint
    }

    /// Wall time, seconds.
    pub fn seconds(&self) -> f64 {
        self.manifest.seconds
    }
}

impl<R: Serialize> Serialize for Stage<R> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let manifest = &self.made.manifest;
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

impl Serialize for Stages {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        fn entry<M: SerializeMap, R: Serialize>(
            map: &mut M,
            id: StageId,
            stage: Option<&Stage<R>>,
        ) -> Result<(), M::Error> {
            match stage {
                Some(stage) => map.serialize_entry(id.name(), stage),
                None => Ok(()),
            }
        }
        let mut map = to.serialize_map(None)?;
        entry(&mut map, StageId::Photos, self.photos.as_ref())?;
        entry(&mut map, StageId::Features, self.features.as_ref())?;
        entry(&mut map, StageId::Poses, self.poses.as_ref())?;
        entry(&mut map, StageId::Lighting, self.lighting.as_ref())?;
        entry(&mut map, StageId::Shading, self.shading.as_ref())?;
        entry(&mut map, StageId::Fusion, self.fusion.as_ref())?;
        map.end()
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
        let mut gathered = Gathered {
            run,
            plan,
            warnings: Vec::new(),
            threads: None,
            peak_memory_bytes: None,
            num_stages: 0,
            cpu_seconds: Some(0.0),
            disk_bytes: 0,
            expected: None,
        };
        let stages = Stages {
            photos: gathered.stage(StageId::Photos)?,
            features: gathered.stage(StageId::Features)?,
            poses: gathered.stage(StageId::Poses)?,
            lighting: gathered.stage(StageId::Lighting)?,
            shading: gathered.stage(StageId::Shading)?,
            fusion: gathered.stage(StageId::Fusion)?,
        };
        let cost = gathered.cost();
        Ok(Self {
            program: system::PROGRAM,
            outcome: outcome.clone(),
            request: request.clone(),
            stages,
            warnings: gathered.warnings,
            threads: gathered.threads,
            peak_memory_bytes: gathered.peak_memory_bytes,
            expected: gathered.expected,
            cost,
            citation: "Queau, Melou, Durou, Cremers: Dense Multi-view 3D-reconstruction Without \
                       Dense Correspondences. ICCV 2017",
        })
    }
}

/// What is read stage by stage.
struct Gathered<'a> {
    run: &'a RunDir,
    plan: Option<&'a Plan>,
    warnings: Vec<Warning>,
    threads: Option<usize>,
    peak_memory_bytes: Option<u64>,
    num_stages: usize,
    /// None where a stage does not tell its own.
    cpu_seconds: Option<f64>,
    disk_bytes: u64,
    expected: Option<Estimate>,
}

impl Gathered<'_> {
    fn cost(&self) -> Option<Cost> {
        if self.num_stages < StageId::ALL.len() {
            return None;
        }
        Some(Cost {
            cpu_seconds: self.cpu_seconds?,
            peak_memory_bytes: self.peak_memory_bytes? as f64,
            disk_bytes: self.disk_bytes as f64,
        })
    }

    fn stage<R: DeserializeOwned>(&mut self, id: StageId) -> anyhow::Result<Option<Stage<R>>> {
        let Ok(Some(mut manifest)) = self.run.manifest(id) else {
            return Ok(None);
        };
        let messages = manifest.warnings.drain(..);
        self.warnings
            .extend(messages.map(|message| Warning { stage: id, message }));
        self.num_stages += 1;
        self.expected = manifest.expected.or(self.expected);
        let cpu_seconds = self.cpu_seconds.zip(manifest.cpu_seconds);
        self.cpu_seconds = cpu_seconds.map(|(sum, of_stage)| sum + of_stage);
        self.disk_bytes += manifest.files.values().map(|file| file.bytes).sum::<u64>();
        self.threads = Some(manifest.threads);
        self.peak_memory_bytes = manifest.peak_memory_bytes.max(self.peak_memory_bytes);
        let state = self.plan.map(|plan| plan.state(self.run, id, Look::Sizes));
        let report = match serde_json::from_value(manifest.report.take()) {
            Ok(report) => report,
            // JSON has no number that is not finite: the results stand, the findings cannot be shown.
            Err(error) => {
                let message = format!("the findings of {id} cannot be shown: {error}");
                self.warnings.push(Warning { stage: id, message });
                return Ok(None);
            }
        };
        Ok(Some(Stage {
            state: state.transpose()?,
            made: Made { manifest },
            report,
        }))
    }
}
