//! Where the table's views come from: a folder laid out as `shading_table`, or two views of a bumpy
//! head made here, 15 degrees apart, for which the image model holds exactly.

use crate::{Failure, table};
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rilievo_scene::{
    DepthMap, Intrinsics, Lighting, LinearImage, NormalMap, RigidTransform, SphericalHarmonics,
};
use rilievo_shading::paper::{ShadingView, ViewLight};
use rilievo_synthetic::testing::{Maps, PAPER_LIGHT};
use std::path::PathBuf;
use std::sync::Arc;

/// Number of matches, as in the paper.
const NUM_MATCHES: usize = 173;
/// Half the side of the window that makes the rough start, pixels.
const ROUGH_RADIUS_PX: usize = 12;

/// The paper's three lightings, rows of channels.
const LIGHTS: [(&str, &[[f64; 9]]); 3] = [
    ("L1", &[[0.1, -0.25, -0.7, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]]),
    ("L2", &[[0.2, 0.3, -0.7, 0.5, -0.2, -0.2, 0.3, 0.3, 0.2]]),
    ("L3", &PAPER_LIGHT),
];

/// Semi-axes of the head, and the cameras' distance from its middle.
const AXES: [f64; 3] = [0.8, 1.0, 0.85];
const DISTANCE: f64 = 4.0;

/// One view of the head: exact depth and normals.
pub struct Rendered {
    camera: Intrinsics,
    cam_from_world: RigidTransform,
    maps: Maps,
}

/// Negative inside the head: an ellipsoid with bumps that hide each other.
fn implicit(p: &Point3<f64>) -> f64 {
    let [a, b, c] = AXES;
    let whole = (p.x / a).powi(2) + (p.y / b).powi(2) + (p.z / c).powi(2) - 1.0;
    let bumps = (7.0 * p.x + 1.0).sin() * (6.0 * p.y).sin() * (6.0 * p.z + 2.0).cos();
    let relief = (19.0 * p.x).sin() * (17.0 * p.y + 0.5).sin() * (18.0 * p.z).cos();
    whole + 0.16 * bumps + 0.03 * relief
}

/// Depth and normal (camera frame) where a pixel's ray first meets the head.
fn hit(
    camera: &Intrinsics,
    cam_from_world: &RigidTransform,
    [x, y]: [f64; 2],
) -> Option<(f64, Vector3<f64>)> {
    let world_from_cam = cam_from_world.inverse();
    let pixel = Point2::new(x, y);
    let at = |z: f64| world_from_cam.apply(&camera.unproject(&pixel, z));
    // The head lies within 1.2 of its middle.
    let step = 0.01;
    let mut steps = (0..240).map(|k| DISTANCE - 1.2 + step * f64::from(k));
    let mut far = steps.find(|&z| implicit(&at(z)) <= 0.0)?;
    let mut near = far - step;
    for _ in 0..40 {
        let middle = 0.5 * (near + far);
        if implicit(&at(middle)) > 0.0 {
            near = middle;
        } else {
            far = middle;
        }
    }
    let (point, h) = (at(far), 1e-5);
    let slope = |axis: Vector3<f64>| implicit(&(point + axis * h)) - implicit(&(point - axis * h));
    let gradient = Vector3::new(
        slope(Vector3::x()),
        slope(Vector3::y()),
        slope(Vector3::z()),
    );
    Some((far, (cam_from_world.rotation * gradient).normalize()))
}

impl Rendered {
    /// A view from an angle around the head's vertical axis.
    fn new(azimuth_deg: f64) -> Self {
        let camera = Intrinsics::pinhole(560, 640, 1100.0, 279.5, 319.5);
        let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), azimuth_deg.to_radians());
        let center = rotation * Point3::new(0.0, 0.0, -DISTANCE);
        let cam_from_world = RigidTransform::from_world_pose(rotation, center);
        Self {
            camera,
            cam_from_world,
            maps: Maps::of(&camera, |pixel| hit(&camera, &cam_from_world, pixel)),
        }
    }
}

/// Points of the first view where the second one sees them.
fn true_matches([first, second]: &[Rendered; 2]) -> Vec<[f64; 4]> {
    let (width, height) = (first.camera.width, first.camera.height);
    let pixels = (0..100 * NUM_MATCHES).map(|k| ((k * 7919) % width, (k * 104_729 / 7) % height));
    let on_head = pixels.filter(|&(x, y)| *first.maps.mask.at(x, y));
    let matched = on_head.filter_map(|(x, y)| {
        let (x, y) = (x as f64, y as f64);
        let (z, _) = hit(&first.camera, &first.cam_from_world, [x, y])?;
        let in_first = first.camera.unproject(&Point2::new(x, y), z);
        let world = first.cam_from_world.inverse().apply(&in_first);
        let there = second.cam_from_world.apply(&world);
        let pixel = second.camera.project(&there)?;
        let (seen, _) = hit(&second.camera, &second.cam_from_world, [pixel.x, pixel.y])?;
        ((seen - there.z).abs() < 1e-6).then_some([x, y, pixel.x, pixel.y])
    });
    matched.take(NUM_MATCHES).collect()
}

/// Two views with their truth.
pub enum Source {
    /// `view1` and `view2` of a folder.
    Folder(PathBuf),
    /// Views made here, named alike, and their matches.
    Made(Box<[Rendered; 2]>, Vec<[f64; 4]>),
}

impl Source {
    /// Two views of the head.
    pub fn made() -> Self {
        let views = [Rendered::new(-7.5), Rendered::new(7.5)];
        let matches = true_matches(&views);
        Self::Made(Box::new(views), matches)
    }

    /// A view under one of the lightings; the start is `flat`, `rough` or `true`.
    pub fn view(&self, name: &str, light: &str, start: &str) -> Result<ShadingView, Failure> {
        let views = match self {
            Self::Folder(folder) => return table::view(folder, name, light, start),
            Self::Made(views, _) => views,
        };
        let Rendered {
            camera,
            cam_from_world,
            maps,
        } = &views[usize::from(name != "view1")];
        let known = LIGHTS.iter().find(|(known, _)| *known == light);
        let (_, rows) = known.ok_or("a lighting is L1, L2 or L3")?;
        let channels: Vec<_> = rows.iter().map(|&row| SphericalHarmonics(row)).collect();
        let mut image = LinearImage::filled(camera.width, camera.height, channels.len(), 0.0);
        for (values, normal) in image.data.chunks_mut(channels.len()).zip(&maps.normal.data) {
            let n = Vector3::from(normal.map(f64::from));
            for (value, row) in values.iter_mut().zip(&channels) {
                *value = n
                    .try_normalize(0.0)
                    .map_or(0.0, |n| row.evaluate(&n) as f32);
            }
        }
        let light = ViewLight::Uniform(Lighting { channels });
        let mut view = ShadingView::new(name, Arc::new(image), maps.mask.clone(), *camera, light);
        view.cam_from_world = Some(*cam_from_world);
        view.initial_depth = Some(match start {
            "flat" => flat(&maps.depth),
            "rough" => rough(&maps.depth),
            _ => maps.depth.clone(),
        });
        Ok(view)
    }

    /// Matches of the two views.
    pub fn matches(&self) -> Result<Vec<[f64; 4]>, Failure> {
        match self {
            Self::Folder(folder) => table::matches(folder),
            Self::Made(_, matches) => Ok(matches.clone()),
        }
    }

    /// True normals and depth of a view.
    pub fn truth(&self, name: &str) -> Result<(NormalMap, DepthMap), Failure> {
        match self {
            Self::Folder(folder) => Ok((
                table::true_normals(folder, name)?,
                rilievo_io::read_depth(&folder.join(name).join("depth_true.exr"))?,
            )),
            Self::Made(views, _) => {
                let maps = &views[usize::from(name != "view1")].maps;
                Ok((maps.normal.clone(), maps.depth.clone()))
            }
        }
    }
}

/// A fronto-parallel plane at the median depth.
fn flat(depth: &DepthMap) -> DepthMap {
    let mut known: Vec<f32> = depth.data.iter().copied().filter(|&z| z > 0.0).collect();
    known.sort_by(f32::total_cmp);
    let middle = known.get(known.len() / 2).copied().unwrap_or(1.0);
    DepthMap::from_fn(depth.width, depth.height, |x, y| {
        if *depth.at(x, y) > 0.0 { middle } else { 0.0 }
    })
}

/// Depth averaged three times over windows, inside the mask.
fn rough(depth: &DepthMap) -> DepthMap {
    let radius = ROUGH_RADIUS_PX as isize;
    let mut map = depth.clone();
    for pass in 0..6 {
        map = DepthMap::from_fn(map.width, map.height, |x, y| {
            if *depth.at(x, y) <= 0.0 {
                return 0.0;
            }
            let (x, y) = (x as isize, y as isize);
            let near = (-radius..=radius).filter_map(|by| match pass % 2 {
                0 => map.get(x + by, y),
                _ => map.get(x, y + by),
            });
            let (sum, count) = near
                .filter(|&&z| z > 0.0)
                .fold((0.0, 0.0), |(sum, count), z| (sum + z, count + 1.0));
            sum / count
        });
    }
    map
}
