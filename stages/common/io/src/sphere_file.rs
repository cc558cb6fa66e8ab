//! The reference spheres as the user describes them: `--sphere FILE.json`.
//!
//! ```text
//! {"radius": 0.04, "unit": "metre", "light": "world" | "camera",
//!  "views": {"IMG_0003.jpg": {"mask": "sphere_masks/IMG_0003.png"}
//!           , "IMG_0004.jpg": {"ellipse": [cx, cy, semi_a, semi_b, angle_deg]}
//!           , "IMG_0005.jpg": {"circle": [cx, cy, r]}, "IMG_0006.jpg": {"points": [[x,y], ... 5 or more]}},
//!  "center": [x, y, z],
//!  "calibration": [{"image": "calibration/CAL_0001.jpg", "same_camera_as": "IMG_0004.jpg", "radius": 0.09, "mask": "..."}]}
//! ```
//! Several spheres stand in a list instead of `views` and `center`; one without a radius has the
//! file's:
//! ```text
//! {"radius": 0.04, "spheres": [{"views": {...}}, {"name": "left", "radius": 0.03, "views": {...}, "center": [...]}]}
//! ```
//! Paths are relative to the file; photos are named with or without ending; marks are in pixels
//! with centres at integers.

use crate::cameras::{last_part, stem};
use crate::error::IoError;
use crate::json::{self, Node};
use crate::mask::read_mask;
use nalgebra::Point3;
use rilievo_scene::{
    LightKind, LinearImage, MarkedSphere, Orientation, Photo, PhotoIdx, PhotoSet,
    SphereCalibration, SphereMark, SphereRequest, Unit,
};
use std::collections::HashSet;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Fewest points that determine an ellipse.
const MIN_NUM_POINTS: usize = 5;
/// Most spheres of a file. Each is fitted in every photo, which takes a tenth of a second or more, and
/// nobody places as many beside an object: a longer list was made by mistake.
pub const MAX_NUM_SPHERES: usize = 64;
/// Radii that can be meant, in whatever unit of length: beyond, sums of squares lose the smaller term.
pub const SPHERE_RADII: RangeInclusive<f64> = 1e-6..=1e6;
/// Largest coordinate of a centre, for the same reason.
const MAX_COORDINATE: f64 = 1e9;
/// Smallest radius of an outline, pixels: a smaller one lies within one pixel.
const MIN_OUTLINE_PX: f64 = 1.0;

/// A photo of a sphere in the object's place, as the file names it.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFileCalibration {
    /// The photo, with the file's folder before it.
    pub image: PathBuf,
    /// The photo of the set taken by the same camera in the same place.
    pub same_camera_as: String,
    /// Radius in the file's unit.
    pub radius: f64,
    /// Outline, where given.
    pub mark: Option<SphereMark>,
}

/// A sphere beside the object, as the file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFileEntry {
    /// What messages call it.
    pub name: String,
    /// Radius in the file's unit.
    pub radius: f64,
    /// Outlines by photo (named with or without ending).
    pub views: Vec<(String, SphereMark)>,
    /// Centre in the frame of the given cameras.
    pub center: Option<[f64; 3]>,
    /// Its place in the file, for messages: `spheres[1].`, or nothing for the only one.
    pub key: String,
}

/// A sphere file.
#[derive(Clone, Debug, PartialEq)]
pub struct SphereFile {
    /// The file.
    pub path: PathBuf,
    /// Unit of the radii.
    pub unit: Unit,
    /// What the light is fixed to, where the file says so.
    pub light: Option<LightKind>,
    /// The spheres beside the object.
    pub spheres: Vec<SphereFileEntry>,
    /// Calibration photos.
    pub calibration: Vec<SphereFileCalibration>,
    /// Every further file that was read or is named: masks and calibration photos, in order.
    pub files: Vec<PathBuf>,
    /// Masks that mark nothing and were left out, with the reason.
    pub left_out: Vec<(PathBuf, String)>,
}

/// What a sphere file asks for in a set of photos.
#[derive(Clone, Debug, Default)]
pub struct SpheresInSet {
    /// The spheres, marked in the frame of the pixels as stored.
    pub request: SphereRequest,
    /// Photos that the file names and the set lacks.
    pub absent: Vec<String>,
    /// Photos whose marks were drawn over the photo as EXIF turns it, and were turned back.
    pub upright: Vec<String>,
    /// Whether that cannot be told, since the marks fit the photos either way: they were taken as they are.
    pub may_be_upright: bool,
}

/// A name, and what it is without folder and without ending: either may be meant.
fn meant(name: &str) -> [&str; 3] {
    [name, last_part(name), stem(name)]
}

/// A photo of the set by its name with or without ending or folder.
fn find_photo(photos: &PhotoSet, name: &str) -> Option<PhotoIdx> {
    meant(name).iter().find_map(|name| photos.find(name))
}

/// Whether a mark's photo, named with or without ending or folder, is the one of a file name and its stem.
pub fn is_mark_of(name: &str, file_name: &str, stem: &str) -> bool {
    let mut meant = meant(name).into_iter();
    meant.any(|name| name == file_name || name == stem)
}

impl SphereFile {
    /// Puts another radius in the place of the file's, which comes back, where the file has one.
    ///
    /// # Errors
    /// When the file's spheres differ in radius.
    pub fn replace_radius(&mut self, radius: f64) -> Result<Option<f64>, IoError> {
        let mut radii = self.spheres.iter().map(|sphere| sphere.radius);
        let first = radii.next();
        if radii.any(|other| Some(other) != first) {
            return Err(IoError::input(
                &self.path,
                "its spheres differ in radius: none can be stated beside the file",
            ));
        }
        for sphere in &mut self.spheres {
            sphere.radius = radius;
        }
        Ok(first)
    }

    /// Whether the marks were drawn over photos as EXIF turns them: some fit their photos only so, and none
    /// only in the frame of the pixels as stored. What draws marks turns all photos or none. `None` where photos are
    /// turned and the marks fit either way.
    fn is_upright(&self, photos: &PhotoSet) -> Option<bool> {
        let marks = self.spheres.iter().flat_map(|sphere| &sphere.views);
        let (mut only_stored, mut only_upright, mut either) = (0, 0, 0);
        for (name, mark) in marks {
            let Some(photo) = find_photo(photos, name) else {
                continue;
            };
            let Photo {
                intrinsics,
                orientation,
                ..
            } = &photos.photos[photo.0];
            if *orientation == Orientation::UPRIGHT {
                continue;
            }
            let stored = (intrinsics.width, intrinsics.height);
            let fits = [stored, orientation.upright_size(stored)]
                .map(|(width, height)| check_frame(mark, width, height).is_ok());
            match fits {
                [true, false] => only_stored += 1,
                [false, true] => only_upright += 1,
                _ => either += 1,
            }
        }
        // One among many is a slip of the pen, and refused.
        if only_stored == 0 && 8 * only_upright > either {
            Some(true)
        } else if only_stored == 0 && either > 0 {
            None
        } else {
            Some(false)
        }
    }

    /// The request for a set of photos; `calibration_images` are the calibration photos, linear,
    /// in the file's order. The set may be a part of what the file describes. Marks are in pixels as stored,
    /// or all of them upright; those of calibration photos are in pixels as stored.
    ///
    /// # Errors
    /// When a calibration photo names a photo that the set lacks, its image is missing, or a mask
    /// has not its photo's size.
    pub fn to_request(
        &self,
        photos: &PhotoSet,
        calibration_images: Vec<LinearImage>,
    ) -> Result<SpheresInSet, IoError> {
        let mut in_set = SpheresInSet::default();
        let SpheresInSet {
            request,
            absent,
            upright,
            may_be_upright,
        } = &mut in_set;
        request.light = self.light;
        let is_upright = self.is_upright(photos);
        *may_be_upright = is_upright.is_none();
        for entry in &self.spheres {
            let mut sphere = MarkedSphere {
                name: entry.name.clone(),
                radius: entry.radius,
                marks: Vec::new(),
                center_in_world: entry.center.map(Point3::from),
            };
            for (name, mark) in &entry.views {
                let Some(photo) = find_photo(photos, name) else {
                    if !absent.contains(name) {
                        absent.push(name.clone());
                    }
                    continue;
                };
                let Photo {
                    intrinsics,
                    orientation,
                    file_name,
                    ..
                } = &photos.photos[photo.0];
                let stored = (intrinsics.width, intrinsics.height);
                let mark = if is_upright == Some(true) && *orientation != Orientation::UPRIGHT {
                    if !upright.contains(file_name) {
                        upright.push(file_name.clone());
                    }
                    orientation.mark_to_stored(mark, stored)
                } else {
                    mark.clone()
                };
                check_frame(&mark, stored.0, stored.1).map_err(|reason| {
                    IoError::input(&self.path, format!("{}views.{name}: {reason}", entry.key))
                })?;
                sphere.marks.push((photo, mark));
            }
            sphere.marks.sort_by_key(|(photo, _)| *photo);
            request.spheres.push(sphere);
        }
        if calibration_images.len() != self.calibration.len() {
            return Err(IoError::input(
                &self.path,
                format!(
                    "names {} calibration photos, of which {} were read",
                    self.calibration.len(),
                    calibration_images.len()
                ),
            ));
        }
        for (i, (entry, image)) in self.calibration.iter().zip(calibration_images).enumerate() {
            let refuse =
                |reason: String| IoError::input(&self.path, format!("calibration[{i}]{reason}"));
            let photo = find_photo(photos, &entry.same_camera_as).ok_or_else(|| {
                refuse(format!(
                    ".same_camera_as: \"{}\" is none of the photos",
                    entry.same_camera_as
                ))
            })?;
            let camera = &photos.photos[photo.0].intrinsics;
            if (image.width, image.height) != (camera.width, camera.height) {
                return Err(refuse(format!(
                    ".image: {} x {} pixels, but {} has {} x {}",
                    image.width, image.height, entry.same_camera_as, camera.width, camera.height
                )));
            }
            if let Some(mark) = &entry.mark {
                check_frame(mark, image.width, image.height)
                    .map_err(|reason| refuse(format!(": {reason}")))?;
            }
            request.calibration.push(SphereCalibration {
                image,
                name: last_part(&entry.image.to_string_lossy()).to_owned(),
                same_camera_as: photo,
                radius: entry.radius,
                mark: entry.mark.clone(),
            });
        }
        Ok(in_set)
    }
}

/// Whether a mark is of a photo of this size: a mask has its size, any other reaches into it.
fn check_frame(mark: &SphereMark, width: usize, height: usize) -> Result<(), String> {
    let reaches = |x: [f64; 2], y: [f64; 2]| {
        x[1] >= -0.5 && x[0] <= width as f64 - 0.5 && y[1] >= -0.5 && y[0] <= height as f64 - 0.5
    };
    let around = |c: &[f64; 2], r: f64| reaches([c[0] - r, c[0] + r], [c[1] - r, c[1] + r]);
    let inside = match mark {
        SphereMark::Mask(mask) if (mask.width, mask.height) != (width, height) => {
            return Err(format!(
                "the sphere's mask has {} x {} pixels, the photo {width} x {height}",
                mask.width, mask.height
            ));
        }
        SphereMark::Mask(_) => true,
        SphereMark::Circle {
            center_px,
            radius_px,
        } => around(center_px, *radius_px),
        SphereMark::Ellipse {
            center_px,
            semi_axes_px: [a, b],
            ..
        } => around(center_px, a.max(*b)),
        SphereMark::Points(points) => points.iter().any(|&[x, y]| reaches([x, x], [y, y])),
    };
    if inside {
        Ok(())
    } else {
        Err(format!(
            "the mark lies outside the photo, which has {width} x {height} pixels"
        ))
    }
}

/// Why a mask is no mark of a sphere; other marks are.
fn unusable(mark: &SphereMark) -> Option<String> {
    let SphereMark::Mask(mask) = mark else {
        return None;
    };
    let count = mask.count();
    if count < MIN_NUM_POINTS {
        Some(format!("the sphere's mask has {count} white pixels"))
    } else if count == mask.data.len() {
        Some("the sphere's mask is white everywhere".to_owned())
    } else {
        None
    }
}

/// Reads a sphere file with the masks that it names.
///
/// # Errors
/// When a file cannot be read or holds a value that cannot be used; names the key.
pub fn read_sphere_file(path: &Path) -> Result<SphereFile, IoError> {
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut named = Named::default();

    let unit = match root.opt("unit")? {
        Some(_) => crate::cameras::unit(&root)?,
        None => Unit::Metre,
    };
    let light = root.opt_as("light", |node| match node.text()? {
        "world" => Ok(LightKind::World),
        "camera" => Ok(LightKind::Camera),
        _ => Err(node.refuse("is neither \"world\" nor \"camera\"")),
    })?;
    let radius = root.opt_as("radius", radius_of)?;
    let spheres = spheres(&root, radius, folder, &mut named)?;
    let mut calibration = Vec::new();
    for node in root.list("calibration")? {
        let image = folder.join(node.get("image")?.text()?);
        named.files.push(image.clone());
        let own_radius = node.opt_as("radius", radius_of)?.or(radius);
        let mark = mark(&node, folder, &mut named.files)?;
        if let (Some(reason), Some(file)) = (mark.as_ref().and_then(unusable), named.files.last()) {
            return Err(IoError::input(file, reason));
        }
        calibration.push(SphereFileCalibration {
            image,
            same_camera_as: node.get("same_camera_as")?.text()?.to_owned(),
            radius: own_radius.ok_or_else(|| node.refuse("has no \"radius\""))?,
            mark,
        });
    }
    if spheres.is_empty() && calibration.is_empty() {
        return Err(IoError::input(
            path,
            "has neither \"views\" nor \"center\" nor \"spheres\" nor \"calibration\": nothing \
             says where the sphere is",
        ));
    }
    let nothing_left = |s: &SphereFileEntry| s.views.is_empty() && s.center.is_none();
    if calibration.is_empty() && spheres.iter().all(nothing_left) {
        let reasons = named.left_out.iter();
        let reasons: Vec<String> = reasons
            .map(|(file, reason)| format!("{}: {reason}", file.display()))
            .collect();
        return Err(IoError::input(
            path,
            format!(
                "no mark of the sphere is left: {}; paint the sphere white in its masks",
                reasons.join("; ")
            ),
        ));
    }
    Ok(SphereFile {
        path: path.to_path_buf(),
        unit,
        light,
        spheres,
        calibration,
        files: named.files,
        left_out: named.left_out,
    })
}

/// Files that a sphere file names.
#[derive(Default)]
struct Named {
    files: Vec<PathBuf>,
    left_out: Vec<(PathBuf, String)>,
}

/// A radius that a sphere can have.
fn radius_of(node: &Node<'_>) -> Result<f64, IoError> {
    let radius = node.positive()?;
    if SPHERE_RADII.contains(&radius) {
        Ok(radius)
    } else {
        Err(node.refuse(format!(
            "is no sphere's radius: {:e} to {:e} can be meant; state it in metres",
            SPHERE_RADII.start(),
            SPHERE_RADII.end()
        )))
    }
}

/// The spheres of a list, or the only one of the top level.
fn spheres(
    root: &Node<'_>,
    common_radius: Option<f64>,
    folder: &Path,
    named: &mut Named,
) -> Result<Vec<SphereFileEntry>, IoError> {
    let Some(list) = root.opt("spheres")? else {
        let name = MarkedSphere::ONLY.to_owned();
        let only = entry(root, name, common_radius, folder, named)?;
        return Ok(only.into_iter().collect());
    };
    if root.opt("views")?.is_some() || root.opt("center")?.is_some() {
        return Err(list.refuse("stands beside \"views\" or \"center\": move those into the list"));
    }
    let nodes = list.array()?;
    if nodes.is_empty() {
        return Err(list.refuse("names no sphere"));
    }
    if nodes.len() > MAX_NUM_SPHERES {
        return Err(IoError::input(
            root.file,
            format!(
                "spheres: names {} spheres, of which {MAX_NUM_SPHERES} at most are taken: each is \
                 fitted in every photo; two or three on different sides of the object serve",
                nodes.len()
            ),
        ));
    }
    let mut spheres = Vec::with_capacity(nodes.len());
    let mut names = HashSet::new();
    for (k, node) in nodes.iter().enumerate() {
        let name = match node.opt("name")? {
            Some(name) => format!("sphere \"{}\"", name.text()?),
            None if nodes.len() == 1 => MarkedSphere::ONLY.to_owned(),
            None => format!("sphere {}", k + 1),
        };
        if !names.insert(name.clone()) {
            return Err(node.get("name")?.refuse("names another sphere already"));
        }
        let sphere = entry(node, name, common_radius, folder, named)?.ok_or_else(|| {
            node.refuse("has neither \"views\" nor \"center\": nothing says where it is")
        })?;
        spheres.push(sphere);
    }
    Ok(spheres)
}

/// The sphere that an object describes; `None` where it says nothing of its place.
fn entry(
    node: &Node<'_>,
    name: String,
    common_radius: Option<f64>,
    folder: &Path,
    named: &mut Named,
) -> Result<Option<SphereFileEntry>, IoError> {
    let mut views = Vec::new();
    let list = node.opt_as("views", Node::members)?.unwrap_or_default();
    let is_marked = !list.is_empty();
    for (name, node) in list {
        let mark = mark(&node, folder, &mut named.files)?.ok_or_else(|| {
            node.refuse("has none of \"mask\", \"ellipse\", \"circle\" and \"points\"")
        })?;
        if let (Some(reason), Some(file)) = (unusable(&mark), named.files.last()) {
            let left_out = (file.clone(), reason);
            // One file may stand for several photos.
            if !named.left_out.contains(&left_out) {
                named.left_out.push(left_out);
            }
            continue;
        }
        views.push((name.to_owned(), mark));
    }
    let center = node.opt_as("center", |node| {
        let center: [f64; 3] = node.numbers()?;
        if center.iter().any(|x| x.abs() > MAX_COORDINATE) {
            return Err(node.refuse(format!(
                "is no place beside the object: a coordinate exceeds {MAX_COORDINATE:e}"
            )));
        }
        Ok(center)
    })?;
    let radius = node.opt_as("radius", radius_of)?.or(common_radius);
    if !is_marked && center.is_none() {
        return Ok(None);
    }
    let key = match node.key.as_str() {
        "" => String::new(),
        key => format!("{key}."),
    };
    let Some(radius) = radius else {
        return Err(IoError::input(
            node.file,
            format!(
                "the key \"{key}radius\" is missing: measure the sphere and state its radius, in \
                 metres or with a \"unit\""
            ),
        ));
    };
    Ok(Some(SphereFileEntry {
        name,
        radius,
        views,
        center,
        key,
    }))
}

/// The mark of a view, where the object has one; two contradict each other. A mask is the last of the
/// files then, and may mark nothing.
fn mark(
    node: &Node<'_>,
    folder: &Path,
    files: &mut Vec<PathBuf>,
) -> Result<Option<SphereMark>, IoError> {
    let mut marks = Vec::new();
    if let Some(mask) = node.opt("mask")? {
        let file = folder.join(mask.text()?);
        let pixels = read_mask(&file)?;
        files.push(file);
        marks.push(SphereMark::Mask(pixels));
    }
    let check_size = |node: &Node<'_>, size: f64, what: &str| {
        if size <= 0.0 {
            return Err(node.refuse(format!("has a {what} that is not greater than zero")));
        }
        if size < MIN_OUTLINE_PX {
            return Err(node.refuse(format!("has a {what} of less than a pixel")));
        }
        Ok(())
    };
    if let Some(ellipse) = node.opt("ellipse")? {
        let [cx, cy, a, b, angle_deg] = ellipse.numbers()?;
        check_size(&ellipse, a.min(b), "semi-axis")?;
        marks.push(SphereMark::Ellipse {
            center_px: [cx, cy],
            semi_axes_px: [a, b],
            angle_rad: angle_deg.to_radians(),
        });
    }
    if let Some(circle) = node.opt("circle")? {
        let [cx, cy, radius_px] = circle.numbers()?;
        check_size(&circle, radius_px, "radius")?;
        marks.push(SphereMark::Circle {
            center_px: [cx, cy],
            radius_px,
        });
    }
    if let Some(points) = node.opt("points")? {
        let list = points
            .array()?
            .iter()
            .map(Node::numbers)
            .collect::<Result<Vec<[f64; 2]>, _>>()?;
        if list.len() < MIN_NUM_POINTS {
            return Err(points.refuse(format!(
                "has {} points; an ellipse takes {MIN_NUM_POINTS} or more",
                list.len()
            )));
        }
        marks.push(SphereMark::Points(list));
    }
    if marks.len() > 1 {
        return Err(node.refuse("marks the sphere in more than one way; keep one"));
    }
    Ok(marks.pop())
}

#[cfg(test)]
mod tests;
