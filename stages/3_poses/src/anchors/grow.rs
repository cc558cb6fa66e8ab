//! Seeds and growing in one reference view.
//!
//! 1. Seeds (sparse points on the object, maxima of the epipolar search) are aligned at the centre
//!    of their cell and kept when they correlate well.
//! 2. Best first: the surest patch of the queue proposes its plane, extended, to the four
//!    neighbouring cells; a proposal is aligned there and kept when it converges, correlates, moves
//!    little, has sources that agree, lies in the hull, and does not graze.
//!
//! A cell is tried a few times at most, from different neighbours. The queue is ordered by priority,
//! then cell, then entry, so that the result does not depend on anything else.

use super::grid::Grid;
use super::pair::{MAX_SOURCES, PairGeometry, ray_angle};
use super::patch::{Alignment, MIN_CORRELATION, align};
use super::plane::PatchPlane;
use super::sampling::Workspace;
use super::working::WorkingView;
use nalgebra::Point3;
use rilievo_scene::AnchorOrigin;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Tolerance of the hull test, relative to the inverse depth: the hull is stepped.
const HULL_TOLERANCE: f64 = 0.01;
/// A cell is aligned at most this often.
const MAX_TRIES: u8 = 3;

/// Smallest correlation of a patch that others grow from at the start.
const SEED_CORRELATION: f64 = 0.85;
/// Smallest correlation of a patch that one source alone supports.
const LONE_CORRELATION: f64 = 0.9;
/// Largest move from the proposed depth, working pixels of disparity; and of a seed.
const MAX_JUMP_PX: f64 = 2.0;
const MAX_SEED_JUMP_PX: f64 = 4.0;
/// Largest standard error between the sources, working pixels.
const MAX_SPREAD_PX: f64 = 0.7;
/// Largest least-squares deviation, working pixels.
const MAX_SIGMA_PX: f64 = 0.3;
/// Largest tangent of the tilt against the image plane.
const MAX_TILT: f64 = 4.0;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Node {
    pub alignment: Alignment,
    /// How it was found.
    pub origin: AnchorOrigin,
}

/// A depth to start from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seed {
    pub cell: usize,
    /// Inverse depth at the cell's centre.
    pub q: f64,
}

/// The reference view with what its patches need.
#[derive(Clone, Copy)]
pub(super) struct Reference<'a> {
    pub views: &'a [WorkingView],
    /// Index of the reference.
    pub index: usize,
    /// Geometry to every view that may serve as a source.
    pub pairs: &'a [PairGeometry],
    pub grid: &'a Grid,
    /// Range of inverse depth per cell.
    pub ranges: &'a [Option<(f64, f64)>],
    /// Radius of a patch, working pixels.
    pub radius_px: usize,
    /// Angles between the rays of reference and source, radians.
    pub angles_rad: (f64, f64),
}

impl<'a> Reference<'a> {
    /// The nearest sources of a point, by angle between the rays, within the allowed angles.
    pub fn sources(&self, point: &Point3<f64>) -> ([&'a PairGeometry; MAX_SOURCES], usize) {
        let mut chosen = [&self.pairs[0]; MAX_SOURCES];
        let mut angles = [f64::INFINITY; MAX_SOURCES];
        let mut count = 0;
        let own = &self.views[self.index].camera.center;
        for pair in self.pairs {
            let angle = ray_angle(point, own, &self.views[pair.source].camera.center);
            if !(self.angles_rad.0..=self.angles_rad.1).contains(&angle) {
                continue;
            }
            // Insertion into the sorted few.
            let at = angles.iter().position(|&a| angle < a);
            let Some(at) = at else { continue };
            for k in (at + 1..MAX_SOURCES).rev() {
                angles[k] = angles[k - 1];
                chosen[k] = chosen[k - 1];
            }
            angles[at] = angle;
            chosen[at] = pair;
            count = (count + 1).min(MAX_SOURCES);
        }
        (chosen, count)
    }

    /// Aligns a proposal and judges it.
    fn try_patch(
        &self,
        cell: usize,
        start: &PatchPlane,
        max_jump_px: f64,
        min_correlation: f64,
        ws: &mut Workspace,
    ) -> Option<Alignment> {
        let camera = &self.views[self.index].camera;
        let point = camera.unproject(start.x as f64, start.y as f64, 1.0 / start.q);
        let (sources, count) = self.sources(&point);
        let sources = &sources[..count];
        let found = align(self.views, self.index, sources, start, self.radius_px, ws)?;
        let px = found.px_per_q;
        let plane = &found.plane;
        let tilt = plane.qx.hypot(plane.qy) / plane.q * camera.focal();
        let (far, near) = self.ranges[cell]?;
        let wanted = if found.num_sources < 2 {
            LONE_CORRELATION
        } else {
            min_correlation
        };
        let kept = found.last_step_px < 0.1
            && found.correlation >= wanted
            && (plane.q - start.q).abs() * px <= max_jump_px
            && found.spread_q * px <= MAX_SPREAD_PX
            && found.sigma_q * px <= MAX_SIGMA_PX
            && tilt <= MAX_TILT
            && plane.q >= far * (1.0 - HULL_TOLERANCE)
            && plane.q <= near * (1.0 + HULL_TOLERANCE);
        kept.then_some(found)
    }

    /// The plane through a cell's centre.
    fn plane_at(&self, cell: usize, q: f64, (qx, qy): (f64, f64)) -> PatchPlane {
        let (x, y) = self.grid.pixel(cell);
        PatchPlane { x, y, q, qx, qy }
    }
}

struct Proposal {
    priority: f64,
    entry: usize,
    cell: usize,
    start: PatchPlane,
}

impl Ord for Proposal {
    // Reversed: the heap gives the largest first, the smallest value is the surest.
    fn cmp(&self, other: &Self) -> Ordering {
        other
            .priority
            .total_cmp(&self.priority)
            .then(other.cell.cmp(&self.cell))
            .then(other.entry.cmp(&self.entry))
    }
}

impl PartialOrd for Proposal {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Proposal {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Proposal {}

/// Aligns seeds into empty cells.
pub(super) fn plant(
    reference: &Reference<'_>,
    seeds: &[Seed],
    nodes: &mut [Option<Node>],
    ws: &mut Workspace,
) {
    for &Seed { cell, q } in seeds {
        if nodes[cell].is_none() {
            let start = reference.plane_at(cell, q, (0.0, 0.0));
            let found = reference.try_patch(cell, &start, MAX_SEED_JUMP_PX, SEED_CORRELATION, ws);
            let origin = AnchorOrigin::Guided;
            nodes[cell] = found.map(|alignment| Node { alignment, origin });
        }
    }
}

/// Grows from the patches that are there into empty cells.
pub(super) fn grow(reference: &Reference<'_>, nodes: &mut [Option<Node>], ws: &mut Workspace) {
    let mut tries = vec![0_u8; nodes.len()];
    let mut queue = BinaryHeap::new();
    let mut entry = 0;
    let mut propose = |queue: &mut BinaryHeap<Proposal>,
                       from: usize,
                       alignment: &Alignment,
                       nodes: &[Option<Node>],
                       tries: &[u8]| {
        let plane = &alignment.plane;
        let priority = (alignment.spread_q + alignment.sigma_q) * alignment.px_per_q;
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let Some(cell) = reference.grid.neighbour(from, dx, dy) else {
                continue;
            };
            if nodes[cell].is_some() || tries[cell] >= MAX_TRIES || reference.ranges[cell].is_none()
            {
                continue;
            }
            let (x, y) = reference.grid.pixel(cell);
            let q = plane.q
                + plane.qx * (x as f64 - plane.x as f64)
                + plane.qy * (y as f64 - plane.y as f64);
            if q > 0.0 {
                let start = reference.plane_at(cell, q, (plane.qx, plane.qy));
                queue.push(Proposal {
                    priority,
                    entry,
                    cell,
                    start,
                });
                entry += 1;
            }
        }
    };
    for cell in 0..nodes.len() {
        if let Some(node) = nodes[cell] {
            propose(&mut queue, cell, &node.alignment, nodes, &tries);
        }
    }
    while let Some(Proposal { cell, start, .. }) = queue.pop() {
        if nodes[cell].is_some() || tries[cell] >= MAX_TRIES {
            continue;
        }
        tries[cell] += 1;
        let found = reference.try_patch(cell, &start, MAX_JUMP_PX, MIN_CORRELATION, ws);
        if let Some(alignment) = found {
            let origin = AnchorOrigin::Grown;
            nodes[cell] = Some(Node { alignment, origin });
            propose(&mut queue, cell, &alignment, nodes, &tries);
        }
    }
}
