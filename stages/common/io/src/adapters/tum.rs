//! TUM trajectories: `pose.txt` with lines `id tx ty tz qx qy qz qw`, world from camera, and one
//! K for all in `intrinsics.txt` beside it (3 x 3, first pixel's centre at 0).
//!
//! `id` is a number or a time; the image is the one in the folder, or in `photos`, `images`, `rgb`
//! or `color` beside it, whose name ends in it (`color000012.png` for `012`).

use super::photos::{Photos, folder_of, size_of};
use super::undistorted::refuse_distortion;
use crate::cameras::{CameraEntry, CameraFile};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::photo::is_photo_name;
use crate::words::lines;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform};
use std::collections::HashMap;
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn intrinsics_of(path: &Path) -> PathBuf {
    path.with_file_name("intrinsics.txt")
}

/// The photos of folders, by name.
struct Listed {
    paths: Vec<PathBuf>,
    /// Places by name, with and without ending.
    places: HashMap<String, usize>,
}

impl Listed {
    fn new(folders: &[PathBuf]) -> Self {
        let mut paths: Vec<PathBuf> = folders
            .iter()
            .filter_map(|name| std::fs::read_dir(name).ok())
            .flat_map(|entries| entries.filter_map(|entry| Some(entry.ok()?.path())))
            .filter(|path| is_photo_name(path))
            .collect();
        paths.sort();
        let mut places = HashMap::new();
        for (place, path) in paths.iter().enumerate() {
            for known in [path.file_name(), path.file_stem()] {
                places.entry(text_of(known)).or_insert(place);
            }
        }
        Self { paths, places }
    }

    /// The photo whose name is an id, or ends in it.
    fn find(&self, id: &str) -> Option<&Path> {
        let ends = |path: &&PathBuf| text_of(path.file_stem()).ends_with(id);
        let named = self.places.get(id).and_then(|&place| self.paths.get(place));
        named
            .or_else(|| self.paths.iter().find(ends))
            .map(PathBuf::as_path)
    }
}

fn text_of(name: Option<&OsStr>) -> String {
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let k_path = intrinsics_of(path);
    let k_text = read_regular_text(&k_path)?;
    let mut k_lines = lines(&k_path, &k_text, false);
    let mut row = || -> Result<[f64; 3], IoError> {
        k_lines
            .next()
            .ok_or_else(|| IoError::input(&k_path, "has not three rows"))?
            .numbers("an entry of K")
    };
    let ([fx, _, cx], [_, fy, cy]) = (row()?, row()?);
    if fx <= 0.0 || fy <= 0.0 {
        return Err(IoError::input(
            &k_path,
            format!("the focal lengths are {fx}, {fy}"),
        ));
    }
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
        let photo = listed
            .find(id)
            .ok_or_else(|| photos.missing(path, &format!("a photo whose name ends in {id}")))?;
        let (width, height) = size_of(photo)?;
        let world_from_cam = RigidTransform {
            rotation: UnitQuaternion::from_quaternion(quaternion),
            translation,
        };
        file.cameras.push(CameraEntry {
            image: Some(text_of(photo.file_name())),
            intrinsics: Intrinsics {
                width,
                height,
                fx,
                fy,
                cx,
                cy,
                distortion: Distortion::default(),
            },
            cam_from_world: Some(world_from_cam.inverse()),
        });
    }
    Ok(file)
}

pub(super) fn files(path: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let mut text = String::from("# image tx ty tz qx qy qz qw (world from camera)\n");
    let mut shared: Option<Intrinsics> = None;
    for entry in &cameras.cameras {
        let Some(pose) = entry.cam_from_world else {
            continue;
        };
        refuse_distortion(path, entry, "TUM's format")?;
        if shared.get_or_insert(entry.intrinsics) != &entry.intrinsics {
            return Err(
                IoError::input(path, "TUM's format has one camera for all photos")
                    .with_hint("choose another format"),
            );
        }
        let world = pose.inverse();
        let (t, q) = (&world.translation, world.rotation.quaternion());
        let name = entry.name();
        Names::Word.check(path, "TUM's format", name)?;
        // Writing into a String cannot fail, hence the ignored result.
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {}",
            name, t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
    }
    let mut files = vec![OutputFile::new(path, text)];
    if let Some(k) = shared {
        let text = format!("{} 0 {}\n0 {} {}\n0 0 1\n", k.fx, k.cx, k.fy, k.cy);
        files.push(OutputFile::new(intrinsics_of(path), text));
    }
    Ok(files)
}
