//! The photo model on a folder with ground truth, cameras given: accuracy after every step and at
//! the end.

use crate::Failure;
use crate::data_set::Set;
use rilievo_photometry::samples::read_spheres;
use rilievo_scene::{
    LightKind, LightSource, LightingCalibration, LocatedSphere, PhotoIdx, ShadedViews, Silent,
    SparsePoint,
};
use rilievo_shading::Surroundings;
use rilievo_shading::photo::{PhotoOptions, run_probed};
use rilievo_synthetic::compare::{TruthMaps, TruthView, aggregate, compare_maps};
use rilievo_synthetic::testing::true_sphere;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// A data set with its sphere in `truth/cameras.json`
    set: PathBuf,
    /// Names of the views to use; all by default
    #[arg(long, value_delimiter = ',')]
    views: Vec<String>,
    /// Takes `linear/NAME.png` for the photos
    #[arg(long)]
    linear: bool,
    /// Options as JSON
    #[arg(long, default_value = "{}")]
    options: String,
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let mut set = Set::load(&arguments.set, arguments.linear, &arguments.views)?;
    set.clip(0.98);
    // Of a set without one, the centre is no number.
    if set.center.iter().all(|x| x.is_finite()) {
        set.posed.spheres.push(LocatedSphere {
            seen_in: (0..set.photos.photos.len())
                .map(|i| (PhotoIdx(i), 0.5))
                .collect(),
            ..true_sphere(set.center, set.radius)
        });
        // The mat under the object, as sparse points of a pose run would show it.
        let on_grid = |i: usize| i as f64 / 19.0 - 0.5;
        set.posed.points.extend((0..400).map(|i| SparsePoint {
            position: [on_grid(i % 20), 0.0, on_grid(i / 20)],
            color: [128; 3],
            error_px: 0.3,
            track: Vec::new(),
        }));
    }
    let (photos, posed) = (&set.photos, &set.posed);
    let mut truth = Vec::new();
    for (i, view) in posed.views.iter().enumerate() {
        let depth = set.true_depth(&view.name)?;
        let normal = set.true_normals(i).ok();
        truth.push(TruthView {
            name: view.name.clone(),
            intrinsics: view.intrinsics,
            maps: TruthMaps::new(Some(depth), normal).ok_or("no truth")?,
        });
    }
    let accuracy = |step: &str, shaded: &ShadedViews| {
        let pairs = truth.iter().zip(&shaded.views);
        let errors: Result<Vec<_>, _> = pairs
            .map(|(truth, view)| compare_maps(truth, Some(&view.depth), Some(&view.normal), 1.0))
            .collect();
        match errors.map(|errors| aggregate(errors.iter())) {
            Ok(Some(all)) => println!(
                "    {step:28} normals {:.2?} / {:.2?} deg, depth {:.5?} / {:.5?}, complete {:.4?}",
                all.normal_mae_deg,
                all.normal_median_deg,
                all.depth_median_rel,
                all.depth_p90_rel,
                all.complete
            ),
            other => println!("    {step:28} {other:?}"),
        }
    };
    let lighting = LightingCalibration {
        source: LightSource::Sphere,
        kind: LightKind::World,
        environment_in_world: None,
        views: Vec::new(),
        spheres: Vec::new(),
        samples: read_spheres(photos, posed)?,
    };
    let options: PhotoOptions = serde_json::from_str(&arguments.options)?;
    let began = std::time::Instant::now();
    let surroundings = Surroundings::in_memory(&Silent);
    let (shaded, report) = run_probed(
        photos,
        posed,
        &lighting,
        &options,
        surroundings,
        Some(&accuracy),
    )?;
    println!(
        "disagreement {:.4}, sigma_match {:.4}; {}; {:?}; {:.1} s",
        report.disagreement,
        report.sigma_match,
        report.shading,
        report.notes,
        began.elapsed().as_secs_f64()
    );
    accuracy("in all", &shaded.views()?);
    Ok(())
}
