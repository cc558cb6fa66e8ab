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

use super::photos::{Photos, listed_names, size_of};
use super::undistorted::refuse_distortion;
use crate::cameras::{CameraEntry, CameraFile, intrinsics_of, matrix_of, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::photo::file_name;
use crate::words::{lines, next_line, spaced};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The file that tells which number is which photo; MVSNet's own programs do without.
const NAMES: &str = "names.txt";

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
    let names: HashMap<String, String> = listed_names(&folder.join(NAMES))?.into_iter().collect();
    let mut file = CameraFile::default();
    for path in files {
        let number = file_name(&path).replace("_cam.txt", "");
        let name = names.get(&number);
        let image = photos.named(&path, &[name.unwrap_or(&number), &number])?;
        let name = name.cloned().unwrap_or_else(|| file_name(&image));
        file.cameras
            .push(read_camera(&path, name, size_of(&image)?)?);
    }
    Ok(file)
}

fn read_camera(path: &Path, name: String, size: (usize, usize)) -> Result<CameraEntry, IoError> {
    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let mut title = next_line(&mut rest, path)?;
    if title.word("\"extrinsic\"")? != "extrinsic" {
        return Err(title.refuse("\"extrinsic\" is missing"));
    }
    let mut rotation = Matrix3::zeros();
    let mut translation = Vector3::zeros();
    for i in 0..3 {
        let [a, b, c, d]: [f64; 4] = next_line(&mut rest, path)?.numbers("the extrinsic")?;
        rotation.set_row(i, &nalgebra::RowVector3::new(a, b, c));
        translation[i] = d;
    }
    next_line(&mut rest, path)?;
    let mut title = next_line(&mut rest, path)?;
    if title.word("\"intrinsic\"")? != "intrinsic" {
        return Err(title.refuse("\"intrinsic\" is missing"));
    }
    let first = next_line(&mut rest, path)?.numbers::<3>("K")?;
    let mut line = next_line(&mut rest, path)?;
    let k = [first, line.numbers("K")?, [0.0, 0.0, 1.0]];
    let intrinsics = intrinsics_of(&Matrix3::from_row_slice(k.as_flattened()), size)
        .map_err(|reason| line.refuse(format!("K {reason}")))?;
    let pose = rigid_from_camera_pose(&rotation, &translation)
        .map_err(|reason| IoError::input(path, format!("the extrinsic {reason}")))?;
    Ok(CameraEntry::posed(name, intrinsics, pose))
}

/// The camera files, numbered in the cameras' order, and `names.txt` that tells which is which.
pub(super) fn files(folder: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let cams = folder.join("cams");
    let names_path = folder.join(NAMES);
    let mut files = Vec::new();
    let mut names = String::new();
    for (i, (entry, pose)) in cameras.posed().enumerate() {
        let path = cams.join(format!("{i:08}_cam.txt"));
        refuse_distortion(&path, entry, "MVSNet's format")?;
        let mut text = String::from("extrinsic\n");
        let rotation = pose.rotation_matrix();
        for (row, t) in rotation.row_iter().zip(&pose.translation) {
            text += &format!("{}\n", spaced(row.iter().chain([t])));
        }
        text += "0 0 0 1\n\nintrinsic\n";
        for row in matrix_of(&entry.intrinsics).row_iter() {
            text += &format!("{}\n", spaced(row.iter()));
        }
        files.push(OutputFile::new(path, text));
        Names::Line.check(&names_path, "the list of MVSNet's photos", entry.name())?;
        names += &format!("{i:08} {}\n", entry.name());
    }
    files.push(OutputFile::new(names_path, names));
    Ok(files)
}
