//! Runs the photo model on a folder with ground truth, cameras given, and prints its accuracy.
//!
//! `cargo run --release -p rilievo-shading --example photo_model -- FOLDER [--views A,B,...]
//! [--photos SUBFOLDER] [--options JSON] [--pictures OUT] [--steps] [--save OUT]`
//!
//! With `--steps` the accuracy after every step is printed too, and `--save` keeps its maps in
//! `OUT/NN_STEP`.

mod accuracy;
mod input;
mod picture;
mod planes;

use rilievo_photometry::samples::read_spheres;
use rilievo_scene::{LightKind, LightSource, LightingCalibration, ShadedViews, Silent};
use rilievo_shading::Surroundings;
use rilievo_shading::photo::{self, PhotoOptions};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

#[derive(Default)]
struct Arguments {
    folder: PathBuf,
    /// All views when empty.
    views: Vec<String>,
    photos: Option<String>,
    options: PhotoOptions,
    /// Where pictures of the errors go.
    pictures: Option<PathBuf>,
    /// Where the maps go.
    save: Option<PathBuf>,
    /// Accuracy after every step.
    steps: bool,
}

impl Arguments {
    fn read(mut words: impl Iterator<Item = String>) -> Result<Self, Box<dyn Error>> {
        let mut out = Self::default();
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
            match word.as_str() {
                "--views" => out.views = value()?.split(',').map(str::to_owned).collect(),
                "--photos" => out.photos = Some(value()?),
                "--options" => out.options = serde_json::from_str(&value()?)?,
                "--pictures" => out.pictures = Some(value()?.into()),
                "--save" => out.save = Some(value()?.into()),
                "--steps" => out.steps = true,
                other if other.starts_with("--") => return Err(format!("unknown {other}").into()),
                folder => out.folder = folder.into(),
            }
        }
        if out.folder.as_os_str().is_empty() {
            return Err("give a folder with photos, masks and truth".into());
        }
        Ok(out)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::read(std::env::args().skip(1))?;
    let photo_folder = arguments.photos.as_deref().unwrap_or("photos");
    let input = input::load(&arguments.folder, photo_folder, &arguments.views)?;
    let regions = accuracy::regions(&input);
    let lighting = LightingCalibration {
        source: LightSource::Sphere,
        kind: LightKind::World,
        environment_in_world: None,
        views: Vec::new(),
        spheres: Vec::new(),
        samples: read_spheres(&input.photos, &input.posed)?,
    };
    let began = std::time::Instant::now();
    let num_steps = AtomicUsize::new(0);
    let probe = |step: &str, shaded: &ShadedViews| {
        if let Ok(summary) = accuracy::evaluate(&input, &regions, shaded, None) {
            println!("    {step:24} {summary}");
        }
        if let Some(out) = &arguments.save {
            let folder = format!("{:02}_{}", num_steps.load(Relaxed), step.replace(' ', "_"));
            if let Err(error) = save(shaded, &out.join(folder)) {
                eprintln!("step {step} was not saved: {error}");
            }
        }
        num_steps.fetch_add(1, Relaxed);
    };
    let (photos, posed, options) = (&input.photos, &input.posed, &arguments.options);
    let probe: Option<&photo::Probe> = arguments.steps.then_some(&probe);
    let around = Surroundings::in_memory(&Silent);
    let (shaded, report) = photo::run_probed(photos, posed, &lighting, options, around, probe)?;
    let shaded = shaded.views()?;
    let wall = began.elapsed().as_secs_f64();
    for iteration in &report.steps {
        println!(
            "  level {} {:28} rounds {} moved {:.3} px, turned {:.2} deg, in all {:.2}, sigma_s {:.4} match {:.4}  {:.1} s",
            iteration.level,
            iteration.step.message(),
            iteration.num_rounds,
            iteration.moved_px,
            iteration.turned_deg,
            iteration.turned_in_all_deg,
            iteration.sigma_shading,
            iteration.match_residual.unwrap_or(f64::NAN),
            iteration.seconds
        );
    }
    println!(
        "  disagreement {:.4}, sigma_match {:.4}; {}; {:?}",
        report.disagreement, report.sigma_match, report.shading, report.notes
    );
    for (view, facts) in shaded.views.iter().zip(&report.views) {
        println!(
            "  {:14} gain {:.3} {:.3} {:.3} disagree {:.3} confirmed {:.3} alone {:.3} light {:.4}",
            view.name,
            facts.gain[0],
            facts.gain[1],
            facts.gain[2],
            facts.disagreement,
            facts.confirmed,
            facts.seen_alone,
            facts.light_residual.unwrap_or(f64::NAN)
        );
    }
    if let Some(out) = &arguments.save {
        save(&shaded, out)?;
    }
    let summary = accuracy::evaluate(&input, &regions, &shaded, arguments.pictures.as_deref())?;
    println!("ALL {summary}  wall {wall:.1} s");
    Ok(())
}

/// Writes depth and normals of all views.
fn save(shaded: &ShadedViews, folder: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    for view in &shaded.views {
        rilievo_io::write_depth(
            &folder.join(format!("{}_depth.exr", view.name)),
            &view.depth,
        )?;
        rilievo_io::write_normal(
            &folder.join(format!("{}_normal.exr", view.name)),
            &view.normal,
        )?;
    }
    Ok(())
}
