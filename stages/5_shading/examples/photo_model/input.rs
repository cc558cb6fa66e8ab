//! A folder with photos, masks, true cameras and true depth.

use rilievo_io::{decode_photo, read_cameras, read_depth, read_mask, read_normal};
use rilievo_scene::{
    DepthMap, LocatedSphere, NormalMap, Photo, PhotoIdx, PhotoSet, PosedViews, SparsePoint,
};
use rilievo_synthetic::testing::{PosedPhotos, linear_of, photo, true_sphere};
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
    let cameras = read_cameras(&folder.join("truth/cameras.json"))?;
    let (mut taken, mut truth) = (PosedPhotos::default(), Vec::new());
    for camera in &cameras.cameras {
        let file_name = camera.image.as_deref().unwrap_or_default();
        let name = file_name.rsplit_once('.').map_or(file_name, |p| p.0);
        if !names.is_empty() && names.iter().all(|asked| asked != name) {
            continue;
        }
        let path = find_file(&folder.join(photo_folder), name)
            .ok_or_else(|| format!("no photo {name}"))?;
        let mask =
            find_file(&folder.join("masks"), name).ok_or_else(|| format!("no mask {name}"))?;
        let image = linear_of(&decode_photo(&path)?);
        let photo = Photo {
            mask: Some(Arc::new(read_mask(&mask)?.packed())),
            clip_level: 0.98,
            ..photo(file_name, image, camera.intrinsics)
        };
        taken.push(photo, camera.cam_from_world.ok_or("no pose")?);
        let of = |map: &str| folder.join(format!("truth/{name}_{map}.exr"));
        truth.push((read_depth(&of("depth"))?, read_normal(&of("normal")).ok()));
    }
    let PosedPhotos { photos, mut posed } = taken;
    if let Some(sphere) = cameras.extra.get("sphere") {
        let center = std::array::from_fn(|k| sphere["center"][k].as_f64().unwrap_or(f64::NAN));
        let radius = sphere["radius"].as_f64().ok_or("no radius")?;
        posed.spheres.push(LocatedSphere {
            seen_in: (0..photos.photos.len())
                .map(|i| (PhotoIdx(i), 0.5))
                .collect(),
            ..true_sphere(center, radius)
        });
        // The mat under the object, as sparse points of a pose run would show it.
        for i in 0..400 {
            let (a, b) = ((i % 20) as f64 / 19.0 - 0.5, (i / 20) as f64 / 19.0 - 0.5);
            posed.points.push(SparsePoint {
                position: [a, 0.0, b],
                color: [128; 3],
                error_px: 0.3,
                track: Vec::new(),
            });
        }
    }
    Ok(Input {
        photos,
        posed,
        truth,
    })
}
