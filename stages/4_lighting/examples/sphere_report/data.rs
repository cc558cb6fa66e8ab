//! Reads a photo set with truth: `photos` or `linear`, `masks`, `sphere_masks`, `truth`.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, FocalSource, InMemoryPixels, Intrinsics, Lighting,
    LinearImage, Mask, NormalMap, Photo, PhotoIdx, PhotoSet, PosedView, PosedViews, Raster,
    RigidTransform, ShadedView, ShadedViews, SphereCalibration, SphereMark, ViewIdx,
};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A photo set with its truth.
pub struct Set {
    folder: PathBuf,
    /// The photos.
    pub photos: PhotoSet,
    /// True poses.
    pub posed: PosedViews,
    /// True centre of the sphere.
    pub center: [f64; 3],
    /// Its radius.
    pub radius: f64,
    /// Marks, from the sphere masks.
    pub marks: Vec<(PhotoIdx, SphereMark)>,
    /// Calibration photos.
    pub calibration: Vec<SphereCalibration>,
    gains: Vec<f64>,
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .map(|a| a.iter().filter_map(Value::as_f64).collect())
        .unwrap_or_default()
}

fn linear_of(path: &Path, is_linear: bool) -> Result<LinearImage> {
    let image = image::open(path)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let data = if is_linear {
        image
            .to_rgb16()
            .into_raw()
            .into_iter()
            .map(|v| f32::from(v) / 65535.0)
            .collect()
    } else {
        let decode = |v: u8| {
            let v = f32::from(v) / 255.0;
            rilievo_scene::srgb::decode(f64::from(v)) as f32
        };
        image.to_rgb8().into_raw().into_iter().map(decode).collect()
    };
    Ok(LinearImage {
        width,
        height,
        channels: 3,
        data,
    })
}

/// Writes a linear image as sRGB.
pub fn write_png(image: &LinearImage, folder: &str, name: &str) -> Result<()> {
    let encode = |v: &f32| (v.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
    let bytes: Vec<u8> = image.data.iter().map(encode).collect();
    let picture =
        image::RgbImage::from_raw(image.width as u32, image.height as u32, bytes).ok_or("size")?;
    picture.save(Path::new(folder).join(format!("{name}.png")))?;
    Ok(())
}

fn mask_of(path: &Path) -> Result<Mask> {
    let image = image::open(path)?.to_luma8();
    Ok(Raster {
        width: image.width() as usize,
        height: image.height() as usize,
        data: image.into_raw().into_iter().map(|v| v > 127).collect(),
    })
}

impl Set {
    /// Loads it.
    pub fn load(folder: &Path, linear: bool) -> Result<Self> {
        let truth: Value =
            serde_json::from_reader(std::fs::File::open(folder.join("truth/cameras.json"))?)?;
        let sphere = &truth["sphere"];
        let center = numbers(&sphere["center"]);
        let mut set = Self {
            folder: folder.to_owned(),
            photos: PhotoSet::default(),
            posed: PosedViews::default(),
            center: [
                center.first().copied().unwrap_or(f64::NAN),
                center.get(1).copied().unwrap_or(f64::NAN),
                center.get(2).copied().unwrap_or(f64::NAN),
            ],
            radius: sphere["radius"].as_f64().unwrap_or(0.04),
            marks: Vec::new(),
            calibration: Vec::new(),
            gains: numbers(&truth["exposure_gains"]),
        };
        for (idx, camera) in truth["cameras"]
            .as_array()
            .ok_or("cameras")?
            .iter()
            .enumerate()
        {
            let file_name = camera["image"].as_str().ok_or("image")?.to_owned();
            let name = file_name.split('.').next().unwrap_or_default().to_owned();
            let path = if linear {
                folder.join(format!("linear/{name}.png"))
            } else {
                folder.join("photos").join(&file_name)
            };
            let image = Arc::new(linear_of(&path, linear)?);
            let k: Vec<Vec<f64>> = camera["K"]
                .as_array()
                .ok_or("K")?
                .iter()
                .map(numbers)
                .collect();
            let r: Vec<f64> = camera["world_from_camera_rotation"]
                .as_array()
                .ok_or("rotation")?
                .iter()
                .flat_map(numbers)
                .collect();
            let c = numbers(&camera["camera_center"]);
            let intrinsics = Intrinsics {
                fx: k[0][0],
                fy: k[1][1],
                ..Intrinsics::pinhole(image.width, image.height, 1.0, k[0][2], k[1][2])
            };
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&r));
            set.posed.views.push(PosedView {
                photo: PhotoIdx(idx),
                name: name.clone(),
                file_name: file_name.clone(),
                intrinsics,
                cam_from_world: RigidTransform::from_world_pose(
                    rotation,
                    Point3::new(c[0], c[1], c[2]),
                ),
            });
            let mask = mask_of(&folder.join(format!("masks/{name}.png"))).ok();
            if let Ok(mask) = mask_of(&folder.join(format!("sphere_masks/{name}.png"))) {
                set.marks.push((PhotoIdx(idx), SphereMark::Mask(mask)));
            }
            set.photos.photos.push(Photo {
                file_name,
                name,
                pixels: Arc::new(InMemoryPixels(image)),
                intrinsics,
                focal_source: FocalSource::CameraFile,
                camera_group: 0,
                orientation: 1,
                mask: mask.map(Arc::new),
                clip_level: 1.0,
                given_cam_from_world: None,
            });
        }
        let about = folder.join("calibration/CAL_0001.json");
        if let Ok(file) = std::fs::File::open(about) {
            let about: Value = serde_json::from_reader(file)?;
            let camera = about["same_camera_as"].as_str().ok_or("same_camera_as")?;
            let ending = if linear { "png" } else { "jpg" };
            let path = folder.join(format!("calibration/CAL_0001.{ending}"));
            set.calibration.push(SphereCalibration {
                image: linear_of(&path, linear)?,
                name: format!("CAL_0001.{ending}"),
                same_camera_as: set.photos.find(camera).ok_or("camera")?,
                radius: about["sphere"]["radius"].as_f64().unwrap_or(0.09),
                mark: None,
            });
        }
        Ok(set)
    }

    /// Intersection over union of the sphere's pixels with `sphere_masks`.
    pub fn overlap(
        &self,
        photo: PhotoIdx,
        sphere: &SphereInCamera,
        intrinsics: &Intrinsics,
    ) -> f64 {
        let Some((_, SphereMark::Mask(mask))) = self.marks.iter().find(|(p, _)| *p == photo) else {
            return f64::NAN;
        };
        let pixels = sphere.pixels(intrinsics, 0.0);
        let object = self.photos.photos[photo.0].mask.as_ref();
        let in_front: Vec<_> = pixels
            .iter()
            .filter(|p| !object.is_some_and(|m| *m.at(p.x, p.y)))
            .collect();
        let both = in_front.iter().filter(|p| *mask.at(p.x, p.y)).count();
        both as f64 / (in_front.len() + mask.count() - both) as f64
    }

    /// True exposure gain relative to the mean of all photos.
    pub fn true_gain(&self, view: usize) -> Option<f64> {
        let mean = self.gains.iter().map(|g| g.ln()).sum::<f64>() / self.gains.len() as f64;
        self.gains.get(view).map(|g| (g.ln() - mean).exp())
    }

    fn channel(&self, name: &str, channel: &str) -> Result<Raster<f32>> {
        let path = self.folder.join("truth").join(name);
        let image = exr::prelude::read_all_flat_layers_from_file(path)?;
        for layer in image.layer_data {
            let size = layer.size;
            for found in layer.channel_data.list {
                if found.name.to_string() == channel {
                    let data = found.sample_data.values_as_f32().collect();
                    return Ok(Raster {
                        width: size.0,
                        height: size.1,
                        data,
                    });
                }
            }
        }
        Err(format!("{name} has no channel {channel}").into())
    }

    /// True normals of a view.
    pub fn true_normals(&self, view: usize) -> Result<NormalMap> {
        let name = format!("{}_normal.exr", self.posed.views[view].name);
        let x = self.channel(&name, "N.X")?;
        let y = self.channel(&name, "N.Y")?;
        let z = self.channel(&name, "N.Z")?;
        Ok(Raster::from_fn(x.width, x.height, |u, v| {
            [*x.at(u, v), *y.at(u, v), *z.at(u, v)]
        }))
    }

    /// Anchors on a grid of pixels, seen by every view that they are visible in, at the true depth
    /// times `1 + noise` (relative standard deviation).
    pub fn true_anchors(&self, step: usize, noise: f64) -> Result<Vec<Anchor>> {
        let mut depths = Vec::new();
        for view in &self.posed.views {
            depths.push(self.channel(&format!("{}_depth.exr", view.name), "Z")?);
        }
        let mut anchors = Vec::new();
        let mut state = 17_u64;
        for (first, view) in self.posed.views.iter().enumerate() {
            for y in (0..depths[first].height).step_by(step) {
                for x in (0..depths[first].width).step_by(step) {
                    let z = f64::from(*depths[first].at(x, y));
                    if z <= 0.0 {
                        continue;
                    }
                    let pixel = nalgebra::Point2::new(x as f64, y as f64);
                    // Twelve uniform deviates make a normal one.
                    let mut deviate = -6.0;
                    for _ in 0..12 {
                        state = state
                            .wrapping_mul(6_364_136_223_846_793_005)
                            .wrapping_add(1_442_695_040_888_963_407);
                        deviate += (state >> 11) as f64 / (1_u64 << 53) as f64;
                    }
                    let z = z * (1.0 + noise * deviate);
                    let in_camera = view.intrinsics.unproject(&pixel, z);
                    let point = view.cam_from_world.inverse().apply(&in_camera);
                    let observations: Vec<AnchorObservation> = (0..depths.len())
                        .filter_map(|other| {
                            let seen_by = &self.posed.views[other];
                            let p = seen_by.cam_from_world.apply(&point);
                            let at = seen_by.intrinsics.project(&p)?;
                            let (u, v) = (at.x.round() as isize, at.y.round() as isize);
                            let depth = f64::from(*depths[other].get(u, v)?);
                            ((depth / p.z).ln().abs() < 0.003 + 3.0 * noise).then_some(
                                AnchorObservation {
                                    view: ViewIdx(other),
                                    pixel: [at.x, at.y],
                                    depth: p.z,
                                    sigma_ln_depth: 1e-3,
                                },
                            )
                        })
                        .collect();
                    if observations.len() >= 2 {
                        anchors.push(Anchor {
                            position: point.coords.into(),
                            covariance: [1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8],
                            origin: AnchorOrigin::Grown,
                            observations,
                        });
                    }
                }
            }
        }
        Ok(anchors)
    }

    /// The true shape, as if stage 5 had found it.
    pub fn true_shape(&self) -> Result<ShadedViews> {
        let mut shaded = ShadedViews::default();
        for (idx, view) in self.posed.views.iter().enumerate() {
            shaded.views.push(ShadedView {
                view: ViewIdx(idx),
                name: view.name.clone(),
                depth: self.channel(&format!("{}_depth.exr", view.name), "Z")?,
                normal: self.true_normals(idx)?,
                confidence: None,
                rendered: None,
                albedo: None,
            });
        }
        Ok(shaded)
    }

    /// Relative RMS of a lighting applied to the true normals over the object's mask.
    pub fn residual_on_truth(&self, view: usize, lighting: &Lighting) -> Result<f64> {
        let normals = self.true_normals(view)?;
        let photo = &self.photos.photos[self.posed.views[view].photo.0];
        let image = photo.linear()?;
        let (mut error, mut size) = (0.0, 0.0);
        for y in 0..image.height {
            for x in 0..image.width {
                let masked = photo.mask.as_ref().is_some_and(|m| !*m.at(x, y));
                let [a, b, c] = *normals.at(x, y);
                if masked || (a == 0.0 && b == 0.0 && c == 0.0) {
                    continue;
                }
                let n = Vector3::new(f64::from(a), f64::from(b), f64::from(c));
                for (light, value) in lighting.channels.iter().zip(image.pixel(x, y)) {
                    if *value < 0.98 {
                        error += (light.evaluate(&n) - f64::from(*value)).powi(2);
                        size += f64::from(*value).powi(2);
                    }
                }
            }
        }
        Ok((error / size).sqrt())
    }
}
