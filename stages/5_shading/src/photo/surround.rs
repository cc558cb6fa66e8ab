//! What stands around the object, as the photos show it: small whole photos, and the ground under the
//! object with its texture.

use nalgebra::{Point3, Vector3};
use rilievo_photometry::visibility::Ground;
use rilievo_scene::{LinearImage, Mask};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::hull::dilate;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::window::block_mean;

/// Longest side of the small photos: the surroundings are needed at a few millimetres only.
const MAX_SIDE: usize = 480;

/// A whole photo at low resolution.
#[derive(Clone, Debug)]
pub(crate) struct SmallPhoto {
    pub camera: Camera,
    /// Three channels; negative where clipped, and where the photo shows nothing.
    pub image: LinearImage,
    /// Pixels of the object, grown by a pixel.
    pub object: Mask,
}

impl SmallPhoto {
    /// Means over blocks; what is not known is marked: a block with a clipped pixel, and one that the straightened photo does
    /// not fill.
    pub fn new(camera: &Camera, image: &LinearImage, mask: &Mask, clip_level: f32) -> Self {
        let block = image.width.max(image.height).div_ceil(MAX_SIDE).max(1);
        let (mean, reduced) = (block_mean(image, block), camera.reduced(block));
        let is_valid = |&v: &f32| v.is_finite() && v < clip_level;
        let mut small = LinearImage::filled(mean.width, mean.height, 3, 0.0);
        let object = Mask::from_fn(mean.width, mean.height, |x, y| {
            let place = |k: usize| (x * block + k % block, y * block + k / block);
            let mut places = (0..block * block).map(place);
            let is_known = reduced.shows(x as i32, y as i32)
                && places
                    .clone()
                    .all(|(x, y)| image.pixel(x, y).iter().all(is_valid));
            for (c, out) in small.pixel_mut(x, y).iter_mut().enumerate() {
                let value = mean.pixel(x, y)[c.min(image.channels - 1)];
                *out = if is_known { value } else { -1.0 };
            }
            places.any(|(x, y)| *mask.at(x, y))
        });
        Self {
            camera: reduced,
            image: small,
            object: dilate(&object, 1),
        }
    }

    /// Divides by the photo's gain.
    pub fn divide_by_gain(&mut self, gain: [f64; 3]) {
        for pixel in self.image.data.chunks_exact_mut(3) {
            for (value, g) in pixel.iter_mut().zip(gain) {
                if *value > 0.0 {
                    *value /= g as f32;
                }
            }
        }
    }

    /// Nearest pixel's radiance of a world point that is not on the object.
    fn look(&self, point: &Point3<f64>) -> Option<[f32; 3]> {
        let (u, v, _) = self.camera.project(point)?;
        let (u, v) = (u.round(), v.round());
        if u < 0.0 || v < 0.0 || u >= self.camera.width as f64 || v >= self.camera.height as f64 {
            return None;
        }
        let (u, v) = (u as usize, v as usize);
        let p = self.image.pixel(u, v);
        (!*self.object.at(u, v) && p.iter().all(|&x| x >= 0.0)).then(|| [p[0], p[1], p[2]])
    }
}

/// Some points of the object's surface at the log depths of all views, world.
pub(crate) fn object_points(level: &Level, depths: &[Vec<f64>]) -> Vec<Point3<f64>> {
    let views = level.views.iter().zip(depths);
    let of_view = |(view, depth): (&LevelView, &Vec<f64>)| -> Vec<Point3<f64>> {
        let pixels = (0..view.pixels.len()).step_by(29);
        let at = pixels.map(|p| {
            let (x, y) = view.xy(p);
            view.camera.unproject(x, y, depth[p].exp())
        });
        at.collect()
    };
    views.flat_map(of_view).collect()
}

/// The plane on which the object stands, from sparse points off the object, with its texture.
///
/// The plane that most of them lie on, with the object on one side of it. `None` where there is
/// none.
pub(crate) fn find_ground(
    points: &[Point3<f64>],
    object: &[Point3<f64>],
    photos: &[SmallPhoto],
) -> Option<Ground> {
    const NUM_TRIALS: u64 = 600;
    const MIN_POINTS: usize = 30;
    let (center, radius) = ball(object)?;
    let background: Vec<&Point3<f64>> = points
        .iter()
        .filter(|p| {
            photos.iter().all(|photo| {
                photo.camera.project(p).is_none_or(|(u, v, _)| {
                    !photo
                        .object
                        .contains(u.round() as isize, v.round() as isize)
                })
            }) && (*p - center).norm() < 6.0 * radius
        })
        .collect();
    if background.len() < MIN_POINTS {
        return None;
    }
    // Half a per cent of the object's size: below it the ground's texture shifts by no more.
    let tolerance = 0.01 * radius;
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut pick = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % background.len()
    };
    let mut best: (usize, Vector3<f64>, f64) = (0, Vector3::zeros(), 0.0);
    for _ in 0..NUM_TRIALS {
        let (a, b, c) = (background[pick()], background[pick()], background[pick()]);
        let normal = (b - a).cross(&(c - a));
        if normal.norm() < 1e-9 * radius * radius {
            continue;
        }
        let normal = normal.normalize();
        let level = normal.dot(&a.coords);
        let count = background
            .iter()
            .filter(|p| (normal.dot(&p.coords) - level).abs() < tolerance)
            .count();
        if count > best.0 {
            best = (count, normal, level);
        }
    }
    if best.0 < MIN_POINTS || best.0 * 10 < background.len() * 3 {
        return None;
    }
    let inliers: Vec<&Point3<f64>> = background
        .into_iter()
        .filter(|p| (best.1.dot(&p.coords) - best.2).abs() < tolerance)
        .collect();
    let mean = inliers.iter().map(|p| p.coords).sum::<Vector3<f64>>() / inliers.len() as f64;
    let mut spread = nalgebra::Matrix3::zeros();
    for p in &inliers {
        let d = p.coords - mean;
        spread += d * d.transpose();
    }
    let eigen = spread.symmetric_eigen();
    let mut normal: Vector3<f64> = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    if normal.dot(&(center.coords - mean)) < 0.0 {
        normal = -normal;
    }
    let above = object
        .iter()
        .filter(|p| normal.dot(&(p.coords - mean)) > -0.03 * radius)
        .count();
    if above * 20 < object.len() * 19 {
        return None;
    }
    Some(texture(center, radius, &mean, &normal, photos))
}

fn ball(points: &[Point3<f64>]) -> Option<(Point3<f64>, f64)> {
    if points.is_empty() {
        return None;
    }
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let mut distances: Vec<f64> = points.iter().map(|p| (p.coords - mean).norm()).collect();
    let radius = rilievo_numerics::robust::quantile(&mut distances, 0.98)?;
    Some((Point3::from(mean), radius))
}

fn texture(
    center: Point3<f64>,
    radius: f64,
    on_plane: &Vector3<f64>,
    normal: &Vector3<f64>,
    photos: &[SmallPhoto],
) -> Ground {
    const SIDE: usize = 400;
    // The ground farther than six object radii is part of the environment.
    let half = 6.0 * radius;
    let foot = center.coords - normal * normal.dot(&(center.coords - on_plane));
    let helper = if normal.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let along = normal.cross(&helper).normalize();
    let across = normal.cross(&along);
    let corner = foot - (along + across) * half;
    let texel = 2.0 * half / SIDE as f64;
    let mut texture = Vec::with_capacity(SIDE * SIDE);
    for j in 0..SIDE {
        for i in 0..SIDE {
            let p = Point3::from(
                corner + along * ((i as f64 + 0.5) * texel) + across * ((j as f64 + 0.5) * texel),
            );
            let (mut sum, mut total) = ([0.0_f32; 3], 0.0_f32);
            for photo in photos {
                // A camera below the ground does not see it.
                if (photo.camera.center - p).dot(normal) <= 0.0 {
                    continue;
                }
                if let Some(rgb) = photo.look(&p) {
                    for c in 0..3 {
                        sum[c] += rgb[c];
                    }
                    total += 1.0;
                }
            }
            texture.push((total > 0.0).then(|| sum.map(|s| s / total)));
        }
    }
    let single = |v: &Vector3<f64>| v.map(|x| x as f32);
    Ground {
        corner: Point3::from(single(&corner)),
        along: single(&along),
        across: single(&across),
        normal: single(normal),
        texel: texel as f32,
        size: [SIDE, SIDE],
        texture,
    }
}
