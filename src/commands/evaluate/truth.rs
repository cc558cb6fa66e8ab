//! Ground truth in a folder.

use super::optional_file::read_if_there;
use crate::exit::Failure;
use rilievo_io::{
    CameraFile, LightingFile, read_cameras, read_depth, read_lighting, read_linear,
    read_mesh_ply_near, read_normal,
};
use rilievo_scene::{Intrinsics, LinearImage, Mesh};
use rilievo_synthetic::compare::{NamedPose, TruthMaps, TruthView};
use std::path::{Path, PathBuf};

/// Ground truth in a folder.
pub(super) struct Truth {
    pub folder: PathBuf,
    /// True cameras, none where the folder has none; as a run has them, in metres where their unit is
    /// one of length, and near the origin.
    pub cameras: CameraFile,
    /// Metres per unit of the folder's files, 1 where that is unknown.
    metres: f64,
    /// What is added to coordinates here for those of the folder's cameras.
    pub offset: [f64; 3],
}

impl Truth {
    /// Opens a folder. `offset` is that of the result, none where it has no world and thus the files'
    /// own unit; `is_fixed` where it must be the truth's, since nothing may be moved.
    pub fn open(folder: &Path, offset: Option<[f64; 3]>, is_fixed: bool) -> Result<Self, Failure> {
        let cameras = read_if_there(&folder.join("cameras.json"), read_cameras)?;
        let mut truth = Self {
            folder: folder.to_path_buf(),
            cameras: cameras.unwrap_or_default(),
            metres: 1.0,
            offset: [0.0; 3],
        };
        if let Some(offset) = offset {
            truth.metres = truth.cameras.unit.metres().unwrap_or(1.0);
            truth.cameras.to_metres();
            truth.offset = truth.cameras.localize(offset).offset;
            if is_fixed {
                let further = [0, 1, 2].map(|k| offset[k] - truth.offset[k]);
                truth.cameras.move_origin(further);
                truth.offset = offset;
            }
        }
        Ok(truth)
    }

    /// Poses of the photos that a result could be expected of.
    pub fn poses(&self, expected: &[String]) -> Vec<NamedPose> {
        expected
            .iter()
            .filter_map(|name| {
                Some(NamedPose {
                    name: name.clone(),
                    cam_from_world: self.cameras.find(name)?.cam_from_world?,
                })
            })
            .collect()
    }

    /// The true surface, if there is one.
    pub fn surface(&self) -> Result<Option<Mesh>, Failure> {
        read_if_there(&self.surface_file(), |path| {
            read_mesh_ply_near(path, self.metres, self.offset)
        })
    }

    /// The true surface's file, there or not.
    pub fn surface_file(&self) -> PathBuf {
        self.folder.join("mesh.ply")
    }

    /// True light, if it is known.
    pub fn lighting(&self) -> Result<Option<LightingFile>, Failure> {
        read_if_there(&self.folder.join("lighting.json"), |path| {
            read_lighting(path, None)
        })
    }

    /// True albedo of a view, if it is known.
    pub fn albedo(&self, name: &str) -> Result<Option<LinearImage>, Failure> {
        read_if_there(&self.albedo_file(name), read_linear)
    }

    /// The file of a view's true albedo, there or not.
    pub fn albedo_file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}_albedo.exr"))
    }

    /// True maps of the photos that have any.
    pub fn views(&self, expected: &[String]) -> Result<Vec<TruthView>, Failure> {
        let mut views = Vec::new();
        for name in expected {
            views.extend(self.view(name)?);
        }
        Ok(views)
    }

    fn view(&self, name: &str) -> Result<Option<TruthView>, Failure> {
        // Files by the view's name, or a folder of its own per view.
        let beside = ["depth", "normal"].map(|map| self.folder.join(format!("{name}_{map}.exr")));
        let [depth, normal] = if beside.iter().any(|file| file.exists()) {
            beside
        } else {
            ["depth_true.exr", "normal_true.exr"].map(|map| self.folder.join(name).join(map))
        };
        let depth = read_if_there(&depth, read_depth)?;
        let depth = depth.map(|mut depth| {
            let metres = self.metres as f32;
            depth.data.iter_mut().for_each(|z| *z *= metres);
            depth
        });
        let Some(maps) = TruthMaps::new(depth, read_if_there(&normal, read_normal)?) else {
            return Ok(None);
        };
        let intrinsics = match self.cameras.find(name) {
            Some(camera) => camera.intrinsics,
            None => own_camera(&self.folder.join(name).join("camera.json"), maps.size())?,
        };
        Ok(Some(TruthView {
            name: name.to_owned(),
            intrinsics,
            maps,
        }))
    }
}

/// The camera beside a view's truth; without one only fitted planes would need it.
fn own_camera(path: &Path, (width, height): (usize, usize)) -> Result<Intrinsics, Failure> {
    let file = read_if_there(path, read_cameras)?;
    let camera = file.and_then(|file| file.cameras.first().map(|camera| camera.intrinsics));
    Ok(camera.unwrap_or_else(|| {
        let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        Intrinsics::pinhole(width, height, 1.2 * width.max(height) as f64, cx, cy)
    }))
}
