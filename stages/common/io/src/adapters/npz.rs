//! IDR's and NeuS's `cameras.npz` (`cameras_sphere.npz`): NumPy arrays in a ZIP file.
//!
//! For the i-th image in the order of names in `image/`: `world_mat_i` (4 x 4), whose first three
//! rows are `P = K [R | t]`, and `scale_mat_i`, which takes the unit sphere of training to the
//! world and is not needed here (written as identity). Pixel centres lie at integers, axes are x
//! right, y down, z forward. `P` is parted by the RQ decomposition of its first three columns
//! (Hartley and Zisserman, Multiple View Geometry, A4.1).
//!
//! Read are arrays of 32 or 64 bits, as `numpy.savez` and `numpy.savez_compressed` write them.

use super::limits::refuse_distortion;
use super::photos::{Photos, folder_of, listed_names, size_of};
use crate::bytes::{Bytes, put};
use crate::cameras::{CameraEntry, CameraFile, intrinsics_of, matrix_of, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular};
use crate::names::Names;
use crate::photo::{file_name, is_photo_name};
use nalgebra::{Matrix3, Matrix4, Vector3};
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Skew over focal length that the rounding of a projection matrix explains.
const ROUNDED_SKEW: f64 = 1e-4;
/// Two arrays a camera, and as many arrays as a ZIP file of the plain kind counts.
const MAX_CAMERAS: usize = u16::MAX as usize / 2;

/// Bytes that are read of an array: sixteen numbers and a header of the longest kind in use. A
/// compressed one may claim gigabytes.
const MAX_ARRAY_BYTES: u64 = 1 << 16;

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let data = read_regular(path)?;
    let matrices = parse(path, &data)?;
    let photos = Photos::new(photos, folder_of(path), &["image", "images", "rgb"]);
    let images = images(path, &photos, matrices.len())?;
    if images.len() < matrices.len() {
        return Err(IoError::input(
            path,
            format!(
                "has {} cameras, but there are only {} photos, which tell names and sizes",
                matrices.len(),
                images.len()
            ),
        ));
    }
    let mut file = CameraFile::default();
    for (index, (matrix, image)) in matrices.iter().zip(&images).enumerate() {
        let refuse = |reason: String| IoError::input(path, format!("world_mat_{index} {reason}"));
        let (mut k, rotation, center) =
            parted(matrix).ok_or_else(|| refuse("is no projection".to_owned()))?;
        // A product of 32-bit matrices leaves a skew of its own rounding.
        if k[(0, 1)].abs() < ROUNDED_SKEW * k[(0, 0)] {
            k[(0, 1)] = 0.0;
        }
        let intrinsics = intrinsics_of(&k, size_of(image)?).map_err(refuse)?;
        let pose = rigid_from_world_pose(&rotation.transpose(), center.into()).map_err(refuse)?;
        file.cameras
            .push(CameraEntry::posed(file_name(image), intrinsics, pose));
    }
    Ok(file)
}

/// The file that names each camera's photo; the format knows its images by their order alone.
fn names_of(path: &Path) -> PathBuf {
    path.with_extension("names.txt")
}

/// The photos in the cameras' order: those that are listed, where all of them are there; else all
/// of the first folder that is there, by name.
fn images(path: &Path, photos: &Photos, num: usize) -> Result<Vec<PathBuf>, IoError> {
    let missing = || photos.missing(path, "a folder image of the photos, in the cameras' order,");
    let names = listed_names(&names_of(path))?;
    if names.len() == num {
        let beside = |name: &str| Some(path.with_file_name(name)).filter(|path| path.is_file());
        let found = |name: &String| photos.find(name).or_else(|| beside(name));
        if let Some(images) = names.iter().map(found).collect() {
            return Ok(images);
        }
    }
    let folder = photos.folders().iter().find(|folder| folder.is_dir());
    let folder = folder.ok_or_else(missing)?;
    let mut images: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|error| IoError::read(folder, &error))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| is_photo_name(path))
        .collect();
    images.sort();
    Ok(images)
}

/// `K` (with 1 in its last corner), rotation camera from world, and centre of `P = K [R | t]`.
fn parted(p: &Matrix4<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>, Vector3<f64>)> {
    let m: Matrix3<f64> = p.fixed_view::<3, 3>(0, 0).into_owned();
    // The sign of a projection is free; that of a rotation is not.
    let sign = m.determinant().signum();
    let (m, t) = (m * sign, p.fixed_view::<3, 1>(0, 3).into_owned() * sign);
    let center = -(m.try_inverse()? * t);
    // RQ of M is QR of M with its rows reversed, transposed.
    let reverse = Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0);
    let qr = (reverse * m).transpose().qr();
    let mut k = reverse * qr.r().transpose() * reverse;
    let mut rotation = reverse * qr.q().transpose();
    for i in 0..3 {
        if k[(i, i)] < 0.0 {
            k.column_mut(i).neg_mut();
            rotation.row_mut(i).neg_mut();
        }
    }
    let last = k[(2, 2)];
    k /= last;
    let usable = k
        .iter()
        .chain(rotation.iter())
        .chain(center.iter())
        .all(|v| v.is_finite());
    (usable && k[(0, 0)] > 0.0 && k[(1, 1)] > 0.0).then_some((k, rotation, center))
}

/// The arrays `world_mat_0`, `world_mat_1`, ... of a file.
fn parse(path: &Path, data: &[u8]) -> Result<Vec<Matrix4<f64>>, IoError> {
    let refuse = |reason: String| IoError::input(path, reason);
    let mut archive = ZipArchive::new(Cursor::new(data))
        .map_err(|error| refuse(format!("is no NumPy file (.npz): {error}")))?;
    let mut matrices = Vec::new();
    loop {
        if matrices.len() > MAX_CAMERAS {
            return Err(refuse(format!("holds more than {MAX_CAMERAS} cameras")));
        }
        let name = format!("world_mat_{}.npy", matrices.len());
        let mut array = Vec::new();
        match archive.by_name(&name) {
            Ok(entry) => entry.take(MAX_ARRAY_BYTES).read_to_end(&mut array),
            Err(ZipError::FileNotFound) if !matrices.is_empty() => return Ok(matrices),
            Err(ZipError::FileNotFound) => {
                return Err(refuse("holds no array world_mat_0".to_owned()));
            }
            Err(error) => return Err(refuse(format!("{name}: {error}"))),
        }
        .map_err(|error| refuse(format!("{name}: {error}")))?;
        matrices.push(array_4x4(path, &name, &array)?);
    }
}

/// A 4 x 4 (or 3 x 4) array, row by row (NumPy's format, versions 1 to 3).
fn array_4x4(path: &Path, name: &str, data: &[u8]) -> Result<Matrix4<f64>, IoError> {
    let refuse = |reason: String| IoError::input(path, format!("{name}: {reason}"));
    let mut bytes = Bytes::new(path, data);
    if bytes.take()? != *b"\x93NUMPY" {
        return Err(refuse("is no array".to_owned()));
    }
    let [major, _] = bytes.take()?;
    let length = if major == 1 {
        usize::from(bytes.u16()?)
    } else {
        bytes.u32()? as usize
    };
    let header = String::from_utf8_lossy(bytes.piece(length)?).replace(' ', "");
    let wide = header.contains("'<f8'");
    if !wide && !header.contains("'<f4'") || header.contains("'fortran_order':True") {
        return Err(refuse(format!("has the header {header}")));
    }
    let rows = if header.contains("(4,4)") {
        4
    } else if header.contains("(3,4)") {
        3
    } else {
        return Err(refuse(format!("is not 4 x 4: {header}")));
    };
    let mut matrix = Matrix4::identity();
    for row in 0..rows {
        for column in 0..4 {
            matrix[(row, column)] = if wide {
                bytes.number()?
            } else {
                f64::from(f32::from_le_bytes(bytes.take()?))
            };
        }
    }
    Ok(matrix)
}

pub(super) fn files(path: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let list = names_of(path);
    let mut arrays = Vec::new();
    let mut names = String::new();
    for (index, (entry, pose)) in cameras.posed().enumerate() {
        if index == MAX_CAMERAS {
            let reason = format!("a NumPy file has no place for more than {MAX_CAMERAS} cameras");
            return Err(IoError::input(path, reason).with_hint("choose another format"));
        }
        refuse_distortion(path, entry, "IDR's and NeuS's format")?;
        let k = matrix_of(&entry.intrinsics);
        let mut world = (k * pose.rotation_matrix()).to_homogeneous();
        let mut last = world.fixed_view_mut::<3, 1>(0, 3);
        last.copy_from(&(k * pose.translation));
        arrays.push((format!("world_mat_{index}.npy"), world));
        arrays.push((format!("scale_mat_{index}.npy"), Matrix4::identity()));
        Names::Line.check(&list, "the list of the photos", entry.name())?;
        names += &format!("{index:06} {}\n", entry.name());
    }
    let archive = archive(&arrays).map_err(|error| IoError::write(path, error))?;
    Ok(vec![
        OutputFile::new(path, archive),
        OutputFile::new(list, names),
    ])
}

/// A ZIP file of arrays, without compression.
fn archive(arrays: &[(String, Matrix4<f64>)]) -> Result<Vec<u8>, ZipError> {
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, matrix) in arrays {
        zip.start_file(name, options)?;
        zip.write_all(&npy(matrix))?;
    }
    Ok(zip.finish()?.into_inner())
}

fn npy(matrix: &Matrix4<f64>) -> Vec<u8> {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 4), }";
    // Magic, version and length take ten bytes; the array begins at a multiple of 64.
    let mut data = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    data.extend(format!("{header:117}\n").as_bytes());
    put(&mut data, matrix.transpose().iter());
    data
}
