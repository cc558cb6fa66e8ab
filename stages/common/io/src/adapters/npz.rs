//! IDR's and NeuS's `cameras.npz` (`cameras_sphere.npz`): NumPy arrays in a ZIP file.
//!
//! For the i-th image in the order of names in `image/`: `world_mat_i` (4 x 4), whose first three rows
//! are `P = K [R | t]`, and `scale_mat_i`, which takes the unit sphere of training to the world and is
//! not needed here (written as identity). Pixel centres lie at integers, axes are x right, y down, z
//! forward. `P` is parted by the RQ decomposition of its first three columns (Hartley and Zisserman,
//! Multiple View Geometry, A4.1).
//!
//! Read are arrays of 32 or 64 bits in files that `numpy.savez` writes (ZIP without compression).

use super::photos::{Photos, folder_of, size_of};
use super::undistorted::refuse_distortion;
use crate::bytes::Bytes;
use crate::cameras::{CameraEntry, CameraFile, rigid_from_world_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular, read_regular_text};
use crate::names::Names;
use nalgebra::{Matrix3, Matrix4, Vector3};
use rilievo_scene::{Distortion, Intrinsics};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Skew over focal length beyond which `P` is of no camera of ours; arrays of 32 bits leave 1e-7.
const MAX_SKEW: f64 = 1e-4;

/// Two arrays a camera, and as many arrays as a ZIP file of the plain kind counts.
const MAX_CAMERAS: usize = u16::MAX as usize / 2;

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
        let (k, rotation, center) =
            parted(matrix).ok_or_else(|| refuse("is no projection".to_owned()))?;
        let (fx, fy, skew) = (k[(0, 0)], k[(1, 1)], k[(0, 1)]);
        if skew.abs() > MAX_SKEW * fx {
            return Err(refuse(format!("has the skew {skew}")));
        }
        let pose = rigid_from_world_pose(&rotation.transpose(), center.into()).map_err(refuse)?;
        let (width, height) = size_of(image)?;
        let name = image
            .file_name()
            .map(|name| name.to_string_lossy().into_owned());
        file.cameras.push(CameraEntry {
            image: name,
            intrinsics: Intrinsics {
                width,
                height,
                fx,
                fy,
                cx: k[(0, 2)],
                cy: k[(1, 2)],
                distortion: Distortion::default(),
            },
            cam_from_world: Some(pose),
        });
    }
    Ok(file)
}

/// The file that tells which camera is which photo's; the format knows its images by their order alone.
fn names_of(path: &Path) -> PathBuf {
    path.with_extension("names.txt")
}

/// Names of the photos in the cameras' order, where this program wrote the file.
fn listed_names(path: &Path) -> Result<Option<Vec<String>>, IoError> {
    let list = names_of(path);
    if !list.is_file() {
        return Ok(None);
    }
    let text = read_regular_text(&list)?;
    let names = text.lines().filter_map(|line| line.split_once(' '));
    Ok(Some(names.map(|(_, name)| name.to_owned()).collect()))
}

/// The photos in the cameras' order: those that are listed, where all of them are there; else all of the
/// first folder that is there, by name.
fn images(path: &Path, photos: &Photos, num: usize) -> Result<Vec<PathBuf>, IoError> {
    let missing = || photos.missing(path, "a folder image of the photos, in the cameras' order,");
    if let Some(names) = listed_names(path)?.filter(|names| names.len() == num) {
        let beside = |name: &String| Some(path.with_file_name(name)).filter(|path| path.is_file());
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
        .filter(|path| crate::photo::is_photo_name(path))
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
    // Of entries of one name the first counts.
    let entries: HashMap<String, &[u8]> = entries(path, data)?.into_iter().rev().collect();
    let mut matrices = Vec::new();
    loop {
        let name = format!("world_mat_{}.npy", matrices.len());
        match entries.get(&name) {
            Some(array) => matrices.push(array_4x4(path, &name, array)?),
            None if matrices.is_empty() => {
                return Err(IoError::input(path, "holds no array world_mat_0"));
            }
            None => return Ok(matrices),
        }
    }
}

/// Names and contents of a ZIP file's entries, by its directory at the end (PKWARE's APPNOTE,
/// 4.3.12 and 4.3.16).
fn entries<'a>(path: &'a Path, data: &'a [u8]) -> Result<Vec<(String, &'a [u8])>, IoError> {
    let refuse = |reason: &str| IoError::input(path, reason.to_owned());
    let end = data
        .windows(4)
        .rposition(|four| four == b"PK\x05\x06")
        .ok_or_else(|| refuse("is no NumPy file (.npz)"))?;
    let mut directory = Bytes::new(path, data);
    directory.go_to(end + 10);
    let num = directory.u16()?;
    directory.u32()?;
    let start = directory.u32()? as usize;
    directory.go_to(start);
    let mut entries = Vec::new();
    for _ in 0..num {
        if directory.take()? != *b"PK\x01\x02" {
            return Err(directory.refuse("an entry of the file's directory is damaged"));
        }
        directory.take::<6>()?;
        let method = directory.u16()?;
        directory.take::<8>()?;
        let stored = directory.u32()? as usize;
        directory.u32()?;
        let lengths = [directory.u16()?, directory.u16()?, directory.u16()?].map(usize::from);
        directory.take::<8>()?;
        let local = directory.u32()? as usize;
        let name = directory.piece(lengths[0])?;
        let name = String::from_utf8_lossy(name).into_owned();
        directory.piece(lengths[1] + lengths[2])?;
        if method != 0 {
            return Err(refuse("is compressed").with_hint("save it with numpy.savez"));
        }
        let mut entry = Bytes::new(path, data);
        entry.go_to(local + 26);
        let skip = usize::from(entry.u16()?) + usize::from(entry.u16()?);
        entry.piece(skip)?;
        entries.push((name, entry.piece(stored)?));
    }
    Ok(entries)
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
    let mut zip = Zip::default();
    let posed = cameras
        .cameras
        .iter()
        .filter_map(|entry| Some((entry, entry.cam_from_world?)));
    let mut names = String::new();
    for (index, (entry, pose)) in posed.enumerate() {
        if index == MAX_CAMERAS {
            let reason = format!("a NumPy file has no place for more than {MAX_CAMERAS} cameras");
            return Err(IoError::input(path, reason).with_hint("choose another format"));
        }
        refuse_distortion(path, entry, "IDR's and NeuS's format")?;
        let i = &entry.intrinsics;
        let k = Matrix3::new(i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0);
        let mut world = Matrix4::identity();
        world
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(k * pose.rotation_matrix()));
        world
            .fixed_view_mut::<3, 1>(0, 3)
            .copy_from(&(k * pose.translation));
        zip.add(&format!("world_mat_{index}.npy"), &npy(&world));
        zip.add(
            &format!("scale_mat_{index}.npy"),
            &npy(&Matrix4::identity()),
        );
        Names::Line.check(&list, "the list of the photos", entry.name())?;
        names += &format!("{index:06} {}\n", entry.name());
    }
    Ok(vec![
        OutputFile::new(path, zip.finish()),
        OutputFile::new(list, names),
    ])
}

fn npy(matrix: &Matrix4<f64>) -> Vec<u8> {
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (4, 4), }".to_owned();
    // Magic, version and length take ten bytes; the array begins at a multiple of 64.
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut data = b"\x93NUMPY\x01\x00".to_vec();
    data.extend((header.len() as u16).to_le_bytes());
    data.extend(header.as_bytes());
    for value in matrix.transpose().iter() {
        data.extend(value.to_le_bytes());
    }
    data
}

/// A ZIP file without compression.
#[derive(Default)]
struct Zip {
    data: Vec<u8>,
    directory: Vec<u8>,
    num: u16,
}

impl Zip {
    fn add(&mut self, name: &str, content: &[u8]) {
        let local = self.data.len() as u32;
        // Version needed, flags, method, time, date (1 January 1980), sums and lengths.
        let mut common = Vec::new();
        for word in [20u16, 0, 0, 0, 0x21] {
            common.extend(word.to_le_bytes());
        }
        common.extend(crc32(content).to_le_bytes());
        common.extend((content.len() as u32).to_le_bytes());
        common.extend((content.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend(0u16.to_le_bytes());
        self.data.extend(b"PK\x03\x04");
        self.data.extend(&common);
        self.data.extend(name.as_bytes());
        self.data.extend(content);
        self.directory.extend(b"PK\x01\x02\x14\x00");
        self.directory.extend(&common);
        // Comment, disk, internal and external attributes: none.
        self.directory.extend([0; 10]);
        self.directory.extend(local.to_le_bytes());
        self.directory.extend(name.as_bytes());
        self.num += 1;
    }

    fn finish(mut self) -> Vec<u8> {
        let start = self.data.len() as u32;
        self.data.extend(&self.directory);
        self.data.extend(b"PK\x05\x06\0\0\0\0");
        self.data.extend(self.num.to_le_bytes());
        self.data.extend(self.num.to_le_bytes());
        self.data
            .extend((self.directory.len() as u32).to_le_bytes());
        self.data.extend(start.to_le_bytes());
        self.data.extend(0u16.to_le_bytes());
        self.data
    }
}

/// The check sum of ZIP (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |mut crc, &byte| {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                0xEDB8_8320 ^ (crc >> 1)
            } else {
                crc >> 1
            };
        }
        crc
    })
}
