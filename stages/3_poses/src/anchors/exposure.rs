//! Offsets between log images, learned from the first patches.
//!
//! A free offset per patch takes whatever exposure did, but it also takes the information of a slow
//! change of shading: on a ramp a shift in depth and an offset look the same. The offsets of seeds
//! in textured places give, per pair of photos, what to expect elsewhere: their median, and
//! `σ = 1.48 MAD`. Photos that agree give a narrow prior, photos that do not give a wide one, which
//! changes nothing. (Measured on a smooth object: a tenth more anchors, five per cent smaller errors;
//! rendered photos have σ of 0.015 to 0.04, real ones 0.07 to 0.13.)

use super::grow::Node;
use super::pair::{OffsetPrior, PairGeometry};
use rilievo_numerics::robust::{SIGMA_FROM_MAD, median};

/// Pairs that scatter more differ by gloss or tone mapping, in whole regions at once: no prior.
const MAX_SIGMA: f64 = 0.05;
/// Fewest patches for a pair's offset.
const MIN_PATCHES: usize = 20;
/// No pair agrees better than this: light that is not quite matte, and vignetting.
const MIN_SIGMA: f64 = 0.02;

/// Sets the offset priors of a reference's pairs from its patches.
pub(super) fn learn_offsets(pairs: &mut [PairGeometry], nodes: &[Option<Node>]) {
    for pair in pairs {
        let mut offsets: Vec<f64> = nodes
            .iter()
            .flatten()
            .flat_map(|node| &node.alignment.offsets[..node.alignment.num_sources])
            .filter(|(source, _)| *source == pair.source)
            .map(|&(_, offset)| offset)
            .collect();
        if offsets.len() < MIN_PATCHES {
            continue;
        }
        let Some(mean) = median(&mut offsets) else {
            continue;
        };
        let mut deviations: Vec<f64> = offsets.iter().map(|o| (o - mean).abs()).collect();
        let mad = median(&mut deviations).unwrap_or(0.0);
        let sigma = (SIGMA_FROM_MAD * mad).max(MIN_SIGMA);
        if sigma > MAX_SIGMA {
            continue;
        }
        // A median within the scatter says that exposure was the same.
        let mean = if mean.abs() <= sigma { 0.0 } else { mean };
        pair.offset = Some(OffsetPrior { mean, sigma });
    }
}
