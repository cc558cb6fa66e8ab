//! Depth and normal maps of a folder, whichever program wrote them, with their cameras.
//!
//! | kind | recognised by | cameras |
//! |---|---|---|
//! | OpenMVS | `*.dmap` | in the files |
//! | COLMAP | `stereo/depth_maps` or `depth_maps` | `sparse` beside them, or `--cameras` |
//! | OpenEXR | `depth/NAME.exr`, or `NAME_depth.exr` | `cameras.json` beside them, or `--cameras` |

use crate::exit::{Failure, Problem};
use nalgebra::Vector3;
use rilievo_io::{
    CameraFile, CameraFormat, import_cameras, read_channel, read_colmap_depth, read_colmap_normal,
    read_depth, read_dmap, read_normal,
};
use rilievo_numerics::robust::median;
use rilievo_scene::{
    ConfidenceMap, DepthMap, Intrinsics, MapSource, NormalMap, PixelError, RigidTransform,
    ShadedImages, ShadedView, Unit, ViewIdx, WorldFrame, local_offset,
};
use std::path::{Path, PathBuf};

/// Share of the normals that may look away from their camera: noise at the rim.
const MAX_AVERTED: f64 = 0.1;
/// Median angle between normals and the depths' own slopes from which they are in another frame:
/// noise of the slopes alone stays below.
const MAX_CONTRADICTION_DEG: f64 = 45.0;

/// A view of another program: its camera, and where its maps are.
pub struct View {
    /// The photo's name, with its ending where it is known.
    pub image: String,
    /// Its camera.
    pub intrinsics: Intrinsics,
    /// Its pose, in the maps' unit.
    pub cam_from_world: RigidTransform,
    /// Whether the normals are the depths' slopes, since there was no map of them.
    pub normals_are_slopes: bool,
    /// Middle of the depths, in the maps' unit.
    pub median_depth: Option<f64>,
    files: Files,
}

/// Program that wrote the maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    OpenMvs,
    Colmap,
    OpenExr,
}

/// The views of a folder; the maps are read when they are asked for.
pub struct Views {
    format: Format,
    /// Unit of all lengths.
    pub unit: Unit,
    /// Where the world's axes lie.
    pub frame: WorldFrame,
    /// What is added to coordinates here for those of the cameras' world, in the maps' unit.
    pub offset: [f64; 3],
    /// The views, in the cameras' order.
    pub views: Vec<View>,
    /// Factor of all depths on the way out.
    pub factor: f64,
}

impl Views {
    /// Name of the format.
    pub fn format(&self) -> &'static str {
        match self.format {
            Format::OpenMvs => "OpenMVS",
            Format::Colmap => "COLMAP",
            Format::OpenExr => "OpenEXR",
        }
    }
}

impl MapSource for Views {
    fn num_views(&self) -> usize {
        self.views.len()
    }

    fn load(&self, idx: usize) -> Result<ShadedView, PixelError> {
        let view = &self.views[idx];
        let mut maps =
            Maps::read(self.format, &view.files, &view.intrinsics).map_err(|failure| {
                PixelError {
                    name: view.image.clone(),
                    reason: failure.to_string(),
                }
            })?;
        for z in &mut maps.depth.data {
            *z = (f64::from(*z) * self.factor) as f32;
        }
        Ok(ShadedView {
            view: ViewIdx(idx),
            name: name_of(&view.image),
            depth: maps.depth,
            normal: maps.normal,
            confidence: maps.confidence,
            rendered: None,
            albedo: None,
        })
    }

    fn images(&self, _: usize) -> Result<ShadedImages, PixelError> {
        Ok(ShadedImages::default())
    }
}

/// File name without its ending.
pub fn name_of(image: &str) -> String {
    Path::new(image).file_stem().map_or_else(
        || image.to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    )
}

/// Files of one view.
struct Files {
    depth: PathBuf,
    normal: PathBuf,
    confidence: Option<PathBuf>,
}

/// Maps of one view.
struct Maps {
    depth: DepthMap,
    normal: NormalMap,
    confidence: Option<ConfidenceMap>,
    normals_are_slopes: bool,
}

impl Maps {
    /// Reads the maps of a camera, all of the camera's size.
    fn read(format: Format, files: &Files, camera: &Intrinsics) -> Result<Self, Failure> {
        let (depth, normal) = match format {
            Format::OpenMvs => {
                let file = read_dmap(&files.depth)?;
                (file.depth, file.normal)
            }
            Format::Colmap => {
                let depth = read_colmap_depth(&files.depth)?;
                let there = files.normal.exists();
                let normal = there.then(|| read_colmap_normal(&files.normal));
                (depth, normal.transpose()?)
            }
            Format::OpenExr => {
                let depth = read_depth(&files.depth)?;
                let there = files.normal.exists();
                let normal = there.then(|| read_normal(&files.normal));
                (depth, normal.transpose()?)
            }
        };
        same_size(&files.depth, (depth.width, depth.height), camera)?;
        let normals_are_slopes = normal.is_none();
        let normal = normal.unwrap_or_else(|| slopes(&depth, camera));
        same_size(&files.normal, (normal.width, normal.height), camera)?;
        let confidence = files.confidence.as_ref().map(|path| {
            let map = read_channel(path, "C")?;
            same_size(path, (map.width, map.height), camera)?;
            Ok::<_, Failure>(map)
        });
        Ok(Self {
            depth,
            normal,
            confidence: confidence.transpose()?,
            normals_are_slopes,
        })
    }
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
        let file = read_dmap(path)?;
        let files = Files {
            depth: path.clone(),
            normal: path.clone(),
            confidence: None,
        };
        let camera = (file.image, file.intrinsics, file.cam_from_world);
        views.push(View::checked(Format::OpenMvs, files, camera)?);
    }
    let poses: Vec<RigidTransform> = views.iter().map(|view| view.cam_from_world).collect();
    let offset = local_offset(&poses, [0.0; 3]);
    for view in &mut views {
        view.cam_from_world = view.cam_from_world.with_origin_at(offset);
    }
    Ok(Views {
        format: Format::OpenMvs,
        unit: Unit::Arbitrary,
        frame: WorldFrame::Given,
        offset,
        views,
        factor: 1.0,
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
    assemble(Format::Colmap, folder, cameras, &find)
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
    assemble(Format::OpenExr, folder, cameras, &find)
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
    import_cameras(&path, format, None).map_err(Failure::from)
}

/// Views of all cameras that have a pose and maps.
fn assemble(
    format: Format,
    folder: &Path,
    mut cameras: CameraFile,
    find: &dyn Fn(&str) -> Option<Files>,
) -> Result<Views, Failure> {
    let world = cameras.localize([0.0; 3]);
    let mut views = Vec::new();
    for camera in &cameras.cameras {
        let (Some(image), Some(cam_from_world)) = (&camera.image, camera.cam_from_world) else {
            continue;
        };
        if let Some(files) = find(image) {
            let camera = (image.clone(), camera.intrinsics, cam_from_world);
            views.push(View::checked(format, files, camera)?);
        }
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
        unit: world.unit,
        frame: world.frame,
        offset: world.offset,
        views,
        factor: 1.0,
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

impl View {
    /// A view whose maps are there, of the camera's size, and in one frame.
    fn checked(
        format: Format,
        files: Files,
        (image, intrinsics, cam_from_world): (String, Intrinsics, RigidTransform),
    ) -> Result<Self, Failure> {
        let maps = Maps::read(format, &files, &intrinsics)?;
        if !maps.normals_are_slopes {
            check_frame(&files.normal, &maps, &intrinsics)?;
        }
        let depths = maps.depth.data.iter().step_by(17).copied();
        let mut depths: Vec<f64> = depths
            .filter(|z| z.is_finite() && *z > 0.0)
            .map(f64::from)
            .collect();
        Ok(Self {
            image,
            intrinsics,
            cam_from_world,
            normals_are_slopes: maps.normals_are_slopes,
            median_depth: median(&mut depths),
            files,
        })
    }
}

/// Refuses normals in another frame than the camera's.
fn check_frame(path: &Path, maps: &Maps, camera: &Intrinsics) -> Result<(), Failure> {
    let own = slopes(&maps.depth, camera);
    let (mut averted, mut angles) = (0_usize, Vec::new());
    for y in 0..maps.depth.height {
        for x in 0..maps.depth.width {
            let slope = Vector3::from(*own.at(x, y));
            let normal = Vector3::from(*maps.normal.at(x, y));
            if slope.norm() < 0.5 || !(0.9..1.1).contains(&normal.norm()) {
                continue;
            }
            let ray = camera.ray(&nalgebra::Point2::new(x as f64, y as f64));
            averted += usize::from(normal.map(f64::from).dot(&ray) > 0.0);
            angles.push(f64::from(normal.angle(&slope).to_degrees()));
        }
    }
    let share = averted as f64 / angles.len() as f64;
    let Some(contradiction) = median(&mut angles) else {
        return Ok(());
    };
    if share > MAX_AVERTED || contradiction > MAX_CONTRADICTION_DEG {
        return Err(Failure::input(
            path,
            format!(
                "the normals contradict the depths ({contradiction:.0} degrees at the median, {:.0} % look \
                 away from the camera); they must be in the camera's frame, x right, y down, z \
                 forward, towards the camera",
                100.0 * share
            ),
        ));
    }
    Ok(())
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
