//! Maps cut to what holds depth, and halved until fusion fits into the memory allowed.
//!
//! With `A` pixels in the cut maps of all views and `D` depths among them, fusion needs about
//! `a A + d D` bytes until the points are gathered; a halving divides both by four. What the halving
//! leaves over is the mesh's. A pixel of the halved map is the surface between four pixels, along
//! the ray through their middle: `x = 2 x' + ½` in the finer map, hence `c' = (c − ½) / 2`, `f' = f / 2`.

use crate::options::FusionOptions;
use crate::view::View;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;
use rilievo_scene::{ConfidenceMap, DepthMap, Intrinsics, Mask, NormalMap, Raster};

/// Bytes of a pixel of a view: depth, normal, confidence, mark, colour.
const PIXEL_BYTES: usize = 4 + 12 + 4 + 1 + 3;
/// Bytes of the rays of a distorting lens.
const RAY_BYTES: usize = 8;
/// Bytes of the cloud per depth: measured are two points, and more where all views are oblique, each
/// with its place in the tree that dresses the mesh and its share of the lists that it is gathered in.
const DEPTH_BYTES: usize = 160;
/// Bytes of a block of the volume with the surface in it: 512 distances, and on average 30 vertices
/// and 60 triangles in pieces and again in the mesh.
pub(crate) const BLOCK_BYTES: usize = 512 * 4 + 5_000;
/// Share of the memory that the mesh has in any case.
const MESH_SHARE: f64 = 0.25;
/// Halvings after which a map is no map any more.
const MAX_NUM_HALVINGS: u32 = 6;
/// Pixels around the depths that are kept, so that interpolation meets the border of the depths
/// before the border of the map.
const MARGIN: usize = 2;

/// Bytes that a view and its points need.
pub(crate) fn needed(view: &View) -> usize {
    let pixels = view.depth.data.len();
    let depths = view.depth.data.iter().filter(|&&z| z > 0.0).count();
    let rays = if view.camera.distortion.is_none() {
        0
    } else {
        RAY_BYTES
    };
    pixels * (PIXEL_BYTES + rays) + depths * DEPTH_BYTES
}

fn allowed(options: &FusionOptions) -> usize {
    options.memory_mib.saturating_mul(1 << 20)
}

/// Whether the views, which need so many bytes together, are too many or too large for the memory.
pub(crate) fn is_exceeded(views: &[View], needed: usize, options: &FusionOptions) -> bool {
    let share = 1.0 - MESH_SHARE;
    needed as f64 > share * allowed(options) as f64
        && views.iter().all(|v| v.num_halvings < MAX_NUM_HALVINGS)
}

/// Blocks of the volume that the rest of the memory holds.
pub(crate) fn max_num_blocks(views: &[View], options: &FusionOptions) -> usize {
    let allowed = allowed(options);
    let rest = allowed
        .saturating_sub(views.iter().map(needed).sum())
        .max((MESH_SHARE * allowed as f64) as usize);
    (rest / BLOCK_BYTES).max(1)
}

fn cut<T: Copy + Send + Sync>(
    map: &Raster<T>,
    [x0, y0]: [usize; 2],
    [width, height]: [usize; 2],
) -> Raster<T> {
    Raster::from_fn(width, height, |x, y| *map.at(x0 + x, y0 + y))
}

/// Cuts a view to the rectangle that holds its depths.
pub(crate) fn crop(view: &mut View) {
    let [[x0, x1], [y0, y1]] = view.depth.bounds(|&z| z > 0.0).unwrap_or_default();
    let (low, high) = ([x0, y0], [x1, y1]);
    let full = [view.depth.width, view.depth.height];
    let from: [usize; 2] = std::array::from_fn(|k| low[k].saturating_sub(MARGIN));
    let size = std::array::from_fn(|k| (high[k] + MARGIN + 1).min(full[k]) - from[k]);
    view.depth = cut(&view.depth, from, size);
    view.normal = cut(&view.normal, from, size);
    view.confidence = view.confidence.as_ref().map(|c| cut(c, from, size));
    view.gives = Mask::filled(size[0], size[1], false);
    view.corner_px = std::array::from_fn(|k| view.corner_px[k] + from[k] as f64);
    view.camera = Intrinsics {
        width: size[0],
        height: size[1],
        cx: view.camera.cx - from[0] as f64,
        cy: view.camera.cy - from[1] as f64,
        ..view.camera
    };
    view.trace_rays();
}

/// Halves the resolution of a view; what gives points is to be marked again.
pub(crate) fn halve(view: &mut View) {
    let (width, height) = (
        (view.depth.width / 2).max(1),
        (view.depth.height / 2).max(1),
    );
    let between: Vec<(f32, [f32; 3], f32)> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let middle = Point2::new(
                2.0 * (i % width) as f64 + 0.5,
                2.0 * (i / width) as f64 + 0.5,
            );
            let ray = view.camera.ray(&middle);
            let surface = view.along(&Point3::from(ray));
            surface
                .filter(|s| !s.is_extrapolated)
                .map_or_else(Default::default, |s| {
                    let normal = s.normal.map(|c| c as f32).into();
                    (s.depth as f32, normal, s.confidence as f32)
                })
        })
        .collect();
    let at = |x: usize, y: usize| between[y * width + x];
    view.depth = DepthMap::from_fn(width, height, |x, y| at(x, y).0);
    view.normal = NormalMap::from_fn(width, height, |x, y| at(x, y).1);
    view.confidence = view
        .confidence
        .as_ref()
        .map(|_| ConfidenceMap::from_fn(width, height, |x, y| at(x, y).2));
    view.gives = Mask::filled(width, height, false);
    view.num_halvings += 1;
    view.camera = Intrinsics {
        width,
        height,
        fx: 0.5 * view.camera.fx,
        fy: 0.5 * view.camera.fy,
        cx: 0.5 * (view.camera.cx - 0.5),
        cy: 0.5 * (view.camera.cy - 0.5),
        ..view.camera
    };
    view.trace_rays();
}
