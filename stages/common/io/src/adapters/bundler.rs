//! Bundler's `bundle.out` (version 0.3), with the images' names in `list.txt` beside it.
//!
//! Per camera `f k1 k2`, a rotation `R` (three rows) and a translation `t`. With `P = R X + t` and
//! `p = −P / P_z`, the pixel is `f (1 + k1 |p|² + k2 |p|⁴) p`, from the middle of the image, x right
//! and y up. A focal length of zero means: no pose. Source: Bundler v0.4 user's manual, section
//! "Output format and scene representation".

use super::axes::flip;
use super::photos::{Photos, folder_of, size_of};
use crate::cameras::{CameraEntry, CameraFile, last_part, rigid_from_camera_pose};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::{Line, lines};
use nalgebra::{Matrix3, Vector3};
use rilievo_scene::{Distortion, Intrinsics, Unit};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// How far fx may be from fy, or the principal point from the middle, to count as the same:
/// what Bundler cannot hold, it must not lose silently.
const SAME_PX: f64 = 1e-6;

fn list_of(path: &Path) -> PathBuf {
    path.with_file_name("list.txt")
}

pub(super) fn read(path: &Path, photos: Option<&Path>) -> Result<CameraFile, IoError> {
    let list = list_of(path);
    let names_text = read_regular_text(&list)?;
    let names: Vec<&str> = lines(&list, &names_text, false)
        .filter_map(|line| line.rest.split_whitespace().next())
        .collect();
    let photos = Photos::new(photos, folder_of(path), &["", "images", "visualize"]);

    let text = read_regular_text(path)?;
    let mut rest = lines(path, &text, false);
    let mut next = || {
        rest.next()
            .ok_or_else(|| IoError::input(path, "ends before its last camera"))
    };
    let num_cameras: usize = next()?.parse("the number of cameras")?;
    if num_cameras != names.len() {
        return Err(IoError::input(
            path,
            format!("has {num_cameras} cameras, list.txt {} names", names.len()),
        ));
    }
    let mut file = CameraFile::default();
    for name in names {
        let mut first = next()?;
        let [f, k1, k2]: [f64; 3] = first.numbers("f k1 k2")?;
        let mut rotation = Matrix3::zeros();
        for i in 0..3 {
            let row: [f64; 3] = next()?.numbers("a row of R")?;
            rotation.set_row(i, &nalgebra::RowVector3::from(row));
        }
        let mut last = next()?;
        let translation = Vector3::from(last.numbers::<3>("t")?);
        let image = last_part(name).to_owned();
        if f == 0.0 {
            file.unregistered
                .push((image, "no pose in Bundler".to_owned()));
            continue;
        }
        let entry = camera(&first, f, [k1, k2], &rotation, &translation, || {
            let found = photos
                .find(name)
                .or_else(|| photos.find(&image))
                .map_or_else(|| photos.named(&list, name), Ok)?;
            size_of(&found)
        })?;
        file.cameras.push(CameraEntry {
            image: Some(image),
            ..entry
        });
    }
    Ok(file)
}

fn camera(
    line: &Line<'_>,
    f: f64,
    [k1, k2]: [f64; 2],
    rotation: &Matrix3<f64>,
    translation: &Vector3<f64>,
    size: impl FnOnce() -> Result<(usize, usize), IoError>,
) -> Result<CameraEntry, IoError> {
    if f < 0.0 {
        return Err(line.refuse(format!("the focal length is {f}")));
    }
    let (width, height) = size()?;
    let pose = rigid_from_camera_pose(&(flip() * rotation), &(flip() * translation))
        .map_err(|reason| line.refuse(format!("the rotation {reason}")))?;
    Ok(CameraEntry {
        image: None,
        intrinsics: Intrinsics {
            distortion: Distortion {
                k1,
                k2,
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(
                width,
                height,
                f,
                0.5 * (width as f64 - 1.0),
                0.5 * (height as f64 - 1.0),
            )
        },
        cam_from_world: Some(pose),
    })
}

pub(super) fn files(path: &Path, cameras: &CameraFile) -> Result<Vec<OutputFile>, IoError> {
    let list_path = list_of(path);
    let mut text = String::from("# Bundle file v0.3\n");
    let mut list = String::new();
    // Writing into a String cannot fail, hence the ignored results.
    let _ = writeln!(text, "{} 0", cameras.cameras.len());
    for entry in &cameras.cameras {
        let image = entry.name();
        Names::Word.check(&list_path, "Bundler's list", image)?;
        Names::Path.check(&list_path, "Bundler's list", image)?;
        let _ = writeln!(list, "{image}");
        let Some(pose) = entry.cam_from_world else {
            text.push_str("0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n");
            continue;
        };
        let (i, d) = (&entry.intrinsics, &entry.intrinsics.distortion);
        let off_center = (i.cx - 0.5 * (i.width as f64 - 1.0))
            .abs()
            .max((i.cy - 0.5 * (i.height as f64 - 1.0)).abs());
        let reason = if (i.fx - i.fy).abs() > SAME_PX {
            Some("two focal lengths")
        } else if off_center > SAME_PX {
            Some("a principal point off the middle")
        } else if d.p1 != 0.0 || d.p2 != 0.0 || d.k3 != 0.0 {
            Some("lens coefficients beyond k1 and k2")
        } else {
            None
        };
        if let Some(reason) = reason {
            let reason = format!("Bundler has no place for {reason}, which {image} has");
            return Err(IoError::input(path, reason).with_hint("choose another format"));
        }
        let rotation = flip() * pose.rotation_matrix();
        let translation = flip() * pose.translation;
        let _ = writeln!(text, "{} {} {}", i.fx, d.k1, d.k2);
        for row in rotation.row_iter() {
            let _ = writeln!(text, "{} {} {}", row[0], row[1], row[2]);
        }
        let _ = writeln!(
            text,
            "{} {} {}",
            translation.x, translation.y, translation.z
        );
    }
    if cameras.unit == Unit::Metre {
        text.push_str("# unit metre\n");
    }
    Ok(vec![
        OutputFile::new(list_path, list),
        OutputFile::new(path, text),
    ])
}
