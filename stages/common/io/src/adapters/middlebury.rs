//! Middlebury multi-view parameter file `NAME_par.txt`.
//!
//! A count, then one line per image: `name k11 k12 k13 k21 … k33 r11 … r33 t1 t2 t3`, with
//! `pixel ~ K (R X + t)`, the first pixel's centre at 0. Source: vision.middlebury.edu/mview/data.

use super::limits::refuse_distortion;
use super::photos::{Photos, folder_of, size_of};
use crate::cameras::{CameraEntry, CameraFile, intrinsics_of, matrix_of, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::{lines, spaced};
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let photos = Photos::new(photos, folder_of(path), &["", "images"]);
    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let first = rest.next();
    let mut first = first.ok_or_else(|| IoError::input(path, "the file ends too early"))?;
    let num_images: usize = first.parse("the number of images")?;
    let mut file = CameraFile::default();
    for mut line in rest.take(num_images) {
        let name = line.word("the image's name")?.to_owned();
        let k = Matrix3::from_row_slice(&line.numbers::<9>("an entry of K")?);
        let rotation = Matrix3::from_row_slice(&line.numbers::<9>("an entry of R")?);
        let translation = Vector3::from(line.numbers::<3>("an entry of t")?);
        let size = size_of(&photos.named(path, &[&name])?)?;
        let intrinsics = intrinsics_of(&k, size)
            .map_err(|reason| line.refuse(format!("K of {name} {reason}")))?;
        let pose = rigid_from_camera_pose(&rotation, &translation)
            .map_err(|reason| line.refuse(format!("R of {name} {reason}")))?;
        file.cameras
            .push(CameraEntry::posed(name, intrinsics, pose));
    }
    let found = file.cameras.len();
    if found < num_images {
        let reason = format!("announces {num_images} images and has {found}");
        return Err(IoError::input(path, reason));
    }
    Ok(file)
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut lines = String::new();
    let mut num_images = 0;
    for (entry, pose) in cameras.posed() {
        refuse_distortion(path, entry, "Middlebury's format")?;
        let name = entry.name();
        Names::Word.check(path, "Middlebury's format", name)?;
        // Row by row, which is column by column of the transpose.
        let k = matrix_of(&entry.intrinsics).transpose();
        let rotation = pose.rotation_matrix().transpose();
        let numbers = k.iter().chain(rotation.iter()).chain(&pose.translation);
        lines += &format!("{name} {}\n", spaced(numbers));
        num_images += 1;
    }
    Ok(OutputFile::new(path, format!("{num_images}\n{lines}")))
}
