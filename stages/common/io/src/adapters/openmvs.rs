//! OpenMVS's scene `.mvs`, as its interface archive: the cameras alone.
//!
//! Little endian: `"MVSI"`, version and a reserved number (32 bits); then lists with their length
//! (64 bits). Platforms hold cameras `K, R, C` relative to the platform and poses `R, C` of the
//! platform; an image names a platform, a camera and a pose: `R = R_camera R_pose`, `C = R_poseᵀ
//! C_camera + C_pose`, `pixel ~ K R (X − C)`. Pixel centres lie at integers; a camera without a
//! size has `K` over the longer side of its images. There is no lens distortion.
//!
//! Source: OpenMVS, `libs/MVS/Interface.h`, versions 0 to 7.

use super::limits::refuse_distortion;
use super::photos::{Photos, folder_of, size_of};
use crate::bytes::{Bytes, put};
use crate::cameras::{
    CameraEntry, CameraFile, DistinctCameras, intrinsics_of, last_part, matrix_of,
    rigid_from_world_pose,
};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular};
use crate::names::Names;
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// First bytes of the file.
const MAGIC: &[u8; 4] = b"MVSI";

/// The newest version that is read.
const MAX_VERSION: u32 = 7;

/// The version that is written: the first with identifiers, before mask names and depths.
const VERSION: u32 = 4;

/// OpenMVS's number for "none".
const NO_ID: u32 = u32::MAX;

struct Camera {
    size: Option<(usize, usize)>,
    k: Matrix3<f64>,
    rotation: Matrix3<f64>,
    center: Vector3<f64>,
}

struct Platform {
    cameras: Vec<Camera>,
    poses: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

fn matrix(bytes: &mut Bytes<'_>) -> Result<Matrix3<f64>, IoError> {
    Ok(Matrix3::from_row_slice(&bytes.numbers::<9>()?))
}

fn vector(bytes: &mut Bytes<'_>) -> Result<Vector3<f64>, IoError> {
    Ok(bytes.numbers::<3>()?.into())
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let photos = Photos::new(photos, folder_of(path), &["", "images"]);
    let data = read_regular(path)?;
    parse(path, &data, &photos)
}

fn parse(path: &Path, data: &[u8], photos: &Photos) -> Result<CameraFile, IoError> {
    let mut bytes = Bytes::new(path, data);
    if bytes.take()? != *MAGIC {
        return Err(IoError::input(path, "is no interface archive of OpenMVS")
            .with_hint("save the scene with --archive-type 0, or export the cameras to COLMAP"));
    }
    let version = bytes.u32()?;
    if version > MAX_VERSION {
        return Err(bytes.refuse(format!("version {version} is not known")));
    }
    bytes.u32()?;
    let mut platforms = Vec::new();
    // Counts come from the file: memory is asked for as content arrives, never ahead.
    for _ in 0..bytes.u64()? {
        platforms.push(platform(&mut bytes, version)?);
    }
    let mut file = CameraFile::default();
    for _ in 0..bytes.u64()? {
        let name = bytes.text()?;
        if version > 4 {
            bytes.text()?;
        }
        let (platform, camera, pose) = (bytes.u32()?, bytes.u32()?, bytes.u32()?);
        if version > 2 {
            bytes.u32()?;
        }
        if version > 6 {
            bytes.take::<12>()?;
            for _ in 0..bytes.u64()? {
                bytes.take::<24>()?;
            }
        }
        let platform = platforms.get(platform as usize);
        let camera = platform.and_then(|platform| platform.cameras.get(camera as usize));
        let (Some(platform), Some(camera)) = (platform, camera) else {
            return Err(bytes.refuse(format!("{name} refers to a camera that is not there")));
        };
        let cam_from_world = if pose == NO_ID {
            None
        } else {
            let (rotation, center) = platform.poses.get(pose as usize).ok_or_else(|| {
                bytes.refuse(format!("{name} refers to a pose that is not there"))
            })?;
            let center = rotation.transpose() * camera.center + center;
            let rotation = camera.rotation * rotation;
            Some(
                rigid_from_world_pose(&rotation.transpose(), center.into())
                    .map_err(|reason| bytes.refuse(format!("the pose of {name} {reason}")))?,
            )
        };
        let (size, scale) = match camera.size {
            Some(size) => (size, 1.0),
            None => {
                let size = size_of(&photos.named(path, &[last_part(&name)])?)?;
                (size, size.0.max(size.1) as f64)
            }
        };
        let in_pixels = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0));
        let intrinsics = intrinsics_of(&(in_pixels * camera.k), size)
            .map_err(|reason| bytes.refuse(format!("K of {name} {reason}")))?;
        file.cameras.push(CameraEntry {
            image: Some(last_part(&name).to_owned()),
            intrinsics,
            cam_from_world,
        });
    }
    if file.cameras.is_empty() {
        return Err(IoError::input(path, "holds no images"));
    }
    Ok(file)
}

fn platform(bytes: &mut Bytes<'_>, version: u32) -> Result<Platform, IoError> {
    bytes.text()?;
    let mut cameras = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.text()?;
        if version > 3 {
            bytes.text()?;
        }
        let size = if version > 0 {
            let (width, height) = (bytes.u32()? as usize, bytes.u32()? as usize);
            (width > 0 && height > 0).then_some((width, height))
        } else {
            None
        };
        cameras.push(Camera {
            size,
            k: matrix(bytes)?,
            rotation: matrix(bytes)?,
            center: vector(bytes)?,
        });
    }
    let mut poses = Vec::new();
    for _ in 0..bytes.u64()? {
        poses.push((matrix(bytes)?, vector(bytes)?));
    }
    Ok(Platform { cameras, poses })
}

pub(super) fn file(path: &Path, cameras: &CameraFile) -> Result<OutputFile, IoError> {
    let mut known = DistinctCameras::default();
    let mut images = Vec::new();
    let mut poses = Vec::new();
    let mut num_images = 0_u32;
    for (entry, pose) in cameras.posed() {
        refuse_distortion(path, entry, "OpenMVS")?;
        let camera = known.place(&entry.intrinsics);
        Names::Path.check(path, "OpenMVS", entry.name())?;
        put_text(&mut images, entry.name());
        for number in [0, camera as u32, num_images, num_images] {
            images.extend(number.to_le_bytes());
        }
        // Row by row, which is column by column of the transpose.
        let rotation = pose.rotation_matrix().transpose();
        let center = pose.center_in_source();
        put(&mut poses, rotation.iter().chain(center.iter()));
        num_images += 1;
    }
    let num_images = u64::from(num_images);
    let mut data = MAGIC.to_vec();
    data.extend(VERSION.to_le_bytes());
    data.extend(0u32.to_le_bytes());
    data.extend(1u64.to_le_bytes());
    put_text(&mut data, "platform");
    data.extend((known.list.len() as u64).to_le_bytes());
    for camera in &known.list {
        put_text(&mut data, "camera");
        put_text(&mut data, "");
        data.extend((camera.width as u32).to_le_bytes());
        data.extend((camera.height as u32).to_le_bytes());
        put(&mut data, matrix_of(camera).transpose().iter());
        put(&mut data, Matrix3::<f64>::identity().iter());
        put(&mut data, &[0.0; 3]);
    }
    data.extend(num_images.to_le_bytes());
    data.extend(poses);
    data.extend(num_images.to_le_bytes());
    data.extend(images);
    // Points, their normals and colours; lines, their normals and colours: none.
    data.extend([0; 6 * 8]);
    put(&mut data, nalgebra::Matrix4::<f64>::identity().iter());
    Ok(OutputFile::new(path, data))
}

fn put_text(data: &mut Vec<u8>, text: &str) {
    data.extend((text.len() as u64).to_le_bytes());
    data.extend(text.as_bytes());
}
