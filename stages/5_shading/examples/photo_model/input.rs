//! A folder with photos, masks, true cameras and true depth.

use nalgebra::{Matrix3, Point3, Rotation3};
use rilievo_scene::{
    DepthMap, FocalSource, InMemoryPixels, Intrinsics, LinearImage, LocatedSphere, MarkedSphere,
    NormalMap, Photo, PhotoIdx, PhotoSet, PosedView, PosedViews, RigidTransform, SparsePoint,
};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What the stage is given, and what it should find.
pub struct Input {
    pub photos: PhotoSet,
    pub posed: PosedViews,
    /// Depth, and normals where the reference has its own.
    pub truth: Vec<(DepthMap, Option<NormalMap>)>,
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

fn linear(path: &Path) -> Result<LinearImage, Box<dyn Error>> {
    let image = image::open(path)?;
    let sixteen = matches!(
        image.color(),
        image::ColorType::Rgb16 | image::ColorType::L16
    );
    let rgb = image.to_rgb16();
    let data = rgb
        .as_raw()
        .iter()
        .map(|&v| {
            let v = f32::from(v) / 65535.0;
            if sixteen {
                v
            } else {
                rilievo_scene::srgb::decode(f64::from(v)) as f32
            }
        })
        .collect();
    Ok(LinearImage {
        width: rgb.width() as usize,
        height: rgb.height() as usize,
        channels: 3,
        data,
    })
}

fn find_file(folder: &Path, stem: &str) -> Option<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .ok()?
        .flatten()
        .map(|e| e.path())
        .collect();
    files.sort();
    files
        .into_iter()
        .find(|p| p.file_stem().is_some_and(|s| s == stem))
}

pub fn load(folder: &Path, photo_folder: &str, names: &[String]) -> Result<Input, Box<dyn Error>> {
    let cameras: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("truth/cameras.json"))?)?;
    let mut input = Input {
        photos: PhotoSet::default(),
        posed: PosedViews::default(),
        truth: Vec::new(),
    };
    for camera in cameras["cameras"].as_array().into_iter().flatten() {
        let file_name = camera["image"].as_str().unwrap_or_default().to_owned();
        let name = file_name
            .rsplit_once('.')
            .map_or(file_name.as_str(), |p| p.0)
            .to_owned();
        if !names.is_empty() && !names.contains(&name) {
            continue;
        }
        let path = find_file(&folder.join(photo_folder), &name)
            .ok_or_else(|| format!("no photo {name}"))?;
        let image = linear(&path)?;
        let mask = rilievo_io::read_mask(
            &find_file(&folder.join("masks"), &name).ok_or_else(|| format!("no mask {name}"))?,
        )?;
        let k = numbers(&camera["K"]);
        let mut intrinsics = Intrinsics::pinhole(image.width, image.height, k[0], k[2], k[5]);
        intrinsics.fy = k[4];
        let rotation = Matrix3::from_row_slice(&numbers(&camera["world_from_camera_rotation"]));
        let center = numbers(&camera["camera_center"]);
        let index = PhotoIdx(input.photos.photos.len());
        input.photos.photos.push(Photo {
            file_name: file_name.clone(),
            name: name.clone(),
            pixels: Arc::new(InMemoryPixels(Arc::new(image))),
            intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: 1,
            mask: Some(Arc::new(mask)),
            clip_level: 0.98,
            given_cam_from_world: None,
        });
        input.posed.views.push(PosedView {
            photo: index,
            name: name.clone(),
            file_name,
            intrinsics,
            cam_from_world: RigidTransform::from_world_pose(
                Rotation3::from_matrix_unchecked(rotation),
                Point3::new(center[0], center[1], center[2]),
            ),
        });
        let truth = folder.join("truth");
        input.truth.push((
            rilievo_io::read_depth(&truth.join(format!("{name}_depth.exr")))?,
            rilievo_io::read_normal(&truth.join(format!("{name}_normal.exr"))).ok(),
        ));
    }
    if let Some(radius) = cameras["sphere"]["radius"].as_f64() {
        let c = numbers(&cameras["sphere"]["center"]);
        input.posed.spheres.push(LocatedSphere {
            name: MarkedSphere::ONLY.to_owned(),
            center_in_world: [c[0], c[1], c[2]],
            radius,
            center_sigma: [0.0; 3],
            seen_in: (0..input.photos.photos.len())
                .map(|i| (PhotoIdx(i), 0.5))
                .collect(),
        });
        // The mat under the object, as sparse points of a pose run would show it.
        for i in 0..400 {
            let (a, b) = ((i % 20) as f64 / 19.0 - 0.5, (i / 20) as f64 / 19.0 - 0.5);
            input.posed.points.push(SparsePoint {
                position: [a, 0.0, b],
                color: [128; 3],
                error_px: 0.3,
                track: Vec::new(),
            });
        }
    }
    Ok(input)
}
