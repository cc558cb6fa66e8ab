//! What a run, or a folder of maps, holds to be compared.

use super::optional_file::read_if_there;
use crate::exit::Failure;
use crate::pipeline::load_poses;
use crate::store::{Manifest, RunDir};
use rilievo_io::{LightingFile, read_depth, read_lighting, read_linear, read_normal};
use rilievo_scene::{DepthMap, LinearImage, NormalMap, StageId, WorldCoordinates, artifact_name};
use rilievo_synthetic::compare::NamedPose;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is to be compared: poses and maps of a run, or the maps of `rilievo shade`.
pub(super) struct Estimate {
    /// Poses of the registered photos.
    pub poses: Vec<NamedPose>,
    /// What coordinates of poses and cloud mean; none of maps without poses.
    pub world: Option<WorldCoordinates>,
    /// Names of all photos that a result could be expected of.
    pub expected: Vec<String>,
    maps: PathBuf,
    /// The cloud's file, there or not.
    pub cloud: PathBuf,
    /// The light's file, there or not.
    light: PathBuf,
    /// The linear photos' folder, there or not.
    photos: PathBuf,
    /// Factors that brought photos to one exposure, by their names.
    gains: BTreeMap<String, f64>,
    /// Held, since the evaluation is written into the run, and must be of one state of it.
    _run: Option<RunDir>,
}

impl Estimate {
    /// Opens a run directory for work, or a folder of `rilievo shade`.
    ///
    /// # Errors
    /// When the run cannot be read, or is in use.
    pub fn open(root: &Path) -> anyhow::Result<Self> {
        if !root.join("run.json").exists() && root.join("depth").is_dir() {
            return Self::of_shade(root);
        }
        let run = RunDir::open(root)?;
        let photos = run.manifest(StageId::Photos)?;
        let gains = exposure_gains(photos.as_ref());
        let (poses, world, expected) = match run.manifest(StageId::Poses)? {
            Some(_) => posed(&run)?,
            // Photos at most, from which a result was expected.
            None => {
                let names = photos.map(|manifest| manifest.items.into_keys().collect());
                (Vec::new(), None, names.unwrap_or_default())
            }
        };
        Ok(Self {
            poses,
            world,
            expected,
            maps: run.stage_dir(StageId::Shading),
            cloud: run.stage_dir(StageId::Fusion).join("cloud.ply"),
            light: run.stage_dir(StageId::Lighting).join("lighting.json"),
            photos: run.stage_dir(StageId::Photos).join("linear"),
            gains,
            _run: Some(run),
        })
    }

    /// The output folder of `rilievo shade` has maps, but neither poses nor a cloud.
    fn of_shade(root: &Path) -> anyhow::Result<Self> {
        let mut expected: Vec<String> = std::fs::read_dir(root.join("depth"))?
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "exr"))
            .filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()))
            .collect();
        expected.sort();
        Ok(Self {
            poses: Vec::new(),
            world: None,
            expected,
            maps: root.to_path_buf(),
            cloud: root.join("cloud.ply"),
            light: root.join("lighting.json"),
            photos: root.join("photos"),
            gains: BTreeMap::new(),
            _run: None,
        })
    }

    /// Whether a view has depth or normals.
    pub fn has_map(&self, name: &str) -> bool {
        ["depth", "normal"]
            .iter()
            .any(|kind| self.maps.join(kind).join(format!("{name}.exr")).exists())
    }

    /// Depth map of a view, if it has one.
    pub fn depth(&self, name: &str) -> Result<Option<DepthMap>, Failure> {
        read_if_there(&self.maps.join(format!("depth/{name}.exr")), read_depth)
    }

    /// Normal map of a view, if it has one.
    pub fn normal(&self, name: &str) -> Result<Option<NormalMap>, Failure> {
        read_if_there(&self.maps.join(format!("normal/{name}.exr")), read_normal)
    }

    /// Light of the views, if it was found.
    pub fn lighting(&self) -> Result<Option<LightingFile>, Failure> {
        read_if_there(&self.light, |path| read_lighting(path, None))
    }

    /// Albedo of a view, if it has one.
    pub fn albedo(&self, name: &str) -> Result<Option<LinearImage>, Failure> {
        read_if_there(&self.albedo_file(name), read_linear)
    }

    /// The file of a view's albedo, there or not.
    pub fn albedo_file(&self, name: &str) -> PathBuf {
        self.maps.join(format!("albedo/{name}.exr"))
    }

    /// The image that the result explains, if it has one.
    pub fn rendered(&self, name: &str) -> Result<Option<LinearImage>, Failure> {
        read_if_there(&self.maps.join(format!("rendered/{name}.exr")), read_linear)
    }

    /// The linear photo at the set's exposure, if it is there.
    pub fn photo(&self, name: &str) -> Result<Option<LinearImage>, Failure> {
        let mut photo = read_if_there(&self.photos.join(format!("{name}.exr")), read_linear)?;
        let gain = self.gains.get(name).copied().unwrap_or(1.0) as f32;
        for value in photo.iter_mut().flat_map(|photo| &mut photo.data) {
            *value *= gain;
        }
        Ok(photo)
    }
}

/// Poses of the registered photos, what their coordinates mean, and the names of all.
fn posed(run: &RunDir) -> anyhow::Result<(Vec<NamedPose>, Option<WorldCoordinates>, Vec<String>)> {
    let views = load_poses(run)?;
    let unregistered = views.unregistered.iter();
    let unregistered = unregistered.map(|photo| artifact_name(&photo.file_name));
    let names = views.views.iter().map(|view| view.name.clone());
    let expected = names.chain(unregistered).collect();
    let poses = views.views.iter().map(|view| NamedPose {
        name: view.name.clone(),
        cam_from_world: view.cam_from_world,
    });
    Ok((poses.collect(), Some(views.coordinates()), expected))
}

/// Exposure gains in the report of stage 1.
fn exposure_gains(photos: Option<&Manifest>) -> BTreeMap<String, f64> {
    let list = |key: &str| {
        let values = photos.and_then(|photos| photos.report.get(key)?.as_array());
        values.cloned().unwrap_or_default()
    };
    let pairs = list("photos").into_iter().zip(list("exposure_gains"));
    pairs
        .filter_map(|(photo, gain)| Some((photo["name"].as_str()?.to_owned(), gain.as_f64()?)))
        .collect()
}
