//! Where two views see one piece of surface, and how far apart they see it.
//!
//! A pixel of view `i` with point `X` and normal `n` meets the surface of view `j` along `j`'s ray
//! in `Y`; their distance along the mean normal is `d = n·(Y − X)`, positive where `j` lies
//! further out.

use crate::correction::Corrections;
use crate::options::FusionOptions;
use crate::reader::Sampler;
use crate::report::Layering;
use crate::view::{Pixels, Surface, View};
use crate::views::Stock;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median, quantile};
use rilievo_scene::ScratchError;

/// Two sightings of one surface point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Views, indices into the fused ones.
    pub views: [u16; 2],
    /// Pixels in them.
    pub pixels: [[f32; 2]; 2],
    /// Distance along the normal, world's unit.
    pub distance: f64,
    /// Change of the distance with the logarithms of the two depths.
    pub slopes: [f64; 2],
    /// Mean pixel footprint, world's unit.
    pub footprint: f64,
}

/// Cosine of incidence up to which a surface counts as turned away from a view: noise of the
/// normals at the rim must not turn it back.
pub(crate) const MIN_FACING: f64 = 0.05;
/// Distance within which surface that faces the same way counts as the same wall, doubled or not, pixel
/// footprints: what is farther apart are different parts of the object.
const WALL_PX: f64 = 30.0;

/// How another view sees a point.
pub(crate) enum Sight {
    /// Outside its map, or turned away.
    Nothing,
    /// Something nearer hides the point.
    Hidden,
    /// The view looks through the point at something farther.
    SeenThrough,
    /// One surface.
    Same {
        /// Distance along the mean normal, world's unit.
        distance: f64,
        /// Normal there, world frame.
        normal: Vector3<f64>,
        /// Cosine between that normal and the ray back to the camera.
        cosine: f64,
        footprint: f64,
        confidence: f64,
        /// Whether the pixel nearest to it gives a point of its own.
        gives: bool,
    },
}

/// A point with what fusion needs of it, world frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
    pub footprint: f64,
}

impl Candidate {
    /// The surface of a view along a ray of its camera, `z = 1`.
    pub fn of(view: &View, ray: &Vector3<f64>, surface: &Surface) -> Self {
        Self {
            point: view.point_to_world(&(ray * surface.depth)),
            normal: view.to_world(&surface.normal),
            footprint: view.footprint(surface.depth),
        }
    }
}

/// Compares a point with the surface of a view, within `tolerance` (world's unit) along the normal. Also tells how
/// far the view's surface lies from the point, along the mean normal, where it covers the point: where it
/// sees surface that faces the same way within [`WALL_PX`].
#[inline]
pub(crate) fn look(
    pixels: &mut impl Pixels,
    view: &View,
    candidate: &Candidate,
    tolerance: f64,
    min_normal_cosine: f64,
) -> (Sight, Option<f64>) {
    let in_cam = view.pose.apply(&candidate.point);
    if in_cam.z <= 0.0 {
        return (Sight::Nothing, None);
    }
    let ray = view.to_world(&(in_cam.coords / in_cam.z));
    // What is turned away lies behind the rim that the view sees, however near.
    if candidate.normal.dot(&ray) > -MIN_FACING * ray.norm() {
        return (Sight::Hidden, None);
    }
    let Some(seen) = view.along(pixels, &in_cam) else {
        return (Sight::Nothing, None);
    };
    let normal = view.to_world(&seen.normal);
    let gap = seen.depth - in_cam.z;
    let mean = candidate.normal + normal;
    let length = mean.norm();
    // Opposite normals have no mean; the surface's own decides how far apart they lie.
    let direction = if length > 0.2 { mean / length } else { normal };
    let distance = direction.dot(&ray) * gap;
    let faces_alike = candidate.normal.dot(&normal) >= min_normal_cosine;
    let is_wall =
        faces_alike && !seen.is_extrapolated && distance.abs() <= WALL_PX * candidate.footprint;
    let covers = is_wall.then_some(distance);
    let sight = if distance.abs() <= tolerance {
        if faces_alike {
            Sight::Same {
                distance,
                normal,
                cosine: -normal.dot(&ray) / ray.norm(),
                footprint: view.footprint(seen.depth),
                confidence: seen.confidence,
                gives: seen.gives,
            }
        } else {
            Sight::Nothing
        }
    } else if gap < 0.0 {
        Sight::Hidden
    } else if gap > 2.0 * tolerance.max(candidate.footprint) {
        Sight::SeenThrough
    } else {
        Sight::Nothing
    };
    (sight, covers)
}

/// For every view the others that look from nearby directions, nearest first.
pub(crate) fn neighbours(views: &[View], max_num: usize) -> Vec<Vec<usize>> {
    let directions: Vec<Vector3<f64>> = views.iter().map(|v| v.to_world(&Vector3::z())).collect();
    (0..views.len())
        .map(|i| {
            let mut others: Vec<usize> = (0..views.len())
                .filter(|&j| j != i && directions[i].dot(&directions[j]) > 0.0)
                .collect();
            others.sort_by(|&a, &b| {
                let towards = |j: usize| directions[i].dot(&directions[j]);
                towards(b).total_cmp(&towards(a)).then(a.cmp(&b))
            });
            others.truncate(max_num);
            others
        })
        .collect()
}

/// Pairs of pixels on a grid of `stride` pixels, in the order of views, rows and columns. Only what
/// gives points counts: a distance at the border or at grazing incidence tells of neither view.
pub(crate) fn find_pairs(
    stock: &Stock,
    corrections: Option<&Corrections>,
    neighbours: &[Vec<usize>],
    stride: usize,
    options: &FusionOptions,
) -> Result<Vec<Pair>, ScratchError> {
    let views = &stock.views;
    let min_normal_cosine = options.normal_tolerance_deg.to_radians().cos();
    let rows: Vec<(usize, usize)> = views
        .iter()
        .enumerate()
        .flat_map(|(i, v)| {
            (stride / 2..v.camera.height)
                .step_by(stride)
                .map(move |y| (i, y))
        })
        .collect();
    let found: Vec<Vec<Pair>> = rows
        .par_iter()
        .map(|&(i, y)| {
            let view = &views[i];
            let mut sampler = Sampler::new(&stock.shelf, corrections);
            let mut pairs = Vec::new();
            for x in (stride / 2..view.camera.width).step_by(stride) {
                let pixel = sampler.pixel(view, x, y);
                let Some(surface) = pixel.surface().filter(|s| s.gives) else {
                    continue;
                };
                let ray = view.ray(x, y, &pixel);
                let candidate = Candidate::of(view, &ray, &surface);
                for &j in &neighbours[i] {
                    let other = &views[j];
                    let tolerance = options.reconcile_max_offset_px * candidate.footprint;
                    let (sight, _) = look(
                        &mut sampler,
                        other,
                        &candidate,
                        tolerance,
                        min_normal_cosine,
                    );
                    let Sight::Same {
                        distance,
                        normal,
                        footprint,
                        gives: true,
                        ..
                    } = sight
                    else {
                        continue;
                    };
                    let in_other = other.pose.apply(&candidate.point);
                    let Some(pixel) = other.camera.project(&in_other) else {
                        continue;
                    };
                    let mean = (candidate.normal + normal).normalize();
                    pairs.push(Pair {
                        views: [i as u16, j as u16],
                        pixels: [[x as f32, y as f32], [pixel.x as f32, pixel.y as f32]],
                        distance,
                        slopes: [
                            -mean.dot(&(candidate.point - view.center)),
                            mean.dot(&(candidate.point - other.center)),
                        ],
                        footprint: 0.5 * (candidate.footprint + footprint),
                    });
                }
            }
            sampler.finish(pairs)
        })
        .collect::<Result<_, _>>()?;
    Ok(found.concat())
}

/// Samples in a window below which its mean says nothing about an offset.
const MIN_WINDOW: usize = 8;

/// Standard deviations between views that still count as one surface.
const NUM_SIGMAS: f64 = 4.0;
/// Views within this many footprints count as one surface in any case: interpolation between
/// pixels errs by less.
const MIN_TOLERANCE_PX: f64 = 1.0;

/// Distance in footprints up to which two views see one surface, from the spread of the data.
pub(crate) fn tolerance_px(median: f64, footprint: f64, options: &FusionOptions) -> f64 {
    let spread = if footprint > 0.0 {
        SIGMA_FROM_MAD * median / footprint
    } else {
        0.0
    };
    (NUM_SIGMAS * spread).clamp(
        MIN_TOLERANCE_PX.min(options.depth_tolerance_px),
        options.depth_tolerance_px,
    )
}

/// Statistics of the distances between views on one surface; pairs beyond the tolerance are
/// different surfaces (one hides the other), and only counted.
pub(crate) fn layering(pairs: &[Pair], options: &FusionOptions) -> Layering {
    if pairs.is_empty() {
        return Layering::default();
    }
    let mut all: Vec<f64> = pairs.iter().map(|p| p.distance.abs()).collect();
    let median_of_all = median(&mut all).unwrap_or_default();
    let footprint = pairs.iter().map(|p| p.footprint).sum::<f64>() / pairs.len() as f64;
    let tolerance = tolerance_px(median_of_all, footprint, options);
    let same: Vec<&Pair> = pairs
        .iter()
        .filter(|p| p.distance.abs() <= tolerance * p.footprint)
        .collect();
    let mut distances: Vec<f64> = same.iter().map(|p| p.distance.abs()).collect();
    let mean_square = distances.iter().map(|d| d * d).sum::<f64>() / distances.len().max(1) as f64;
    let mut windows: Vec<([u32; 4], f64)> = same
        .iter()
        .map(|p| {
            let cell = |c: f32| (f64::from(c) / options.reconcile_grid_px) as u32;
            let key = [
                p.views[0].into(),
                p.views[1].into(),
                cell(p.pixels[0][1]),
                cell(p.pixels[0][0]),
            ];
            (key, p.distance)
        })
        .collect();
    // A stable sort keeps the order of the sums.
    windows.sort_by_key(|w| w.0);
    let (mut square, mut weight) = (0.0, 0.0);
    for window in windows.chunk_by(|a, b| a.0 == b.0) {
        if window.len() >= MIN_WINDOW {
            let count = window.len() as f64;
            let mean = window.iter().map(|w| w.1).sum::<f64>() / count;
            square += mean * mean * count;
            weight += count;
        }
    }
    Layering {
        num_pairs: same.len(),
        num_apart: pairs.len() - same.len(),
        rms: mean_square.sqrt(),
        median: quantile(&mut distances, 0.5).unwrap_or_default(),
        p90: quantile(&mut distances, 0.9).unwrap_or_default(),
        smooth_rms: if weight > 0.0 {
            f64::sqrt(square / weight)
        } else {
            0.0
        },
        footprint,
        tolerance: tolerance * footprint,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::testing::stock;
    use nalgebra::{Point2, UnitQuaternion};
    use rilievo_scene::{Intrinsics, PosedViews, RigidTransform, ShadedViews};
    use rilievo_synthetic::testing::{Maps, posed_view};

    /// Two views of the plane `n·X = -2`, the depths of view `v` multiplied by `factors[v]`.
    fn views(factors: [f64; 2]) -> Stock {
        let camera = Intrinsics::pinhole(64, 48, 90.0, 31.5, 23.5);
        let normal = Vector3::new(0.2, -0.1, -1.0).normalize();
        let mut posed = PosedViews::default();
        let mut shaded = ShadedViews::default();
        for (v, factor) in factors.into_iter().enumerate() {
            let pose = RigidTransform {
                rotation: UnitQuaternion::from_euler_angles(0.0, 0.15 * v as f64, 0.05),
                translation: Vector3::new(0.3 * v as f64, 0.0, 0.0),
            };
            let normal_in_cam = pose.rotation * normal;
            let offset = normal_in_cam.dot(&pose.translation) - 2.0;
            let name = format!("IMG_{v}");
            posed.views.push(posed_view(v, &name, camera, pose));
            let maps = Maps::of(&camera, |[x, y]| {
                let ray = camera.ray(&Point2::new(x, y));
                let depth = factor * offset / normal_in_cam.dot(&ray);
                Some((depth, normal_in_cam))
            });
            shaded.views.push(maps.shaded(v, &name));
        }
        stock(&posed, &shaded)
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_distances() {
        let options = FusionOptions::default();
        let neighbours = [vec![1], vec![0]];
        let pairs = |factors| {
            find_pairs(&views(factors), None, &neighbours, 4, &options).expect("room in memory")
        };
        let exact = pairs([1.0; 2]);
        assert!(exact.len() > 100, "{}", exact.len());
        // A thousandth is far above the rounding of f32 depths; its square is the tolerance.
        let step = 1e-3_f64;
        for side in 0..2 {
            let mut factors = [1.0; 2];
            factors[side] = step.exp();
            let moved = pairs(factors);
            let mut compared = 0;
            for a in &exact {
                assert!(a.distance.abs() < 2e-6, "{a:?}");
                let Some(b) = moved
                    .iter()
                    .find(|b| b.views == a.views && b.pixels[0] == a.pixels[0])
                else {
                    continue;
                };
                let own = usize::from(usize::from(a.views[0]) != side);
                let (numeric, analytic) = ((b.distance - a.distance) / step, a.slopes[own]);
                let error = (numeric - analytic).abs();
                assert!(error < 5e-3, "{a:?}: {numeric} {analytic}");
                compared += 1;
            }
            assert!(compared > 100, "{compared}");
        }
    }
}
