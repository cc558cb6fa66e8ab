//! TUM trajectories: `pose.txt` with lines `id tx ty tz qx qy qz qw`, world from camera, and one
//! K for all in `intrinsics.txt` beside it (3 x 3, first pixel's centre at 0).
//!
//! `id` is a number or a time; the image is the one in the folder, or in `photos`, `images`, `rgb`
//! or `color` beside it, whose name ends in it (`color000012.png` for `012`).

use super::{image_size, refuse_distortion};
use crate::cameras::{CameraEntry, CameraFile, last_part, stem};
use crate::error::IoError;
use crate::files::read_regular_text;
use crate::photo::is_photo_name;
use crate::words::lines;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn intrinsics_of(path: &Path) -> PathBuf {
    path.with_file_name("intrinsics.txt")
}

/// Photos beside the trajectory, in order.
fn photos(folder: &Path) -> Vec<PathBuf> {
    let mut photos: Vec<PathBuf> = ["photos", "images", "rgb", "color", ""]
        .iter()
        .filter_map(|name| std::fs::read_dir(folder.join(name)).ok())
        .flat_map(|entries| entries.filter_map(|entry| Some(entry.ok()?.path())))
        .filter(|path| is_photo_name(path))
        .collect();
    photos.sort();
    photos
}

pub(super) fn read(path: &Path) -> Result<CameraFile, IoError> {
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
    let photos = photos(path.parent().unwrap_or(Path::new("")));
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
        let photo = photos
            .iter()
            .find(|photo| {
                let name = photo.to_string_lossy();
                last_part(&name) == id || stem(&name) == id
            })
            .or_else(|| {
                photos
                    .iter()
                    .find(|photo| stem(&photo.to_string_lossy()).ends_with(id))
            })
            .ok_or_else(|| line.refuse(format!("no photo's name ends in {id}")))?;
        let (width, height) = image_size(photo)?;
        let world_from_cam = RigidTransform {
            rotation: UnitQuaternion::from_quaternion(quaternion),
            translation,
        };
        file.cameras.push(CameraEntry {
            image: Some(last_part(&photo.to_string_lossy()).to_owned()),
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

pub(super) fn write(path: &Path, cameras: &CameraFile) -> Result<(), IoError> {
    let mut text = String::from("# image tx ty tz qx qy qz qw (world from camera)\n");
    let mut shared: Option<Intrinsics> = None;
    for entry in &cameras.cameras {
        let Some(pose) = entry.cam_from_world else {
            continue;
        };
        refuse_distortion(path, entry, "TUM's format")?;
        if shared.get_or_insert(entry.intrinsics) != &entry.intrinsics {
            return Err(
                IoError::write(path, "TUM's format has one camera for all photos")
                    .with_hint("choose another format"),
            );
        }
        let world = pose.inverse();
        let (t, q) = (&world.translation, world.rotation.quaternion());
        let name = entry.image.as_deref().unwrap_or("image");
        if name.contains(char::is_whitespace) {
            return Err(IoError::write(
                path,
                format!("TUM's format has no names with spaces, as \"{name}\""),
            ));
        }
        // Writing into a String cannot fail, hence the ignored result.
        let _ = writeln!(
            text,
            "{} {} {} {} {} {} {} {}",
            name, t.x, t.y, t.z, q.i, q.j, q.k, q.w
        );
    }
    std::fs::write(path, text).map_err(|error| IoError::write(path, error))?;
    if let Some(k) = shared {
        let k_path = intrinsics_of(path);
        let text = format!("{} 0 {}\n0 {} {}\n0 0 1\n", k.fx, k.cx, k.fy, k.cy);
        std::fs::write(&k_path, text).map_err(|error| IoError::write(&k_path, error))?;
    }
    Ok(())
}
