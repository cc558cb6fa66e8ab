//! TUM trajectories: `pose.txt` with lines `id tx ty tz qx qy qz qw`, world from camera, and one
//! K for all in `intrinsics.txt` beside it (3 x 3, first pixel's centre at 0).
//!
//! `id` is a number or a time; the image is the one in the folder, or in `photos`, `images`, `rgb`
//! or `color` beside it, whose name ends in it (`color000012.png` for `012`).

use super::photos::{Photos, folder_of, size_of};
use super::undistorted::refuse_distortion;
use crate::cameras::{CameraEntry, CameraFile, intrinsics_of, matrix_of, stem};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::photo::{file_name, is_photo_name};
use crate::words::{lines, next_line, spaced};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rilievo_scene::{Intrinsics, RigidTransform};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

fn intrinsics_path(path: &Path) -> PathBuf {
    path.with_file_name("intrinsics.txt")
}

/// The photos of folders, by name.
struct Listed {
    /// In alphabetical order, each with its file's name.
    photos: Vec<(PathBuf, String)>,
    /// Places by name, with and without ending.
    places: HashMap<String, usize>,
}

impl Listed {
    fn new(folders: &[PathBuf]) -> Self {
        let mut photos: Vec<(PathBuf, String)> = folders
            .iter()
            .filter_map(|name| std::fs::read_dir(name).ok())
            .flat_map(|entries| entries.filter_map(|entry| Some(entry.ok()?.path())))
            .filter(|path| is_photo_name(path))
            .map(|path| (path.clone(), file_name(&path)))
            .collect();
        photos.sort();
        let mut places = HashMap::new();
        for (place, (_, name)) in photos.iter().enumerate() {
            for known in [name, stem(name)] {
                places.entry(known.to_owned()).or_insert(place);
            }
        }
        Self { photos, places }
    }

    /// The photo whose name is an id, or ends in it.
    fn find(&self, id: &str) -> Option<&(PathBuf, String)> {
        let named = self.places.get(id).and_then(|&at| self.photos.get(at));
        named.or_else(|| {
            let mut photos = self.photos.iter();
            photos.find(|(_, name)| stem(name).ends_with(id))
        })
    }
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let k_path = intrinsics_path(path);
    let k_text = read_regular_text(&k_path)?;
    let mut k_lines = lines(&k_path, &k_text, false);
    let mut row = || next_line(&mut k_lines, &k_path)?.numbers::<3>("an entry of K");
    let k = [row()?, row()?, [0.0, 0.0, 1.0]];
    let k = Matrix3::from_row_slice(k.as_flattened());
    let inside = ["photos", "images", "rgb", "color", ""];
    let photos = Photos::new(photos, folder_of(path), &inside);
    let listed = Listed::new(photos.folders());
    let mut file = CameraFile::default();
    let text = read_regular_text(path)?;
    for mut line in lines(path, &text, false) {
        let id = line.word("the id")?;
        let translation = Vector3::from(line.numbers::<3>("the position")?);
        let [x, y, z, w] = line.numbers("the quaternion")?;
        let quaternion = Quaternion::new(w, x, y, z);
        if !(0.5..=2.0).contains(&quaternion.norm()) {
            return Err(line.refuse(format!("the quaternion {x} {y} {z} {w} is no rotation")));
        }
        let (photo, name) = listed
            .find(id)
            .ok_or_else(|| photos.missing(path, &format!("a photo whose name ends in {id}")))?;
        let intrinsics = intrinsics_of(&k, size_of(photo)?)
            .map_err(|reason| IoError::input(&k_path, format!("K {reason}")))?;
        let world_from_cam = RigidTransform {
            rotation: UnitQuaternion::from_quaternion(quaternion),
            translation,
        };
        let pose = world_from_cam.inverse();
        file.cameras
            .push(CameraEntry::posed(name.clone(), intrinsics, pose));
    }
    Ok(file)
}

pub(super) fn files(path: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let mut text = String::from("# image tx ty tz qx qy qz qw (world from camera)\n");
    let mut shared: Option<Intrinsics> = None;
    for (entry, pose) in cameras.posed() {
        refuse_distortion(path, entry, "TUM's format")?;
        if shared.get_or_insert(entry.intrinsics) != &entry.intrinsics {
            return Err(
                IoError::input(path, "TUM's format has one camera for all photos")
                    .with_hint("choose another format"),
            );
        }
        let name = entry.name();
        Names::Word.check(path, "TUM's format", name)?;
        let world = pose.inverse();
        // A quaternion's coordinates are i, j, k and w, in this order.
        let numbers = world.translation.iter().chain(&world.rotation.coords);
        text += &format!("{name} {}\n", spaced(numbers));
    }
    let mut files = vec![OutputFile::new(path, text)];
    if let Some(camera) = shared {
        let rows = matrix_of(&camera);
        let rows = rows.row_iter().map(|row| spaced(row.iter()) + "\n");
        let text: String = rows.collect();
        files.push(OutputFile::new(intrinsics_path(path), text));
    }
    Ok(files)
}
