//! The views' maps, loaded, checked and cleaned: no depth edges, no borders, no more than the memory
//! holds.

use crate::error::FusionError;
use crate::memory;
use crate::options::FusionOptions;
use crate::report::ViewFusion;
use crate::view::View;
use nalgebra::Vector3;
use rilievo_scene::{MapSource, Mask, PosedViews, Raster, ShadedView};

/// Slope of an edge against the steepest surface that is kept: noise must not cut slopes.
const EDGE_FACTOR: f64 = 1.5;
/// Share of a step in depth that the normals may leave unexplained where it is no edge.
const MAX_SURPRISE: f64 = 0.5;

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
