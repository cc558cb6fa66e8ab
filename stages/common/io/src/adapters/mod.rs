//! Cameras of other programs, in and out.
//!
//! | format | file | camera axes | first pixel's centre | pose |
//! |---|---|---|---|---|
//! | `cameras.json` | file | x right, y down, z forward | 0 | rotation and centre in the world |
//! | COLMAP | folder | the same | 0.5 | camera from world |
//! | nerfstudio, instant-ngp | `transforms.json` | x right, y up, z backward | 0.5 | world from camera |
//! | Middlebury | `*_par.txt` | x right, y down, z forward | 0 | camera from world |
//! | Metashape | `cameras.xml` | x right, y down, z forward | 0.5 | world from camera |
//! | AliceVision | `cameras.sfm` (JSON) | the same | 0 | camera from world, and centre |
//! | OpenMVS | `scene.mvs` (interface archive) | the same | 0 | camera from world, and centre |
//! | IDR, NeuS | `cameras.npz` with `image/` | the same | 0 | projection matrix `K [R t]` |
//! | Blender | a script, written only | x right, y up, z backward | shifts from the image's middle | world from camera |
//!
//! All become a [`CameraFile`] with our conventions, converted in both directions; a camera that a
//! format cannot hold is refused by name, never approximated. Formats that leave out the images'
//! size take it from the photos beside them, or in a folder that is named.

mod blender;
mod limits;
mod metashape;
mod middlebury;
mod npz;
mod openmvs;
mod photos;
mod sfm_data;
mod transforms;

pub use blender::blender_file;

use crate::cameras::{CameraFile, cameras_file, read_cameras};
use crate::colmap;
use crate::error::IoError;
use crate::files::{OutputFile, write_all};
use std::path::{Path, PathBuf};

/// A format of camera files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// Our own `cameras.json`.
    CamerasJson,
    /// A COLMAP model folder (written as text).
    Colmap,
    /// A COLMAP model folder, binary.
    ColmapBinary,
    /// `transforms.json` of nerfstudio and instant-ngp.
    Transforms,
    /// Middlebury's parameter file.
    Middlebury,
    /// Metashape's `cameras.xml`.
    Metashape,
    /// AliceVision's `sfmData`.
    SfmData,
    /// OpenMVS's scene.
    OpenMvs,
    /// IDR's and NeuS's `cameras.npz`.
    Npz,
}

/// Files by which a folder's format is known; the first that is there counts.
const FILES_OF_FOLDERS: [(&str, CameraFormat); 3] = [
    ("cameras.bin", CameraFormat::ColmapBinary),
    ("cameras.txt", CameraFormat::Colmap),
    ("transforms.json", CameraFormat::Transforms),
];

/// Endings of names by which a file's format is known.
const ENDINGS: [(&str, CameraFormat); 5] = [
    (".sfm", CameraFormat::SfmData),
    (".mvs", CameraFormat::OpenMvs),
    (".npz", CameraFormat::Npz),
    (".xml", CameraFormat::Metashape),
    ("_par.txt", CameraFormat::Middlebury),
];

impl CameraFormat {
    /// All formats.
    pub const ALL: [Self; 9] = [
        Self::CamerasJson,
        Self::Colmap,
        Self::ColmapBinary,
        Self::Transforms,
        Self::Middlebury,
        Self::Metashape,
        Self::SfmData,
        Self::OpenMvs,
        Self::Npz,
    ];

    /// Name, as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::CamerasJson => "cameras",
            Self::Colmap => "colmap",
            Self::ColmapBinary => "colmap-binary",
            Self::Transforms => "transforms",
            Self::Middlebury => "middlebury",
            Self::Metashape => "metashape",
            Self::SfmData => "sfmdata",
            Self::OpenMvs => "openmvs",
            Self::Npz => "npz",
        }
    }

    /// The format of a file or folder, by its name and its first words.
    pub fn detect(path: &Path) -> Option<Self> {
        if path.is_dir() {
            let mut files = FILES_OF_FOLDERS.iter();
            let found = files.find(|(name, _)| path.join(name).is_file());
            return found.map(|(_, format)| *format);
        }
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        if name.ends_with(".json") {
            let is_transforms = crate::json::read(path).is_ok_and(|v| v.get("frames").is_some());
            return Some(if is_transforms {
                Self::Transforms
            } else {
                Self::CamerasJson
            });
        }
        let mut known = ENDINGS.iter();
        let found = known.find(|(ending, _)| name.ends_with(ending));
        found.map(|(_, format)| *format)
    }
}

/// Reads cameras in a format; a folder that holds the format's usual file stands for it. Photos
/// whose size the format leaves out are looked for in a folder of their own, then beside the file.
///
/// # Errors
/// When a file cannot be read or refuses to be a camera; names file, place and value.
pub fn import_cameras(
    path: &Path,
    format: CameraFormat,
    photos: Option<&Path>,
) -> Result<CameraFile, IoError> {
    match format {
        CameraFormat::CamerasJson | CameraFormat::Colmap | CameraFormat::ColmapBinary => {
            read_cameras(path)
        }
        CameraFormat::Transforms => transforms::read(&inside(path, "transforms.json"), photos),
        CameraFormat::Middlebury => middlebury::read(path, photos),
        CameraFormat::Metashape => metashape::read(path),
        CameraFormat::SfmData => sfm_data::read(&inside(path, "cameras.sfm")),
        CameraFormat::OpenMvs => openmvs::read(&inside(path, "scene.mvs"), photos),
        CameraFormat::Npz => npz::read(&inside(path, "cameras_sphere.npz"), photos),
    }
}

/// Writes cameras in a format; folders are made where the format is one. Cameras without a pose
/// are left out by formats that have no place for them.
///
/// # Errors
/// As [`camera_files`]; and when a file cannot be written.
pub fn export_cameras(
    path: &Path,
    format: CameraFormat,
    cameras: &CameraFile,
) -> Result<(), IoError> {
    write_all(&camera_files(path, format, cameras)?)
}

/// The files that hold cameras in a format, to be written: `path` is the file, or the folder of a
/// format that is one; some formats have further files beside it.
///
/// # Errors
/// When the format cannot hold a camera or its photo's name.
pub fn camera_files(
    path: &Path,
    format: CameraFormat,
    cameras: &CameraFile,
) -> Result<Vec<OutputFile>, IoError> {
    let model = || colmap::ColmapModel::from_cameras(cameras);
    let file = match format {
        CameraFormat::CamerasJson => cameras_file(path, cameras),
        CameraFormat::Transforms => transforms::file(path, cameras),
        CameraFormat::Middlebury => middlebury::file(path, cameras),
        CameraFormat::Metashape => metashape::file(path, cameras),
        CameraFormat::SfmData => sfm_data::file(path, cameras),
        CameraFormat::OpenMvs => openmvs::file(path, cameras),
        CameraFormat::Colmap => return colmap::text_files(path, &model()),
        CameraFormat::ColmapBinary => return colmap::binary_files(path, &model()),
        CameraFormat::Npz => return npz::files(path, cameras),
    };
    Ok(vec![file?])
}

fn inside(path: &Path, name: &str) -> PathBuf {
    if path.is_dir() {
        path.join(name)
    } else {
        path.to_path_buf()
    }
}

#[cfg(test)]
mod tests;
