//! A view as fusion sees it: its cleaned maps with their camera, and surface between pixels.
//!
//! Between four pixels `k` with bilinear weights `b_k`, inverse depths `w_k` and normals `n_k`, the
//! inverse depth along a ray `r` is the mean of two interpolants,
//! `½ Σ b_k w_k + ½ Σ b_k w_k (n_k·r)/(n_k·r_k)`: the chord of the depths and the blend of the
//! tangent planes. On a curve their errors are `±κ t(1−t)/2`, so that the mean is the cubic
//! Hermite interpolant, exact to third order. Planes are exact in both.

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use rayon::prelude::*;
use rilievo_scene::{ConfidenceMap, DepthMap, Intrinsics, Mask, NormalMap, Raster, RigidTransform};

/// A view with its cleaned maps.
#[derive(Clone, Debug)]
pub(crate) struct View {
    /// Index into the posed views.
    pub posed_idx: usize,
    /// Index into the maps.
    pub maps_idx: usize,
    /// First pixel of the map in the photo's camera.
    pub corner_px: [f64; 2],
    /// Times that the map's resolution was halved.
    pub num_halvings: u32,
    pub camera: Intrinsics,
    pub pose: RigidTransform,
    pub world_from_cam: Matrix3<f64>,
    pub center: Point3<f64>,
    /// Depth, 0 where there is none, and on both sides of depth edges.
    pub depth: DepthMap,
    /// Pixels good enough to give points: not at the border of the map, not grazing. The others
    /// still confirm what another view sees better.
    pub gives: Mask,
    /// Normals, camera frame.
    pub normal: NormalMap,
    pub confidence: Option<ConfidenceMap>,
    /// Normalised coordinates of the pixels of a distorting lens, by [`View::trace_rays`].
    pub rays: Option<Raster<[f32; 2]>>,
}

/// A point of a view's surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub depth: f64,
    /// Unit normal, camera frame.
    pub normal: Vector3<f64>,
    pub confidence: f64,
    /// Whether the nearest pixel gives points.
    pub gives: bool,
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
    /// Ray of an integer pixel, `z = 1`.
    #[inline]
    pub fn ray(&self, x: usize, y: usize) -> Vector3<f64> {
        match &self.rays {
            Some(rays) => {
                let [u, v] = *rays.at(x, y);
                Vector3::new(u.into(), v.into(), 1.0)
            }
            None => Vector3::new(
                (x as f64 - self.camera.cx) / self.camera.fx,
                (y as f64 - self.camera.cy) / self.camera.fy,
                1.0,
            ),
        }
    }

    /// Makes the rays of a distorting lens anew, for the camera has changed.
    pub fn trace_rays(&mut self) {
        let camera = self.camera;
        self.rays = (!camera.distortion.is_none()).then(|| {
            let data = (0..camera.width * camera.height)
                .into_par_iter()
                .map(|i| {
                    let pixel = Point2::new((i % camera.width) as f64, (i / camera.width) as f64);
                    let n = camera.normalized(&pixel);
                    [n.x as f32, n.y as f32]
                })
                .collect();
            Raster {
                width: camera.width,
                height: camera.height,
                data,
            }
        });
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

    #[inline]
    fn confidence_at(&self, x: usize, y: usize) -> f64 {
        self.confidence
            .as_ref()
            .map_or(1.0, |c| f64::from(*c.at(x, y)).clamp(MIN_CONFIDENCE, 1.0))
    }

    /// The surface at an integer pixel.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> Option<Surface> {
        let depth = *self.depth.at(x, y);
        if depth <= 0.0 {
            return None;
        }
        Some(Surface {
            depth: depth.into(),
            normal: Vector3::from(self.normal.at(x, y).map(f64::from)),
            confidence: self.confidence_at(x, y),
            gives: *self.gives.at(x, y),
            is_extrapolated: false,
            strain_px: 0.0,
        })
    }

    /// The surface along the ray through a point in the camera frame; `None` outside the map.
    #[inline]
    pub fn along(&self, in_cam: &Point3<f64>) -> Option<Surface> {
        let pixel = self.camera.project(in_cam)?;
        let (x0, y0) = (pixel.x.floor(), pixel.y.floor());
        if x0 < 0.0
            || y0 < 0.0
            || x0 + 1.0 >= self.depth.width as f64
            || y0 + 1.0 >= self.depth.height as f64
        {
            return None;
        }
        let (fx, fy) = (pixel.x - x0, pixel.y - y0);
        let (x, y) = (x0 as usize, y0 as usize);
        let ray = in_cam.coords / in_cam.z;
        let (mut chord, mut planes, mut confidence) = (0.0, 0.0, 0.0);
        let (mut normal, mut total) = (Vector3::zeros(), 0.0);
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let Some(corner) = self.at(x + dx, y + dy) else {
                continue;
            };
            let inverse = weight / corner.depth;
            chord += inverse;
            planes +=
                inverse * corner.normal.dot(&ray) / corner.normal.dot(&self.ray(x + dx, y + dy));
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
        Some(Surface {
            depth: 1.0 / inverse,
            normal,
            confidence: trust * confidence / total,
            gives: *self
                .gives
                .at(x + usize::from(fx > 0.5), y + usize::from(fy > 0.5)),
            is_extrapolated,
            strain_px: apart_px * normal.dot(&ray).abs(),
        })
    }
}
