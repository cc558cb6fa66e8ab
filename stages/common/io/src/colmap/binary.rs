//! The binary files, little endian.

use super::model::{CameraModel, ColmapCamera, ColmapImage, ColmapModel, ColmapPoint};
use super::text::pose;
use crate::bytes::{Bytes, put};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular};
use crate::names::Names;
use std::path::Path;

/// COLMAP's number for "no point".
const NO_POINT: u64 = u64::MAX;

/// Reads the three files; `points3D.bin` may be missing.
pub(super) fn read(folder: &Path) -> Result<ColmapModel, IoError> {
    let mut model = ColmapModel::default();
    let path = folder.join("cameras.bin");
    parse_cameras(&path, &read_regular(&path)?, &mut model)?;
    let path = folder.join("images.bin");
    parse_images(&path, &read_regular(&path)?, &mut model)?;
    let path = folder.join("points3D.bin");
    if path.is_file() {
        parse_points(&path, &read_regular(&path)?, &mut model)?;
    }
    Ok(model)
}

pub(super) fn parse_cameras(
    file: &Path,
    data: &[u8],
    model: &mut ColmapModel,
) -> Result<(), IoError> {
    let mut bytes = Bytes::new(file, data);
    // Counts come from the file: memory is asked for as content arrives, never ahead.
    for _ in 0..bytes.u64()? {
        let id = bytes.u32()?;
        let number = bytes.u32()?;
        let camera_model =
            CameraModel::from_number(number).map_err(|reason| bytes.refuse(reason))?;
        let (width, height) = (bytes.size()?, bytes.size()?);
        let params = (0..camera_model.num_params)
            .map(|_| bytes.number())
            .collect::<Result<Vec<f64>, _>>()?;
        let camera = ColmapCamera {
            id,
            model: camera_model,
            width,
            height,
            params,
        };
        camera.intrinsics().map_err(|reason| bytes.refuse(reason))?;
        model.cameras.push(camera);
    }
    Ok(())
}

pub(super) fn parse_images(
    file: &Path,
    data: &[u8],
    model: &mut ColmapModel,
) -> Result<(), IoError> {
    let mut bytes = Bytes::new(file, data);
    for _ in 0..bytes.u64()? {
        let id = bytes.u32()?;
        let (q, translation) = (bytes.numbers()?, bytes.numbers()?);
        let cam_from_world = pose(q, translation).map_err(|reason| bytes.refuse(reason))?;
        let camera_id = bytes.u32()?;
        let name = bytes.name()?;
        let mut points2d = Vec::new();
        for _ in 0..bytes.u64()? {
            let pixel = bytes.numbers()?;
            let point = bytes.u64()?;
            points2d.push((pixel, (point != NO_POINT).then_some(point)));
        }
        model.images.push(ColmapImage {
            id,
            cam_from_world,
            camera_id,
            name,
            points2d,
        });
    }
    Ok(())
}

pub(super) fn parse_points(
    file: &Path,
    data: &[u8],
    model: &mut ColmapModel,
) -> Result<(), IoError> {
    let mut bytes = Bytes::new(file, data);
    for _ in 0..bytes.u64()? {
        let mut point = ColmapPoint {
            id: bytes.u64()?,
            position: bytes.numbers()?,
            color: bytes.take()?,
            error_px: bytes.number()?,
            track: Vec::new(),
        };
        for _ in 0..bytes.u64()? {
            point.track.push((bytes.u32()?, bytes.u32()?));
        }
        model.points.push(point);
    }
    Ok(())
}

/// `cameras.bin`, `images.bin` and `points3D.bin` of a model, to be written.
///
/// # Errors
/// When an image's name has a zero in it, which ends names there.
pub fn binary_files(folder: &Path, model: &ColmapModel) -> Result<Vec<OutputFile>, IoError> {
    let mut files = Vec::with_capacity(3);
    let mut save = |name: &str, data: Vec<u8>| files.push(OutputFile::new(folder.join(name), data));
    let images_path = folder.join("images.bin");
    let mut data = (model.cameras.len() as u64).to_le_bytes().to_vec();
    for camera in &model.cameras {
        data.extend(camera.id.to_le_bytes());
        data.extend(camera.model.number().to_le_bytes());
        data.extend((camera.width as u64).to_le_bytes());
        data.extend((camera.height as u64).to_le_bytes());
        put(&mut data, &camera.params);
    }
    save("cameras.bin", data);

    let mut data = (model.images.len() as u64).to_le_bytes().to_vec();
    for image in &model.images {
        Names::Terminated.check(&images_path, "COLMAP's binary model", &image.name)?;
        let q = image.cam_from_world.rotation.quaternion();
        let t = &image.cam_from_world.translation;
        data.extend(image.id.to_le_bytes());
        put(&mut data, &[q.w, q.i, q.j, q.k, t.x, t.y, t.z]);
        data.extend(image.camera_id.to_le_bytes());
        data.extend(image.name.as_bytes());
        data.push(0);
        data.extend((image.points2d.len() as u64).to_le_bytes());
        for (pixel, point) in &image.points2d {
            put(&mut data, pixel);
            data.extend(point.unwrap_or(NO_POINT).to_le_bytes());
        }
    }
    save("images.bin", data);

    let mut data = (model.points.len() as u64).to_le_bytes().to_vec();
    for point in &model.points {
        data.extend(point.id.to_le_bytes());
        put(&mut data, &point.position);
        data.extend(point.color);
        data.extend(point.error_px.to_le_bytes());
        data.extend((point.track.len() as u64).to_le_bytes());
        for (image, index) in &point.track {
            data.extend(image.to_le_bytes());
            data.extend(index.to_le_bytes());
        }
    }
    save("points3D.bin", data);
    Ok(files)
}
