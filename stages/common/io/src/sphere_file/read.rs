//! Reading a sphere file with the masks that it names.

use super::file::{
    MAX_NUM_SPHERES, SPHERE_RADII, SphereFile, SphereFileCalibration, SphereFileEntry,
};
use crate::error::IoError;
use crate::json::{self, Node};
use crate::mask::read_mask;
use rilievo_scene::{LightKind, MarkedSphere, SphereMark, Unit};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Fewest points that determine an ellipse.
const MIN_NUM_POINTS: usize = 5;
/// Largest coordinate of a centre: beyond, sums of squares lose the smaller term.
const MAX_COORDINATE: f64 = 1e9;
/// Smallest radius of an outline, pixels: a smaller one lies within one pixel.
const MIN_OUTLINE_PX: f64 = 1.0;

/// Reads a sphere file with the masks that it names.
///
/// # Errors
/// When a file cannot be read or holds a value that cannot be used; names the key.
pub fn read_sphere_file(path: &Path) -> Result<SphereFile, IoError> {
    let value = json::read(path)?;
    let root = Node::root(path, &value);
    let unit = match root.opt("unit")? {
        Some(_) => crate::cameras::unit(&root)?,
        None => Unit::Metre,
    };
    let light = root.opt_as("light", |node| match node.text()? {
        "world" => Ok(LightKind::World),
        "camera" => Ok(LightKind::Camera),
        _ => Err(node.refuse("is neither \"world\" nor \"camera\"")),
    })?;
    let mut reader = Reader {
        folder: path.parent().unwrap_or(Path::new("")),
        radius: root.opt_as("radius", radius_of)?,
        files: Vec::new(),
        left_out: Vec::new(),
    };
    let mut spheres = reader.spheres(&root)?;
    let calibration = root.list("calibration")?;
    let calibration = calibration.iter().map(|node| reader.calibration(node));
    let mut calibration = calibration.collect::<Result<Vec<_>, _>>()?;
    let metres = unit.metres().unwrap_or(1.0);
    let radii = spheres.iter_mut().map(|sphere| &mut sphere.radius);
    for radius in radii.chain(calibration.iter_mut().map(|c| &mut c.radius)) {
        *radius *= metres;
    }
    if spheres.is_empty() && calibration.is_empty() {
        return Err(IoError::input(
            path,
            "has neither \"views\" nor \"center\" nor \"spheres\" nor \"calibration\": nothing \
             says where the sphere is",
        ));
    }
    let is_empty = |s: &SphereFileEntry| s.views.is_empty() && s.center.is_none();
    if calibration.is_empty() && spheres.iter().all(is_empty) {
        let reasons = reader.left_out.iter();
        let reasons: Vec<String> = reasons
            .map(|(file, reason)| format!("{}: {reason}", file.display()))
            .collect();
        let reasons = reasons.join("; ");
        return Err(IoError::input(
            path,
            format!(
                "no mark of the sphere is left: {reasons}; paint the sphere white in its masks"
            ),
        ));
    }
    Ok(SphereFile {
        path: path.to_path_buf(),
        unit: unit.metres().map_or(unit, |_| Unit::Metre),
        light,
        spheres,
        calibration,
        files: reader.files,
        left_out: reader.left_out,
    })
}

/// A radius that a sphere can have.
fn radius_of(node: &Node<'_>) -> Result<f64, IoError> {
    let radius = node.positive()?;
    if SPHERE_RADII.contains(&radius) {
        return Ok(radius);
    }
    let (least, most) = (SPHERE_RADII.start(), SPHERE_RADII.end());
    Err(node.refuse(format!(
        "is no sphere's radius: {least:e} to {most:e} can be meant; state it in metres"
    )))
}

/// Why a mask is no mark of a sphere; other marks are.
fn unusable(mark: &SphereMark) -> Option<String> {
    let SphereMark::Mask(mask) = mark else {
        return None;
    };
    match mask.count() {
        count if count < MIN_NUM_POINTS => {
            Some(format!("the sphere's mask has {count} white pixels"))
        }
        count if count == mask.data.len() => {
            Some("the sphere's mask is white everywhere".to_owned())
        }
        _ => None,
    }
}

/// What is common to a file's spheres, and the files that they name.
struct Reader<'a> {
    folder: &'a Path,
    radius: Option<f64>,
    files: Vec<PathBuf>,
    left_out: Vec<(PathBuf, String)>,
}

impl Reader<'_> {
    /// The spheres of a list, or the only one of the top level.
    fn spheres(&mut self, root: &Node<'_>) -> Result<Vec<SphereFileEntry>, IoError> {
        let Some(list) = root.opt("spheres")? else {
            let only = self.entry(root, MarkedSphere::ONLY.to_owned())?;
            return Ok(only.into_iter().collect());
        };
        if root.opt("views")?.is_some() || root.opt("center")?.is_some() {
            return Err(
                list.refuse("stands beside \"views\" or \"center\": move those into the list")
            );
        }
        let nodes = list.array()?;
        if nodes.is_empty() {
            return Err(list.refuse("names no sphere"));
        }
        if nodes.len() > MAX_NUM_SPHERES {
            let num = nodes.len();
            return Err(IoError::input(
                root.file,
                format!(
                    "spheres: names {num} spheres, of which {MAX_NUM_SPHERES} at most are taken: each is \
                     fitted in every photo; two or three on different sides of the object serve"
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
            let sphere = self.entry(node, name)?.ok_or_else(|| {
                node.refuse("has neither \"views\" nor \"center\": nothing says where it is")
            })?;
            spheres.push(sphere);
        }
        Ok(spheres)
    }

    /// The sphere that an object describes; `None` where it has neither marks nor centre.
    fn entry(&mut self, node: &Node<'_>, name: String) -> Result<Option<SphereFileEntry>, IoError> {
        let mut views = Vec::new();
        let list = node.opt_as("views", Node::members)?.unwrap_or_default();
        let is_marked = !list.is_empty();
        for (name, node) in list {
            let mark = self.mark(&node)?.ok_or_else(|| {
                node.refuse("has none of \"mask\", \"ellipse\", \"circle\" and \"points\"")
            })?;
            let (Some(reason), Some(file)) = (unusable(&mark), self.files.last()) else {
                views.push((name.to_owned(), mark));
                continue;
            };
            let left_out = (file.clone(), reason);
            // One file may stand for several photos.
            if !self.left_out.contains(&left_out) {
                self.left_out.push(left_out);
            }
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
        let radius = node.opt_as("radius", radius_of)?.or(self.radius);
        if !is_marked && center.is_none() {
            return Ok(None);
        }
        let key = match node.key.as_str() {
            "" => String::new(),
            key => format!("{key}."),
        };
        let radius = radius.ok_or_else(|| {
            let reason = format!(
                "the key \"{key}radius\" is missing: measure the sphere and state its radius, in \
                 metres or with a \"unit\""
            );
            IoError::input(node.file, reason)
        })?;
        Ok(Some(SphereFileEntry {
            name,
            radius,
            views,
            center,
            key,
        }))
    }

    fn calibration(&mut self, node: &Node<'_>) -> Result<SphereFileCalibration, IoError> {
        let image = self.folder.join(node.get("image")?.text()?);
        self.files.push(image.clone());
        let radius = node.opt_as("radius", radius_of)?.or(self.radius);
        let mark = self.mark(node)?;
        if let (Some(reason), Some(file)) = (mark.as_ref().and_then(unusable), self.files.last()) {
            return Err(IoError::input(file, reason));
        }
        Ok(SphereFileCalibration {
            image,
            same_camera_as: node.get("same_camera_as")?.text()?.to_owned(),
            radius: radius.ok_or_else(|| node.refuse("has no \"radius\""))?,
            mark,
        })
    }

    /// The mark of a view, where the object has one; two contradict each other. A mask is the last
    /// of the files then, and may mark nothing.
    fn mark(&mut self, node: &Node<'_>) -> Result<Option<SphereMark>, IoError> {
        let mask = node.opt_as("mask", |mask| {
            let file = self.folder.join(mask.text()?);
            let pixels = read_mask(&file)?;
            self.files.push(file);
            Ok(SphereMark::Mask(pixels))
        })?;
        let ellipse = node.opt_as("ellipse", |ellipse| {
            let [cx, cy, a, b, angle_deg] = ellipse.numbers()?;
            check_size(ellipse, a.min(b), "semi-axis")?;
            Ok(SphereMark::Ellipse {
                center_px: [cx, cy],
                semi_axes_px: [a, b],
                angle_rad: angle_deg.to_radians(),
            })
        })?;
        let circle = node.opt_as("circle", |circle| {
            let [cx, cy, radius_px] = circle.numbers()?;
            check_size(circle, radius_px, "radius")?;
            Ok(SphereMark::Circle {
                center_px: [cx, cy],
                radius_px,
            })
        })?;
        let points = node.opt_as("points", |points| {
            let list = points.array()?;
            let list = list.iter().map(Node::numbers);
            let list = list.collect::<Result<Vec<[f64; 2]>, _>>()?;
            if list.len() < MIN_NUM_POINTS {
                let num = list.len();
                return Err(points.refuse(format!(
                    "has {num} points; an ellipse takes {MIN_NUM_POINTS} or more"
                )));
            }
            Ok(SphereMark::Points(list))
        })?;
        let mut marks = [mask, ellipse, circle, points].into_iter().flatten();
        match (marks.next(), marks.next()) {
            (_, Some(_)) => Err(node.refuse("marks the sphere in more than one way; keep one")),
            (mark, None) => Ok(mark),
        }
    }
}

fn check_size(node: &Node<'_>, size: f64, what: &str) -> Result<(), IoError> {
    if size <= 0.0 {
        return Err(node.refuse(format!("has a {what} that is not greater than zero")));
    }
    if size < MIN_OUTLINE_PX {
        return Err(node.refuse(format!("has a {what} of less than a pixel")));
    }
    Ok(())
}
