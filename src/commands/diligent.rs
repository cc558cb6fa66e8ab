//! `rilievo import OBJECT --format diligent`: an object of the data sets DiLiGenT and DiLiGenT-MV.
//!
//! ```text
//! DIR/photos/view_01.exr          linear, by one lamp or the mean over all of them
//! DIR/masks/view_01.png           the object
//! DIR/lamps/view_01.lp            directions towards the lamps, with the names of the set's own photos
//! DIR/truth/cameras.json          DiLiGenT-MV: true cameras, metres
//! DIR/truth/view_01_normal.exr    true normals
//! DIR/truth/mesh.ply              DiLiGenT-MV: true surface, metres
//! ```
//!
//! Each photo is divided by its lamp's strength. Light adds, so that the mean over `n` lamps is the photo
//! under all of them at once, `L = (1/n) Σ L_i / e_i`, with `√n` times less noise.

use super::output_files;
use crate::cli::ImportArgs;
use crate::exit::Failure;
use rilievo_io::diligent::METRES_PER_MM;
use rilievo_io::{
    CameraEntry, CameraFile, DiligentObject, DiligentView, OutputFile, cameras_file, linear_file,
    lp_file, mask_file, mesh_ply_file, normal_file, read_diligent, read_diligent_photo,
    read_mesh_ply,
};
use rilievo_scene::{LinearImage, Unit};
use std::path::Path;

/// Reads an object's folder and writes photos, masks and truth.
///
/// # Errors
/// When a file of the object cannot be used, there is no such lamp, or the folder cannot be written.
pub fn import(args: &ImportArgs, output: &Path) -> anyhow::Result<()> {
    let object = read_diligent(&args.source).map_err(Failure::from)?;
    let mut cameras = CameraFile {
        unit: Unit::Metre,
        ..CameraFile::default()
    };
    let mut files = Vec::new();
    for view in &object.views {
        files.extend(view_files(&args.source, output, view, args.lamp)?);
        cameras
            .cameras
            .extend(view.camera.clone().map(|camera| CameraEntry {
                image: Some(format!("{}.exr", view.name)),
                ..camera
            }));
    }
    if !cameras.cameras.is_empty() {
        let path = output.join("truth/cameras.json");
        files.push(cameras_file(&path, &cameras).map_err(Failure::from)?);
    }
    if let Some(path) = &object.mesh {
        let mut mesh = read_mesh_ply(path).map_err(Failure::from)?;
        for vertex in &mut mesh.vertices {
            vertex.iter_mut().for_each(|x| *x *= METRES_PER_MM as f32);
        }
        let path = output.join("truth/mesh.ply");
        files.push(mesh_ply_file(&path, &mesh, Unit::Metre).map_err(Failure::from)?);
    }
    output_files::write(&files, args.overwrite)?;
    say!("{}", summary(&object, output))?;
    Ok(())
}

fn view_files(
    source: &Path,
    output: &Path,
    view: &DiligentView,
    lamp: Option<u16>,
) -> Result<Vec<OutputFile>, Failure> {
    let name = &view.name;
    let photos = match lamp.map(usize::from) {
        None => &view.photos[..],
        Some(number) => view.photos.get(number - 1..number).ok_or_else(|| {
            let reason = format!("{name} has {} lamps (--lamp {number})", view.photos.len());
            Failure::input(source, reason)
        })?,
    };
    let mut mean: Option<LinearImage> = None;
    for photo in photos {
        let image = read_diligent_photo(photo)?;
        let Some(sum) = &mut mean else {
            mean = Some(image);
            continue;
        };
        if (sum.width, sum.height) != (image.width, image.height) {
            return Err(Failure::input(
                &photo.path,
                "has another size than the photos before it",
            ));
        }
        sum.data
            .iter_mut()
            .zip(&image.data)
            .for_each(|(s, v)| *s += v);
    }
    let mut files = Vec::new();
    if let Some(mut image) = mean {
        let share = 1.0 / photos.len() as f32;
        image.data.iter_mut().for_each(|value| *value *= share);
        files.push(linear_file(
            &output.join(format!("photos/{name}.exr")),
            &image,
        ));
    }
    files.push(mask_file(
        &output.join(format!("masks/{name}.png")),
        &view.mask,
    ));
    let lamps: Vec<(String, [f64; 3])> = view
        .photos
        .iter()
        .filter_map(|photo| {
            let name = photo.path.file_name()?.to_string_lossy().into_owned();
            Some((name, photo.towards_light))
        })
        .collect();
    let lamps = lamps
        .iter()
        .map(|(name, direction)| (name.as_str(), *direction));
    files.push(lp_file(&output.join(format!("lamps/{name}.lp")), lamps));
    if let Some(normal) = &view.normal {
        let path = output.join(format!("truth/{name}_normal.exr"));
        files.push(normal_file(&path, normal));
    }
    files
        .into_iter()
        .collect::<Result<_, _>>()
        .map_err(Failure::from)
}

/// What was written, and what it is good for.
fn summary(object: &DiligentObject, output: &Path) -> String {
    let posed = object.views.iter().all(|view| view.camera.is_some());
    let use_of = if posed {
        format!(
            "the lamps stand still relative to the camera (config: lighting.own_shape_light = \
             \"camera\"); give the true cameras with --cameras {}",
            output.join("truth/cameras.json").display()
        )
    } else {
        "one view without a camera: nothing to reconstruct from, but normals to compare with".into()
    };
    format!(
        "{} views are in {}: {use_of}",
        object.views.len(),
        output.display()
    )
}
