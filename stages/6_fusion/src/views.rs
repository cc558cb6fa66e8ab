//! The views as fusion sees them: cleaned maps with their cameras, and surface between pixels.
//!
//! Between four pixels `k` with bilinear weights `b_k`, inverse depths `w_k` and normals `n_k`, the
//! inverse depth along a ray `r` is the mean of two interpolants,
//! `½ Σ b_k w_k + ½ Σ b_k w_k (n_k·r)/(n_k·r_k)`: the chord of the depths and the blend of the
//! tangent planes. On a curve their errors are `±κ t(1−t)/2`, so that the mean is the cubic
//! Hermite interpolant, exact to third order. Planes are exact in both.

use crate::error::FusionError;
use crate::memory;
use crate::options::FusionOptions;
use crate::report::ViewFusion;
use nalgebra::{Matrix3, Point2, Point3, Vector3};
use rayon::prelude::*;
use rilievo_scene::{
    ConfidenceMap, DepthMap, Intrinsics, MapSource, Mask, NormalMap, PosedViews, Raster,
    RigidTransform, ShadedView,
};

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
    /// Normalised coordinates of the pixels of a distorting lens.
    rays: Option<Raster<[f32; 2]>>,
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
/// Slope of an edge against the steepest surface that is kept: noise must not cut slopes.
const EDGE_FACTOR: f64 = 1.5;
/// Share of a step in depth that the normals may leave unexplained where it is no edge.
const MAX_SURPRISE: f64 = 0.5;

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

/// Loads, checks and cleans the maps of all views, one after the other, and halves the resolution of
/// all as often as the memory asks for.
pub(crate) fn prepare(
    posed: &PosedViews,
    maps: &dyn MapSource,
    options: &FusionOptions,
) -> Result<(Vec<View>, Vec<ViewFusion>), FusionError> {
    let mut views: Vec<View> = Vec::new();
    let mut reports = Vec::new();
    let mut needed = 0;
    for maps_idx in 0..maps.num_views() {
        let loaded = maps.load(maps_idx)?;
        let (mut view, report) = clean(posed, maps_idx, loaded, options)?;
        let num_halvings = views.first().map_or(0, |v| v.num_halvings);
        for _ in 0..num_halvings {
            memory::halve(&mut view);
        }
        needed += memory::needed(&view);
        views.push(view);
        reports.push(report);
        while memory::is_exceeded(&views, needed, options) {
            views.iter_mut().for_each(memory::halve);
            needed = views.iter().map(memory::needed).sum();
        }
    }
    if reports.iter().all(|r| r.num_depths == 0) {
        return Err(FusionError::NoDepth {
            num_views: views.len(),
        });
    }
    for (view, report) in views.iter_mut().zip(&mut reports) {
        mark_givers(view, options, report);
    }
    Ok((views, reports))
}

fn clean(
    posed: &PosedViews,
    maps_idx: usize,
    maps: ShadedView,
    options: &FusionOptions,
) -> Result<(View, ViewFusion), FusionError> {
    let camera_of = posed
        .views
        .get(maps.view.0)
        .ok_or_else(|| FusionError::NoCamera {
            view: maps.name.clone(),
            view_idx: maps.view.0,
            num_posed: posed.views.len(),
        })?;
    let camera = camera_of.intrinsics;
    let expected = (camera.width, camera.height);
    let sizes = [
        ("depth map", Some((maps.depth.width, maps.depth.height))),
        ("normal map", Some((maps.normal.width, maps.normal.height))),
        (
            "confidence map",
            maps.confidence.as_ref().map(|c| (c.width, c.height)),
        ),
    ];
    for (what, size) in sizes {
        if let Some(got) = size.filter(|&size| size != expected) {
            return Err(FusionError::SizeMismatch {
                view: maps.name.clone(),
                what,
                got,
                expected,
            });
        }
    }
    let pose = camera_of.cam_from_world;
    let mut view = View {
        posed_idx: maps.view.0,
        maps_idx,
        corner_px: [0.0; 2],
        num_halvings: 0,
        camera,
        pose,
        world_from_cam: pose.rotation.inverse().to_rotation_matrix().into_inner(),
        center: pose.center_in_source(),
        depth: maps.depth,
        gives: Mask::filled(camera.width, camera.height, false),
        normal: maps.normal,
        confidence: maps.confidence,
        rays: None,
    };
    let mut report = ViewFusion {
        name: maps.name,
        ..ViewFusion::default()
    };
    for (z, n) in view.depth.data.iter_mut().zip(&view.normal.data) {
        let normal_is_usable =
            n.iter().all(|c| c.is_finite()) && (Vector3::from(*n).norm() - 1.0).abs() < 0.1;
        if z.is_finite() && *z > 0.0 && normal_is_usable {
            report.num_depths += 1;
        } else {
            report.num_invalid += usize::from(*z != 0.0);
            *z = 0.0;
        }
    }
    memory::crop(&mut view);
    drop_edges(&mut view, options, &mut report);
    Ok((view, report))
}

const AROUND: [(isize, isize); 4] = [(-1, 0), (1, 0), (0, -1), (0, 1)];

/// Clears pixels on both sides of depth edges: no surface runs from one side to the other. A step
/// that the tangent planes of both sides foretell is no edge but oblique surface.
fn drop_edges(view: &mut View, options: &FusionOptions, report: &mut ViewFusion) {
    // The steepest surface that is kept rises by this share of its depth from pixel to pixel.
    let steepest =
        EDGE_FACTOR * options.max_grazing_deg.min(89.0).to_radians().tan() / view.camera.focal_px();
    let is_edge_to = |x: usize, y: usize, dx: isize, dy: isize| {
        let (Some(here), Some(u), Some(v)) = (
            view.at(x, y),
            x.checked_add_signed(dx).filter(|&u| u < view.depth.width),
            y.checked_add_signed(dy).filter(|&v| v < view.depth.height),
        ) else {
            return false;
        };
        let Some(there) = view.at(u, v) else {
            return false;
        };
        let step = (there.depth / here.depth).ln();
        if step.abs() <= steepest {
            return false;
        }
        // The logarithm of the depths' ratio on a plane with normal n is ln(n·r / n·r').
        let (ray, next) = (view.ray(x, y), view.ray(u, v));
        let on_plane = |n: &Vector3<f64>| (n.dot(&ray) / n.dot(&next)).ln();
        let foretold = 0.5 * (on_plane(&here.normal) + on_plane(&there.normal));
        // Written so that a plane seen from behind, whose logarithm is no number, foretells nothing.
        !(step - foretold).abs().lt(&(MAX_SURPRISE * step.abs()))
    };
    let mut edges = Vec::new();
    for y in 0..view.depth.height {
        for x in 0..view.depth.width {
            if AROUND.iter().any(|&(dx, dy)| is_edge_to(x, y, dx, dy)) {
                edges.push((x, y));
            }
        }
    }
    report.num_border += edges.len();
    for (x, y) in edges {
        *view.depth.at_mut(x, y) = 0.0;
    }
}

/// Marks the pixels that give points: `border_px` from the map's border, and not grazing.
fn mark_givers(view: &mut View, options: &FusionOptions, report: &mut ViewFusion) {
    let mut inside: Mask = Raster {
        width: view.depth.width,
        height: view.depth.height,
        data: view.depth.data.iter().map(|&z| z > 0.0).collect(),
    };
    for _ in 0..options.border_px {
        let before = inside.clone();
        for y in 0..before.height {
            for x in 0..before.width {
                let at_border = AROUND
                    .iter()
                    .any(|(dx, dy)| !before.contains(x as isize + dx, y as isize + dy));
                if *before.at(x, y) && at_border {
                    *inside.at_mut(x, y) = false;
                    report.num_border += 1;
                }
            }
        }
    }
    let min_cosine = options.max_grazing_deg.to_radians().cos();
    for y in 0..inside.height {
        for x in 0..inside.width {
            let Some(surface) = view.at(x, y).filter(|_| *inside.at(x, y)) else {
                continue;
            };
            let cosine = -surface.normal.dot(&view.ray(x, y).normalize());
            if cosine.is_nan() || cosine < min_cosine {
                *inside.at_mut(x, y) = false;
                report.num_grazing += 1;
            }
        }
    }
    view.gives = inside;
}
