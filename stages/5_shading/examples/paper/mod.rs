//! Where the table's views come from: a folder laid out as `shading_table`, or a head made here.

use crate::table::{Failure, read_matches, read_view};
use nalgebra::{Point3, Rotation3, Vector3};
use rilievo_scene::{
    DepthMap, Intrinsics, Lighting, LinearImage, Mask, NormalMap, RigidTransform,
    SphericalHarmonics,
};
use rilievo_shading::paper::{ShadingView, ViewLight};
use rilievo_synthetic::testing::PAPER_LIGHT;
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
    name: String,
    camera: Intrinsics,
    world_from_cam: Rotation3<f64>,
    depth: DepthMap,
    normal: NormalMap,
}

/// Negative inside the head: an ellipsoid with bumps that hide each other.
fn implicit(p: &Vector3<f64>) -> f64 {
    let [a, b, c] = AXES;
    let whole = (p.x / a).powi(2) + (p.y / b).powi(2) + (p.z / c).powi(2) - 1.0;
    let bumps = (7.0 * p.x + 1.0).sin() * (6.0 * p.y).sin() * (6.0 * p.z + 2.0).cos();
    let relief = (19.0 * p.x).sin() * (17.0 * p.y + 0.5).sin() * (18.0 * p.z).cos();
    whole + 0.16 * bumps + 0.03 * relief
}

impl Rendered {
    /// A view from an angle around the head's vertical axis.
    fn new(name: &str, azimuth_deg: f64) -> Self {
        let (width, height) = (560, 640);
        let camera = Intrinsics::pinhole(width, height, 1100.0, 279.5, 319.5);
        let axis = Vector3::y_axis();
        let mut view = Self {
            name: name.to_owned(),
            camera,
            world_from_cam: Rotation3::from_axis_angle(&axis, azimuth_deg.to_radians()),
            depth: DepthMap::filled(width, height, 0.0),
            normal: NormalMap::filled(width, height, [0.0; 3]),
        };
        for y in 0..height {
            for x in 0..width {
                if let Some((z, n)) = view.hit([x as f64, y as f64]) {
                    *view.depth.at_mut(x, y) = z as f32;
                    *view.normal.at_mut(x, y) = [n.x as f32, n.y as f32, n.z as f32];
                }
            }
        }
        view
    }

    fn center(&self) -> Vector3<f64> {
        self.world_from_cam * Vector3::new(0.0, 0.0, -DISTANCE)
    }

    /// Depth and normal (camera frame) where a pixel's ray first meets the head.
    fn hit(&self, pixel: [f64; 2]) -> Option<(f64, Vector3<f64>)> {
        let camera = &self.camera;
        let ray = Vector3::new(
            (pixel[0] - camera.cx) / camera.fx,
            (pixel[1] - camera.cy) / camera.fy,
            1.0,
        );
        let (ray, center) = (self.world_from_cam * ray, self.center());
        let at = |z: f64| center + ray * z;
        // The head lies within 1.2 of its middle.
        let step = 0.01;
        let steps = (0..240).map(|k| DISTANCE - 1.2 + step * f64::from(k));
        let mut outside = steps.skip_while(|&z| implicit(&at(z)) > 0.0);
        let mut far = outside.next()?;
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
        let slope =
            |axis: Vector3<f64>| implicit(&(point + axis * h)) - implicit(&(point - axis * h));
        let gradient = Vector3::new(
            slope(Vector3::x()),
            slope(Vector3::y()),
            slope(Vector3::z()),
        );
        Some((far, (self.world_from_cam.inverse() * gradient).normalize()))
    }

    fn cam_from_world(&self) -> RigidTransform {
        RigidTransform::from_world_pose(self.world_from_cam, Point3::from(self.center()))
    }
}

/// Points of the first view where the second one sees them.
fn true_matches(views: &[Rendered; 2]) -> Vec<[f64; 4]> {
    let [first, second] = views;
    let (width, height) = (first.depth.width, first.depth.height);
    (0..100 * NUM_MATCHES)
        .filter_map(|k| {
            let (x, y) = ((k * 7919) % width, (k * 104_729 / 7) % height);
            let z = f64::from(*first.depth.at(x, y));
            if z <= 0.0 {
                return None;
            }
            let (z, _) = first.hit([x as f64, y as f64])?;
            let camera = &first.camera;
            let ray = Vector3::new(
                (x as f64 - camera.cx) / camera.fx,
                (y as f64 - camera.cy) / camera.fy,
                1.0,
            );
            let world = first.center() + first.world_from_cam * (ray * z);
            let there = second.cam_from_world().apply(&Point3::from(world));
            let pixel = second.camera.project(&there)?;
            let (seen, _) = second.hit([pixel.x, pixel.y])?;
            let same = (seen - there.z).abs() < 1e-6;
            same.then_some([x as f64, y as f64, pixel.x, pixel.y])
        })
        .take(NUM_MATCHES)
        .collect()
}

/// Two views with their truth.
pub enum Source {
    /// `view1` and `view2` of a folder.
    Folder(PathBuf),
    /// Views made here, named alike, and their matches.
    Made(Box<[Rendered; 2]>, Vec<[f64; 4]>),
}

impl Source {
    /// Two views of a bumpy head, 15 degrees apart; the image model holds exactly.
    pub fn made() -> Self {
        let views = [Rendered::new("view1", -7.5), Rendered::new("view2", 7.5)];
        let matches = true_matches(&views);
        Self::Made(Box::new(views), matches)
    }

    fn rendered(views: &[Rendered; 2], name: &str) -> usize {
        usize::from(views[0].name != name)
    }

    /// A view under one of the lightings; the start is `flat`, `rough` or `true`.
    pub fn view(&self, name: &str, light: &str, start: &str) -> Result<ShadingView, Failure> {
        let (views, _) = match self {
            Self::Folder(folder) => return read_view(folder, name, light, start),
            Self::Made(views, matches) => (views, matches),
        };
        let rendered = &views[Self::rendered(views, name)];
        let (_, rows) = LIGHTS
            .iter()
            .find(|(known, _)| *known == light)
            .ok_or("a lighting is L1, L2 or L3")?;
        let rows: Vec<SphericalHarmonics> = rows.iter().map(|&r| SphericalHarmonics(r)).collect();
        let (width, height) = (rendered.depth.width, rendered.depth.height);
        let mask = Mask::from_fn(width, height, |x, y| *rendered.depth.at(x, y) > 0.0);
        let mut image = LinearImage::filled(width, height, rows.len(), 0.0);
        for y in 0..height {
            for x in 0..width {
                if let Some(n) = rendered.normal.normal(x, y) {
                    let n: Vector3<f64> = n.normalize();
                    for (value, row) in image.pixel_mut(x, y).iter_mut().zip(&rows) {
                        *value = row.evaluate(&n) as f32;
                    }
                }
            }
        }
        let mut view = ShadingView::new(
            name,
            Arc::new(image),
            mask,
            rendered.camera,
            ViewLight::Uniform(Lighting { channels: rows }),
        );
        view.cam_from_world = Some(rendered.cam_from_world());
        view.initial_depth = Some(match start {
            "flat" => flat(&rendered.depth),
            "rough" => rough(&rendered.depth),
            _ => rendered.depth.clone(),
        });
        Ok(view)
    }

    /// Matches of the two views.
    pub fn matches(&self) -> Result<Vec<[f64; 4]>, Failure> {
        match self {
            Self::Folder(folder) => read_matches(folder),
            Self::Made(_, matches) => Ok(matches.clone()),
        }
    }

    /// True normals and depth of a view.
    pub fn truth(&self, name: &str) -> Result<(NormalMap, DepthMap), Failure> {
        match self {
            Self::Folder(folder) => Ok((
                rilievo_io::read_normal(&folder.join(name).join("normal_true.exr"))?,
                rilievo_io::read_depth(&folder.join(name).join("depth_true.exr"))?,
            )),
            Self::Made(views, _) => {
                let view = &views[Self::rendered(views, name)];
                Ok((view.normal.clone(), view.depth.clone()))
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
    let mut map = depth.clone();
    for pass in 0..6 {
        let along_x = pass % 2 == 0;
        map = DepthMap::from_fn(map.width, map.height, |x, y| {
            if *depth.at(x, y) <= 0.0 {
                return 0.0;
            }
            let (mut sum, mut count) = (0.0, 0.0);
            for step in 0..=2 * ROUGH_RADIUS_PX {
                let by = step as isize - ROUGH_RADIUS_PX as isize;
                let (i, j) = if along_x { (by, 0) } else { (0, by) };
                if let Some(&z) = map.get(x as isize + i, y as isize + j)
                    && z > 0.0
                {
                    sum += z;
                    count += 1.0;
                }
            }
            sum / count
        });
    }
    map
}
