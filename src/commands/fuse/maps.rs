//! Depth and normal maps of a folder, whichever program wrote them, with their cameras.
//!
//! | kind | told by | cameras |
//! |---|---|---|
//! | OpenMVS | `*.dmap` | in the files |
//! | COLMAP | `stereo/depth_maps` or `depth_maps` | `sparse` beside them, or `--cameras` |
//! | OpenEXR | `depth/NAME.exr`, or `NAME_depth.exr` | `cameras.json` beside them, or `--cameras` |

use crate::exit::{Failure, Problem};
use crate::pipeline::from_io;
use nalgebra::Vector3;
use rilievo_io::{
    CameraFile, CameraFormat, import_cameras, read_channel, read_colmap_depth, read_colmap_normal,
    read_depth, read_dmap, read_normal,
};
use rilievo_scene::{ConfidenceMap, DepthMap, Intrinsics, NormalMap, RigidTransform, Unit};
use std::path::{Path, PathBuf};

/// Share of the normals that may look away from their camera: noise at the rim.
const MAX_AVERTED: f64 = 0.1;
/// Median angle between normals and the depths' own slopes from which they are in another frame:
/// noise of the slopes alone stays below.
const MAX_CONTRADICTION_DEG: f64 = 45.0;

/// A view of another program.
pub struct View {
    /// The photo's name, with its ending where it is known.
    pub image: String,
    /// Its camera.
    pub intrinsics: Intrinsics,
    /// Its pose.
    pub cam_from_world: RigidTransform,
    /// Depth.
    pub depth: DepthMap,
    /// Normals, camera frame.
    pub normal: NormalMap,
    /// Confidence, where there is a map of it.
    pub confidence: Option<ConfidenceMap>,
    /// Whether the normals are the depths' slopes, since there was no map of them.
    pub normals_are_slopes: bool,
}

/// The views of a folder.
pub struct Views {
    /// Name of the format.
    pub format: &'static str,
    /// Unit of all lengths.
    pub unit: Unit,
    /// The views, in the cameras' order.
    pub views: Vec<View>,
}

/// Files of one view.
struct Files {
    depth: PathBuf,
    normal: PathBuf,
    confidence: Option<PathBuf>,
}

/// Reads all views of a folder.
///
/// # Errors
/// When there are no maps or no cameras, or they do not belong together; names every file.
pub fn read(folder: &Path, cameras: Option<&Path>) -> Result<Views, Failure> {
    if !folder.is_dir() {
        return Err(Failure::input(folder, "there is no such folder"));
    }
    let dmaps = files_ending(folder, ".dmap")?;
    if !dmaps.is_empty() {
        return of_openmvs(&dmaps);
    }
    for place in [folder.join("stereo"), folder.to_path_buf()] {
        if place.join("depth_maps").is_dir() {
            return of_colmap(folder, &place, cameras);
        }
    }
    of_exr(folder, cameras)
}

fn files_ending(folder: &Path, ending: &str) -> Result<Vec<PathBuf>, Failure> {
    let entries = std::fs::read_dir(folder).map_err(|error| {
        Failure::ReadOrWrite(format!("{} cannot be read: {error}", folder.display()))
    })?;
    let mut files: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.to_string_lossy().ends_with(ending))
        .collect();
    files.sort();
    Ok(files)
}

fn of_openmvs(files: &[PathBuf]) -> Result<Views, Failure> {
    let mut views = Vec::new();
    for path in files {
        let file = read_dmap(path).map_err(from_io)?;
        let (normal, normals_are_slopes) = match file.normal {
            Some(normal) => (normal, false),
            None => (slopes(&file.depth, &file.intrinsics), true),
        };
        views.push(checked(
            path,
            View {
                image: file.image,
                intrinsics: file.intrinsics,
                cam_from_world: file.cam_from_world,
                depth: file.depth,
                normal,
                confidence: None,
                normals_are_slopes,
            },
        )?);
    }
    Ok(Views {
        format: "OpenMVS",
        unit: Unit::Arbitrary,
        views,
    })
}

fn of_colmap(folder: &Path, maps: &Path, cameras: Option<&Path>) -> Result<Views, Failure> {
    let beside = [
        folder.join("sparse"),
        folder.join("sparse/0"),
        folder.join("cameras.json"),
    ];
    let cameras = read_cameras_of(folder, cameras, &beside)?;
    let find = |image: &str| {
        // The geometric maps are the checked ones; the photometric ones stand in.
        ["geometric", "photometric"].iter().find_map(|kind| {
            let file = |what: &str| maps.join(what).join(format!("{image}.{kind}.bin"));
            let depth = file("depth_maps");
            depth.exists().then(|| Files {
                depth,
                normal: file("normal_maps"),
                confidence: None,
            })
        })
    };
    assemble(
        "COLMAP",
        folder,
        &cameras,
        &find,
        |path| {
            let depth = read_colmap_depth(path);
            depth.map_err(from_io)
        },
        |path| read_colmap_normal(path).map_err(from_io),
    )
}

fn of_exr(folder: &Path, cameras: Option<&Path>) -> Result<Views, Failure> {
    let any = folder.join("depth").is_dir() || !files_ending(folder, "_depth.exr")?.is_empty();
    if !any {
        return Err(Failure::input(
            folder,
            "holds no maps: neither *.dmap (OpenMVS), nor stereo/depth_maps (COLMAP), nor \
             depth/NAME.exr, nor NAME_depth.exr",
        ));
    }
    let beside = [
        folder.join("cameras.json"),
        folder.join("../3_poses/cameras.json"),
    ];
    let cameras = read_cameras_of(folder, cameras, &beside)?;
    let find = |image: &str| {
        let stem = Path::new(image).file_stem().unwrap_or_default();
        let stem = stem.to_string_lossy();
        [
            ["depth", "normal", "confidence"].map(|what| folder.join(format!("{what}/{stem}.exr"))),
            ["depth", "normal", "confidence"].map(|what| folder.join(format!("{stem}_{what}.exr"))),
        ]
        .into_iter()
        .find(|[depth, ..]| depth.exists())
        .map(|[depth, normal, confidence]| Files {
            depth,
            normal,
            confidence: confidence.exists().then_some(confidence),
        })
    };
    assemble(
        "OpenEXR",
        folder,
        &cameras,
        &find,
        |path| read_depth(path).map_err(from_io),
        |path| read_normal(path).map_err(from_io),
    )
}

/// Cameras as given, or from the first place beside the maps that has some.
fn read_cameras_of(
    folder: &Path,
    given: Option<&Path>,
    beside: &[PathBuf],
) -> Result<CameraFile, Failure> {
    let found = given.map(Path::to_path_buf).or_else(|| {
        beside
            .iter()
            .find(|path| match path.extension() {
                Some(_) => path.exists(),
                None => path.join("cameras.bin").exists() || path.join("cameras.txt").exists(),
            })
            .cloned()
    });
    let Some(path) = found else {
        return Err(Failure::input(
            folder,
            "there are no cameras beside the maps; give them with --cameras",
        ));
    };
    let format = CameraFormat::detect(&path)
        .ok_or_else(|| Failure::input(&path, "is no camera file of a known format (--cameras)"))?;
    import_cameras(&path, format).map_err(from_io)
}

/// Views of all cameras that have a pose and maps.
fn assemble(
    format: &'static str,
    folder: &Path,
    cameras: &CameraFile,
    find: &dyn Fn(&str) -> Option<Files>,
    depth_of: impl Fn(&Path) -> Result<DepthMap, Failure>,
    normal_of: impl Fn(&Path) -> Result<NormalMap, Failure>,
) -> Result<Views, Failure> {
    let mut views = Vec::new();
    for camera in &cameras.cameras {
        let (Some(image), Some(cam_from_world)) = (&camera.image, camera.cam_from_world) else {
            continue;
        };
        let Some(files) = find(image) else {
            continue;
        };
        let depth = depth_of(&files.depth)?;
        let normals_are_slopes = !files.normal.exists();
        // A map of another size than the camera's is refused before its slopes are taken.
        same_size(
            &files.depth,
            (depth.width, depth.height),
            &camera.intrinsics,
        )?;
        let normal = if normals_are_slopes {
            slopes(&depth, &camera.intrinsics)
        } else {
            let normal = normal_of(&files.normal)?;
            same_size(
                &files.normal,
                (normal.width, normal.height),
                &camera.intrinsics,
            )?;
            normal
        };
        let confidence = match &files.confidence {
            Some(path) => {
                let map = read_channel(path, "C").map_err(from_io)?;
                same_size(path, (map.width, map.height), &camera.intrinsics)?;
                Some(map)
            }
            None => None,
        };
        views.push(checked(
            &files.normal,
            View {
                image: image.clone(),
                intrinsics: camera.intrinsics,
                cam_from_world,
                depth,
                normal,
                confidence,
                normals_are_slopes,
            },
        )?);
    }
    if views.is_empty() {
        let posed = cameras
            .cameras
            .iter()
            .filter(|c| c.cam_from_world.is_some());
        return Err(Failure::input(
            folder,
            format!(
                "none of its maps has a camera with a pose: {} of {} cameras have one, and their \
                 names are not the maps'",
                posed.count(),
                cameras.cameras.len()
            ),
        ));
    }
    Ok(Views {
        format,
        unit: cameras.unit,
        views,
    })
}

fn same_size(
    path: &Path,
    (width, height): (usize, usize),
    camera: &Intrinsics,
) -> Result<(), Failure> {
    if (width, height) == (camera.width, camera.height) {
        return Ok(());
    }
    Err(Failure::Input(vec![Problem {
        file: path.to_path_buf(),
        reason: format!(
            "is {width} x {height} pixels, and its camera is {} x {}; give the cameras of the \
             maps' own size",
            camera.width, camera.height
        ),
    }]))
}

/// Refuses normals in another frame than the camera's.
fn checked(path: &Path, view: View) -> Result<View, Failure> {
    if view.normals_are_slopes {
        return Ok(view);
    }
    let own = slopes(&view.depth, &view.intrinsics);
    let (mut averted, mut angles) = (0_usize, Vec::new());
    for y in 0..view.depth.height {
        for x in 0..view.depth.width {
            let slope = Vector3::from(*own.at(x, y));
            let normal = Vector3::from(*view.normal.at(x, y));
            if slope.norm() < 0.5 || !(0.9..1.1).contains(&normal.norm()) {
                continue;
            }
            let ray = view
                .intrinsics
                .ray(&nalgebra::Point2::new(x as f64, y as f64));
            averted += usize::from(normal.map(f64::from).dot(&ray) > 0.0);
            angles.push(normal.angle(&slope).to_degrees());
        }
    }
    if angles.is_empty() {
        return Ok(view);
    }
    let share = averted as f64 / angles.len() as f64;
    let middle = angles.len() / 2;
    let median = f64::from(*angles.select_nth_unstable_by(middle, f32::total_cmp).1);
    if share > MAX_AVERTED || median > MAX_CONTRADICTION_DEG {
        return Err(Failure::input(
            path,
            format!(
                "the normals contradict the depths ({median:.0} degrees at the median, {:.0} % look \
                 away from the camera); they must be in the camera's frame, x right, y down, z \
                 forward, towards the camera",
                100.0 * share
            ),
        ));
    }
    Ok(view)
}

/// Normals from the depths: the cross product of the central differences of the points.
fn slopes(depth: &DepthMap, camera: &Intrinsics) -> NormalMap {
    let point = |x: usize, y: usize| -> Option<Vector3<f64>> {
        let z = f64::from(*depth.at(x, y));
        let pixel = nalgebra::Point2::new(x as f64, y as f64);
        (z.is_finite() && z > 0.0).then(|| camera.unproject(&pixel, z).coords)
    };
    NormalMap::from_fn(depth.width, depth.height, |x, y| {
        let normal = || -> Option<Vector3<f64>> {
            let here = point(x, y)?;
            // The longest difference that has a value at both ends.
            let along =
                |before: Option<Vector3<f64>>, after: Option<Vector3<f64>>| match (before, after) {
                    (Some(a), Some(b)) => Some(b - a),
                    (Some(a), None) => Some(here - a),
                    (None, Some(b)) => Some(b - here),
                    (None, None) => None,
                };
            let at = |x: Option<usize>, y: Option<usize>| {
                let (x, y) = (x?, y?);
                (x < depth.width && y < depth.height).then(|| point(x, y))?
            };
            let across = along(at(x.checked_sub(1), Some(y)), at(Some(x + 1), Some(y)))?;
            let down = along(at(Some(x), y.checked_sub(1)), at(Some(x), Some(y + 1)))?;
            let normal = across.cross(&down).try_normalize(0.0)?;
            Some(if normal.dot(&here) > 0.0 {
                -normal
            } else {
                normal
            })
        };
        normal().map_or([0.0; 3], |n| n.map(|c| c as f32).into())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_of_a_plane_are_its_normal() {
        let camera = Intrinsics::pinhole(20, 16, 30.0, 9.5, 7.5);
        let normal = Vector3::new(0.3, -0.2, -1.0).normalize();
        let mut depth = DepthMap::from_fn(20, 16, |x, y| {
            let ray = camera.ray(&nalgebra::Point2::new(x as f64, y as f64));
            (-2.0 / normal.dot(&ray)) as f32
        });
        *depth.at_mut(4, 4) = f32::NAN;
        let found = slopes(&depth, &camera);
        for (i, n) in found.data.iter().enumerate() {
            let error = (Vector3::from(n.map(f64::from)) - normal).norm();
            assert!(error < 1e-4 || i == 4 * 20 + 4, "{i}: {n:?}");
        }
        assert_eq!(*found.at(4, 4), [0.0; 3]);
    }
}
