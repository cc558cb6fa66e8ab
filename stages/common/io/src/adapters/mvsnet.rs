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

use super::{find_image, image_size, refuse_distortion};
use crate::cameras::{CameraEntry, CameraFile, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::read_regular_text;
use crate::words::{Line, lines};
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Distortion, Intrinsics};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

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

pub(super) fn read(folder: &Path) -> Result<CameraFile, IoError> {
    let files = camera_files(folder)?;
    if files.is_empty() {
        return Err(IoError::input(folder, "holds no cams/NNNNNNNN_cam.txt"));
    }
    let image_folders = [
        folder.join("images"),
        folder.to_path_buf(),
        folder.join("blended_images"),
    ];
    let mut file = CameraFile::default();
    for path in files {
        let stem = path
            .file_name()
            .map(|name| name.to_string_lossy().replace("_cam.txt", ""))
            .unwrap_or_default();
        let image = find_image(&image_folders, &stem).ok_or_else(|| {
            IoError::input(
                &path,
                format!("its image {stem}, which tells the size, is not there"),
            )
        })?;
        let name = image
            .file_name()
            .map(|name| name.to_string_lossy().into_owned());
        file.cameras.push(CameraEntry {
            image: name,
            ..read_camera(&path, image_size(&image)?)?
        });
    }
    Ok(file)
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
pub(super) fn write(
    folder: &Path,
    cameras: &CameraFile,
    range: Option<MvsnetDepthRange>,
) -> Result<(), IoError> {
    let cams = folder.join("cams");
    std::fs::create_dir_all(&cams).map_err(|error| IoError::write(&cams, error))?;
    let save = |path: PathBuf, text: String| {
        std::fs::write(&path, text).map_err(|error| IoError::write(&path, error))
    };
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
        save(path, text)?;
        let _ = writeln!(names, "{i:08} {}", entry.image.as_deref().unwrap_or(""));
    }
    save(folder.join("names.txt"), names)
}
