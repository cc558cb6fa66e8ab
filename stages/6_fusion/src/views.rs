//! The views' maps, loaded one by one, checked, cleaned and stored: no depth edges, no borders.

use crate::color;
use crate::error::FusionError;
use crate::options::{ColorMode, FusionOptions};
use crate::pixel::Pixel;
use crate::report::ViewFusion;
use crate::view::{BlockMaxDepth, View, pinhole_ray};
use nalgebra::{Point2, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{
    BaseColor, ConfidenceMap, DepthMap, Intrinsics, MapSource, Mask, NormalMap, PageStore,
    PhotoSet, PosedView, PosedViews, Raster, Scratch, ShadedView,
};
use std::ops::Range;

/// Surface seen under a larger angle than this to its normal makes no points, degrees: there a
/// pixel covers several footprints and its depth is a guess.
const MAX_GRAZING_DEG: f64 = 82.0;
/// Slope of an edge against the steepest surface that is kept: noise must not cut slopes.
const EDGE_FACTOR: f64 = 1.5;
/// Share of a step in depth that the normals may leave unexplained where it is no edge.
const MAX_SURPRISE: f64 = 0.5;
/// Pixels around the depths that are kept, so that interpolation meets the border of the depths
/// before the border of the map.
const MARGIN: usize = 2;
/// Pixels over which a view's confidence grows from its border on, so that no seam shows where it
/// ends among others.
const BLEND_PX: f32 = 8.0;

/// Pages up to so many pixels from a depth are kept, for their colours.
const COLOR_MARGIN: usize = 4;
/// Every seventh pixel counts in the median footprint, or fewer where there would be more than this
/// many.
const SAMPLE_STEP: usize = 7;
const MAX_NUM_SAMPLES: usize = 4 << 20;

/// Least cosine of incidence of surface that makes points and shapes the mesh.
pub(crate) fn min_grazing_cosine() -> f64 {
    MAX_GRAZING_DEG.to_radians().cos()
}

/// All views, and where their pixels lie.
#[derive(Debug)]
pub(crate) struct LoadedViews {
    pub views: Vec<View>,
    pub store: PageStore,
    /// Median pixel footprint of the surface in all views, world's unit.
    pub median_footprint: f64,
    /// What the albedos are, which an asset takes for its base colour.
    pub asset_shows: BaseColor,
}

/// The maps of one view in memory.
struct Maps {
    /// First pixel in the photo's camera.
    corner_px: [usize; 2],
    camera: Intrinsics,
    depth: DepthMap,
    normal: NormalMap,
    confidence: Option<ConfidenceMap>,
    /// Normalised coordinates of the pixels of a lens that distorts.
    rays: Option<Raster<[f32; 2]>>,
    /// Pixels that make points.
    makes_points: Mask,
}

/// Loads, checks and cleans the maps of all views, and stores them with their colours.
pub(crate) fn prepare(
    photos: &PhotoSet,
    posed: &PosedViews,
    maps: &dyn MapSource,
    scratch: &dyn Scratch,
    options: &FusionOptions,
    mut next: impl FnMut(usize) -> Result<(), FusionError>,
) -> Result<(LoadedViews, Vec<ViewFusion>), FusionError> {
    let mut store = PageStore::new(scratch)?;
    let num_pixels: usize = (posed.views.iter())
        .map(|v| v.intrinsics.width.saturating_mul(v.intrinsics.height))
        .fold(0, usize::saturating_add);
    let step = SAMPLE_STEP * num_pixels.div_ceil(SAMPLE_STEP * MAX_NUM_SAMPLES).max(1);
    let mut footprints = Vec::new();
    let mut views: Vec<View> = Vec::new();
    let mut reports: Vec<ViewFusion> = Vec::new();
    let mut asset_shows = BaseColor::Grey;
    for maps_idx in 0..maps.num_views() {
        next(maps_idx)?;
        let loaded = maps.load(maps_idx)?;
        let camera_of = camera_of(posed, &loaded)?;
        let (cleaned, report) = clean(camera_of, loaded);
        let photo = photos.photos.get(camera_of.photo.0);
        let mut shows = BaseColor::Grey;
        let mut painted = |mode: ColorMode| -> Result<Option<Vec<[u8; 3]>>, FusionError> {
            let Some(photo) = photo else {
                return Ok(None);
            };
            let shown;
            (shown, shows) = color::shown(photo, maps, maps_idx, mode)?;
            let size = [cleaned.camera.width, cleaned.camera.height];
            let camera = &camera_of.intrinsics;
            let encoded = color::encode(&shown, camera, cleaned.corner_px, size);
            Ok(Some(encoded))
        };
        let colors = painted(options.color)?;
        let albedo = match (options.makes_asset(), options.color) {
            (false, _) => None,
            (true, ColorMode::Albedo) => colors.clone(),
            (true, ColorMode::Photographed) => painted(ColorMode::Albedo)?,
        };
        // One photo that keeps its light is enough for the asset to show some.
        asset_shows = match (asset_shows, shows) {
            (BaseColor::Grey, shows) | (shows, BaseColor::Grey) => shows,
            (BaseColor::Albedo, BaseColor::Albedo) => BaseColor::Albedo,
            _ => BaseColor::Photographed,
        };
        let view = store_view(
            views.len(),
            camera_of,
            &cleaned,
            [colors.as_deref(), albedo.as_deref()],
            &mut store,
        )?;
        let sampled = cleaned.depth.data.iter().step_by(step);
        footprints.extend(
            sampled
                .filter(|z| **z > 0.0)
                .map(|&z| view.footprint(z.into())),
        );
        views.push(view);
        reports.push(report);
    }
    if reports.iter().all(|r| r.num_depths == 0) {
        return Err(FusionError::NoDepth {
            num_views: views.len(),
        });
    }
    let all = LoadedViews {
        views,
        store,
        median_footprint: median(&mut footprints).unwrap_or(0.0),
        asset_shows,
    };
    Ok((all, reports))
}

fn store_view(
    idx: usize,
    camera_of: &PosedView,
    maps: &Maps,
    [colors, albedo]: [Option<&[[u8; 3]]>; 2],
    store: &mut PageStore,
) -> Result<View, FusionError> {
    let size = [maps.camera.width, maps.camera.height];
    let blend = border_blend(&maps.depth);
    let pixel = |x: usize, y: usize| {
        let i = y * size[0] + x;
        Pixel {
            depth: maps.depth.data[i],
            normal: maps.normal.data[i],
            confidence: blend.data[i] * maps.confidence.as_ref().map_or(1.0, |c| c.data[i]),
            color: colors.map_or([0; 3], |colors| colors[i]),
            albedo: albedo.map_or([0; 3], |albedo| albedo[i]),
            makes_points: maps.makes_points.data[i],
            is_kept: true,
            ray: maps.rays.as_ref().map_or([0.0; 2], |rays| rays.data[i]),
        }
    };
    let record = Pixel::record(albedo.is_some(), maps.rays.is_some());
    let pages = store.allocate(size, record, |[across, down]| {
        let grown = |range: Range<usize>, end: usize| {
            range.start.saturating_sub(COLOR_MARGIN)..(range.end + COLOR_MARGIN).min(end)
        };
        let (across, mut down) = (grown(across, size[0]), grown(down, size[1]));
        down.any(|y| across.clone().any(|x| *maps.depth.at(x, y) > 0.0))
    });
    let kept = pages.kept();
    kept.par_iter()
        .try_for_each(|&page| store.write(&pages, page, |x, y, out| pixel(x, y).write(out)))?;
    let first = maps.depth.data.iter().position(|&z| z > 0.0);
    let pose = camera_of.cam_from_world;
    Ok(View {
        idx,
        camera: maps.camera,
        pose,
        world_from_cam: pose.rotation.inverse().to_rotation_matrix().into_inner(),
        center: pose.center_in_source(),
        has_photo: colors.is_some(),
        num_depths: maps.depth.data.iter().filter(|&&z| z > 0.0).count(),
        first_px: first.map(|i| [i % size[0], i / size[0]]),
        pages,
        max_depth: BlockMaxDepth::of(&maps.depth),
    })
}

/// The posed view that maps belong to, whose camera they must fit.
fn camera_of<'a>(posed: &'a PosedViews, maps: &ShadedView) -> Result<&'a PosedView, FusionError> {
    let camera_of = posed
        .views
        .get(maps.view.0)
        .ok_or_else(|| FusionError::NoCamera {
            view: maps.name.clone(),
            view_idx: maps.view.0,
            num_posed: posed.views.len(),
        })?;
    let expected = (camera_of.intrinsics.width, camera_of.intrinsics.height);
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
    Ok(camera_of)
}

fn clean(camera_of: &PosedView, maps: ShadedView) -> (Maps, ViewFusion) {
    let mut report = ViewFusion {
        name: maps.name,
        ..ViewFusion::default()
    };
    let mut depth = maps.depth;
    for (z, n) in depth.data.iter_mut().zip(&maps.normal.data) {
        let normal_is_usable =
            n.iter().all(|c| c.is_finite()) && (Vector3::from(*n).norm() - 1.0).abs() < 0.1;
        if z.is_finite() && *z > 0.0 && normal_is_usable {
            report.num_depths += 1;
        } else {
            report.num_invalid += usize::from(*z != 0.0);
            *z = 0.0;
        }
    }
    let mut maps = crop(&camera_of.intrinsics, depth, maps.normal, maps.confidence);
    drop_edges(&mut maps, &mut report);
    mark_points(&mut maps, &mut report);
    (maps, report)
}

/// Cuts maps to the rectangle that holds depths.
fn crop(
    camera: &Intrinsics,
    depth: DepthMap,
    normal: NormalMap,
    confidence: Option<ConfidenceMap>,
) -> Maps {
    let [[x0, x1], [y0, y1]] = depth.bounds(|&z| z > 0.0).unwrap_or_default();
    let (low, high) = ([x0, y0], [x1, y1]);
    let full = [depth.width, depth.height];
    let from: [usize; 2] = std::array::from_fn(|k| low[k].saturating_sub(MARGIN));
    let [width, height] = std::array::from_fn(|k| (high[k] + MARGIN + 1).min(full[k]) - from[k]);
    let [x0, y0] = from;
    let camera = camera.cropped(x0, y0, width, height);
    Maps {
        corner_px: from,
        depth: depth.cropped(x0, y0, width, height),
        normal: normal.cropped(x0, y0, width, height),
        confidence: confidence.map(|c| c.cropped(x0, y0, width, height)),
        rays: (!camera.distortion.is_none()).then(|| rays(&camera)),
        makes_points: Mask::filled(width, height, false),
        camera,
    }
}

/// Normalised coordinates of all pixels.
fn rays(camera: &Intrinsics) -> Raster<[f32; 2]> {
    let (width, height) = (camera.width, camera.height);
    let data = (0..width * height).into_par_iter().map(|i| {
        let pixel = Point2::new((i % width) as f64, (i / width) as f64);
        let n = camera.normalized(&pixel);
        [n.x as f32, n.y as f32]
    });
    Raster {
        width,
        height,
        data: data.collect(),
    }
}

impl Maps {
    fn ray(&self, x: usize, y: usize) -> Vector3<f64> {
        match &self.rays {
            Some(rays) => {
                let [u, v] = *rays.at(x, y);
                Vector3::new(u.into(), v.into(), 1.0)
            }
            None => pinhole_ray(&self.camera, x, y),
        }
    }

    /// Depth and normal of a pixel.
    fn at(&self, x: usize, y: usize) -> Option<(f64, Vector3<f64>)> {
        let depth = *self.depth.at(x, y);
        let normal = Vector3::from(self.normal.at(x, y).map(f64::from));
        (depth > 0.0).then_some((depth.into(), normal))
    }
}

/// Steps to the four neighbours.
const AROUND: [[isize; 2]; 4] = [[-1, 0], [1, 0], [0, -1], [0, 1]];

/// Clears pixels on both sides of depth edges: no surface runs from one side to the other. A step
/// that the tangent planes of both sides foretell is no edge but oblique surface.
fn drop_edges(maps: &mut Maps, report: &mut ViewFusion) {
    let (width, height) = (maps.depth.width, maps.depth.height);
    // The steepest surface that is kept rises by this share of its depth from pixel to pixel.
    let steepest = EDGE_FACTOR * MAX_GRAZING_DEG.to_radians().tan() / maps.camera.focal_px();
    let is_edge_to = |x: usize, y: usize, dx: isize, dy: isize| {
        let (Some((depth, normal)), Some(u), Some(v)) = (
            maps.at(x, y),
            x.checked_add_signed(dx).filter(|&u| u < width),
            y.checked_add_signed(dy).filter(|&v| v < height),
        ) else {
            return false;
        };
        let Some((next_depth, next_normal)) = maps.at(u, v) else {
            return false;
        };
        let step = (next_depth / depth).ln();
        if step.abs() <= steepest {
            return false;
        }
        // The logarithm of the depths' ratio on a plane with normal n is ln(n·r / n·r').
        let (ray, next) = (maps.ray(x, y), maps.ray(u, v));
        let on_plane = |n: &Vector3<f64>| (n.dot(&ray) / n.dot(&next)).ln();
        let foretold = 0.5 * (on_plane(&normal) + on_plane(&next_normal));
        // Written so that a plane seen from behind, whose logarithm is no number, foretells
        // nothing.
        !(step - foretold).abs().lt(&(MAX_SURPRISE * step.abs()))
    };
    let edges: Vec<usize> = (0..width * height)
        .into_par_iter()
        .filter(|i| {
            let (x, y) = (i % width, i / width);
            AROUND.iter().any(|&[dx, dy]| is_edge_to(x, y, dx, dy))
        })
        .collect();
    report.num_border += edges.len();
    for i in edges {
        maps.depth.data[i] = 0.0;
    }
}

/// Weight of a pixel by its distance from where the map ends, 0 there and 1 from [`BLEND_PX`] on.
/// Distances are those of steps to the eight neighbours. Single pixels without a depth are no end:
/// their eight neighbours are without one there.
fn border_blend(depth: &DepthMap) -> Raster<f32> {
    let (width, height) = (depth.width, depth.height);
    let is_end = |x: usize, y: usize| {
        let (columns, rows) = (x.saturating_sub(1)..=x + 1, y.saturating_sub(1)..=y + 1);
        let mut around = rows.flat_map(|v| columns.clone().map(move |u| (u, v)));
        around.all(|(u, v)| u >= width || v >= height || *depth.at(u, v) <= 0.0)
    };
    let mut distance = Raster::from_fn(width, height, |x, y| {
        let at_frame = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        if at_frame || is_end(x, y) {
            0.0
        } else {
            BLEND_PX
        }
    });
    let diagonal = std::f32::consts::SQRT_2;
    let steps = [
        (-1, 0, 1.0),
        (-1, -1, diagonal),
        (0, -1, 1.0),
        (1, -1, diagonal),
    ];
    let mut relax = |x: usize, y: usize, sign: isize| {
        let mut least = *distance.at(x, y);
        if least > 0.0 {
            for (dx, dy, length) in steps {
                let from = (
                    x.wrapping_add_signed(sign * dx),
                    y.wrapping_add_signed(sign * dy),
                );
                least = least.min(*distance.at(from.0, from.1) + length);
            }
            *distance.at_mut(x, y) = least;
        }
    };
    for y in 0..height {
        (0..width).for_each(|x| relax(x, y, 1));
    }
    for y in (0..height).rev() {
        (0..width).rev().for_each(|x| relax(x, y, -1));
    }
    distance.data.iter_mut().for_each(|d| *d /= BLEND_PX);
    distance
}

/// Marks the pixels that make points: not at the map's border, where depth is extrapolated, and not
/// grazing.
fn mark_points(maps: &mut Maps, report: &mut ViewFusion) {
    let (width, height) = (maps.depth.width, maps.depth.height);
    let has_depth = |x: usize, y: usize, [dx, dy]: [isize; 2]| {
        let depth = maps.depth.get(x as isize + dx, y as isize + dy);
        depth.is_some_and(|&z| z > 0.0)
    };
    let mut inside = Mask::from_fn(width, height, |x, y| {
        let is_inside = AROUND.iter().all(|&step| has_depth(x, y, step));
        let is_there = has_depth(x, y, [0, 0]);
        report.num_border += usize::from(is_there && !is_inside);
        is_there && is_inside
    });
    let min_cosine = min_grazing_cosine();
    let is_grazing = |i: usize| {
        let (x, y) = (i % width, i / width);
        let surface = maps.at(x, y).filter(|_| inside.data[i]);
        surface.is_some_and(|(_, normal)| {
            let cosine = -normal.dot(&maps.ray(x, y).normalize());
            cosine.is_nan() || cosine < min_cosine
        })
    };
    let grazing: Vec<usize> = (0..width * height)
        .into_par_iter()
        .filter(|&i| is_grazing(i))
        .collect();
    report.num_grazing += grazing.len();
    for i in grazing {
        inside.data[i] = false;
    }
    maps.makes_points = inside;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_grow_from_every_border_on() {
        let mut depth = DepthMap::filled(80, 60, 1.0);
        *depth.at_mut(20, 30) = 0.0;
        for (x, y) in (39..42).flat_map(|x| (29..32).map(move |y| (x, y))) {
            *depth.at_mut(x, y) = 0.0;
        }
        let blend = border_blend(&depth);
        let expected = |x: usize, y: usize| {
            let frame = x.min(y).min(79 - x).min(59 - y) as f64;
            let hole = (x as f64 - 40.0).hypot(y as f64 - 30.0);
            frame.min(hole).min(f64::from(BLEND_PX)) / f64::from(BLEND_PX)
        };
        for y in 0..60 {
            for x in 0..80 {
                // Steps to eight neighbours are at most 8.2 % longer than the straight line.
                let (got, wanted) = (f64::from(*blend.at(x, y)), expected(x, y));
                let fits = got >= wanted - 1e-6 && got <= 1.083 * wanted + 1e-6;
                assert!(fits, "{x} {y}: {got} {wanted}");
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;
    use rilievo_scene::{MemoryScratch, ShadedViews};

    /// Views of a set without photos, in memory.
    pub fn load(posed: &PosedViews, shaded: &ShadedViews) -> LoadedViews {
        let (photos, options) = (PhotoSet::default(), FusionOptions::default());
        prepare(&photos, posed, shaded, &MemoryScratch, &options, |_| Ok(()))
            .expect("sound maps")
            .0
    }
}
