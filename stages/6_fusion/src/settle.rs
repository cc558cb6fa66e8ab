//! The views' depths as they are fused: corrected, and what is to be known of them beforehand.

use crate::correction::Corrections;
use crate::shelf::PAGE_SIDE;
use crate::view::Farthest;
use crate::views::Stock;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::ScratchError;

/// Every seventh pixel tells its footprint, or fewer where there would be more than this many.
const SAMPLE_STEP: usize = 7;
const MAX_NUM_SAMPLES: usize = 4 << 20;
/// Squares of [`Farthest`] along a page.
const NUM_SQUARES: usize = PAGE_SIDE / Farthest::SIDE;

/// What is known of all depths.
#[derive(Clone, Debug, Default)]
pub(crate) struct Settled {
    /// Root mean square correction of each view, world's unit.
    pub correction_rms: Vec<f64>,
    /// Median pixel footprint of the surface in all views.
    pub median_footprint: f64,
}

/// One page's share.
#[derive(Default)]
struct Share {
    farthest: [[f32; NUM_SQUARES]; NUM_SQUARES],
    square: f64,
    footprints: Vec<f64>,
}

/// Puts corrected depths in the place of those that were loaded.
pub(crate) fn settle(
    stock: &mut Stock,
    corrections: Option<&Corrections>,
) -> Result<Settled, ScratchError> {
    let shelf = &stock.shelf;
    let num_pixels: usize = stock
        .views
        .iter()
        .map(|v| v.camera.width * v.camera.height)
        .sum();
    let step = SAMPLE_STEP * num_pixels.div_ceil(SAMPLE_STEP * MAX_NUM_SAMPLES).max(1);
    let mut footprints = Vec::new();
    let mut settled = Settled::default();
    for view in &mut stock.views {
        let numbers = view.pages.kept();
        let shares: Vec<Share> = numbers
            .par_iter()
            .map(|&page| {
                let mut share = Share::default();
                shelf.visit(&view.pages, page, |x, y, pixel| {
                    if pixel.depth <= 0.0 {
                        return pixel.depth;
                    }
                    let mut depth = pixel.depth;
                    if let Some(corrections) = corrections {
                        depth = corrections.corrected(view.idx, x, y, depth);
                        let change = f64::from(depth) * corrections.at(view.idx, x, y);
                        share.square += change.powi(2);
                    }
                    let [i, j] = [x, y].map(|at| at % PAGE_SIDE / Farthest::SIDE);
                    share.farthest[j][i] = share.farthest[j][i].max(depth);
                    if (y * view.camera.width + x).is_multiple_of(step) {
                        share.footprints.push(view.footprint(depth.into()));
                    }
                    depth
                })?;
                Ok(share)
            })
            .collect::<Result<_, ScratchError>>()?;
        let columns = view.pages.columns * NUM_SQUARES;
        let rows = view.camera.height.div_ceil(PAGE_SIDE) * NUM_SQUARES;
        let mut farthest = Farthest {
            columns,
            depths: vec![0.0; columns * rows],
        };
        let mut square = 0.0;
        for (page, share) in numbers.iter().zip(shares) {
            let (i, j) = (page % view.pages.columns, page / view.pages.columns);
            for (k, row) in share.farthest.iter().enumerate() {
                let first = (j * NUM_SQUARES + k) * columns + i * NUM_SQUARES;
                farthest.depths[first..first + NUM_SQUARES].copy_from_slice(row);
            }
            square += share.square;
            footprints.extend(share.footprints);
        }
        view.farthest = farthest;
        let rms = f64::sqrt(square / view.num_depths.max(1) as f64);
        settled.correction_rms.push(rms);
    }
    settled.median_footprint = median(&mut footprints).unwrap_or(0.0);
    Ok(settled)
}
