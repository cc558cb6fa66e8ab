//! What a run directory holds, read back.

use super::failure::CommandFailure;
use super::host::guarded;
use crate::exit::Failure;
use crate::pipeline::{cloud_offset, load_poses};
use crate::store::RunDir;
use rilievo_io::{
    IoError, read_channel, read_cloud_ply, read_depth, read_linear, read_normal, read_regular_text,
};
use rilievo_scene::{
    DepthMap, LinearImage, NormalMap, PointCloud, PosedView, PosedViews, Raster, StageId,
    first_and_more,
};
use std::path::Path;

/// A run directory that is only read.
#[derive(Debug)]
pub struct RunResults {
    run: RunDir,
}

impl RunResults {
    /// Opens a run directory.
    ///
    /// # Errors
    /// When it is none, or of another version.
    pub fn open(root: &Path) -> Result<Self, CommandFailure> {
        guarded(|| {
            let run = RunDir::open_to_read(root).map_err(anyhow::Error::from)?;
            Ok(Self { run })
        })
    }

    fn posed(&self) -> Result<PosedViews, CommandFailure> {
        Ok(load_poses(&self.run)?)
    }

    /// The cameras in the order of the photos; those of photos without a pose are left out.
    ///
    /// # Errors
    /// When stage 3 has no result, or it is damaged.
    pub fn cameras(&self) -> Result<Vec<PosedView>, CommandFailure> {
        guarded(|| Ok(self.posed()?.in_world().views))
    }

    /// Unit of every length, `metre` or `arbitrary`.
    ///
    /// # Errors
    /// As [`Self::cameras`].
    pub fn unit(&self) -> Result<&'static str, CommandFailure> {
        guarded(|| Ok(self.posed()?.scale.unit.name()))
    }

    /// Depth of a view along the optical axis; 0 where there is none.
    ///
    /// # Errors
    /// When there is no such view, it has no such map, or the map cannot be read.
    pub fn depth(&self, name: &str) -> Result<DepthMap, CommandFailure> {
        self.map("depth", name, read_depth)
    }

    /// Normals of a view, camera frame; zero where there are none.
    ///
    /// # Errors
    /// As [`Self::depth`].
    pub fn normal(&self, name: &str) -> Result<NormalMap, CommandFailure> {
        self.map("normal", name, read_normal)
    }

    /// Albedo of a view relative to the mean albedo.
    ///
    /// # Errors
    /// As [`Self::depth`].
    pub fn albedo(&self, name: &str) -> Result<LinearImage, CommandFailure> {
        self.map("albedo", name, read_linear)
    }

    /// The image that a view's shape explains, linear.
    ///
    /// # Errors
    /// As [`Self::depth`].
    pub fn rendered(&self, name: &str) -> Result<LinearImage, CommandFailure> {
        self.map("rendered", name, read_linear)
    }

    /// How far each normal of a view can be trusted, 0 to 1.
    ///
    /// # Errors
    /// As [`Self::depth`].
    pub fn confidence(&self, name: &str) -> Result<Raster<f32>, CommandFailure> {
        self.map("confidence", name, |path| read_channel(path, "C"))
    }

    fn map<T>(
        &self,
        kind: &str,
        name: &str,
        read: impl FnOnce(&Path) -> Result<T, IoError>,
    ) -> Result<T, CommandFailure> {
        guarded(|| {
            let views = self.posed()?.views;
            // Names are compared before one becomes part of a path.
            if !views.iter().any(|view| view.name == name) {
                let names: Vec<_> = views.iter().map(|view| view.name.as_str()).collect();
                let reason = format!(
                    "has no view {name:?}; there are {}",
                    first_and_more(names).unwrap_or_default()
                );
                return Err(anyhow::Error::from(Failure::input(self.run.root(), reason)).into());
            }
            let file = format!("{kind}/{name}.exr");
            self.file(StageId::Shading, &file, kind, read)
        })
    }

    /// What is added to the cloud's positions for those of the cameras' world; zero where they stand
    /// near the origin.
    ///
    /// # Errors
    /// When the file that states it is damaged.
    pub fn offset(&self) -> Result<[f64; 3], CommandFailure> {
        guarded(|| Ok(cloud_offset(&self.run)?))
    }

    /// The point cloud, without [`Self::offset`].
    ///
    /// # Errors
    /// When stage 6 has no result, or it cannot be read.
    pub fn cloud(&self) -> Result<PointCloud, CommandFailure> {
        guarded(|| self.file(StageId::Fusion, "cloud.ply", "cloud", read_cloud_ply))
    }

    fn file<T>(
        &self,
        stage: StageId,
        file: &str,
        what: &str,
        read: impl FnOnce(&Path) -> Result<T, IoError>,
    ) -> Result<T, CommandFailure> {
        let path = self.run.stage_dir(stage).join(file);
        present(&path, &format!(": this run has no {what}"), read)
    }

    /// The text of `report.json`.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub fn report(&self) -> Result<String, CommandFailure> {
        guarded(|| {
            let path = self.run.root().join("report.json");
            present(&path, "", read_regular_text)
        })
    }
}

/// What a file holds; where there is none, an error that goes on with `why`.
fn present<T>(
    path: &Path,
    why: &str,
    read: impl FnOnce(&Path) -> Result<T, IoError>,
) -> Result<T, CommandFailure> {
    let found = if path.exists() {
        read(path).map_err(Failure::from)
    } else {
        let reason = format!("{} is not there{why}", path.display());
        Err(Failure::RunDirectory(reason))
    };
    Ok(found.map_err(anyhow::Error::from)?)
}
