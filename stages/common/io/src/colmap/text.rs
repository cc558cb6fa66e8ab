//! The text files.

use super::model::{CameraModel, ColmapCamera, ColmapImage, ColmapModel, ColmapPoint};
use crate::error::IoError;
use crate::files::{OutputFile, read_regular_text};
use crate::names::Names;
use crate::words::{Line, lines, spaced};
use nalgebra::{Quaternion, UnitQuaternion};
use rilievo_scene::{PosedViews, RigidTransform};
use std::fmt::Write as _;
use std::path::Path;

/// Writes `cameras.txt`, `images.txt` and `points3D.txt` into an existing folder.
///
/// # Errors
/// As [`text_files`]; and when a file cannot be written.
pub fn write_colmap_text(folder: &Path, views: &PosedViews) -> Result<(), IoError> {
    text_files(folder, &ColmapModel::from_posed_views(views))?
        .iter()
        .try_for_each(OutputFile::write)
}

/// `cameras.txt`, `images.txt` and `points3D.txt` of a model, to be written.
///
/// # Errors
/// When an image's name cannot stand in a line.
pub fn text_files(folder: &Path, model: &ColmapModel) -> Result<Vec<OutputFile>, IoError> {
    let mut files = Vec::with_capacity(3);
    let mut save = |name: &str, text: String| files.push(OutputFile::new(folder.join(name), text));
    let images_path = folder.join("images.txt");
    // Writing into a String cannot fail, hence the ignored results below.
    let mut text = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for camera in &model.cameras {
        let (id, model) = (camera.id, camera.model.name);
        let (width, height) = (camera.width, camera.height);
        let params = spaced(&camera.params);
        let _ = writeln!(text, "{id} {model} {width} {height} {params}");
    }
    save("cameras.txt", text);

    let mut text = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
         # POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for image in &model.images {
        Names::Line.check(&images_path, "COLMAP's text", &image.name)?;
        let q = image.cam_from_world.rotation.quaternion();
        let t = &image.cam_from_world.translation;
        let (id, camera_id, name) = (image.id, image.camera_id, &image.name);
        let pose = spaced(&[q.w, q.i, q.j, q.k, t.x, t.y, t.z]);
        let _ = writeln!(text, "{id} {pose} {camera_id} {name}");
        for (i, ([x, y], point)) in image.points2d.iter().enumerate() {
            let gap = if i == 0 { "" } else { " " };
            let _ = match point {
                Some(id) => write!(text, "{gap}{x} {y} {id}"),
                None => write!(text, "{gap}{x} {y} -1"),
            };
        }
        text.push('\n');
    }
    save("images.txt", text);

    let mut text =
        String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    for point in &model.points {
        let ([x, y, z], [r, g, b]) = (point.position, point.color);
        let _ = write!(
            text,
            "{} {x} {y} {z} {r} {g} {b} {}",
            point.id, point.error_px
        );
        for (image, index) in &point.track {
            let _ = write!(text, " {image} {index}");
        }
        text.push('\n');
    }
    save("points3D.txt", text);
    Ok(files)
}

/// Reads the three files; `points3D.txt` may be missing.
pub(super) fn read(folder: &Path) -> Result<ColmapModel, IoError> {
    let mut model = ColmapModel::default();

    let path = folder.join("cameras.txt");
    for mut line in lines(&path, &read_regular_text(&path)?, false) {
        let id = line.parse("CAMERA_ID")?;
        let name = line.word("MODEL")?;
        let camera_model = CameraModel::from_name(name).map_err(|reason| line.refuse(reason))?;
        let (width, height) = (line.parse("WIDTH")?, line.parse("HEIGHT")?);
        let mut params = Vec::new();
        while !line.is_done() {
            params.push(line.number("a parameter")?);
        }
        let camera = ColmapCamera {
            id,
            model: camera_model,
            width,
            height,
            params,
        };
        camera.intrinsics().map_err(|reason| line.refuse(reason))?;
        model.cameras.push(camera);
    }

    let path = folder.join("images.txt");
    let text = read_regular_text(&path)?;
    let mut image_lines = lines(&path, &text, true);
    while let Some(mut line) = image_lines.next() {
        // The second line of an image may be empty; a first line never is.
        if line.is_done() {
            continue;
        }
        let mut image = read_image(&mut line)?;
        if let Some(mut line) = image_lines.next() {
            while !line.is_done() {
                let pixel = line.numbers("X, Y")?;
                let point: i64 = line.parse("POINT3D_ID")?;
                image.points2d.push((pixel, u64::try_from(point).ok()));
            }
        }
        model.images.push(image);
    }

    let path = folder.join("points3D.txt");
    if path.is_file() {
        for mut line in lines(&path, &read_regular_text(&path)?, false) {
            let mut point = ColmapPoint {
                id: line.parse("POINT3D_ID")?,
                position: line.numbers("X, Y, Z")?,
                color: [line.parse("R")?, line.parse("G")?, line.parse("B")?],
                error_px: line.number("ERROR")?,
                track: Vec::new(),
            };
            while !line.is_done() {
                let element = (line.parse("IMAGE_ID")?, line.parse("POINT2D_IDX")?);
                point.track.push(element);
            }
            model.points.push(point);
        }
    }
    Ok(model)
}

fn read_image(line: &mut Line<'_>) -> Result<ColmapImage, IoError> {
    let id = line.parse("IMAGE_ID")?;
    let q = line.numbers("QW, QX, QY, QZ")?;
    let translation = line.numbers("TX, TY, TZ")?;
    let camera_id = line.parse("CAMERA_ID")?;
    let name = line.rest.trim().to_owned();
    if name.is_empty() {
        return Err(line.refuse("NAME is missing"));
    }
    Ok(ColmapImage {
        id,
        cam_from_world: pose(q, translation).map_err(|reason| line.refuse(reason))?,
        camera_id,
        name,
        points2d: Vec::new(),
    })
}

/// The pose of a quaternion `w x y z` and a translation.
pub(super) fn pose(q: [f64; 4], translation: [f64; 3]) -> Result<RigidTransform, String> {
    let quaternion = Quaternion::new(q[0], q[1], q[2], q[3]);
    let norm = quaternion.norm();
    if !(0.5..=2.0).contains(&norm) {
        return Err(format!(
            "the pose {q:?}, {translation:?} is no rigid motion"
        ));
    }
    // A quaternion that is a unit one already is kept to the bit.
    let rotation = if (norm - 1.0).abs() < 1e-15 {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::from_quaternion(quaternion)
    };
    Ok(RigidTransform {
        rotation,
        translation: translation.into(),
    })
}
