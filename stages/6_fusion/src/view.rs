//! A view as fusion sees it: its camera, where its cleaned maps lie, and surface between pixels.
//!
//! Between four pixels `k` with bilinear weights `b_k`, inverse depths `w_k` and normals `n_k`, the
//! inverse depth along a ray `r` is the mean of two interpolants,
//! `½ Σ b_k w_k + ½ Σ b_k w_k (n_k·r)/(n_k·r_k)`: the chord of the depths and the blend of the
//! tangent planes. On a curve their errors are `±κ t(1−t)/2`, so that the mean is the cubic
//! Hermite interpolant, exact to third order. Planes are exact in both.

use crate::pixel::Pixel;
use nalgebra::{Matrix3, Point3, Vector3};
use rilievo_scene::{DepthMap, Intrinsics, PAGE_SIDE, PageCache, Pages, RigidTransform};

/// A view; its pixels lie in the [`rilievo_scene::PageStore`].
#[derive(Clone, Debug)]
pub(crate) struct View {
    /// Index among the fused views.
    pub idx: usize,
    /// Camera of the map, which is cut to what holds depth.
    pub camera: Intrinsics,
    pub pose: RigidTransform,
    pub world_from_cam: Matrix3<f64>,
    pub center: Point3<f64>,
    /// Whether the pixels have colours.
    pub has_photo: bool,
    /// Pixels with a depth.
    pub num_depths: usize,
    /// The first of them, where there is one.
    pub first_px: Option<[usize; 2]>,
    pub pages: Pages,
    pub max_depth: BlockMaxDepth,
}

/// Largest depths in squares of a view's map, 0 where there is none: what lies well behind them the
/// view says nothing about.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockMaxDepth {
    pub columns: usize,
    pub depths: Vec<f32>,
}

impl BlockMaxDepth {
    /// Side of the squares, pixels: about what a block covers.
    pub const SIDE: usize = 8;

    pub fn of(depth: &DepthMap) -> Self {
        let columns = depth.width.div_ceil(Self::SIDE);
        let mut depths = vec![0.0; columns * depth.height.div_ceil(Self::SIDE)];
        for (i, &z) in depth.data.iter().enumerate() {
            let [x, y] = [i % depth.width, i / depth.width].map(|at| at / Self::SIDE);
            let max = &mut depths[y * columns + x];
            *max = f32::max(*max, z);
        }
        Self { columns, depths }
    }
}

/// A point of a view's surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub depth: f64,
    /// Unit normal, camera frame.
    pub normal: Vector3<f64>,
    pub confidence: f64,
    /// Whether the nearest pixel makes points.
    pub makes_points: bool,
    /// Whether a corner was missing, and the tangent planes of the others carried on.
    pub is_extrapolated: bool,
    /// How far the two interpolants lie apart along the normal, pixel footprints.
    pub strain_px: f64,
}

/// Share of the bilinear weights that must exist: half a pixel beyond the map's border.
const MIN_WEIGHT: f64 = 0.25;
/// Share of the bilinear weights above which no corner is missing, but for rounding.
const FULL_WEIGHT: f64 = 1.0 - 1e-9;
/// Weight of an extrapolated surface against an interpolated one.
const EXTRAPOLATED: f64 = 0.01;
/// Confidence below which a pixel still counts as this much: no pixel is worth nothing.
const MIN_CONFIDENCE: f64 = 0.05;

impl View {
    /// A pixel inside the map.
    #[inline]
    pub fn pixel(&self, pixels: &mut PageCache<'_>, x: usize, y: usize) -> Pixel {
        let (page, at) = self.pages.locate(x, y);
        let bytes = pixels.page(&self.pages, page);
        bytes.map_or_else(Pixel::default, |bytes| Pixel::read(&bytes[at]))
    }

    /// A pixel, its right neighbour, and the two below, all inside the map.
    #[inline]
    pub fn square(&self, pixels: &mut PageCache<'_>, x: usize, y: usize) -> [Pixel; 4] {
        if x % PAGE_SIDE + 1 == PAGE_SIDE || y % PAGE_SIDE + 1 == PAGE_SIDE {
            return [(0, 0), (1, 0), (0, 1), (1, 1)]
                .map(|(dx, dy)| self.pixel(pixels, x + dx, y + dy));
        }
        let (page, at) = self.pages.locate(x, y);
        let Some(bytes) = pixels.page(&self.pages, page) else {
            return [Pixel::default(); 4];
        };
        let record = at.len();
        // Written out: a map over an array copies every pixel once more, a sixth of all time.
        let next = |k: usize| Pixel::read(&bytes[at.start + k * record..][..record]);
        [next(0), next(1), next(PAGE_SIDE), next(PAGE_SIDE + 1)]
    }

    /// Ray of an integer pixel, `z = 1`.
    #[inline]
    pub fn ray(&self, x: usize, y: usize, pixel: &Pixel) -> Vector3<f64> {
        if self.camera.distortion.is_none() {
            pinhole_ray(&self.camera, x, y)
        } else {
            let [u, v] = pixel.ray.map(f64::from);
            Vector3::new(u, v, 1.0)
        }
    }

    /// Size of a pixel on a surface at a depth that faces the camera, world's unit.
    #[inline]
    pub fn footprint(&self, depth: f64) -> f64 {
        depth / self.camera.focal_px()
    }

    /// Direction from the camera frame to the world.
    #[inline]
    pub fn to_world(&self, direction_in_cam: &Vector3<f64>) -> Vector3<f64> {
        self.world_from_cam * direction_in_cam
    }

    /// World point of a camera-frame point.
    #[inline]
    pub fn point_to_world(&self, in_cam: &Vector3<f64>) -> Point3<f64> {
        self.center + self.world_from_cam * in_cam
    }

    /// The surface along the ray through a point in the camera frame; `None` outside the map.
    #[inline]
    pub fn along(&self, pixels: &mut PageCache<'_>, in_cam: &Point3<f64>) -> Option<Surface> {
        let place = self.camera.project(in_cam)?;
        if !(place.x >= 0.0 && place.y >= 0.0) {
            return None;
        }
        let (x, y) = (place.x as usize, place.y as usize);
        let [columns, rows] = [self.camera.width, self.camera.height].map(|n| n.saturating_sub(1));
        if x >= columns || y >= rows {
            return None;
        }
        let (fx, fy) = (place.x - x as f64, place.y - y as f64);
        let ray = in_cam.coords / in_cam.z;
        let (mut chord, mut planes, mut confidence) = (0.0, 0.0, 0.0);
        let (mut normal, mut total) = (Vector3::zeros(), 0.0);
        let corners = self.square(pixels, x, y);
        for (k, weight) in bilinear_weights(fx, fy).into_iter().enumerate() {
            let pixel = &corners[k];
            let Some(corner) = pixel.surface() else {
                continue;
            };
            let own_ray = self.ray(x + (k & 1), y + (k >> 1), pixel);
            let inverse = weight / corner.depth;
            chord += inverse;
            planes += inverse * corner.normal.dot(&ray) / corner.normal.dot(&own_ray);
            normal += corner.normal * weight;
            confidence += corner.confidence * weight;
            total += weight;
        }
        if total < MIN_WEIGHT {
            return None;
        }
        // Beside a missing corner the surface is extrapolated: good to confirm, not to average.
        let is_extrapolated = total <= FULL_WEIGHT;
        let trust = if is_extrapolated { EXTRAPOLATED } else { 1.0 };
        let apart_px = (planes / chord - 1.0).abs() * self.camera.focal_px();
        let inverse = match (is_extrapolated, apart_px < 1.0) {
            (false, true) => 0.5 * (chord + planes),
            // Normals that contradict the depths by a pixel footprint have nothing to add to them.
            (false, false) => chord,
            // Beside a missing corner the chord leans; the tangent planes carry on.
            (true, _) => planes / total,
        };
        let normal = normal.normalize();
        let nearest = usize::from(fx > 0.5) + 2 * usize::from(fy > 0.5);
        Some(Surface {
            depth: 1.0 / inverse,
            normal,
            confidence: trust * confidence / total,
            makes_points: corners[nearest].makes_points,
            is_extrapolated,
            strain_px: apart_px * normal.dot(&ray).abs(),
        })
    }
}

impl Pixel {
    /// The surface at the pixel, where it has one.
    #[inline]
    pub fn surface(&self) -> Option<Surface> {
        (self.depth > 0.0).then(|| Surface {
            depth: self.depth.into(),
            normal: Vector3::from(self.normal.map(f64::from)),
            confidence: f64::from(self.confidence).clamp(MIN_CONFIDENCE, 1.0),
            makes_points: self.makes_points,
            is_extrapolated: false,
            strain_px: 0.0,
        })
    }
}

/// Weights of the four pixels around a place, in the order of [`View::square`].
#[inline]
pub(crate) fn bilinear_weights(fx: f64, fy: f64) -> [f64; 4] {
    [
        (1.0 - fx) * (1.0 - fy),
        fx * (1.0 - fy),
        (1.0 - fx) * fy,
        fx * fy,
    ]
}

/// Ray of an integer pixel of a lens that does not distort, `z = 1`.
#[inline]
pub(crate) fn pinhole_ray(camera: &Intrinsics, x: usize, y: usize) -> Vector3<f64> {
    Vector3::new(
        (x as f64 - camera.cx) / camera.fx,
        (y as f64 - camera.cy) / camera.fy,
        1.0,
    )
}
