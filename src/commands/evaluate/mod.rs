//! `rilievo evaluate RUN --truth DIR`: accuracy against ground truth, the alignment said aloud.

mod errors;

use crate::cli::{Align, EvaluateArgs};
use crate::exit::Failure;
use crate::pipeline::{from_io, load_poses};
use crate::report;
use crate::store::{RunDir, StoreError};
use rilievo_io::{
    CameraFile, read_cameras, read_cloud_ply, read_depth, read_mesh_ply, read_normal,
};
use rilievo_scene::{DepthMap, Intrinsics, Mesh, NormalMap, RigidTransform, StageId};
use rilievo_synthetic::compare::{
    self, AlignmentRequest, Evaluation, MapComparison, NamedPose, PixelErrors, TrueSurface,
    TruthView, compare_maps,
};
use std::path::{Path, PathBuf};

/// Runs the command.
///
/// # Errors
/// When run or truth cannot be read, or what was asked for cannot be aligned.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<()> {
    if !args.truth.is_dir() {
        return Err(Failure::input(&args.truth, "there is no such folder (--truth)").into());
    }
    let request = match args.align {
        Align::Auto => AlignmentRequest::Auto,
        Align::None => AlignmentRequest::None,
        Align::Se3 => AlignmentRequest::Se3,
        Align::Sim3 => AlignmentRequest::Sim3,
    };
    let evaluation = measure(&args.run, &args.truth, request)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&evaluation)?)?;
    } else {
        say!("{}", table(&evaluation).trim_end())?;
    }
    show(&args.run, &args.truth, request, &evaluation)
}

/// Shows where the errors lie: a section of the run's report, and `evaluation/deviation.ply`.
///
/// # Errors
/// When maps cannot be read, or the files cannot be written.
pub fn show(
    run: &Path,
    truth: &Path,
    request: AlignmentRequest,
    evaluation: &Evaluation,
) -> anyhow::Result<()> {
    let estimate = Estimate::open(run)?;
    let truth = Truth::open(truth)?;
    let mut views = Vec::new();
    for name in &estimate.expected {
        views.extend(truth.view(name)?);
    }
    let maps = errors::maps(&estimate, &views, evaluation.scale)?;
    let cloud = read_if_there(&estimate.cloud, read_cloud_ply)?;
    let surface = read_if_there(&truth.folder.join("mesh.ply"), read_mesh_ply)?;
    let mut deviations = Vec::new();
    if let (Some(cloud), Some(surface), Some(compared)) = (cloud, surface, &evaluation.cloud) {
        let poses = truth.poses(&estimate.expected);
        let similarity = compare::align(&estimate.poses, &poses, request)
            .map_err(|error| Failure::NoResult(error.to_string()))?;
        let max = compared.threshold;
        deviations = errors::deviations(&cloud, &surface, &similarity, max / 3.0);
        let folder = run.join("evaluation");
        std::fs::create_dir_all(&folder).map_err(StoreError::files("create", &folder))?;
        let path = folder.join("deviation.ply");
        let unit = truth.cameras.unit;
        errors::write_deviations(&path, &cloud, &deviations, max, unit)?;
        tell!(
            "signed distances of the cloud, blue inside to red outside at {:.2} mm, are in {}",
            1e3 * max,
            path.display()
        );
    }
    for deviation in &mut deviations {
        *deviation *= 1e3;
    }
    if report::add_evaluation(run, &table(evaluation), &maps, &deviations)? {
        tell!("error maps are in {}", run.join("report.html").display());
    }
    Ok(())
}

/// What is to be compared: poses and maps of a run, or the maps of `rilievo shade`.
struct Estimate {
    poses: Vec<NamedPose>,
    /// Names of all photos that a result could be expected of.
    expected: Vec<String>,
    maps: PathBuf,
    cloud: PathBuf,
}

impl Estimate {
    fn open(root: &Path) -> anyhow::Result<Self> {
        if !root.join("run.json").exists() && root.join("depth").is_dir() {
            return Self::of_shade(root);
        }
        let run = RunDir::open_to_read(root)?;
        if run.manifest(StageId::Poses)?.is_none() {
            return Self::without_poses(&run);
        }
        let views = load_poses(&run)?;
        let poses = views
            .views
            .iter()
            .map(|view| NamedPose {
                name: view.name.clone(),
                cam_from_world: view.cam_from_world,
            })
            .collect();
        let unregistered = views.unregistered.iter().map(|photo| {
            let name = Path::new(&photo.file_name).file_stem();
            name.map_or(String::new(), |name| name.to_string_lossy().into_owned())
        });
        let posed = views.views.iter().map(|view| view.name.clone());
        Ok(Self {
            expected: posed.chain(unregistered).collect(),
            poses,
            maps: run.stage_dir(StageId::Shading),
            cloud: run.stage_dir(StageId::Fusion).join("cloud.ply"),
        })
    }

    /// A run that has not come to poses yet: photos at most, from which a result was expected.
    fn without_poses(run: &RunDir) -> anyhow::Result<Self> {
        let photos = run.manifest(StageId::Photos)?;
        Ok(Self {
            poses: Vec::new(),
            expected: photos.map_or_else(Vec::new, |manifest| manifest.items.into_keys().collect()),
            maps: run.stage_dir(StageId::Shading),
            cloud: run.stage_dir(StageId::Fusion).join("cloud.ply"),
        })
    }

    /// The output folder of `rilievo shade` has maps, but neither poses nor a cloud.
    fn of_shade(root: &Path) -> anyhow::Result<Self> {
        let mut expected: Vec<String> = std::fs::read_dir(root.join("depth"))?
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "exr"))
            .filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()))
            .collect();
        expected.sort();
        Ok(Self {
            poses: Vec::new(),
            expected,
            maps: root.to_path_buf(),
            cloud: root.join("cloud.ply"),
        })
    }

    fn depth(&self, name: &str) -> Result<Option<DepthMap>, Failure> {
        read_if_there(&self.maps.join(format!("depth/{name}.exr")), read_depth)
    }

    fn normal(&self, name: &str) -> Result<Option<NormalMap>, Failure> {
        read_if_there(&self.maps.join(format!("normal/{name}.exr")), read_normal)
    }
}

/// Ground truth in a folder.
struct Truth {
    folder: PathBuf,
    cameras: CameraFile,
}

impl Truth {
    fn open(folder: &Path) -> Result<Self, Failure> {
        let cameras = read_if_there(&folder.join("cameras.json"), read_cameras)?;
        Ok(Self {
            folder: folder.to_path_buf(),
            cameras: cameras.unwrap_or_default(),
        })
    }

    /// Poses of the photos that a result could be expected of.
    fn poses(&self, expected: &[String]) -> Vec<NamedPose> {
        expected
            .iter()
            .filter_map(|name| {
                Some(NamedPose {
                    name: name.clone(),
                    cam_from_world: self.cameras.find(name)?.cam_from_world?,
                })
            })
            .collect()
    }

    fn view(&self, name: &str) -> Result<Option<TruthView>, Failure> {
        // Beside NAME_depth.exr, a folder of its own per view.
        let beside = self.folder.join(format!("{name}_depth.exr"));
        let (depth, normal) = if beside.exists() {
            (beside, self.folder.join(format!("{name}_normal.exr")))
        } else {
            let own = self.folder.join(name);
            (own.join("depth_true.exr"), own.join("normal_true.exr"))
        };
        let Some(depth) = read_if_there(&depth, read_depth)? else {
            return Ok(None);
        };
        let intrinsics = match self.cameras.find(name) {
            Some(camera) => camera.intrinsics,
            None => own_camera(&self.folder.join(name).join("camera.json"), &depth)?,
        };
        Ok(Some(TruthView {
            name: name.to_owned(),
            intrinsics,
            normal: read_if_there(&normal, read_normal)?,
            depth,
        }))
    }
}

/// The camera beside a view's truth; without one only fitted planes would need it.
fn own_camera(path: &Path, depth: &DepthMap) -> Result<Intrinsics, Failure> {
    let file = read_if_there(path, read_cameras)?;
    let camera = file.and_then(|file| file.cameras.first().map(|camera| camera.intrinsics));
    let (width, height) = (depth.width, depth.height);
    Ok(camera.unwrap_or_else(|| {
        let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        Intrinsics::pinhole(width, height, 1.2 * width.max(height) as f64, cx, cy)
    }))
}

/// Compares a run with the truth.
///
/// # Errors
/// As [`evaluate`].
pub fn measure(run: &Path, truth: &Path, request: AlignmentRequest) -> anyhow::Result<Evaluation> {
    let estimate = Estimate::open(run)?;
    let truth = Truth::open(truth)?;
    let mut views = Vec::new();
    for name in &estimate.expected {
        if let Some(view) = truth.view(name)? {
            views.push(view);
        }
    }
    let posed: Vec<(RigidTransform, &TruthView)> = views
        .iter()
        .filter_map(|view| Some((truth.cameras.find(&view.name)?.cam_from_world?, view)))
        .collect();
    let cloud = read_if_there(&estimate.cloud, read_cloud_ply)?;
    let mesh_path = truth.folder.join("mesh.ply");
    let mesh: Option<Mesh> = read_if_there(&mesh_path, read_mesh_ply)?;
    let pair = match (&cloud, &mesh) {
        (Some(cloud), Some(mesh)) => Ok((
            cloud.points.as_slice(),
            TrueSurface {
                mesh,
                views: &posed,
                threshold: None,
            },
        )),
        (None, _) => Err(format!("there is no {}", estimate.cloud.display())),
        (_, None) => Err(format!("there is no {}", mesh_path.display())),
    };
    // Reading errors inside the comparison are kept here, since it knows only its own.
    let mut unreadable = None;
    let evaluation = compare::evaluate(
        &estimate.poses,
        &truth.poses(&estimate.expected),
        request,
        |scale| {
            let mut errors: Vec<(String, PixelErrors)> = Vec::new();
            for view in &views {
                let maps = estimate
                    .depth(&view.name)
                    .and_then(|depth| Ok((depth, estimate.normal(&view.name)?)));
                let (depth, normal) = match maps {
                    Ok(maps) => maps,
                    Err(failure) => {
                        unreadable.get_or_insert(failure);
                        (None, None)
                    }
                };
                let compared = compare_maps(view, depth.as_ref(), normal.as_ref(), scale)?;
                errors.push((view.name.clone(), compared));
            }
            Ok(errors)
        },
        pair,
    )
    .map_err(|error| Failure::NoResult(error.to_string()))?;
    match unreadable {
        Some(failure) => Err(failure.into()),
        None => Ok(evaluation),
    }
}

fn read_if_there<T>(
    path: &Path,
    read: impl FnOnce(&Path) -> Result<T, rilievo_io::IoError>,
) -> Result<Option<T>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    read(path).map(Some).map_err(from_io)
}

/// The numbers as a table for people.
pub fn table(evaluation: &Evaluation) -> String {
    let mut text = format!(
        "alignment: {} (scale {:.5}): {}\n",
        match evaluation.alignment {
            compare::Alignment::None => "none",
            compare::Alignment::Se3 => "se3",
            compare::Alignment::Sim3 => "sim3",
        },
        evaluation.scale,
        evaluation.alignment_reason
    );
    if let Some(poses) = &evaluation.poses {
        text += &format!(
            "poses: {} of {} cameras; centre error mean {:.3} mm, max {:.3} mm; rotation error mean \
             {:.4} deg, max {:.4} deg\n",
            poses.num_cameras,
            poses.num_cameras + poses.num_missing,
            1e3 * poses.center_error_mean,
            1e3 * poses.center_error_max,
            poses.rotation_error_mean_deg,
            poses.rotation_error_max_deg
        );
    }
    let width = evaluation
        .views
        .keys()
        .map(|name| name.chars().count())
        .fold("all".len(), usize::max);
    text += &format!(
        "{:<width$}  complete   normals MAE  median   depth median      p90\n",
        "view"
    );
    for (name, view) in &evaluation.views {
        text += &row(name, view, width);
    }
    if let Some(all) = &evaluation.all {
        text += &row("all", all, width);
    }
    if let Some(cloud) = &evaluation.cloud {
        text += &format!(
            "cloud: accuracy median {:.3} mm; completeness {:.1} %, F {:.3} at {:.2} mm\n",
            1e3 * cloud.accuracy_median,
            100.0 * cloud.completeness,
            cloud.f_score,
            1e3 * cloud.threshold
        );
    }
    for (key, reason) in &evaluation.reasons {
        text += &format!("no {key}: {reason}\n");
    }
    text
}

fn row(name: &str, view: &MapComparison, width: usize) -> String {
    let cell = |value: Option<f64>, factor: f64, unit: &str, digits: usize| match value {
        Some(value) => format!("{:.digits$} {unit}", factor * value),
        None => "-".to_owned(),
    };
    format!(
        "{name:<width$}  {:>8}  {:>12}  {:>9}  {:>9}  {:>9}\n",
        cell(view.complete, 100.0, "%", 1),
        cell(view.normal_mae_deg, 1.0, "deg", 2),
        cell(view.normal_median_deg, 1.0, "deg", 2),
        cell(view.depth_median_rel, 100.0, "%", 3),
        cell(view.depth_p90_rel, 100.0, "%", 3),
    )
}
