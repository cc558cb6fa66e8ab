//! Photos for the colours of fused maps: decoded when they are needed, one at a time.

use crate::exit::Failure;
use crate::paths::text_of;
use rilievo_io::{decode_photo, is_photo_name};
use rilievo_photos::{Encoding, linearize};
use rilievo_scene::{
    FocalSource, LinearImage, Orientation, Photo, PhotoIdx, PhotoSet, PixelError, PixelSource,
    PosedViews,
};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A photo on the disk.
#[derive(Debug)]
struct File(PathBuf);

impl PixelSource for File {
    fn load(&self) -> Result<Arc<LinearImage>, PixelError> {
        let photo = decode_photo(&self.0).map_err(|error| PixelError {
            name: self.0.display().to_string(),
            reason: error.reason,
        })?;
        let (image, _) = linearize(&photo, Encoding::Auto);
        Ok(Arc::new(image))
    }
}

/// The photos of a folder that belong to the views, by name with or without the ending. Views
/// without one keep no photo, and fusion warns of them.
///
/// # Errors
/// When the folder cannot be read, or holds no photo of any view.
pub fn find(folder: &Path, posed: &mut PosedViews) -> Result<PhotoSet, Failure> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| Failure::input(folder, format!("cannot be read: {error} (--photos)")))?;
    let mut files: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| is_photo_name(path))
        .collect();
    files.sort();
    let mut photos = PhotoSet::default();
    for view in &mut posed.views {
        let fits = |path: &&PathBuf| {
            text_of(path.file_name()) == view.file_name || text_of(path.file_stem()) == view.name
        };
        // One of a run of subfolders is called by its path below the folder.
        let below = Some(folder.join(&view.file_name)).filter(|path| path.is_file());
        let Some(path) = below.as_ref().or_else(|| files.iter().find(fits)) else {
            view.photo = PhotoIdx(usize::MAX);
            continue;
        };
        view.photo = PhotoIdx(photos.photos.len());
        photos.photos.push(Photo {
            file_name: view.file_name.clone(),
            name: view.name.clone(),
            pixels: Arc::new(File(path.clone())),
            intrinsics: view.intrinsics,
            focal_source: FocalSource::CameraFile,
            camera_group: 0,
            orientation: Orientation::UPRIGHT,
            mask: None,
            clip_level: 1.0,
            given_cam_from_world: None,
        });
    }
    if photos.photos.is_empty() {
        return Err(Failure::input(
            folder,
            "holds no photo of any of the views (--photos)",
        ));
    }
    Ok(photos)
}
