//! Where along its ray a pixel's surface point may lie: inside every view's mask.
//!
//! The range of the whole object comes first: the point nearest to the rays through the masks'
//! centroids, and the largest extent that a mask subtends there; or, without masks, the depths of
//! the sparse points. Per pixel, inverse depths are sampled and kept while all masks contain them, or they lie beyond a
//! photo whose frame cuts the object.

use crate::camera::{Camera, Warp};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::lines::nearest_point;
use rilievo_numerics::robust::quantile;
use rilievo_scene::Mask;

/// Samples along a ray.
const NUM_SAMPLES: usize = 256;

/// Where a view shows the object.
#[derive(Clone, Copy, Debug)]
pub struct Outline<'a> {
    /// The view's camera, of the mask's size.
    pub camera: &'a Camera,
    /// The object, or all pixels where there is no mask.
    pub mask: &'a Mask,
    /// Whether there is one.
    pub is_masked: bool,
    /// Whether the object may reach beyond what the photo shows.
    pub cut_by_frame: bool,
}

impl Outline<'_> {
    /// Whether a point at a homogeneous pixel may belong to the object.
    #[inline]
    fn allows(&self, p: &Vector3<f64>) -> bool {
        if p.z.is_nan() || p.z <= 0.0 {
            return self.cut_by_frame;
        }
        let (u, v) = ((p.x / p.z).round(), (p.y / p.z).round());
        self.mask.contains(u as isize, v as isize)
            || self.cut_by_frame && !self.camera.shows(u as i32, v as i32)
    }
}

/// Inverse depths between which a view's surface lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthRange {
    /// That of the farthest point, one over the world's unit.
    pub low: f32,
    /// That of the nearest point.
    pub high: f32,
}

/// How much farther, and nearer, than sparse points the object may reach where masks do not end with it.
const BEYOND_POINTS: f32 = 2.0;

/// Range of each view, `None` where it is not known: from two masks and more, else from points in the world; from both
/// where the frame cuts the object, since its masks may bound it badly.
pub fn object_ranges(
    outlines: &[Outline],
    points: &[Point3<f64>],
) -> Vec<Option<InverseDepthRange>> {
    let masked: Vec<Outline> = outlines.iter().copied().filter(|o| o.is_masked).collect();
    if masked.len() < 2 {
        return outlines
            .iter()
            .map(|outline| range_of_points(outline, points))
            .collect();
    }
    let ball = object_ball(&masked);
    let of_ball = |outline: &Outline| {
        let (center, radius) = ball?;
        let (_, _, depth) = outline.camera.project(&center)?;
        let near = (depth - 1.3 * radius).max(0.15 * depth);
        Some(InverseDepthRange {
            low: (1.0 / (depth + 1.3 * radius)) as f32,
            high: (1.0 / near) as f32,
        })
    };
    let is_cut = masked.iter().any(|outline| outline.cut_by_frame);
    outlines
        .iter()
        .map(|outline| {
            let of_points = is_cut.then(|| range_of_points(outline, points)).flatten();
            match (of_ball(outline), of_points) {
                (Some(a), Some(b)) => Some(InverseDepthRange {
                    low: a.low.max(b.low / BEYOND_POINTS).min(b.low),
                    high: a.high.min(b.high * BEYOND_POINTS).max(b.high),
                }),
                (a, b) => a.or(b),
            }
        })
        .collect()
}

/// Centre and radius of a ball around the object, from the masks.
pub fn object_ball(outlines: &[Outline]) -> Option<(Point3<f64>, f64)> {
    let mut axes = Vec::new();
    let mut extents = Vec::new();
    for Outline { camera, mask, .. } in outlines {
        let inside = || {
            let at = |i: usize| ((i % mask.width) as f64, (i / mask.width) as f64);
            let set = mask.data.iter().enumerate().filter(|&(_, &inside)| inside);
            set.map(move |(i, _)| at(i))
        };
        let (mut x, mut y, mut n) = (0.0, 0.0, 0.0);
        for (px, py) in inside() {
            (x, y, n) = (x + px, y + py, n + 1.0);
        }
        if n == 0.0 {
            continue;
        }
        let (x, y) = (x / n, y / n);
        let direction = camera.rotation.tr_mul(&camera.ray(x, y)).normalize();
        axes.push((camera.center, direction));
        let farthest = inside()
            .map(|(px, py)| ((px - x) / camera.fx).hypot((py - y) / camera.fy))
            .fold(0.0, f64::max);
        extents.push((camera, farthest));
    }
    let center = nearest_point(axes)?;
    let mut radius = 0.0_f64;
    for (camera, farthest) in extents {
        // A camera with the centre behind it is posed wrongly, and does not count.
        if let Some((_, _, depth)) = camera.project(&center) {
            radius = radius.max(farthest * depth);
        }
    }
    (radius > 0.0).then_some((center, radius))
}

fn range_of_points(outline: &Outline, points: &[Point3<f64>]) -> Option<InverseDepthRange> {
    let mut inverse: Vec<f64> = points
        .iter()
        .filter_map(|p| outline.camera.project(p))
        .filter(|&(x, y, _)| {
            let mask = outline.mask;
            mask.contains(x.round() as isize, y.round() as isize)
        })
        .map(|(_, _, z)| 1.0 / z)
        .collect();
    if inverse.len() < 3 {
        return None;
    }
    let (low, high) = (quantile(&mut inverse, 0.01)?, quantile(&mut inverse, 0.99)?);
    let margin = 0.3 * (high - low) + 0.02 * high;
    Some(InverseDepthRange {
        low: (low - margin).max(0.2 * low) as f32,
        high: (high + margin) as f32,
    })
}

/// Part of `range` that all outlines but view `index`'s own allow, at each of its pixels `positions`; `None`
/// where they contradict each other.
pub fn ranges_inside(
    outlines: &[Outline],
    index: usize,
    positions: &[(f64, f64)],
    range: InverseDepthRange,
) -> Vec<Option<InverseDepthRange>> {
    let camera = outlines[index].camera;
    let others: Vec<(Warp, &Outline)> = outlines
        .iter()
        .enumerate()
        .filter(|&(j, _)| j != index)
        .filter_map(|(_, other)| Warp::between(camera, other.camera).map(|warp| (warp, other)))
        .collect();
    let step = (range.high - range.low) / (NUM_SAMPLES - 1) as f32;
    positions
        .par_iter()
        .map(|&(x, y)| {
            let bases: Vec<Vector3<f64>> = others
                .iter()
                .map(|(warp, _)| warp.a * Vector3::new(x, y, 1.0))
                .collect();
            let inverse_depth = |k: usize| range.low + step * k as f32;
            let is_seen = |&k: &usize| {
                let w = f64::from(inverse_depth(k));
                others
                    .iter()
                    .zip(&bases)
                    .all(|((warp, other), base)| other.allows(&(base + warp.b * w)))
            };
            let low = (0..NUM_SAMPLES).find(is_seen)?;
            let high = (low..NUM_SAMPLES).rev().find(is_seen)?;
            Some(InverseDepthRange {
                low: inverse_depth(low) - 2.0 * step,
                high: inverse_depth(high) + 2.0 * step,
            })
        })
        .collect()
}

/// A mask grown by `radius` pixels (square neighbourhood).
pub fn dilate(mask: &Mask, radius: usize) -> Mask {
    let reach = radius as isize;
    let grown = |mask: &Mask, dx: isize, dy: isize| {
        Mask::from_fn(mask.width, mask.height, |x, y| {
            let (x, y) = (x as isize, y as isize);
            (-reach..=reach).any(|k| mask.contains(x + k * dx, y + k * dy))
        })
    };
    grown(&grown(mask, 1, 0), 0, 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::is_cut_by_frame;
    use rilievo_scene::{Intrinsics, RigidTransform};

    /// A camera at `x` that looks along +z, and sees 80 columns to the right of its axis and `to_left` to the left.
    fn camera(x: f64, to_left: usize) -> Camera {
        let intrinsics = Intrinsics::pinhole(to_left + 80, 60, 100.0, to_left as f64, 29.5);
        let pose = RigidTransform {
            translation: Vector3::new(-x, 0.0, 0.0),
            ..RigidTransform::identity()
        };
        Camera::new(&intrinsics, &pose)
    }

    fn outline<'a>(camera: &'a Camera, mask: &'a Mask, cut_by_frame: bool) -> Outline<'a> {
        Outline {
            camera,
            mask,
            is_masked: true,
            cut_by_frame,
        }
    }

    #[test]
    fn a_photo_forbids_nothing_beyond_its_frame() {
        // At depth 1 the point lies 50 px left of the second camera's axis, at depth 2 25 px.
        let (first, second) = (camera(0.0, 60), camera(0.5, 40));
        let masks = [&first, &second].map(|c| Mask::filled(c.width, c.height, true));
        let whole = InverseDepthRange {
            low: 0.4,
            high: 1.25,
        };
        let range = |cut_by_frame: bool| {
            let outlines = [
                outline(&first, &masks[0], cut_by_frame),
                outline(&second, &masks[1], cut_by_frame),
            ];
            ranges_inside(&outlines, 0, &[(60.0, 30.0)], whole)[0].unwrap()
        };
        let (ends, cut) = (range(false), range(true));
        assert!((ends.high - 0.8).abs() < 0.02, "{ends:?}");
        assert!(cut.low <= whole.low && cut.high >= whole.high, "{cut:?}");
        // What the photo shows beside the object stays forbidden.
        let right = Mask::from_fn(second.width, second.height, |x, _| x > 20);
        let cut = outline(&second, &right, true);
        let beside = |w: f64| !cut.allows(&Vector3::new(40.0 - 50.0 * w, 30.0, 1.0));
        assert!(!beside(0.3) && beside(0.5) && beside(0.7) && !beside(0.9));
    }

    #[test]
    fn parallel_photos_that_the_object_fills_are_ranged_by_points() {
        let cameras = [0.0, 0.5, 1.0].map(|x| camera(x, 60));
        let mask = Mask::filled(140, 60, true);
        let points: Vec<Point3<f64>> = (0..40)
            .map(|i| {
                Point3::new(
                    0.05 * f64::from(i) - 0.5,
                    0.1,
                    2.0 + 0.01 * f64::from(i % 7),
                )
            })
            .collect();
        let outlines = cameras
            .each_ref()
            .map(|camera| outline(camera, &mask, true));
        for range in object_ranges(&outlines, &points) {
            let range = range.unwrap();
            assert!(range.low < 0.485 && range.low > 0.2, "{range:?}");
            assert!(range.high > 0.5 && range.high < 1.1, "{range:?}");
        }
        // Masks that turn about the object bound it beyond the points.
        let turned = [-0.4_f64, 0.0, 0.4].map(|angle| {
            let about = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
            let target = Vector3::new(0.1, 0.0, 2.0);
            let pose = RigidTransform {
                rotation: about,
                translation: target - about * target,
            };
            Camera::new(&Intrinsics::pinhole(140, 60, 100.0, 60.0, 29.5), &pose)
        });
        let outlines = turned.each_ref().map(|camera| outline(camera, &mask, true));
        let few: Vec<Point3<f64>> = (0..9)
            .map(|i| Point3::new(0.1 + 0.01 * f64::from(i), 0.0, 2.0))
            .collect();
        let range = object_ranges(&outlines, &few)[1].unwrap();
        assert!(range.low < 0.4 && range.low > 0.2, "{range:?}");
    }

    #[test]
    fn a_mask_beside_the_frame_may_be_cut_by_it() {
        let camera = camera(0.0, 60);
        let reaching = |from: usize| {
            Mask::from_fn(140, 60, |x, y| x >= from && x < 90 && (20..40).contains(&y))
        };
        for (from, expected) in [(0, true), (2, true), (6, false)] {
            assert_eq!(
                is_cut_by_frame(&camera, &reaching(from)),
                expected,
                "{from}"
            );
        }
    }

    #[test]
    fn dilation_reaches_as_far_as_asked() {
        let mut mask = Mask::filled(9, 9, false);
        *mask.at_mut(4, 4) = true;
        let wide = dilate(&mask, 2);
        assert_eq!(wide.count(), 25);
        assert!(*wide.at(2, 6) && !*wide.at(1, 4));
    }
}
