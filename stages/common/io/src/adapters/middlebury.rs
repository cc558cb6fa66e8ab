//! Middlebury multi-view parameter file `NAME_par.txt`.
//!
//! A count, then one line per image: `name k11 k12 k13 k21 … k33 r11 … r33 t1 t2 t3`, with
//! `pixel ~ K (R X + t)`, the first pixel's centre at 0. Source: vision.middlebury.edu/mview/data.

use super::photos::{Photos, folder_of};
use super::undistorted::refuse_distortion;
use crate::cameras::{CameraEntry, CameraFile, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::lines;
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Distortion, Intrinsics};
use std::fmt::Write as _;
use std::path::Path;

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let photos = Photos::new(photos, folder_of(path), &["", "images"]);
    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let mut first = rest
        .next()
        .ok_or_else(|| IoError::input(path, "the file is empty"))?;
    let num_images: usize = first.parse("the number of images")?;
    let mut file = CameraFile::default();
    for mut line in rest.by_ref().take(num_images) {
        let name = line.word("the image's name")?.to_owned();
        let k = Matrix3::from_row_slice(&line.numbers::<9>("an entry of K")?);
        let rotation = Matrix3::from_row_slice(&line.numbers::<9>("an entry of R")?);
        let translation = Vector3::from(line.numbers::<3>("an entry of t")?);
        let upper = k[(1, 0)] == 0.0 && k[(2, 0)] == 0.0 && k[(2, 1)] == 0.0 && k[(2, 2)] == 1.0;
        if !upper || k[(0, 0)] <= 0.0 || k[(1, 1)] <= 0.0 || k[(0, 1)].abs() > 1e-6 * k[(0, 0)] {
            return Err(line.refuse(format!("K of {name} is no camera matrix without skew")));
        }
        let (width, height) = photos.size(path, &name)?;
        let pose = rigid_from_camera_pose(&rotation, &translation)
            .map_err(|reason| line.refuse(format!("R of {name} {reason}")))?;
        file.cameras.push(CameraEntry {
            image: Some(name),
            intrinsics: Intrinsics {
                width,
                height,
                fx: k[(0, 0)],
                fy: k[(1, 1)],
                cx: k[(0, 2)],
                cy: k[(1, 2)],
                distortion: Distortion::default(),
            },
            cam_from_world: Some(pose),
        });
    }
    if file.cameras.len() < num_images {
        return Err(IoError::input(
            path,
            format!(
                "announces {num_images} images and has {}",
                file.cameras.len()
            ),
        ));
    }
    Ok(file)
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut lines = String::new();
    let mut num_images = 0;
    for entry in &cameras.cameras {
        let Some(pose) = entry.cam_from_world else {
            continue;
        };
        refuse_distortion(path, entry, "Middlebury's format")?;
        let name = entry.name();
        Names::Word.check(path, "Middlebury's format", name)?;
        let i = &entry.intrinsics;
        // Writing into a String cannot fail, hence the ignored results.
        let _ = write!(
            lines,
            "{name} {} 0 {} 0 {} {} 0 0 1",
            i.fx, i.cx, i.fy, i.cy
        );
        for value in pose.rotation_matrix().transpose().iter() {
            let _ = write!(lines, " {value}");
        }
        let t = &pose.translation;
        let _ = writeln!(lines, " {} {} {}", t.x, t.y, t.z);
        num_images += 1;
    }
    Ok(OutputFile::new(path, format!("{num_images}\n{lines}")))
}
