//! What each stage is made from, and whether its result in the run directory is still that.

use super::inputs::Inputs;
use super::request::{MaskOrigin, Request, SphereInput};
use crate::cost::Estimate;
use crate::exit::Failure;
use crate::store::{Ingredients, Look, RunDir, StoreError, hash_json};
use rilievo_scene::StageId;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// State of a stage's result.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum StageState {
    /// Made from exactly what it would be made from now.
    Valid,
    /// Made from something else.
    Stale {
        /// What changed.
        reasons: Vec<String>,
    },
    /// A file of it is gone or does not have the content that it was written with.
    Damaged {
        /// Which, and how.
        reason: String,
    },
    /// Not there.
    Missing,
}

impl std::fmt::Display for StageState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Valid => f.write_str("valid"),
            Self::Stale { reasons } => write!(f, "stale: {}", reasons.join("; ")),
            Self::Damaged { reason } => write!(f, "damaged: {reason}"),
            Self::Missing => f.write_str("missing"),
        }
    }
}

/// Version of a stage's method.
fn version(stage: StageId) -> u32 {
    match stage {
        StageId::Photos => rilievo_photos::VERSION,
        StageId::Features => rilievo_features::VERSION,
        StageId::Poses => rilievo_poses::VERSION,
        StageId::Lighting => rilievo_lighting::VERSION,
        StageId::Shading => rilievo_shading::VERSION,
        StageId::Fusion => rilievo_fusion::VERSION,
    }
}

/// Stages whose results a stage reads.
pub fn upstream(stage: StageId) -> &'static [StageId] {
    use StageId::{Features, Lighting, Photos, Poses, Shading};
    match stage {
        Photos => &[],
        Features => &[Photos],
        Poses => &[Photos, Features],
        Lighting => &[Photos, Poses],
        Shading => &[Photos, Poses, Lighting],
        StageId::Fusion => &[Photos, Poses, Shading],
    }
}

/// Ingredients of all stages, as of now.
pub struct Plan {
    ingredients: BTreeMap<StageId, Ingredients>,
    /// What a run of all stages is expected to cost, where that was estimated.
    pub expected: Option<Estimate>,
}

impl Plan {
    /// Computes them from what was asked and the files' contents.
    pub fn new(request: &Request, inputs: &Inputs) -> Self {
        let mut ingredients = BTreeMap::<StageId, Ingredients>::new();
        for stage in StageId::ALL {
            let upstream = upstream(stage)
                .iter()
                .filter_map(|of| Some((of.name().to_owned(), ingredients.get(of)?.fingerprint())))
                .collect();
            let own = Ingredients {
                stage,
                stage_version: version(stage),
                options: options(stage, request),
                inputs: stage_inputs(stage, request, inputs),
                upstream,
            };
            ingredients.insert(stage, own);
        }
        Self {
            ingredients,
            expected: None,
        }
    }

    /// What a stage would be made from now.
    pub fn of(&self, stage: StageId) -> &Ingredients {
        // Every stage of `StageId::ALL` was inserted above.
        &self.ingredients[&stage]
    }

    /// State of a stage's result, whose files are looked at as closely as asked.
    pub fn state(&self, run: &RunDir, stage: StageId, look: Look) -> Result<StageState, Failure> {
        let manifest = match run.manifest(stage) {
            Ok(Some(manifest)) => manifest,
            Ok(None) => return Ok(StageState::Missing),
            Err(error @ StoreError::Damaged { .. }) => {
                let reason = error.to_string();
                return Ok(StageState::Damaged { reason });
            }
            Err(error) => return Err(error.into()),
        };
        if let Some(reason) = manifest.damage(&run.stage_dir(stage), look) {
            return Ok(StageState::Damaged { reason });
        }
        let now = self.of(stage);
        if manifest.fingerprint == now.fingerprint() {
            return Ok(StageState::Valid);
        }
        Ok(StageState::Stale {
            reasons: now.changes_since(&manifest.ingredients),
        })
    }
}

/// Options that affect a stage's result.
fn options(stage: StageId, request: &Request) -> serde_json::Value {
    fn value(options: &impl Serialize) -> serde_json::Value {
        // Options are plain data; they always have a JSON form.
        serde_json::to_value(options).unwrap_or_default()
    }
    match stage {
        StageId::Photos => value(&request.options.photos),
        StageId::Features => value(&request.options.features),
        StageId::Poses => value(&request.options.poses),
        StageId::Lighting => value(&request.options.lighting),
        StageId::Shading => value(&request.options.shading),
        StageId::Fusion => value(&request.options.fusion),
    }
}

/// The role of a photo among the inputs of stage 1.
pub fn photo_role(file_name: &str) -> String {
    format!("photo {file_name}")
}

/// Whether a set of photos has nothing in common with the one that a stage 1 was made from: they are
/// of another object.
pub fn is_another_set(inputs: &Inputs, made_from: &Ingredients) -> bool {
    let role = photo_role("");
    let before = made_from.inputs.iter();
    let before = before.filter(|(of, _)| of.starts_with(&role));
    let before: BTreeSet<&String> = before.map(|(_, hash)| hash).collect();
    !before.is_empty()
        && !inputs
            .photos
            .iter()
            .any(|photo| before.contains(&photo.hash))
}

/// Content hashes of the files that a stage reads from outside the run directory.
fn stage_inputs(stage: StageId, request: &Request, inputs: &Inputs) -> BTreeMap<String, String> {
    match stage {
        StageId::Photos => {
            let mut hashes = BTreeMap::new();
            for photo in &inputs.photos {
                let file = &photo.file_name;
                hashes.insert(photo_role(file), photo.hash.clone());
                if let Some((_, mask)) = &photo.mask {
                    hashes.insert(format!("mask of {file}"), mask.clone());
                }
                if let Some(camera) = &photo.camera {
                    let camera = (camera.intrinsics, camera.cam_from_world);
                    hashes.insert(format!("camera of {file}"), hash_json(&camera));
                }
            }
            // It has no effect where all photos have one.
            let masked = inputs.photos.iter().all(|photo| photo.mask.is_some());
            hashes.insert(
                "masks asked for".into(),
                (masked || request.needs_masks()).to_string(),
            );
            if !masked && request.masks_from == MaskOrigin::None {
                hashes.insert("the whole frame asked for".into(), true.to_string());
            }
            // A build without it leaves those photos out.
            hashes.insert(
                "camera RAW decoded".into(),
                cfg!(feature = "raw").to_string(),
            );
            hashes
        }
        StageId::Poses => {
            let mut hashes = inputs.spheres.hashes.clone();
            let world = inputs.given_world;
            let (frame, unit) = (world.frame.words(), inputs.given_unit.name());
            let [x, y, z] = world.offset;
            let text = format!("{frame}; {unit}; offset {x} {y} {z}");
            hashes.insert("frame of given cameras".into(), text);
            if let Some(of) = &inputs.frame_of {
                let (unit, frame) = (of.world.unit, of.world.frame);
                let asked_for = hash_json(&(&of.cameras, unit, frame, of.world.offset));
                hashes.insert("frame asked for".into(), asked_for);
            }
            hashes
        }
        StageId::Lighting => {
            let mut hashes = inputs.lighting_hashes.clone();
            if request.sphere != SphereInput::None {
                hashes.extend(inputs.spheres.hashes.clone());
            }
            hashes
        }
        StageId::Features | StageId::Shading | StageId::Fusion => BTreeMap::new(),
    }
}
