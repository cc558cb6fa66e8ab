//! MVSNet's folder: `cams/NNNNNNNN_cam.txt` with the images in `images/NNNNNNNN.jpg`.
//!
//! ```text
//! extrinsic
//! 4 x 4 camera from world
//!
//! intrinsic
//! 3 x 3 K, first pixel's centre at 0
//!
//! depth_min depth_interval [num_depths depth_max]
//! ```

use super::photos::{Photos, size_of};
use super::undistorted::refuse_distortion;
use crate::cameras::{CameraEntry, CameraFile, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::{Line, lines};
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Distortion, Intrinsics};
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// The file that tells which number is which photo; MVSNet's own programs do without.
const NAMES: &str = "names.txt";

/// Depth planes of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MvsnetDepthRange {
    /// Nearest depth, world's unit.
    pub min: f64,
    /// Distance of the planes, world's unit.
    pub interval: f64,
    /// Number of planes.
    pub num: usize,
}

/// The camera files of a folder or of its `cams`, in order.
pub(super) fn camera_files(folder: &Path) -> Result<Vec<PathBuf>, IoError> {
    let cams = folder.join("cams");
    let place = if cams.is_dir() {
        cams
    } else {
        folder.to_path_buf()
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(&place)
        .map_err(|error| IoError::read(&place, &error))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.to_string_lossy().ends_with("_cam.txt"))
        .collect();
    files.sort();
    Ok(files)
}

pub(super) fn read(folder: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let files = camera_files(folder)?;
    if files.is_empty() {
        return Err(IoError::input(folder, "holds no cams/NNNNNNNN_cam.txt"));
    }
    let photos = Photos::new(photos, folder, &["images", "", "blended_images"]);
    let names = read_names(&folder.join(NAMES))?;
    let mut file = CameraFile::default();
    for path in files {
        let number = path
            .file_name()
            .map(|name| name.to_string_lossy().replace("_cam.txt", ""))
            .unwrap_or_default();
        let name = names.get(&number).unwrap_or(&number);
        let image = photos
            .find(name)
            .or_else(|| photos.find(&number))
            .map_or_else(|| photos.named(&path, name), Ok)?;
        let entry = read_camera(&path, size_of(&image)?)?;
        let name = match names.get(&number) {
            Some(name) => Some(name.clone()),
            None => image
                .file_name()
                .map(|name| name.to_string_lossy().into_owned()),
        };
        file.cameras.push(CameraEntry {
            image: name,
            ..entry
        });
    }
    Ok(file)
}

/// Which photo a number stands for, where this program wrote the folder.
fn read_names(path: &Path) -> Result<HashMap<String, String>, IoError> {
    if !path.is_file() {
        return Ok(HashMap::new());
    }
    let text = read_regular_text(path)?;
    let pairs = text.lines().filter_map(|line| line.split_once(' '));
    Ok(pairs
        .filter(|(_, name)| !name.is_empty())
        .map(|(number, name)| (number.to_owned(), name.to_owned()))
        .collect())
}

fn read_camera(path: &Path, (width, height): (usize, usize)) -> Result<CameraEntry, IoError> {
    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let mut next = || -> Result<Line<'_>, IoError> {
        rest.next()
            .ok_or_else(|| IoError::input(path, "ends too early"))
    };
    let mut title = next()?;
    if title.word("\"extrinsic\"")? != "extrinsic" {
        return Err(title.refuse("\"extrinsic\" is missing"));
    }
    let mut rotation = Matrix3::zeros();
    let mut translation = Vector3::zeros();
    for i in 0..3 {
        let [a, b, c, d]: [f64; 4] = next()?.numbers("the extrinsic")?;
        rotation.set_row(i, &nalgebra::RowVector3::new(a, b, c));
        translation[i] = d;
    }
    next()?;
    let mut title = next()?;
    if title.word("\"intrinsic\"")? != "intrinsic" {
        return Err(title.refuse("\"intrinsic\" is missing"));
    }
    let [fx, skew, cx]: [f64; 3] = next()?.numbers("K")?;
    let mut second = next()?;
    let [_, fy, cy]: [f64; 3] = second.numbers("K")?;
    if fx <= 0.0 || fy <= 0.0 || skew != 0.0 {
        return Err(second.refuse(format!(
            "K has the focal lengths {fx}, {fy} and skew {skew}"
        )));
    }
    let pose = rigid_from_camera_pose(&rotation, &translation)
        .map_err(|reason| IoError::input(path, format!("the extrinsic {reason}")))?;
    Ok(CameraEntry {
        image: None,
        intrinsics: Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion: Distortion::default(),
        },
        cam_from_world: Some(pose),
    })
}

/// Writes the camera files, numbered in the cameras' order, and `names.txt` that tells which is
/// which.
pub(super) fn files(
    folder: &Path,
    cameras: &CameraFile,
    range: Option<MvsnetDepthRange>,
) -> Result<Vec<OutputFile>, IoError> {
    let cams = folder.join("cams");
    let names_path = folder.join(NAMES);
    let mut files = Vec::new();
    let mut names = String::new();
    let posed = cameras
        .cameras
        .iter()
        .filter_map(|entry| Some((entry, entry.cam_from_world?)));
    for (i, (entry, pose)) in posed.enumerate() {
        let path = cams.join(format!("{i:08}_cam.txt"));
        refuse_distortion(&path, entry, "MVSNet's format")?;
        let (r, t) = (pose.rotation_matrix(), &pose.translation);
        let mut text = String::from("extrinsic\n");
        // Writing into a String cannot fail, hence the ignored results.
        for row in 0..3 {
            let _ = writeln!(
                text,
                "{} {} {} {}",
                r[(row, 0)],
                r[(row, 1)],
                r[(row, 2)],
                t[row]
            );
        }
        let k = &entry.intrinsics;
        let _ = write!(
            text,
            "0 0 0 1\n\nintrinsic\n{} 0 {}\n0 {} {}\n0 0 1\n",
            k.fx, k.cx, k.fy, k.cy
        );
        if let Some(range) = range {
            let max = range.min + range.interval * range.num.saturating_sub(1) as f64;
            let _ = write!(
                text,
                "\n{} {} {} {max}\n",
                range.min, range.interval, range.num
            );
        }
        files.push(OutputFile::new(path, text));
        Names::Line.check(&names_path, "the list of MVSNet's photos", entry.name())?;
        let _ = writeln!(names, "{i:08} {}", entry.name());
    }
    files.push(OutputFile::new(names_path, names));
    Ok(files)
}
