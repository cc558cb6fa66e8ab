//! Range of depth at every cell of a view, from the masks of the others (visual hull).
//!
//! A point of the object lies, in every view that shows it, on that view's mask. Along the ray of a
//! cell, inverse depth is stepped through the ball that holds the object and tested against all
//! masks; the range is the span of the steps that pass, widened by one step on either side.
//! The ball is centred where the rays through the masks' centroids meet (least squares), with the
//! radius that the largest mask subtends. Without any mask the range is that of the sparse points
//! in the world, widened.

use super::filter::box_dilate;
use super::working::WorkingView;
use nalgebra::{Matrix3, Point3, Vector3};
use rilievo_numerics::robust::quantile;
use rilievo_scene::Mask;

/// Steps along a ray.
const NUM_STEPS: usize = 96;
/// Masks are widened before the test: outlines and poses are not exact.
const MASK_TOLERANCE_PX: usize = 3;
/// Radius of the ball in units of the root of a mask's area, seen at the ball's distance: 1.1 holds
/// an object four times as long as wide.
const RADIUS_PER_ROOT_AREA: f64 = 1.1;
/// Cells on the object of a view at most: more anchors would cost time and tell little, since
/// neighbours' errors correlate.
const MAX_CELLS: f64 = 6000.0;
/// Widening of the sparse points' range of depth when there are no masks.
const RANGE_MARGIN: f64 = 1.15;

/// Ball that holds the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    /// Its centre in the world.
    pub center: Point3<f64>,
    /// Its radius, world's unit.
    pub radius: f64,
}

/// Regular cells over a working view; anchors lie at their centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Grid {
    /// Distance between neighbouring anchors, working pixels.
    pub spacing: usize,
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
}

impl Grid {
    /// Cells over a view.
    pub fn new(view: &WorkingView, spacing: usize) -> Self {
        Self {
            spacing,
            columns: view.width / spacing,
            rows: view.height / spacing,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Pixel at the centre of a cell.
    pub fn pixel(&self, cell: usize) -> (usize, usize) {
        let half = self.spacing / 2;
        (
            (cell % self.columns) * self.spacing + half,
            (cell / self.columns) * self.spacing + half,
        )
    }

    /// Cell of a position.
    pub fn cell(&self, x: f64, y: f64) -> Option<usize> {
        if x.is_nan() || y.is_nan() || x < 0.0 || y < 0.0 {
            return None;
        }
        let (column, row) = (x as usize / self.spacing, y as usize / self.spacing);
        (column < self.columns && row < self.rows).then(|| row * self.columns + column)
    }

    /// Cell at an offset in columns and rows.
    pub fn neighbour(&self, cell: usize, dx: isize, dy: isize) -> Option<usize> {
        let column = (cell % self.columns) as isize + dx;
        let row = (cell / self.columns) as isize + dy;
        (column >= 0 && row >= 0 && column < self.columns as isize && row < self.rows as isize)
            .then(|| row as usize * self.columns + column as usize)
    }
}

/// Distance between cells: the wanted one, or more where the object is so large in the photos that
/// a view would get more than a few thousand anchors.
pub(super) fn grid_spacing(views: &[WorkingView], wanted_px: f64) -> usize {
    let largest = views.iter().map(|view| view.object.count()).max();
    let needed = (largest.unwrap_or(0) as f64 / MAX_CELLS).sqrt();
    wanted_px.max(needed).round() as usize
}

/// Ball that holds the object; `None` where neither masks nor sparse points tell.
pub(super) fn bounding_ball(views: &[WorkingView], points: &[Point3<f64>]) -> Option<Ball> {
    let masked: Vec<&WorkingView> = views.iter().filter(|view| view.has_mask).collect();
    if masked.len() < 2 {
        return ball_of_points(points);
    }
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for view in &masked {
        let (mut x, mut y, mut n) = (0.0, 0.0, 0.0);
        for v in 0..view.height {
            for u in 0..view.width {
                if *view.object.at(u, v) {
                    x += u as f64;
                    y += v as f64;
                    n += 1.0;
                }
            }
        }
        let ray = (view.rotation.transpose() * view.ray(x / n, y / n)).normalize();
        let across = Matrix3::identity() - ray * ray.transpose();
        normal += across;
        right += across * view.center.coords;
    }
    let center = Point3::from(normal.try_inverse()? * right);
    let radius = masked
        .iter()
        .map(|view| {
            RADIUS_PER_ROOT_AREA
                * (view.center - center).norm()
                * (view.object.count() as f64).sqrt()
                / view.focal()
        })
        .fold(0.0, f64::max);
    (radius.is_finite() && radius > 0.0).then_some(Ball { center, radius })
}

/// Ball around the sparse points, the outermost hundredth left out.
fn ball_of_points(points: &[Point3<f64>]) -> Option<Ball> {
    if points.len() < 2 {
        return None;
    }
    let axis = |k: usize| {
        let mut values: Vec<f64> = points.iter().map(|p| p[k]).collect();
        quantile(&mut values, 0.5)
    };
    let center = Point3::new(axis(0)?, axis(1)?, axis(2)?);
    let mut distances: Vec<f64> = points.iter().map(|p| (p - center).norm()).collect();
    let radius = RANGE_MARGIN * quantile(&mut distances, 0.99)?;
    (radius > 0.0).then_some(Ball { center, radius })
}

/// Masks widened for the hull test, one per view; `None` without a mask.
pub(super) fn widened_masks(views: &[WorkingView]) -> Vec<Option<Mask>> {
    views
        .iter()
        .map(|view| {
            view.has_mask
                .then(|| box_dilate(&view.object, MASK_TOLERANCE_PX))
        })
        .collect()
}

/// Range of inverse depth (far, near) at the cells of a view; `None` off the object and outside
/// the hull.
pub(super) fn depth_ranges(
    views: &[WorkingView],
    reference: usize,
    grid: &Grid,
    ball: &Ball,
    masks: &[Option<Mask>],
) -> Vec<Option<(f64, f64)>> {
    let view = &views[reference];
    let depth_of_center = view.cam_from_world.apply(&ball.center).z;
    let nearest = (depth_of_center - ball.radius).max(0.02 * depth_of_center.abs());
    let farthest = depth_of_center + ball.radius;
    if farthest <= nearest {
        return vec![None; grid.len()];
    }
    let (q_near, q_far) = (1.0 / nearest, 1.0 / farthest);
    let step = (q_near - q_far) / (NUM_STEPS - 1) as f64;
    (0..grid.len())
        .map(|cell| {
            let (x, y) = grid.pixel(cell);
            if !view.on_object(x as f64, y as f64) {
                return None;
            }
            let inside = |k: usize| {
                let point = view.point(x as f64, y as f64, q_far + k as f64 * step);
                views
                    .iter()
                    .zip(masks)
                    .enumerate()
                    .all(|(idx, (other, mask))| {
                        let Some(mask) = mask else { return true };
                        if idx == reference {
                            return true;
                        }
                        let Some((u, v, _)) = other.project(&point) else {
                            return true;
                        };
                        !other.in_frame(u, v)
                            || mask.contains(u.round() as isize, v.round() as isize)
                    })
            };
            let first = (0..NUM_STEPS).find(|&k| inside(k))?;
            let last = (first..NUM_STEPS).rev().find(|&k| inside(k))?;
            let far = q_far + (first as f64 - 1.0) * step;
            let near = q_far + (last as f64 + 1.0) * step;
            Some((far.max(0.5 * q_far), near))
        })
        .collect()
}
