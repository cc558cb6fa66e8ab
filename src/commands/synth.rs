//! `rilievo synth OUT`: a synthetic photo folder with ground truth.
//!
//! ```text
//! OUT/photos/IMG_0001.jpg …       8-bit sRGB, as a camera would write them
//! OUT/masks/IMG_0001.png …        the object
//! OUT/sphere_masks/IMG_0001.png … the reference sphere; of several the first, the others in
//!                                 sphere_masks_2, sphere_masks_3 …
//! OUT/synth.json                  the options that it was made with, written first
//! OUT/intrinsics.json             cameras without poses
//! OUT/sphere.json                 the spheres' radii and masks
//! OUT/truth/                      cameras.json, NAME_depth.exr, NAME_normal.exr, NAME_albedo.exr,
//!                                 lighting.json, mesh.ply, matches/NAME1_NAME2.csv
//! ```

use super::reporting::reporting;
use crate::cli::{SynthArgs, SynthFormat};
use crate::config::{read_toml, take_over};
use crate::exit::Failure;
use crate::observe::Console;
use crate::store::{StoreError, create_folder};
use rilievo_io::{
    CameraEntry, CameraFile, read_mesh_ply, write_cameras, write_depth, write_linear, write_mask,
    write_matches_csv, write_mesh_ply, write_normal, write_photo_deep, write_photo_dng,
    write_photo_jpeg,
};
use rilievo_scene::{ExifFacts, InTable, LinearImage, NormalMap, Observer, StageId, Unit};
use rilievo_synthetic::{
    RenderOptions, RenderedView, Renderer, Scene, SceneOptions, SyntheticError, true_tracks,
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::path::Path;

/// JPEG quality of the photos: a camera's usual "fine".
const JPEG_QUALITY: u8 = 95;

/// Surface points whose matches are written: some hundred for every two views.
const NUM_TRACKS: usize = 1000;

/// Options of `--config`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SynthOptions {
    /// The world in front of the camera.
    pub scene: SceneOptions,
    pub photographs: RenderOptions,
}

impl SynthOptions {
    /// Checks every number, so that a wrong one is reported before anything is made.
    ///
    /// # Errors
    /// [`Failure::Usage`] with the first one that is out of its range.
    pub fn validate(&self) -> Result<(), Failure> {
        self.scene
            .validate()
            .in_table("scene")
            .and_then(|()| self.photographs.validate().in_table("photographs"))
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Runs the command.
///
/// # Errors
/// Unusable options, or a folder that holds something else or cannot be written.
pub fn synth(args: &SynthArgs) -> anyhow::Result<()> {
    synth_to(args, &Console::new(args.json))
}

/// The same on a console that is there already.
pub fn synth_to(args: &SynthArgs, console: &Console) -> anyhow::Result<()> {
    let facts = json!({"folder": args.output.display().to_string()});
    reporting(console, facts, |console| {
        let options = options(args)?;
        if !is_set(&args.output) && !is_new(&args.output)? {
            return Err(not_ours(&args.output, "synth").into());
        }
        write_set(
            &args.output,
            &options,
            args.format,
            args.mesh.as_deref(),
            &console.of_command("synth"),
        )?;
        console.note(&format!(
            "{} photos, masks and ground truth are in {}",
            options.photographs.num_views,
            args.output.display()
        ));
        Ok(())
    })
}

/// The file's options, over which those of the command line go.
fn options(args: &SynthArgs) -> anyhow::Result<SynthOptions> {
    let mut options = match &args.config {
        None => SynthOptions::default(),
        Some(path) => read_toml(path, &rilievo_synthetic::RETIRED_KEYS)?,
    };
    let photographs = &mut options.photographs;
    take_over(&mut options.scene.seed, args.seed);
    take_over(&mut options.scene.lamps_at_m, args.near.map(Some));
    take_over(&mut options.scene.gloss, args.gloss);
    take_over(&mut photographs.num_views, args.views);
    if let Some((width, height)) = args.size {
        (photographs.width, photographs.height) = (width, height);
    }
    options.validate()?;
    Ok(options)
}

/// File that marks a set, whatever became of the rest of it.
const SET_FILE: &str = "synth.json";

/// Whether a folder is an earlier set, which a new one may replace.
pub fn is_set(folder: &Path) -> bool {
    let has = |file: &str| folder.join(file).exists();
    // Sets of earlier versions have no mark, but cameras without and with poses.
    has(SET_FILE) || (has("intrinsics.json") && has("truth/cameras.json"))
}

/// Whether a folder is absent or empty.
pub fn is_new(folder: &Path) -> Result<bool, StoreError> {
    match std::fs::read_dir(folder) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(error) => Err(StoreError::files("read", folder)(error)),
    }
}

/// The folder holds what no earlier call of the command wrote.
pub fn not_ours(folder: &Path, command: &str) -> Failure {
    Failure::RunDirectory(format!(
        "{} is not empty and was not made by `rilievo {command}`; choose another folder",
        folder.display()
    ))
}

/// Makes a scene, photographs it, and writes photos and truth.
pub fn write_set(
    folder: &Path,
    options: &SynthOptions,
    format: SynthFormat,
    mesh: Option<&Path>,
    observer: &dyn Observer,
) -> anyhow::Result<()> {
    let scene = match mesh {
        None => Scene::new(options.scene.clone()).map_err(usage)?,
        Some(path) => {
            let mesh = read_mesh_ply(path).map_err(Failure::from)?;
            Scene::with_mesh(options.scene.clone(), mesh)
                .map_err(|error| Failure::input(path, error.to_string()))?
        }
    };
    let renderer = Renderer::new(&scene, &options.photographs).map_err(usage)?;
    create_folder(folder)?;
    write_json(&folder.join(SET_FILE), &serde_json::to_value(options)?)?;
    let kinds = ["photos", "masks", "truth", "truth/matches"].map(str::to_owned);
    let sphere_masks = (0..scene.spheres.len().max(1)).map(mask_folder);
    for name in kinds.into_iter().chain(sphere_masks) {
        create_folder(&folder.join(name))?;
    }
    let mut taken = Taken::of(&scene);
    let total = renderer.num_views();
    for index in 0..total {
        let view = renderer.render(index).map_err(usage)?;
        write_view(folder, &view, format)?;
        taken.add(view, ending(format))?;
        let flow = observer.progress(
            StageId::Photos,
            "photographing the scene",
            (index + 1, total),
        );
        flow.ok_or(Failure::Interrupted)?;
    }
    taken.write(folder, &scene, options.photographs.turntable)?;
    write_mesh_ply(&folder.join("truth/mesh.ply"), &scene.mesh, Unit::Metre)
        .map_err(Failure::from)?;
    write_matches(folder, &scene, &taken.views)
}

fn usage(error: SyntheticError) -> Failure {
    Failure::Usage(error.to_string())
}

/// What is written of all photos together, once all are taken.
struct Taken {
    cameras: CameraFile,
    /// Every sphere's mask in every photo that shows it.
    sphere_views: Vec<Map<String, Value>>,
    lighting: Map<String, Value>,
    gains: Map<String, Value>,
    /// Without pixels.
    views: Vec<RenderedView>,
}

impl Taken {
    fn of(scene: &Scene) -> Self {
        Self {
            cameras: CameraFile {
                unit: Unit::Metre,
                ..CameraFile::default()
            },
            sphere_views: vec![Map::new(); scene.spheres.len()],
            lighting: Map::new(),
            gains: Map::new(),
            views: Vec::new(),
        }
    }

    fn add(&mut self, view: RenderedView, ending: &str) -> anyhow::Result<()> {
        let file_name = format!("{}.{ending}", view.name);
        for (k, mask) in view.sphere_masks.iter().enumerate() {
            if mask.count() > 0 {
                let file = format!("{}/{}.png", mask_folder(k), view.name);
                self.sphere_views[k].insert(file_name.clone(), json!({"mask": file}));
            }
        }
        let lighting = serde_json::to_value(&view.lighting)?;
        self.lighting.insert(view.name.clone(), lighting);
        self.gains.insert(file_name.clone(), view.gain.into());
        self.cameras.cameras.push(CameraEntry {
            image: Some(file_name),
            intrinsics: view.intrinsics,
            cam_from_world: Some(view.cam_from_world),
        });
        // Matches need no pixels.
        self.views.push(RenderedView {
            image: LinearImage::filled(0, 0, 3, 0.0),
            albedo: LinearImage::filled(0, 0, 3, 0.0),
            normal: NormalMap::filled(0, 0, [0.0; 3]),
            ..view
        });
        Ok(())
    }

    /// Cameras, spheres and light.
    fn write(&mut self, folder: &Path, scene: &Scene, turns: bool) -> anyhow::Result<()> {
        let cameras = &mut self.cameras;
        let mut extra = |key: &str, value: Value| cameras.extra.insert(key.to_owned(), value);
        extra("exposure_gains", std::mem::take(&mut self.gains).into());
        extra("albedo", json!(scene.options.albedo));
        let spheres = scene.spheres.iter();
        let spheres: Vec<Value> = spheres
            .map(|s| json!({"center": s.center_in_world, "radius": s.radius}))
            .collect();
        if let Some(first) = spheres.first() {
            extra("sphere", first.clone());
        }
        if spheres.len() > 1 {
            extra("spheres", spheres.into());
        }
        write_cameras(&folder.join("truth/cameras.json"), cameras).map_err(Failure::from)?;
        cameras.extra.clear();
        for camera in &mut cameras.cameras {
            camera.cam_from_world = None;
        }
        write_cameras(&folder.join("intrinsics.json"), cameras).map_err(Failure::from)?;
        if !scene.spheres.is_empty() {
            let file = sphere_file(scene, std::mem::take(&mut self.sphere_views), turns);
            write_json(&folder.join("sphere.json"), &file)?;
        }
        let lighting = json!({
            "basis": rilievo_scene::SphericalHarmonics::BASIS,
            "frame": "camera",
            "includes_albedo": true,
            "views": self.lighting,
        });
        write_json(&folder.join("truth/lighting.json"), &lighting)
    }
}

/// Folder of a sphere's masks.
fn mask_folder(sphere: usize) -> String {
    match sphere {
        0 => "sphere_masks".to_owned(),
        k => format!("sphere_masks_{}", k + 1),
    }
}

/// The sphere file: one sphere at its top, several in a list; `turns` for an object on a turntable.
fn sphere_file(scene: &Scene, views: Vec<Map<String, Value>>, turns: bool) -> Value {
    let mut entries: Vec<Value> = scene
        .spheres
        .iter()
        .zip(views)
        .map(|(sphere, views)| json!({"radius": sphere.radius, "views": views}))
        .collect();
    let mut file = match entries.len() {
        1 => entries.swap_remove(0),
        _ => json!({"spheres": entries}),
    };
    file["unit"] = "metre".into();
    file["light"] = if turns { "camera" } else { "world" }.into();
    file
}

/// True matches of every two views, exact to the renderer's arithmetic.
fn write_matches(folder: &Path, scene: &Scene, views: &[RenderedView]) -> anyhow::Result<()> {
    let tracks = true_tracks(&scene.mesh, views, NUM_TRACKS, scene.options.seed);
    for (i, first) in views.iter().enumerate() {
        for (j, second) in views.iter().enumerate().skip(i + 1) {
            let matches: Vec<[f64; 4]> = tracks
                .iter()
                .filter_map(|track| {
                    let at = |idx| track.observations.iter().find(|o| o.0 == idx);
                    let ([x1, y1], [x2, y2]) = (at(i)?.1, at(j)?.1);
                    Some([x1, y1, x2, y2])
                })
                .collect();
            let file = format!("truth/matches/{}_{}.csv", first.name, second.name);
            write_matches_csv(&folder.join(file), &matches).map_err(Failure::from)?;
        }
    }
    Ok(())
}

/// Ending of the photos' names.
fn ending(format: SynthFormat) -> &'static str {
    match format {
        SynthFormat::Jpeg => "jpg",
        SynthFormat::Tiff => "tif",
        SynthFormat::Png => "png",
        SynthFormat::Exr => "exr",
        SynthFormat::Dng => "dng",
    }
}

fn write_view(folder: &Path, view: &RenderedView, format: SynthFormat) -> Result<(), Failure> {
    let name = &view.name;
    let photo = folder.join(format!("photos/{name}.{}", ending(format)));
    match format {
        SynthFormat::Jpeg => write_photo_jpeg(&photo, &view.image, JPEG_QUALITY),
        SynthFormat::Tiff | SynthFormat::Png => write_photo_deep(&photo, &view.image),
        SynthFormat::Exr => write_linear(&photo, &view.image),
        SynthFormat::Dng => write_photo_dng(&photo, &view.image, [1.0; 3], &ExifFacts::default()),
    }?;
    let albedo = folder.join(format!("truth/{name}_albedo.exr"));
    write_linear(&albedo, &view.albedo)?;
    let mask = folder.join(format!("masks/{name}.png"));
    write_mask(&mask, &view.object_mask)?;
    for (k, mask) in view.sphere_masks.iter().enumerate() {
        let sphere = folder.join(format!("{}/{name}.png", mask_folder(k)));
        write_mask(&sphere, mask)?;
    }
    let depth = folder.join(format!("truth/{name}_depth.exr"));
    write_depth(&depth, &view.depth)?;
    let normal = folder.join(format!("truth/{name}_normal.exr"));
    write_normal(&normal, &view.normal).map_err(Failure::from)
}

fn write_json(path: &Path, value: &Value) -> anyhow::Result<()> {
    std::fs::write(path, serde_json::to_vec_pretty(value)?)
        .map_err(StoreError::files("write", path))?;
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser;

    #[test]
    fn the_command_line_goes_over_the_file_and_the_file_over_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("options.toml");
        std::fs::write(
            &file,
            "[scene]\nseed = 7\n[photographs]\nnum_views = 3\nwidth = 320\nheight = 200\n",
        )
        .unwrap();
        let told = |given: &[&str]| {
            let line = [&["rilievo", "synth", "set"], given].concat();
            let Command::Synth(args) = Cli::parse_from(line).command else {
                panic!("not synth");
            };
            let SynthOptions { scene, photographs } = options(&args).unwrap();
            (
                scene.seed,
                photographs.num_views,
                photographs.width,
                photographs.height,
            )
        };
        let config = ["--config", file.to_str().unwrap()];
        assert_eq!(told(&[]), (1, 6, 640, 480));
        assert_eq!(told(&config), (7, 3, 320, 200));
        let given = ["--views", "2", "--size", "64x48", "--seed", "9"];
        assert_eq!(told(&[&config[..], &given].concat()), (9, 2, 64, 48));
    }
}
