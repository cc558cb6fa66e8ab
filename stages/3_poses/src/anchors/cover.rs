//! Patches of one view: seeds from sparse points and epipolar search, then growing.

use super::exposure::learn_offsets;
use super::grow::{Node, Reference, Seed, grow, plant};
use super::pair::PairGeometry;
use super::prepare::AnchorScene;
use super::sampling::Workspace;
use super::sweep::{SweepScratch, search, search_cells};

/// Seeds in one view, and what grows from them.
pub(super) fn cover(scene: &AnchorScene<'_>, index: usize) -> Vec<Option<Node>> {
    let (view, grid) = (&scene.views[index], &scene.grids[index]);
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
        let reference = scene.reference(index, &pairs);
        for cell in search_cells(grid, stride) {
            if nodes[cell].is_none() && !std::mem::replace(&mut searched[cell], true) {
                seeds.extend(seed_of_search(&reference, scene, cell, &mut scratch));
            }
        }
        plant(&reference, &seeds, &mut nodes, &mut ws);
        seeds.clear();
        // Later patches have been held to the prior: they would only confirm it.
        if pairs.iter().all(|pair| pair.offset.is_none()) {
            learn_offsets(&mut pairs, &nodes);
        }
        grow(&scene.reference(index, &pairs), &mut nodes, &mut ws);
    }
    nodes
}

/// The depth of a cell by epipolar search.
fn seed_of_search(
    reference: &Reference<'_>,
    scene: &AnchorScene<'_>,
    cell: usize,
    scratch: &mut SweepScratch,
) -> Option<Seed> {
    let range = reference.ranges[cell]?;
    let (x, y) = reference.grid.pixel(cell);
    let camera = &reference.views[reference.index].camera;
    let middle = camera.unproject(x as f64, y as f64, 2.0 / (range.0 + range.1));
    let (sources, count) = reference.sources(&middle);
    let sources = &sources[..count];
    let q = search(
        &scene.details,
        reference.index,
        sources,
        (x, y),
        range,
        scratch,
    )?;
    Some(Seed { cell, q })
}

/// Sparse points on the object that a view sees, as seeds of their cells.
fn seeds_of_points(scene: &AnchorScene<'_>, index: usize) -> Vec<Seed> {
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
            })
        })
        .collect()
}
