//! Bundler's `bundle.out` (version 0.3), with the images' names in `list.txt` beside it.
//!
//! Per camera `f k1 k2`, a rotation `R` (three rows) and a translation `t`. With `P = R X + t` and
//! `p = −P / P_z`, the pixel is `f (1 + k1 |p|² + k2 |p|⁴) p`, from the middle of the image, x right
//! and y up. A focal length of zero means: no pose. Source: Bundler v0.4 user's manual, section
//! "Output format and scene representation".

use super::axes::flip;
use super::photos::{Photos, folder_of, size_of};
use crate::cameras::{CameraEntry, CameraFile, last_part, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::{lines, next_line, spaced};
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Distortion, Intrinsics, Unit};
use std::path::{Path, PathBuf};

/// How far fx may be from fy, or the principal point from the middle, to count as the same:
/// what Bundler cannot hold, it must not lose silently.
const SAME_PX: f64 = 1e-6;

fn list_of(path: &Path) -> PathBuf {
    path.with_file_name("list.txt")
}

/// The middle of an image, which is Bundler's principal point.
fn middle(width: usize, height: usize) -> [f64; 2] {
    [width, height].map(|side| 0.5 * (side as f64 - 1.0))
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let list = list_of(path);
    let names_text = read_regular_text(&list)?;
    let names: Vec<&str> = lines(&list, &names_text, false)
        .filter_map(|line| line.rest.split_whitespace().next())
        .collect();
    let photos = Photos::new(photos, folder_of(path), &["", "images", "visualize"]);

    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let mut next = || next_line(&mut rest, path);
    let num_cameras: usize = next()?.parse("the number of cameras")?;
    if num_cameras != names.len() {
        return Err(IoError::input(
            path,
            format!("has {num_cameras} cameras, list.txt {} names", names.len()),
        ));
    }
    let mut file = CameraFile::default();
    for name in names {
        let mut first = next()?;
        let [f, k1, k2]: [f64; 3] = first.numbers("f k1 k2")?;
        let mut row = || next()?.numbers::<3>("a row of R");
        let rotation = Matrix3::from_row_slice([row()?, row()?, row()?].as_flattened());
        let translation = Vector3::from(next()?.numbers::<3>("t")?);
        let image = last_part(name).to_owned();
        if f == 0.0 {
            file.unregistered
                .push((image, "no pose in Bundler".to_owned()));
            continue;
        }
        if f < 0.0 {
            return Err(first.refuse(format!("the focal length is {f}")));
        }
        let (width, height) = size_of(&photos.named(&list, &[name, &image])?)?;
        let [cx, cy] = middle(width, height);
        let pose = rigid_from_camera_pose(&(flip() * rotation), &(flip() * translation))
            .map_err(|reason| first.refuse(format!("the rotation {reason}")))?;
        let mut intrinsics = Intrinsics::pinhole(width, height, f, cx, cy);
        (intrinsics.distortion.k1, intrinsics.distortion.k2) = (k1, k2);
        file.cameras
            .push(CameraEntry::posed(image, intrinsics, pose));
    }
    Ok(file)
}

/// What of a camera Bundler has no place for.
fn obstacle(camera: &Intrinsics) -> Option<&'static str> {
    let [x, y] = middle(camera.width, camera.height);
    let Distortion { p1, p2, k3, .. } = camera.distortion;
    if (camera.fx - camera.fy).abs() > SAME_PX {
        Some("two focal lengths")
    } else if (camera.cx - x).abs().max((camera.cy - y).abs()) > SAME_PX {
        Some("a principal point off the middle")
    } else if [p1, p2, k3] != [0.0; 3] {
        Some("lens coefficients beyond k1 and k2")
    } else {
        None
    }
}

pub(super) fn files(path: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let list_path = list_of(path);
    let mut text = format!("# Bundle file v0.3\n{} 0\n", cameras.cameras.len());
    let mut list = String::new();
    for entry in &cameras.cameras {
        let image = entry.name();
        Names::Word.check(&list_path, "Bundler's list", image)?;
        Names::Path.check(&list_path, "Bundler's list", image)?;
        list += &format!("{image}\n");
        let Some(pose) = entry.cam_from_world else {
            text.push_str("0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n");
            continue;
        };
        if let Some(reason) = obstacle(&entry.intrinsics) {
            let reason = format!("Bundler has no place for {reason}, which {image} has");
            return Err(IoError::input(path, reason).with_hint("choose another format"));
        }
        let d = &entry.intrinsics.distortion;
        text += &format!("{}\n", spaced(&[entry.intrinsics.fx, d.k1, d.k2]));
        for row in (flip() * pose.rotation_matrix()).row_iter() {
            text += &format!("{}\n", spaced(row.iter()));
        }
        text += &format!("{}\n", spaced((flip() * pose.translation).iter()));
    }
    if cameras.unit == Unit::Metre {
        text.push_str("# unit metre\n");
    }
    Ok(vec![
        OutputFile::new(list_path, list),
        OutputFile::new(path, text),
    ])
}
