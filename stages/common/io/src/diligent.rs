//! The photometric stereo data sets DiLiGenT and DiLiGenT-MV, as their authors publish them.
//!
//! ```text
//! OBJECT/                            DiLiGenT: one view; DiLiGenT-MV: view_01, view_02, … inside
//!   filenames.txt                    photos of 16 bits, linear, one a line
//!   light_directions.txt             x y z towards the lamp of each photo
//!   light_intensities.txt            red green blue strength of each lamp
//!   mask.png, Normal_gt.mat          the object; `Normal_gt`, rows x columns x 3
//! OBJECT/Calib_Results.mat           DiLiGenT-MV: `KK`, and `Rc_i`, `Tc_i` of view i (millimetres)
//! OBJECT/mesh_Gt.ply                 DiLiGenT-MV: the true surface (millimetres)
//! ```
//!
//! # Conventions
//! Directions and normals there are in camera axes x right, y up, z to the viewer; ours are x
//! right, y down, z forward, so that y and z change sign. The calibration is the one of Bouguet's
//! toolbox, `x_camera = R x_world + t` with our axes, first pixel's centre at 0. Its lens
//! distortion is not applied: the published photos fit the pinhole camera `KK`. Lengths become
//! metres.
//!
//! Source: Shi et al., A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated
//! Photometric Stereo, PAMI 41(2), 2019; Li et al., Multi-view Photometric Stereo: A Robust
//! Solution and Benchmark Dataset for Spatially Varying Isotropic Materials, TIP 29, 2020.

use crate::cameras::{CameraEntry, intrinsics_of, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::read_regular_text;
use crate::mask::read_mask;
use crate::mat::{MatArray, read_mat};
use crate::photo::{decode_photo, photo_size};
use crate::words::lines;
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{LinearImage, Mask, NormalMap, Samples};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metres in the unit of DiLiGenT-MV's calibration and mesh.
pub const METRES_PER_MM: f64 = 1e-3;

/// Numbers of views that are looked for: names have two digits.
const MAX_VIEWS: usize = 99;

/// Name of the calibration file.
const CALIBRATION: &str = "Calib_Results.mat";

/// One photo with its lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct DiligentPhoto {
    /// Its file.
    pub path: PathBuf,
    /// Direction towards the lamp, camera frame (x right, y down, z forward), unit length.
    pub towards_light: [f64; 3],
    /// Strength of the lamp in red, green and blue.
    pub intensity: [f64; 3],
}

/// Photos from one place.
#[derive(Clone, Debug)]
pub struct DiligentView {
    /// The folder's name.
    pub name: String,
    /// Camera, where the set has one (DiLiGenT-MV).
    pub camera: Option<CameraEntry>,
    /// One photo a lamp.
    pub photos: Vec<DiligentPhoto>,
    /// The object.
    pub mask: Mask,
    /// True normals in our camera frame, 0 outside the mask; where the set has them.
    pub normal: Option<NormalMap>,
}

/// An object of either data set.
#[derive(Clone, Debug)]
pub struct DiligentObject {
    /// Its views, by name.
    pub views: Vec<DiligentView>,
    /// The true surface in millimetres, where there is one.
    pub mesh: Option<PathBuf>,
}

/// Whether a folder is an object of one of the data sets.
pub fn is_diligent(folder: &Path) -> bool {
    folder.join("light_directions.txt").is_file() || folder.join(CALIBRATION).is_file()
}

/// Reads an object's folder; photos stay on the disk.
///
/// # Errors
/// When a file is missing, cannot be read, or contradicts another; names it.
pub fn read_diligent(folder: &Path) -> Result<DiligentObject, IoError> {
    let calibration = folder.join(CALIBRATION);
    let mesh = Some(folder.join("mesh_Gt.ply")).filter(|path| path.is_file());
    if !calibration.is_file() {
        let views = vec![view(folder, None)?];
        return Ok(DiligentObject { views, mesh });
    }
    let arrays = read_mat(&calibration, |name| {
        name == "KK" || name.starts_with("Rc_") || name.starts_with("Tc_")
    })?;
    let mut views = Vec::new();
    for number in 1..=MAX_VIEWS {
        let place = folder.join(format!("view_{number:02}"));
        if place.is_dir() {
            views.push(view(&place, Some(&camera(&calibration, &arrays, number)?))?);
        }
    }
    if views.is_empty() {
        return Err(IoError::input(folder, "holds no folder view_01"));
    }
    Ok(DiligentObject { views, mesh })
}

/// Camera of a view of DiLiGenT-MV, without name and size.
fn camera(
    path: &Path,
    arrays: &BTreeMap<String, MatArray>,
    number: usize,
) -> Result<CameraEntry, IoError> {
    fn matrix<const R: usize, const C: usize>(
        path: &Path,
        arrays: &BTreeMap<String, MatArray>,
        name: &str,
    ) -> Result<[[f64; C]; R], IoError> {
        let found = arrays.get(name).and_then(MatArray::matrix);
        found.ok_or_else(|| IoError::input(path, format!("has no {R} x {C} matrix {name}")))
    }
    let k: [[f64; 3]; 3] = matrix(path, arrays, "KK")?;
    let rotation: [[f64; 3]; 3] = matrix(path, arrays, &format!("Rc_{number}"))?;
    let translation: [[f64; 1]; 3] = matrix(path, arrays, &format!("Tc_{number}"))?;
    let refuse = |reason: String| IoError::input(path, reason);
    // The size is that of the photos, which are read later.
    let k = Matrix3::from_row_slice(k.as_flattened());
    let intrinsics = intrinsics_of(&k, (0, 0)).map_err(|reason| refuse(format!("KK {reason}")))?;
    let rotation = Matrix3::from_row_slice(rotation.as_flattened());
    let metres = Vector3::from(translation.map(|[t]| t * METRES_PER_MM));
    let pose = rigid_from_camera_pose(&rotation, &metres)
        .map_err(|reason| refuse(format!("Rc_{number} {reason}")))?;
    Ok(CameraEntry {
        image: None,
        intrinsics,
        cam_from_world: Some(pose),
    })
}

fn view(folder: &Path, camera: Option<&CameraEntry>) -> Result<DiligentView, IoError> {
    let name = folder
        .canonicalize()
        .ok()
        .and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .unwrap_or_else(|| "view".to_owned());
    let rows = |name: &str| -> Result<Vec<[f64; 3]>, IoError> {
        let path = folder.join(name);
        let text = read_regular_text(&path)?;
        lines(&path, &text, false)
            .map(|mut line| line.numbers("a number"))
            .collect()
    };
    let list = folder.join("filenames.txt");
    let names = read_regular_text(&list)?;
    let names: Vec<&str> = names.split_whitespace().collect();
    let (directions, intensities) = (
        rows("light_directions.txt")?,
        rows("light_intensities.txt")?,
    );
    if names.is_empty() || names.len() != directions.len() || names.len() != intensities.len() {
        let reason = format!(
            "names {} photos, beside {} light directions and {} intensities",
            names.len(),
            directions.len(),
            intensities.len()
        );
        return Err(IoError::input(&list, reason));
    }
    let mut photos = Vec::with_capacity(names.len());
    for ((photo, direction), intensity) in names.iter().zip(directions).zip(intensities) {
        let [x, y, z] = direction;
        let length = (x * x + y * y + z * z).sqrt();
        // Written so that NaN is refused too.
        if !(length > 0.0 && intensity.iter().all(|&strength| strength > 0.0)) {
            let reason = format!("the lamp of {photo} is {direction:?} times {intensity:?}");
            return Err(IoError::input(folder, reason));
        }
        photos.push(DiligentPhoto {
            path: folder.join(photo),
            towards_light: [x / length, -y / length, -z / length],
            intensity,
        });
    }
    let mask_path = folder.join("mask.png");
    let mask = read_mask(&mask_path)?;
    let size = (mask.width, mask.height);
    if let Some(found) = photo_size(&photos[0].path).filter(|&found| found != size) {
        let reason = format!(
            "is {} x {}, its photos {} x {}",
            size.0, size.1, found.0, found.1
        );
        return Err(IoError::input(&mask_path, reason));
    }
    let truth = folder.join("Normal_gt.mat");
    let normal = truth
        .is_file()
        .then(|| normals(&truth, &mask))
        .transpose()?;
    let camera = camera.map(|camera| {
        let mut camera = camera.clone();
        (camera.intrinsics.width, camera.intrinsics.height) = size;
        camera.image = Some(name.clone());
        camera
    });
    Ok(DiligentView {
        name,
        camera,
        photos,
        mask,
        normal,
    })
}

/// True normals in our axes.
fn normals(path: &Path, mask: &Mask) -> Result<NormalMap, IoError> {
    let (width, height) = (mask.width, mask.height);
    let arrays = read_mat(path, |name| name.eq_ignore_ascii_case("normal_gt"))?;
    let array = arrays
        .into_values()
        .next()
        .ok_or_else(|| IoError::input(path, "has no array Normal_gt"))?;
    if array.dims != [height, width, 3] {
        let reason = format!("Normal_gt is {:?}, the mask {width} x {height}", array.dims);
        return Err(IoError::input(path, reason));
    }
    Ok(NormalMap::from_fn(width, height, |x, y| {
        let value = |c: usize| array.values[(c * width + x) * height + y];
        let (n1, n2, n3) = (value(0), -value(1), -value(2));
        let length = (n1 * n1 + n2 * n2 + n3 * n3).sqrt();
        if *mask.at(x, y) && length > 0.5 && length.is_finite() {
            [n1, n2, n3].map(|n| (n / length) as f32)
        } else {
            [0.0; 3]
        }
    }))
}

/// Linear intensities of a photo for a lamp of unit strength; 1 is the photo's white under a lamp
/// of strength 1.
///
/// # Errors
/// When the photo cannot be read or is not in colour.
pub fn read_diligent_photo(photo: &DiligentPhoto) -> Result<LinearImage, IoError> {
    let decoded = decode_photo(&photo.path)?;
    let white = match decoded.samples.bits() {
        8 => 255.0,
        16 => 65_535.0,
        _ => 1.0,
    };
    let factors = photo.intensity.map(|strength| 1.0 / (white * strength));
    if decoded.channels != 3 {
        return Err(IoError::input(&photo.path, "is not in colour"));
    }
    // Of whatever depth, the sets' photos are proportional to light.
    let sample = |i: usize| -> f64 {
        match &decoded.samples {
            Samples::U8(values) => values[i].into(),
            Samples::U16(values) => values[i].into(),
            Samples::F32(values) => values[i].into(),
        }
    };
    let num_samples = 3 * decoded.width * decoded.height;
    let data = (0..num_samples)
        .map(|i| (sample(i) * factors[i % 3]) as f32)
        .collect();
    Ok(LinearImage {
        width: decoded.width,
        height: decoded.height,
        channels: 3,
        data,
    })
}

#[cfg(test)]
mod tests;
