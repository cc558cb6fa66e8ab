//! Between COLMAP's words and ours.

use super::model::{CameraModel, ColmapCamera, ColmapImage, ColmapModel, ColmapPoint};
use crate::cameras::entry::{CameraEntry, CameraFile};
use crate::cameras::index::DistinctCameras;
use crate::cameras::lens::LensModel;
use crate::error::IoError;
use nalgebra::{Point3, Vector3};
use rilievo_scene::{Intrinsics, PosedViews, Unit};
use std::collections::HashMap;
use std::path::Path;

/// Centre of the first pixel in COLMAP's coordinates.
pub(super) const HALF_PIXEL: f64 = 0.5;

impl ColmapCamera {
    /// The camera with pixel centres at integers.
    ///
    /// # Errors
    /// The reason why it is no usable camera.
    pub fn intrinsics(&self) -> Result<Intrinsics, String> {
        let p = &self.params;
        if p.len() != self.model.num_params {
            return Err(format!(
                "camera {} has {} parameters; {} takes {}",
                self.id,
                p.len(),
                self.model.name,
                self.model.num_params
            ));
        }
        if let Some(value) = p.iter().find(|value| !value.is_finite()) {
            return Err(format!("camera {} has the parameter {value}", self.id));
        }
        // Focal lengths, principal point, then the lens's coefficients.
        let (focals, rest) = p.split_at(self.model.num_focals);
        let (fx, fy) = (focals[0], focals[focals.len() - 1]);
        if fx <= 0.0 || fy <= 0.0 || self.width == 0 || self.height == 0 {
            return Err(format!(
                "camera {} has focal lengths {fx}, {fy} and {} x {} pixels",
                self.id, self.width, self.height
            ));
        }
        let (cx, cy) = (rest[0] - HALF_PIXEL, rest[1] - HALF_PIXEL);
        let camera = Intrinsics {
            distortion: self.model.lens.distortion(&rest[2..]),
            ..Intrinsics::undistorted((self.width, self.height), [fx, fy, cx, cy])
        };
        match camera.check_lens() {
            Ok(()) => Ok(camera),
            Err(reason) => Err(format!(
                "camera {} ({}): {reason}",
                self.id, self.model.name
            )),
        }
    }

    /// COLMAP's camera of ours.
    pub fn from_intrinsics(id: u32, camera: &Intrinsics) -> Self {
        let d = &camera.distortion;
        let mut params = vec![
            camera.fx,
            camera.fy,
            camera.cx + HALF_PIXEL,
            camera.cy + HALF_PIXEL,
        ];
        let (lens, mut coefficients) = LensModel::of(d);
        let model = match lens {
            _ if d.is_none() => CameraModel::PINHOLE,
            LensModel::OpenCv if d.is_plain() && d.k3 == 0.0 => CameraModel::OPENCV,
            LensModel::OpenCv => CameraModel::FULL_OPENCV,
            LensModel::Fisheye => CameraModel::OPENCV_FISHEYE,
            LensModel::ThinPrismFisheye => CameraModel::THIN_PRISM_FISHEYE,
        };
        coefficients.resize(model.num_params - params.len(), 0.0);
        params.extend(coefficients);
        Self {
            id,
            model,
            width: camera.width,
            height: camera.height,
            params,
        }
    }
}

impl ColmapModel {
    /// The cameras alone, in the order of the images' names; `folder` is named in messages. A
    /// model has no unit.
    ///
    /// # Errors
    /// When an image refers to no camera, or a camera cannot be converted.
    pub fn to_camera_file(&self, folder: &Path) -> Result<CameraFile, IoError> {
        let mut by_id = HashMap::new();
        for camera in &self.cameras {
            by_id.entry(camera.id).or_insert(camera);
        }
        let mut cameras = Vec::with_capacity(self.images.len());
        for image in &self.images {
            let (name, id) = (&image.name, image.camera_id);
            let camera = by_id.get(&id).ok_or_else(|| {
                let reason = format!("{name} refers to camera {id}, which is not there");
                IoError::input(folder, reason)
            })?;
            let intrinsics = camera
                .intrinsics()
                .map_err(|reason| IoError::input(folder, reason))?;
            cameras.push(CameraEntry::posed(
                name.clone(),
                intrinsics,
                image.cam_from_world,
            ));
        }
        cameras.sort_by(|a, b| a.image.cmp(&b.image));
        Ok(CameraFile {
            unit: Unit::Arbitrary,
            cameras,
            ..CameraFile::default()
        })
    }

    /// The model of cameras without points. Cameras with equal intrinsics are one, those without
    /// a pose are left out; numbers count from one, as COLMAP's do.
    pub fn from_cameras(cameras: &CameraFile) -> Self {
        let mut model = Self::default();
        let mut known = DistinctCameras::default();
        for (entry, cam_from_world) in cameras.posed() {
            let camera = known.place(&entry.intrinsics);
            model.images.push(ColmapImage {
                id: model.images.len() as u32 + 1,
                cam_from_world,
                camera_id: camera as u32 + 1,
                name: entry.name().to_owned(),
                points2d: Vec::new(),
            });
        }
        model.cameras = (1..)
            .zip(&known.list)
            .map(|(id, camera)| ColmapCamera::from_intrinsics(id, camera))
            .collect();
        model
    }

    /// The model of posed views with their sparse points.
    pub fn from_posed_views(views: &PosedViews) -> Self {
        let mut model = Self::from_cameras(&CameraFile::from_posed_views(views));
        let [x, y, z] = views.offset;
        for (i, point) in views.points.iter().enumerate() {
            let id = i as u64 + 1;
            let mut track = Vec::with_capacity(point.track.len());
            for element in &point.track {
                if let Some(image) = model.images.get_mut(element.view.0) {
                    track.push((image.id, image.points2d.len() as u32));
                    let pixel = element.pixel.map(|coordinate| coordinate + HALF_PIXEL);
                    image.points2d.push((pixel, Some(id)));
                }
            }
            model.points.push(ColmapPoint {
                id,
                position: (Point3::from(point.position) + Vector3::new(x, y, z)).into(),
                color: point.color,
                error_px: point.error_px,
                track,
            });
        }
        model
    }
}
