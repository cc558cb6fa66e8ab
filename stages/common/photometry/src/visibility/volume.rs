//! A solid on a regular grid: carved by the masks and depth maps of all views, with the distance to
//! it, and the radiance of its surface.
//!
//! Signed distance of a voxel (positive outside): the mean of `z_j(x) − z` over the views that see
//! it before or shortly behind their surface, times the cosine of incidence and weighted with its
//! square, truncated (Curless, Levoy, SIGGRAPH 1996); outside where a mask does not contain it;
//! inside where it lies behind the surface of every view that shows it. So the solid has a back,
//! which shades. What no view shows, beyond the frames or on a rim between pixels, holds back no
//! light.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::distance;
use rilievo_scene::{DepthMap, Intrinsics, LinearImage, RigidTransform};

/// Voxels behind a surface that still count as seen.
const TRUNCATION: f32 = 4.0;
/// Rays start between these heights over the surface, in voxels: below the first its roughness is
/// the grid's own, beyond the last a fold's far side comes near.
const START: [f32; 2] = [0.5, 2.5];
/// Signed distance, in voxels, at which the start is free of the surface that it belongs to.
const FREE: f32 = 0.4;

/// What one view contributes: its camera (without distortion) and rasters of one size.
#[derive(Clone, Debug)]
pub struct DepthView {
    /// Pinhole.
    pub intrinsics: Intrinsics,
    /// Pose.
    pub cam_from_world: RigidTransform,
    /// Depth along the axis, 0 beside the object, NaN where the photo shows nothing.
    pub depth: DepthMap,
    /// cos² of the angle of incidence, 0 outside the mask.
    pub weight: rilievo_scene::Raster<f32>,
    /// Three channels.
    pub image: LinearImage,
    /// Whether the photo's frame cuts the object: then nothing is known beyond the rasters.
    pub cut_by_frame: bool,
}

/// The solid.
#[derive(Clone, Debug)]
pub struct Volume {
    origin: Vector3<f32>,
    /// Edge of a voxel, world's unit.
    pub voxel: f32,
    size: [usize; 3],
    /// Signed distance in voxels, truncated.
    signed: Vec<f32>,
    /// Distance to the solid in voxels, a lower bound, 0 inside.
    clearance: Vec<f32>,
    /// Radiance of voxels near the surface, mean of the views that see them.
    radiance: Vec<[f32; 3]>,
}

struct Camera {
    r: [[f32; 3]; 3],
    t: [f32; 3],
    k: [f32; 4],
}

impl Camera {
    fn new(view: &DepthView) -> Self {
        let (r, t) = (
            view.cam_from_world.rotation_matrix(),
            view.cam_from_world.translation,
        );
        let k = &view.intrinsics;
        Self {
            r: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[(i, j)] as f32)),
            t: [0, 1, 2].map(|i| t[i] as f32),
            k: [k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32],
        }
    }

    /// Pixel and depth.
    #[inline]
    fn project(&self, p: &Vector3<f32>) -> [f32; 3] {
        let c = [0, 1, 2]
            .map(|i| self.r[i][0] * p.x + self.r[i][1] * p.y + self.r[i][2] * p.z + self.t[i]);
        [
            self.k[0] * c[0] / c[2] + self.k[2],
            self.k[1] * c[1] / c[2] + self.k[3],
            c[2],
        ]
    }
}

/// What a view says of a voxel.
enum Sight {
    /// Not in its frame.
    Unknown,
    /// Beside the object.
    Empty,
    /// Distance to the surface in voxels (positive in front) with the view's weight.
    Surface { distance: f32, weight: f32 },
}

fn sight(camera: &Camera, view: &DepthView, p: &Vector3<f32>, voxel: f32) -> Sight {
    let [u, v, z] = camera.project(p);
    let depth = &view.depth;
    if z.is_nan()
        || z <= 0.0
        || !(u >= 0.0 && v >= 0.0 && u < (depth.width - 1) as f32 && v < (depth.height - 1) as f32)
    {
        return if view.cut_by_frame || z.is_nan() || z <= 0.0 {
            Sight::Unknown
        } else {
            Sight::Empty
        };
    }
    let (u0, v0) = (u as usize, v as usize);
    let (a, b) = (u - u0 as f32, v - v0 as f32);
    let base = v0 * depth.width + u0;
    let below = base + depth.width;
    let d = &depth.data;
    let corners = [d[base], d[base + 1], d[below], d[below + 1]];
    if !corners.iter().all(|&c| c > 0.0) {
        let nearest = (v + 0.5) as usize * depth.width + (u + 0.5) as usize;
        return if d[nearest] <= 0.0 {
            Sight::Empty
        } else {
            Sight::Unknown
        };
    }
    let mix =
        |c: [f32; 4]| (1.0 - b) * ((1.0 - a) * c[0] + a * c[1]) + b * ((1.0 - a) * c[2] + a * c[3]);
    let w = &view.weight.data;
    let weight = mix([w[base], w[base + 1], w[below], w[below + 1]]);
    let cosine = weight.max(0.0).sqrt().max(0.2);
    Sight::Surface {
        distance: (mix(corners) - z) * cosine / voxel,
        weight,
    }
}

/// One voxel of the grid.
struct Voxel {
    /// Signed distance in voxels, truncated.
    signed: f32,
    /// Mean of the views that see a surface near it.
    radiance: Option<[f32; 3]>,
}

impl Voxel {
    /// What all views together say of the place `p`.
    fn seen(cameras: &[Camera], views: &[DepthView], p: &Vector3<f32>, voxel: f32) -> Self {
        let (mut sum, mut total) = (0.0, 0.0);
        let mut behind = false;
        let (mut colour, mut colour_total) = ([0.0_f32; 3], 0.0_f32);
        for (camera, view) in cameras.iter().zip(views) {
            let (distance, weight) = match sight(camera, view, p, voxel) {
                Sight::Unknown => continue,
                Sight::Empty => {
                    return Self {
                        signed: TRUNCATION,
                        radiance: None,
                    };
                }
                Sight::Surface { distance, weight } => (distance, weight),
            };
            if distance < -TRUNCATION {
                behind = true;
                continue;
            }
            sum += weight * distance.min(TRUNCATION);
            total += weight;
            if distance.abs() < 2.0 {
                let [u, v, _] = camera.project(p);
                let rgb = view.image.pixel((u + 0.5) as usize, (v + 0.5) as usize);
                for c in 0..3 {
                    colour[c] += weight * rgb[c];
                }
                colour_total += weight;
            }
        }
        let signed = match (total > 0.0, behind) {
            (true, _) => sum / total,
            (false, true) => -TRUNCATION,
            (false, false) => TRUNCATION,
        };
        Self {
            signed,
            radiance: (colour_total > 0.0).then(|| colour.map(|c| c / colour_total)),
        }
    }
}

impl Volume {
    /// Carves and colours a grid of at most `max_voxels` along its longest side.
    ///
    /// `None` when no view has a depth.
    pub fn carve(views: &[DepthView], max_voxels: usize) -> Option<Self> {
        let (low, high) = bounds(views)?;
        let span = high - low;
        let longest = span.x.max(span.y).max(span.z);
        let voxel = 1.1 * longest / max_voxels as f32;
        if !(voxel.is_finite() && voxel > 0.0) {
            return None;
        }
        let origin = low - span * 0.05 - Vector3::repeat(2.0 * voxel);
        let size = [span.x, span.y, span.z].map(|s| (1.1 * s / voxel).ceil() as usize + 5);
        let cameras: Vec<Camera> = views.iter().map(Camera::new).collect();
        let plane = size[0] * size[1];
        let slices: Vec<Vec<Voxel>> = (0..size[2])
            .into_par_iter()
            .map(|z| {
                let places = (0..plane).map(|at| [at % size[0], at / size[0], z]);
                let points = places.map(|p| origin + Vector3::from(p.map(|v| v as f32)) * voxel);
                points
                    .map(|p| Voxel::seen(&cameras, views, &p, voxel))
                    .collect()
            })
            .collect();
        let (mut signed, mut radiance) = (Vec::new(), Vec::new());
        let mut coloured = Vec::new();
        for voxel in slices.into_iter().flatten() {
            signed.push(voxel.signed);
            radiance.push(voxel.radiance.unwrap_or_default());
            coloured.push(voxel.radiance.is_some());
        }
        let clearance = clearance(&signed, size);
        spread_colour(&mut radiance, &mut coloured, size);
        Some(Self {
            origin,
            voxel,
            size,
            signed,
            clearance,
            radiance,
        })
    }

    /// Smallest and largest corner.
    pub fn corners(&self) -> (Point3<f32>, Point3<f32>) {
        let extent = Vector3::new(
            (self.size[0] - 1) as f32,
            (self.size[1] - 1) as f32,
            (self.size[2] - 1) as f32,
        ) * self.voxel;
        (
            Point3::from(self.origin),
            Point3::from(self.origin + extent),
        )
    }

    /// Radiance where a ray meets the solid, within the grid.
    pub fn cast(&self, start: &Vector3<f32>, direction: &Vector3<f32>) -> Option<[f32; 3]> {
        // In voxels.
        let o = (start - self.origin) / self.voxel;
        let d = direction.normalize();
        let (mut t, end) = self.clip(&o, &d)?;
        let [nx, ny, _] = self.size;
        while t < end {
            let p = o + d * t;
            let (x, y, z) = (p.x as usize, p.y as usize, p.z as usize);
            let nearest =
                ((p.z + 0.5) as usize * ny + (p.y + 0.5) as usize) * nx + (p.x + 0.5) as usize;
            let clearance = self.clearance[nearest];
            if clearance > 2.0 {
                t += clearance - 0.9;
                continue;
            }
            if self.trilinear(x, y, z, p.x - x as f32, p.y - y as f32, p.z - z as f32) <= 0.0 {
                return Some(self.radiance[nearest]);
            }
            t += 0.6;
        }
        None
    }

    /// Height over a surface point, along its normal and in the world's unit, at which rays start:
    /// the least at which the grid leaves the point free. A fixed height would either lift the
    /// floor of a fold into the light, or leave points under the surface where the grid has
    /// smoothed it.
    pub fn start_height(&self, point: &Vector3<f32>, normal: &Vector3<f32>) -> f32 {
        const STEP: f32 = 0.25;
        let o = (point - self.origin) / self.voxel;
        let is_free = |height: f32| {
            let p = o + normal * height;
            let inside = (0..3).all(|k| p[k] >= 0.0 && p[k] < (self.size[k] - 1) as f32);
            if !inside {
                return true;
            }
            let (x, y, z) = (p.x as usize, p.y as usize, p.z as usize);
            let [a, b, c] = [p.x - x as f32, p.y - y as f32, p.z - z as f32];
            self.trilinear(x, y, z, a, b, c) >= FREE
        };
        let mut height = START[0];
        while height < START[1] && !is_free(height) {
            height += STEP;
        }
        height * self.voxel
    }

    /// Stretch of a ray inside the grid, kept half a voxel off its faces.
    fn clip(&self, o: &Vector3<f32>, d: &Vector3<f32>) -> Option<(f32, f32)> {
        let (mut near, mut far) = (0.0_f32, f32::INFINITY);
        for k in 0..3 {
            let (low, high) = (0.01, (self.size[k] - 1) as f32 - 0.51);
            if d[k].abs() < 1e-9 {
                if o[k] < low || o[k] > high {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low - o[k]) / d[k], (high - o[k]) / d[k]);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near < far).then_some((near, far))
    }

    #[inline]
    fn trilinear(&self, x: usize, y: usize, z: usize, a: f32, b: f32, c: f32) -> f32 {
        let [nx, ny, _] = self.size;
        let base = (z * ny + y) * nx + x;
        let s = &self.signed;
        let line = |i: usize| s[i] + a * (s[i + 1] - s[i]);
        let face = |i: usize| {
            let (p, q) = (line(i), line(i + nx));
            p + b * (q - p)
        };
        let (p, q) = (face(base), face(base + nx * ny));
        p + c * (q - p)
    }
}

fn bounds(views: &[DepthView]) -> Option<(Vector3<f32>, Vector3<f32>)> {
    let mut axes: [Vec<f64>; 3] = Default::default();
    for view in views {
        let world_from_cam = view.cam_from_world.inverse();
        // Every third pixel is enough for a bounding box.
        for y in (0..view.depth.height).step_by(3) {
            for x in (0..view.depth.width).step_by(3) {
                let z = f64::from(*view.depth.at(x, y));
                if z > 0.0 {
                    let pixel = nalgebra::Point2::new(x as f64, y as f64);
                    let p = world_from_cam.apply(&view.intrinsics.unproject(&pixel, z));
                    for k in 0..3 {
                        axes[k].push(p[k]);
                    }
                }
            }
        }
    }
    let (mut low, mut high) = (Vector3::zeros(), Vector3::zeros());
    for (k, axis) in axes.iter_mut().enumerate() {
        if axis.is_empty() {
            return None;
        }
        // Stray depths must not blow up the grid.
        axis.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| axis[((axis.len() - 1) as f64 * share) as usize] as f32;
        low[k] = at(0.002);
        high[k] = at(0.998);
    }
    Some((low, high))
}

/// Euclidean distance to the nearest voxel with a negative sign, less the voxel's own half
/// diagonal.
fn clearance(signed: &[f32], size: [usize; 3]) -> Vec<f32> {
    let mut squared: Vec<f32> = signed
        .iter()
        .map(|&s| if s <= 0.0 { 0.0 } else { distance::FAR })
        .collect();
    distance::transform(&mut squared, &mut vec![(); signed.len()], size);
    for value in &mut squared {
        *value = (value.max(0.0).sqrt() - 0.87).max(0.0);
    }
    squared
}

/// Gives uncoloured voxels the mean of coloured neighbours, a few voxels deep; the rest the mean of
/// all: no view sees the back.
fn spread_colour(radiance: &mut [[f32; 3]], coloured: &mut [bool], size: [usize; 3]) {
    const PASSES: usize = 3;
    let [nx, ny, nz] = size;
    let (mut sum, mut count) = ([0.0_f64; 3], 0.0_f64);
    for (rgb, &known) in radiance.iter().zip(coloured.iter()) {
        if known {
            for c in 0..3 {
                sum[c] += f64::from(rgb[c]);
            }
            count += 1.0;
        }
    }
    let steps = [1, nx, nx * ny];
    for _ in 0..PASSES {
        let mut found: Vec<(usize, [f32; 3])> = Vec::new();
        for z in 1..nz.saturating_sub(1) {
            for y in 1..ny.saturating_sub(1) {
                for x in 1..nx.saturating_sub(1) {
                    let at = (z * ny + y) * nx + x;
                    if coloured[at] {
                        continue;
                    }
                    let (mut rgb, mut n) = ([0.0_f32; 3], 0.0_f32);
                    for step in steps {
                        for other in [at - step, at + step] {
                            if coloured[other] {
                                for c in 0..3 {
                                    rgb[c] += radiance[other][c];
                                }
                                n += 1.0;
                            }
                        }
                    }
                    if n > 0.0 {
                        found.push((at, rgb.map(|v| v / n)));
                    }
                }
            }
        }
        for (at, rgb) in found {
            radiance[at] = rgb;
            coloured[at] = true;
        }
    }
    let mean = sum.map(|s| (s / count.max(1.0)) as f32);
    for (rgb, &known) in radiance.iter_mut().zip(coloured.iter()) {
        if !known {
            *rgb = mean;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Raster;

    /// A camera at the world's origin whose frame of 16×16 pixels cuts the object.
    fn cut_view(depth: DepthMap) -> DepthView {
        DepthView {
            intrinsics: Intrinsics::pinhole(16, 16, 16.0, 7.5, 7.5),
            cam_from_world: RigidTransform::identity(),
            depth,
            weight: Raster::filled(16, 16, 1.0),
            image: LinearImage::filled(16, 16, 3, 0.3),
            cut_by_frame: true,
        }
    }

    #[test]
    fn beside_the_object_is_empty_and_beyond_the_photo_unknown() {
        // The middle columns show a surface, those on the left its background, those on the right
        // nothing.
        let depth = Raster::from_fn(16, 16, |x, _| match x {
            0..6 => 0.0,
            6..10 => 2.0,
            _ => f32::NAN,
        });
        let view = cut_view(depth);
        let camera = Camera::new(&view);
        let at = |u: f32| {
            sight(
                &camera,
                &view,
                &Vector3::new((u - 7.5) / 8.0, 0.0, 2.0),
                0.1,
            )
        };
        assert!(matches!(at(3.0), Sight::Empty));
        assert!(matches!(at(7.5), Sight::Surface { distance, .. } if distance.abs() < 1e-4));
        assert!(matches!(at(9.6), Sight::Unknown));
        assert!(matches!(at(12.0), Sight::Unknown));
        assert!(matches!(at(20.0), Sight::Unknown));
    }

    #[test]
    fn a_place_that_no_photo_shows_holds_back_no_light() {
        // A near surface on the left and a far one on the right, cut off by the frame.
        let depth = Raster::from_fn(16, 16, |x, _| if x < 8 { 1.0 } else { 2.0 });
        let Some(volume) = Volume::carve(&[cut_view(depth)], 64) else {
            panic!("a view with depths carves a solid")
        };
        let meets = |start: [f32; 3], towards: f32| {
            let direction = Vector3::new(0.0, 0.0, towards);
            volume.cast(&Vector3::from(start), &direction).is_some()
        };
        // From the far surface past the frame's side, which no photo shows in front of it.
        assert!(!meets([0.8, 0.0, 1.9], -1.0));
        // Both surfaces from the front; behind the near one is the solid.
        assert!(meets([0.3, 0.0, 1.2], 1.0));
        assert!(meets([-0.2, 0.0, 0.98], 1.0));
        assert!(meets([-0.2, 0.0, 1.5], 1.0));
    }
}
