//! Columns of the reduced system, and which of its entries are not zero.
//!
//! Columns come in blocks, one for each view, for each camera's lens and for its principal point, where
//! they are free. Two blocks meet in the Schur complement where both bear on one point, so that a view
//! meets the views that it shares points with, and a refined camera all of its own. The lower triangle
//! is kept by columns: below the diagonal block follow the blocks that meet it, ascending, so that all
//! columns of a block have the same rows but for those above their diagonal.

use super::bundle::Bundle;
use crate::projection::{NUM_INTRINSICS, PRINCIPAL_POINT};
use std::ops::Range;

/// Column of each parameter in the reduced system; `None` where it is fixed.
pub(crate) struct Layout {
    /// Per view: `(ω, δ)`.
    pub views: Vec<[Option<usize>; 6]>,
    /// Per camera.
    pub cameras: Vec<[Option<usize>; NUM_INTRINSICS]>,
    /// Entries of the reduced system.
    pub pattern: Pattern,
}

impl Layout {
    /// Numbers the free parameters, views first, and finds what meets.
    pub fn new(bundle: &Bundle) -> Self {
        let mut starts = vec![0];
        let mut next = 0;
        let mut number = |free: bool| {
            free.then(|| {
                next += 1;
                next - 1
            })
        };
        // Block of each view and camera.
        let mut blocks = Vec::new();
        let mut end_block = |last: Option<usize>| {
            blocks.push(last.map(|last| {
                starts.push(last + 1);
                starts.len() - 2
            }));
        };
        let mut views = Vec::with_capacity(bundle.views.len());
        for view in &bundle.views {
            let columns = view.free.map(&mut number);
            end_block(columns.iter().flatten().next_back().copied());
            views.push(columns);
        }
        let mut cameras = Vec::with_capacity(bundle.cameras.len());
        // Of each camera its lens, then its principal point: cameras may share the former alone.
        for camera in &bundle.cameras {
            let mut columns = [None; NUM_INTRINSICS];
            for of_lens in [true, false] {
                let mut last = None;
                for (k, column) in columns.iter_mut().enumerate() {
                    if of_lens != PRINCIPAL_POINT.contains(&k) {
                        *column = number(camera.is_own(k) && camera.prior_sigma[k].is_some());
                        last = column.or(last);
                    }
                }
                end_block(last);
            }
            cameras.push(columns);
        }
        for (k, camera) in bundle.cameras.iter().enumerate() {
            if let Some(lens) = camera.lens_of {
                let mut columns: [Option<usize>; NUM_INTRINSICS] = cameras[lens];
                columns[PRINCIPAL_POINT].copy_from_slice(&cameras[k][PRINCIPAL_POINT]);
                cameras[k] = columns;
            }
        }
        let pattern = Pattern::new(starts, &blocks_of_points(bundle, &blocks));
        Self {
            views,
            cameras,
            pattern,
        }
    }
}

/// The blocks that bear on each point, ascending.
fn blocks_of_points(bundle: &Bundle, blocks: &[Option<usize>]) -> Vec<Vec<usize>> {
    bundle
        .offsets
        .windows(2)
        .map(|range| {
            let observations = &bundle.observations[range[0]..range[1]];
            let mut found: Vec<usize> = observations
                .iter()
                .flat_map(|o| {
                    let camera = bundle.views[o.view].camera;
                    let lens = bundle.cameras[camera].lens_of.unwrap_or(camera);
                    let first = bundle.views.len();
                    [o.view, first + 2 * lens, first + 2 * camera + 1]
                })
                .filter_map(|k| blocks[k])
                .collect();
            found.sort_unstable();
            found.dedup();
            found
        })
        .collect()
}

/// Lower triangle of a symmetric matrix of blocks, by columns.
pub(crate) struct Pattern {
    /// First column of each block, and the number of columns.
    starts: Vec<usize>,
    /// Block of each column.
    block_of: Vec<usize>,
    /// Per block: the blocks below that meet it, ascending, and the rows of its first column before each.
    below: Vec<Vec<(usize, usize)>>,
    /// Where the entries of each column start, and their number.
    pub column_starts: Vec<usize>,
    /// Row of each entry.
    pub rows: Vec<usize>,
}

impl Pattern {
    fn new(starts: Vec<usize>, blocks_of_points: &[Vec<usize>]) -> Self {
        let num_blocks = starts.len() - 1;
        let mut points_of = vec![Vec::new(); num_blocks];
        for (p, blocks) in blocks_of_points.iter().enumerate() {
            for &block in blocks {
                points_of[block].push(p);
            }
        }
        let mut block_of = Vec::new();
        let (mut column_starts, mut rows) = (vec![0], Vec::new());
        let mut below = Vec::with_capacity(num_blocks);
        let mut met_by = vec![usize::MAX; num_blocks];
        for block in 0..num_blocks {
            let mut meets = Vec::new();
            for &p in &points_of[block] {
                for &other in blocks_of_points[p].iter().rev() {
                    if other <= block {
                        break;
                    }
                    if std::mem::replace(&mut met_by[other], block) != block {
                        meets.push(other);
                    }
                }
            }
            meets.sort_unstable();
            let columns = starts[block]..starts[block + 1];
            let mut before = columns.len();
            let meets: Vec<(usize, usize)> = meets
                .into_iter()
                .map(|other| {
                    before += starts[other + 1] - starts[other];
                    (other, before - (starts[other + 1] - starts[other]))
                })
                .collect();
            for column in columns.clone() {
                block_of.push(block);
                rows.extend(column..columns.end);
                for &(other, _) in &meets {
                    rows.extend(starts[other]..starts[other + 1]);
                }
                column_starts.push(rows.len());
            }
            below.push(meets);
        }
        Self {
            starts,
            block_of,
            below,
            column_starts,
            rows,
        }
    }

    pub fn num_columns(&self) -> usize {
        self.block_of.len()
    }

    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Rows of the first column of a block before another that meets it, or is it.
    fn rows_before(&self, block: usize, other: usize) -> Option<usize> {
        if block == other {
            return Some(0);
        }
        let below = &self.below[block];
        let at = below.binary_search_by_key(&other, |b| b.0).ok()?;
        Some(below[at].1)
    }

    /// Place of the entry at a row on or below the diagonal; `None` where it is always zero.
    pub fn place(&self, row: usize, column: usize) -> Option<usize> {
        let (block, other) = (self.block_of[column], self.block_of[row]);
        let before = self.rows_before(block, other)?;
        Some(
            self.column_starts[column] + before + (row - self.starts[other])
                - (column - self.starts[block]),
        )
    }

    /// Visits all pairs of a point's rows of `W` (their columns ascend; all of a block or none) by runs: the place of
    /// the lower column in the list, those of the higher ones, whose entries follow each other, and where these start.
    pub fn for_runs<T>(
        &self,
        rows: &[(usize, T)],
        mut visit: impl FnMut(usize, Range<usize>, usize),
    ) {
        let block_at = |first: usize| {
            let block = self.block_of[rows[first].0];
            let size = self.starts[block + 1] - self.starts[block];
            (block, first..first + size)
        };
        let mut first = 0;
        while first < rows.len() {
            let (block, own) = block_at(first);
            let mut second = first;
            while second < rows.len() {
                let (other, theirs) = block_at(second);
                second = theirs.end;
                let Some(before) = self.rows_before(block, other) else {
                    continue;
                };
                for j in own.clone() {
                    let column = rows[j].0;
                    let from = theirs.start.max(j);
                    let row = rows[from].0 - self.starts[other];
                    let start = self.column_starts[column] + before + self.starts[block] - column;
                    visit(j, from..theirs.end, start + row);
                }
            }
            first = own.end;
        }
    }
}
