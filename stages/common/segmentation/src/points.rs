//! Which of the matched points are the object's.
//!
//! It stands before planes: on a mat or a table, which have nothing behind them, or on a pedestal, from whose top a gap
//! parts it.

use crate::error::SegmentationError;
use nalgebra::{Point2, Point3, Vector3};
use rilievo_numerics::lines::nearest_point;
use rilievo_numerics::plane::Plane;
use rilievo_numerics::robust::median;
use rilievo_scene::{PosedView, PosedViews};
use std::collections::{BTreeMap, VecDeque};

/// Distance of a point from a plane up to which it lies on it, as a share of the cameras' distance.
const ON_PLANE: f64 = 0.003;
/// Distance from a plane from which a point stands before it.
const BEFORE_PLANE: f64 = 0.012;
/// Fewest points on a plane, and how many times as many as behind it.
const MIN_ON_PLANE: usize = 60;
const MIN_ON_OVER_BEHIND: usize = 5;
/// Least distance of what the cameras look at from a plane: nearer, the plane is the object's own face.
const MIN_FOCUS_DISTANCE: f64 = 0.02;
/// Gap between a pedestal and what stands on it, as a share of the cameras' distance, where it may begin above the
/// pedestal's top, and the share of the points on its poorer side that may lie in it.
const GAP: f64 = 0.012;
const GAP_STEP: f64 = 0.003;
const NUM_GAP_STEPS: usize = 12;
const MAX_IN_GAP: f64 = 0.005;
/// Planes that are looked at: mat or table, a pedestal's top, walls.
const MAX_NUM_PLANES: usize = 6;
const NUM_TRIPLES: usize = 1500;
/// Points farther from what the cameras look at belong to something else, as a share of the cameras' distance.
const MAX_OFF_FOCUS: f64 = 0.6;
/// Share of the photos that have a point of the object in their frame.
const MIN_SHARE_OF_FRAMES: f64 = 0.6;
/// Side of the cells by which points are connected, as a share of the cameras' distance.
const CELL: f64 = 0.03;
/// Fewest points of an object, and of a group beside it.
const MIN_OBJECT_POINTS: usize = 60;
const MIN_BESIDE_POINTS: usize = 8;

/// What a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Object,
    Beside,
    Support,
    /// Alone, or just above a support: it may be either.
    Unsure,
    Elsewhere,
}

/// The matched points of posed photos with where each photo sees them.
#[derive(Debug)]
pub struct SeenPoints {
    points: Vec<Point3<f64>>,
    /// Of each view, the points that it sees, with their pixels.
    seen: Vec<Vec<(usize, Point2<f64>)>>,
}

/// The object's points in space, and what each photo sees of them and of everything else.
#[derive(Clone, Debug, Default)]
pub struct ObjectPoints {
    /// All points of the object, world frame.
    pub object: Vec<Point3<f64>>,
    /// Where the object stands, if on a plane that was found: points of it under the object's lowest ones.
    pub feet: Vec<Point3<f64>>,
    /// Points of other things before a support.
    pub beside: Vec<Point3<f64>>,
    /// Of each view, the pixels at which it sees something that is not the object.
    pub other_pixels: Vec<Vec<Point2<f64>>>,
}

impl SeenPoints {
    /// Sparse points and anchors.
    pub fn new(posed: &PosedViews) -> Self {
        let mut points = Vec::with_capacity(posed.points.len() + posed.anchors.len());
        let mut seen = vec![Vec::new(); posed.views.len()];
        for point in &posed.points {
            for sighting in &point.track {
                seen[sighting.view.0].push((points.len(), Point2::from(sighting.pixel)));
            }
            points.push(Point3::from(point.position));
        }
        for anchor in &posed.anchors {
            for observation in &anchor.observations {
                seen[observation.view.0].push((points.len(), Point2::from(observation.pixel)));
            }
            points.push(Point3::from(anchor.position));
        }
        Self { points, seen }
    }

    /// Parts the object from everything else.
    ///
    /// # Errors
    /// [`SegmentationError::FewPoints`].
    pub fn part(&self, views: &[PosedView]) -> Result<ObjectPoints, SegmentationError> {
        let refused = |found| SegmentationError::FewPoints {
            found,
            needed: MIN_OBJECT_POINTS,
        };
        let (focus, reach) = focus(views).ok_or(refused(0))?;
        let near: Vec<usize> = (0..self.points.len())
            .filter(|&k| (self.points[k] - focus).norm() < reach)
            .collect();
        let planes = self.supports(views, &near, &focus, reach);
        let before_all = |p: &Point3<f64>| {
            let mut planes = planes.iter();
            planes.all(|plane| plane.distance(p) > BEFORE_PLANE * reach)
        };
        let in_frames = |p: &Point3<f64>| {
            let num = views
                .iter()
                .filter(|view| project(view, p).is_some())
                .count();
            num as f64 >= MIN_SHARE_OF_FRAMES * views.len() as f64
        };
        let standing: Vec<usize> = near
            .iter()
            .copied()
            .filter(|&k| {
                let p = &self.points[k];
                (p - focus).norm() < MAX_OFF_FOCUS * reach && before_all(p) && in_frames(p)
            })
            .collect();
        let groups = self.connected(&standing, CELL * reach);
        let object = groups.first().map_or(&[][..], Vec::as_slice);
        if object.len() < MIN_OBJECT_POINTS {
            return Err(refused(object.len()));
        }
        let mut parts = vec![Part::Elsewhere; self.points.len()];
        let on_some = |p: &Point3<f64>| {
            let mut planes = planes.iter();
            planes.any(|plane| plane.distance(p) < 2.0 * ON_PLANE * reach)
        };
        for &k in &near {
            parts[k] = match on_some(&self.points[k]) {
                true => Part::Support,
                false => Part::Unsure,
            };
        }
        for group in groups[1..].iter().filter(|g| g.len() >= MIN_BESIDE_POINTS) {
            group.iter().for_each(|&k| parts[k] = Part::Beside);
        }
        object.iter().for_each(|&k| parts[k] = Part::Object);
        let of = |part: Part| -> Vec<Point3<f64>> {
            let all = self.points.iter().zip(&parts);
            all.filter(|(_, p)| **p == part).map(|(p, _)| *p).collect()
        };
        let other_pixels = self.seen.iter().map(|list| {
            let is_other = |k: usize| !matches!(parts[k], Part::Object | Part::Unsure);
            let others = list.iter().filter(|(k, _)| is_other(*k));
            others.map(|(_, pixel)| *pixel).collect()
        });
        let object = of(Part::Object);
        Ok(ObjectPoints {
            feet: planes
                .first()
                .map_or(Vec::new(), |plane| feet(&object, plane)),
            object,
            beside: of(Part::Beside),
            other_pixels: other_pixels.collect(),
        })
    }

    /// Planes that the object stands on or before: near it, with all cameras before them, and either nothing behind them or
    /// a gap between them and the object. The one with the most points first.
    fn supports(
        &self,
        views: &[PosedView],
        near: &[usize],
        focus: &Point3<f64>,
        reach: f64,
    ) -> Vec<Plane> {
        let centers: Vec<Point3<f64>> = views.iter().map(center).collect();
        let all: Vec<Point3<f64>> = near.iter().map(|&k| self.points[k]).collect();
        let mut left = all.clone();
        let mut planes = Vec::new();
        // Cameras and what they look at are on one side.
        let is_before = |normal: &Vector3<f64>, at: &Point3<f64>| {
            let side = (focus - at).dot(normal);
            side.abs() > MIN_FOCUS_DISTANCE * reach
                && centers.iter().all(|c| (c - at).dot(normal) * side > 0.0)
        };
        for _ in 0..MAX_NUM_PLANES {
            let Some(plane) = Plane::of_most(&left, ON_PLANE * reach, NUM_TRIPLES, is_before)
            else {
                break;
            };
            let plane = plane.facing(&centers);
            left.retain(|p| plane.distance(p).abs() > 2.0 * ON_PLANE * reach);
            let mut distances: Vec<f64> = all.iter().map(|p| plane.distance(p) / reach).collect();
            distances.sort_by(f64::total_cmp);
            if let Some(above) = top(&distances) {
                left.retain(|p| plane.distance(p) > above * reach);
                planes.push(Plane {
                    at: plane.at + plane.normal * (above * reach),
                    ..plane
                });
            }
        }
        planes
    }

    /// Groups of points in cells that touch, the largest first.
    fn connected(&self, chosen: &[usize], cell: f64) -> Vec<Vec<usize>> {
        let cell_of = |k: usize| {
            let p = self.points[k];
            [p.x, p.y, p.z].map(|v| (v / cell).floor() as i64)
        };
        let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
        for &k in chosen {
            cells.entry(cell_of(k)).or_default().push(k);
        }
        let mut groups = Vec::new();
        while let Some((first, points)) = cells.pop_first() {
            let mut group = points;
            let mut open = VecDeque::from([first]);
            while let Some([x, y, z]) = open.pop_front() {
                for step in 0..27 {
                    let next = [x + step % 3 - 1, y + step / 3 % 3 - 1, z + step / 9 - 1];
                    if let Some(points) = cells.remove(&next) {
                        group.extend(points);
                        open.push_back(next);
                    }
                }
            }
            groups.push(group);
        }
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        groups
    }
}

/// How far above a plane what belongs to it ends: 0 where nothing lies behind it; else, as for the top of a pedestal, where a
/// gap begins. `None` where the plane is part of something that goes on before it. `distances` of all points from it, in
/// order, and the result are shares of the cameras' distance.
fn top(distances: &[f64]) -> Option<f64> {
    let below = |limit: f64| distances.partition_point(|&d| d < limit);
    let on = below(ON_PLANE) - below(-ON_PLANE);
    if on < MIN_ON_PLANE {
        return None;
    }
    if on > MIN_ON_OVER_BEHIND * below(-BEFORE_PLANE) {
        return Some(0.0);
    }
    let begins = (0..NUM_GAP_STEPS).map(|k| BEFORE_PLANE + GAP_STEP * k as f64);
    let sides = begins.map(|start| {
        let (under, over) = (below(start), distances.len() - below(start + GAP));
        (start, below(start + GAP) - below(start), under.min(over))
    });
    let (start, inside, side) = sides.min_by_key(|(_, inside, _)| *inside)?;
    let is_gap = side >= MIN_ON_PLANE && inside as f64 <= MAX_IN_GAP * side as f64;
    is_gap.then_some(start)
}

/// Where a view sees a point; `None` outside its frame.
pub(crate) fn project(view: &PosedView, point: &Point3<f64>) -> Option<Point2<f64>> {
    let pixel = view.intrinsics.project(&view.cam_from_world.apply(point))?;
    let within = |v: f64, size: usize| (-0.5..size as f64 - 0.5).contains(&v);
    let is_in_frame =
        within(pixel.x, view.intrinsics.width) && within(pixel.y, view.intrinsics.height);
    is_in_frame.then_some(pixel)
}

fn center(view: &PosedView) -> Point3<f64> {
    view.cam_from_world.center_in_source()
}

/// The point that the middles of the frames look at, and the cameras' median distance from it.
fn focus(views: &[PosedView]) -> Option<(Point3<f64>, f64)> {
    let axes = views.iter().map(|view| {
        let camera = &view.intrinsics;
        let middle = Point2::new(
            0.5 * camera.width as f64 - 0.5,
            0.5 * camera.height as f64 - 0.5,
        );
        let axis = view.cam_from_world.rotation.inverse() * camera.ray(&middle);
        (center(view), axis.normalize())
    });
    let focus = nearest_point(axes)?;
    let mut distances: Vec<f64> = views.iter().map(|v| (center(v) - focus).norm()).collect();
    let reach = median(&mut distances)?;
    (reach > 0.0 && reach.is_finite()).then_some((focus, reach))
}

/// Share of the object's height up to which its points have their feet right below.
const LOW: f64 = 0.15;

/// The object's lowest points, moved down to its support.
fn feet(object: &[Point3<f64>], plane: &Plane) -> Vec<Point3<f64>> {
    let height = object.iter().map(|p| plane.distance(p)).fold(0.0, f64::max);
    let low = object.iter().filter(|p| plane.distance(p) < LOW * height);
    low.map(|p| p - plane.normal * plane.distance(p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distances(parts: &[(usize, [f64; 2])]) -> Vec<f64> {
        let spread = |&(num, [from, to]): &(usize, [f64; 2])| {
            (0..num).map(move |k| from + (to - from) * (k as f64 + 0.5) / num as f64)
        };
        let mut all: Vec<f64> = parts.iter().flat_map(spread).collect();
        all.sort_by(f64::total_cmp);
        all
    }

    #[test]
    fn a_mat_ends_at_itself_a_pedestal_at_the_gap_and_a_face_of_the_object_nowhere() {
        let on = (500, [-0.002, 0.002]);
        let object = (3000, [0.05, 0.4]);
        assert_eq!(top(&distances(&[on, (2000, [0.0, 0.4])])), Some(0.0));
        let above = top(&distances(&[
            (4000, [-0.3, 0.0]),
            on,
            (100, [0.0, 0.014]),
            object,
        ]));
        assert!(
            above.is_some_and(|a| (0.014..0.038).contains(&a)),
            "{above:?}"
        );
        assert_eq!(top(&distances(&[(4000, [-0.3, 0.4]), on])), None);
        // Too few points to be a plane at all.
        assert_eq!(top(&distances(&[(20, [-0.002, 0.002]), object])), None);
    }
}
