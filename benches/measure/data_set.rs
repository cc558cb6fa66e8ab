//! A photo set with truth: `photos` or `linear`, `masks`, `sphere_masks`, `truth`.

use nalgebra::Vector3;
use rilievo_io::{decode_photo, read_cameras, read_depth, read_mask, read_normal};
use rilievo_photometry::sphere::SphereInCamera;
use rilievo_scene::{
    DepthMap, Intrinsics, Lighting, LinearImage, NormalMap, Photo, PhotoIdx, PhotoSet, PosedViews,
    ShadedView, ShadedViews, SphereCalibration, SphereMark, ViewIdx,
};
use rilievo_synthetic::testing::{PosedPhotos, linear_of, photo};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

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

/// A number of a file's own facts.
fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn linear(path: &Path) -> Result<LinearImage> {
    Ok(linear_of(&decode_photo(path)?))
}

impl Set {
    /// Loads it; of all views without `names`.
    pub fn load(folder: &Path, is_linear: bool, names: &[String]) -> Result<Self> {
        let truth = read_cameras(&folder.join("truth/cameras.json"))?;
        // Of some sets nobody knows one: its centre is then no number.
        let sphere = truth.extra.get("sphere").unwrap_or(&Value::Null);
        let gains = truth.extra.get("exposure_gains").and_then(Value::as_array);
        let (mut taken, mut marks) = (PosedPhotos::default(), Vec::new());
        for camera in &truth.cameras {
            let file_name = camera.image.as_deref().ok_or("image")?;
            let name = file_name.split('.').next().unwrap_or_default();
            if !names.is_empty() && names.iter().all(|asked| asked != name) {
                continue;
            }
            let idx = taken.photos.photos.len();
            let path = if is_linear {
                folder.join(format!("linear/{name}.png"))
            } else {
                folder.join("photos").join(file_name)
            };
            let photo = photo(file_name, linear(&path)?, camera.intrinsics);
            let mask = read_mask(&folder.join(format!("masks/{name}.png"))).ok();
            if let Ok(mask) = read_mask(&folder.join(format!("sphere_masks/{name}.png"))) {
                marks.push((PhotoIdx(idx), SphereMark::Mask(mask)));
            }
            let photo = Photo {
                mask: mask.map(|mask| Arc::new(mask.packed())),
                ..photo
            };
            taken.push(photo, camera.cam_from_world.ok_or("pose")?);
        }
        let mut set = Self {
            folder: folder.to_owned(),
            photos: taken.photos,
            posed: taken.posed,
            center: std::array::from_fn(|k| number(&sphere["center"][k])),
            radius: sphere["radius"].as_f64().unwrap_or(0.04),
            marks,
            calibration: Vec::new(),
            gains: gains.into_iter().flatten().map(number).collect(),
        };
        let about = folder.join("calibration/CAL_0001.json");
        if let Ok(file) = std::fs::File::open(about) {
            let about: Value = serde_json::from_reader(file)?;
            let camera = about["same_camera_as"].as_str().ok_or("same_camera_as")?;
            let ending = if is_linear { "png" } else { "jpg" };
            set.calibration.push(SphereCalibration {
                image: linear(&folder.join(format!("calibration/CAL_0001.{ending}")))?,
                name: format!("CAL_0001.{ending}"),
                same_camera_as: set.photos.find(camera).ok_or("camera")?,
                radius: about["sphere"]["radius"].as_f64().unwrap_or(0.09),
                mark: None,
            });
        }
        Ok(set)
    }

    /// Sets the value from which on all photos are clipped.
    pub fn clip(&mut self, level: f32) {
        let photos = self.photos.photos.iter_mut();
        photos.for_each(|photo| photo.clip_level = level);
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
            .filter(|p| !object.is_some_and(|m| m.contains(p.x as isize, p.y as isize)))
            .collect();
        let both = in_front.iter().filter(|p| *mask.at(p.x, p.y)).count();
        both as f64 / (in_front.len() + mask.count() - both) as f64
    }

    /// True exposure gain relative to the mean of all photos.
    pub fn true_gain(&self, view: usize) -> Option<f64> {
        let mean = self.gains.iter().map(|g| g.ln()).sum::<f64>() / self.gains.len() as f64;
        self.gains.get(view).map(|g| (g.ln() - mean).exp())
    }

    /// True depth of a view, by its name.
    pub fn true_depth(&self, name: &str) -> Result<DepthMap> {
        let path = self.folder.join(format!("truth/{name}_depth.exr"));
        Ok(read_depth(&path)?)
    }

    /// True normals of a view.
    pub fn true_normals(&self, view: usize) -> Result<NormalMap> {
        let name = &self.posed.views[view].name;
        let path = self.folder.join(format!("truth/{name}_normal.exr"));
        Ok(read_normal(&path)?)
    }

    /// The true shape, as if stage 5 had found it.
    pub fn true_shape(&self) -> Result<ShadedViews> {
        let mut shaded = ShadedViews::default();
        for (idx, view) in self.posed.views.iter().enumerate() {
            shaded.views.push(ShadedView {
                view: ViewIdx(idx),
                name: view.name.clone(),
                depth: self.true_depth(&view.name)?,
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
                let masked = photo
                    .mask
                    .as_ref()
                    .is_some_and(|m| !m.contains(x as isize, y as isize));
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
