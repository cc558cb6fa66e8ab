//! The shading problem that a command line or a scene file describes.

use super::depth_order;
use super::described::{Described, ViewParts, mask_misfit};
use crate::cli::ShadeArgs;
use crate::config::StageOptions;
use crate::exit::Failure;
use crate::observe::Console;
use rilievo_io::{
    LightingFile, SceneFile, SceneView, decode_photo, read_cameras, read_lighting, read_mask,
    read_matches_csv, read_scene, split_lighting_spec,
};
use rilievo_scene::{Lighting, Orientation, StageId};
use rilievo_shading::paper::ViewMatches;
use std::path::{Path, PathBuf};

/// Reads everything that the command line or the scene names.
///
/// # Errors
/// [`Failure::Input`] names the file that cannot be used.
pub fn build(
    args: &ShadeArgs,
    options: &StageOptions,
    console: &Console,
) -> anyhow::Result<Described> {
    let scene = match (&args.scene, &args.image, &args.camera) {
        (Some(path), _, _) => read_scene(path).map_err(Failure::from)?,
        (None, Some(image), Some(camera)) => single(args, image.clone(), camera.clone()),
        _ => {
            let usage = "give SCENE.json for several views, or --image PHOTO with --camera CAMERA.json \
                         for one";
            return Err(Failure::Usage(usage.to_owned()).into());
        }
    };
    refuse_one_file_for_all(args, scene.views.len())?;
    let mut described = Described::default();
    for view in &scene.views {
        let parts = read_view(view, args, console)?;
        described.add(parts, args.prior_weight, options, console)?;
    }
    for matches in &scene.matches {
        let index = |name: &String| {
            let found = scene.views.iter().position(|view| view.name == *name);
            found.ok_or_else(|| {
                let file = args.scene.clone().unwrap_or_default();
                Failure::input(
                    file,
                    format!("\"matches\" names a view \"{name}\" that is not there"),
                )
            })
        };
        described.problem.matches.push(ViewMatches {
            views: [index(&matches.views[0])?, index(&matches.views[1])?],
            pixels: read_matches_csv(&matches.file).map_err(Failure::from)?,
        });
    }
    described.tell_of_matches(console);
    Ok(described)
}

/// Masks and depths belong to a view each: one file cannot stand for several.
fn refuse_one_file_for_all(args: &ShadeArgs, num_views: usize) -> Result<(), Failure> {
    let init_file = args.init.as_deref().filter(|init| !is_word(init));
    let given = [
        ("mask", args.mask.is_some()),
        ("prior", args.prior.is_some()),
        ("init", init_file.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((key, _)) if num_views > 1 => Err(Failure::Usage(format!(
            "--{key} gives the file of one view, but the scene has {num_views}: name one per view in the \
             scene, as \"{key}\""
        ))),
        _ => Ok(()),
    }
}

fn is_word(init: &str) -> bool {
    matches!(init, "plane" | "anchors")
}

/// A scene of one view from the command line.
fn single(args: &ShadeArgs, image: PathBuf, camera: PathBuf) -> SceneFile {
    let name = image.file_stem().map_or("image".to_owned(), |stem| {
        stem.to_string_lossy().into_owned()
    });
    let view = SceneView {
        name,
        image,
        mask: args.mask.clone(),
        camera,
        lighting: None,
        init: None,
        prior: args.prior.clone(),
    };
    SceneFile {
        views: vec![view],
        matches: Vec::new(),
    }
}

/// One view; what the command line says replaces what the scene says.
fn read_view(view: &SceneView, args: &ShadeArgs, console: &Console) -> anyhow::Result<ViewParts> {
    let photo = decode_photo(&view.image).map_err(Failure::from)?;
    let size = (photo.width, photo.height);
    let cameras = read_cameras(&view.camera).map_err(Failure::from)?;
    let camera = cameras
        .cameras
        .first()
        .ok_or_else(|| Failure::input(&view.camera, "holds no camera"))?;
    let mask_file = args.mask.as_ref().or(view.mask.as_ref());
    let mask = mask_file
        .map(|path| {
            let mask = read_mask(path).map_err(Failure::from)?;
            let number = photo.exif.orientation;
            let orientation = number.and_then(Orientation::of_exif).unwrap_or_default();
            let (mask, was_upright) = orientation.mask_by_size(mask, size);
            if was_upright {
                let text = "the mask was drawn over the image as EXIF turns it; it was turned back to the pixels as stored";
                console.warn(StageId::Shading, text);
            }
            match mask_misfit(&mask, size) {
                Some(reason) => Err(Failure::input(path, reason)),
                None => Ok(mask),
            }
        })
        .transpose()?;
    let depth = |path: &Path| depth_order::read(path, console);
    let prior_file = args.prior.as_deref().or(view.prior.as_deref());
    let prior = prior_file.map(depth).transpose()?;
    let init_file = args.init.as_deref().or(view.init.as_deref());
    let init_file = init_file.filter(|init| !is_word(init));
    let initial = match init_file.map(Path::new) {
        // Read, and warned of, once.
        same if same == prior_file => prior.clone(),
        other => other.map(depth).transpose()?,
    };
    let spec = args.lighting.as_deref().map(split_lighting_spec);
    let lighting = spec
        .or_else(|| view.lighting.clone())
        .map(|(path, name)| given_lighting(path, name, &view.name))
        .transpose()?;
    Ok(ViewParts {
        name: view.name.clone(),
        photo,
        mask,
        intrinsics: camera.intrinsics,
        cam_from_world: camera.cam_from_world,
        lighting,
        initial,
        prior,
    })
}

fn given_lighting(
    path: PathBuf,
    name: Option<String>,
    view: &str,
) -> Result<(Lighting, String), Failure> {
    let file = read_lighting(&path, name.as_deref())?;
    let source = match &name {
        Some(name) => format!("{name} of {}", path.display()),
        None => format!("of {}", path.display()),
    };
    match &file {
        LightingFile::ForAll(lighting) => Ok((lighting.clone(), source)),
        LightingFile::PerView(_) => {
            let lighting = file.for_view(view).ok_or_else(|| {
                Failure::input(&path, format!("has no lighting of view \"{view}\""))
            })?;
            Ok((lighting.clone(), source))
        }
    }
}
