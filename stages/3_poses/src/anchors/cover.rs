//! Patches of one view: seeds from sparse points and epipolar search, then growing.

use super::exposure::learn_offsets;
use super::grow::{Node, Reference, Seed, grow, plant};
use super::options::AnchorMode;
use super::pair::PairGeometry;
use super::prepare::Scene;
use super::sampling::Workspace;
use super::sweep::{SweepOptions, SweepScratch, search, search_cells};
use rilievo_scene::AnchorOrigin;

/// Criteria of the epipolar search; the ratio is that of keypoint matching.
const SWEEP: SweepOptions = SweepOptions {
    min_score: 0.5,
    ratio: 0.8,
};

/// Seeds and, in `grown` mode, growing in one view.
pub(super) fn cover(scene: &Scene<'_>, index: usize) -> Vec<Option<Node>> {
    let (view, grid) = (&scene.views[index], &scene.grids[index]);
    let ranges = &scene.ranges[index];
    let mut pairs: Vec<PairGeometry> = (scene.neighbours[index].iter())
        .filter_map(|&source| PairGeometry::new(view, source, &scene.views[source]))
        .collect();
    let mut nodes = vec![None; grid.len()];
    let mut ws = Workspace::default();
    let mut scratch = SweepScratch::default();
    let mut seeds = seeds_of_points(scene, index);
    let mut searched = vec![false; grid.len()];
    // Searching costs most: what growing has covered from few seeds need not be searched.
    for stride in [4, 2] {
        let reference = Reference {
            views: &scene.views,
            index,
            pairs: &pairs,
            grid,
            ranges,
        };
        for cell in search_cells(grid, stride) {
            if nodes[cell].is_none() && !std::mem::replace(&mut searched[cell], true) {
                seeds.extend(seed_of_search(&reference, scene, cell, &mut scratch));
            }
        }
        plant(
            &reference,
            &seeds,
            AnchorOrigin::Guided,
            &scene.grow,
            &mut nodes,
            &mut ws,
        );
        seeds.clear();
        if scene.options.mode == AnchorMode::Grown {
            // Later patches have been held to the prior: they would only confirm it.
            if pairs.iter().all(|pair| pair.offset.is_none()) {
                learn_offsets(&mut pairs, &nodes);
            }
            let reference = Reference {
                views: &scene.views,
                index,
                pairs: &pairs,
                grid,
                ranges,
            };
            grow(&reference, &scene.grow, &mut nodes, &mut ws);
        }
    }
    nodes
}

/// The depth of a cell by epipolar search.
fn seed_of_search(
    reference: &Reference<'_>,
    scene: &Scene<'_>,
    cell: usize,
    scratch: &mut SweepScratch,
) -> Option<Seed> {
    let range = reference.ranges[cell]?;
    let (x, y) = reference.grid.pixel(cell);
    let view = &reference.views[reference.index];
    let middle = view
        .camera
        .unproject(x as f64, y as f64, 2.0 / (range.0 + range.1));
    let (sources, count) = reference.sources(&middle, scene.grow.angles_rad);
    let q = search(
        &scene.details,
        reference.index,
        &sources[..count],
        (x, y),
        range,
        &SWEEP,
        scratch,
    )?;
    Some(Seed {
        cell,
        q,
        qx: 0.0,
        qy: 0.0,
    })
}

/// Sparse points on the object that a view sees, as seeds of their cells.
fn seeds_of_points(scene: &Scene<'_>, index: usize) -> Vec<Seed> {
    let (view, grid) = (&scene.views[index], &scene.grids[index]);
    scene.points[index]
        .iter()
        .filter_map(|point| {
            let (x, y, depth) = view.camera.project(point)?;
            let cell = grid.cell(x, y).filter(|_| view.on_object(x, y))?;
            scene.ranges[index][cell]?;
            Some(Seed {
                cell,
                q: 1.0 / depth,
                qx: 0.0,
                qy: 0.0,
            })
        })
        .collect()
}
