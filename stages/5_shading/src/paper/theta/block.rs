//! As many pixels as a vector register has lanes.

// Arrays of lanes are indexed in parallel: zipped iterators would hide the lane.
#![allow(clippy::needless_range_loop)]

use super::pixel::{Pixel, Quadratic};
use crate::paper::pixels::LANES;

/// Lanes of one block.
pub(super) struct Block<const C: usize> {
    pub(super) light: [[[f32; LANES]; 9]; C],
    pub(super) intensity: [[f32; LANES]; C],
    pub(super) weight: [f32; LANES],
    pub(super) ray: [[f32; LANES]; 2],
    pub(super) target: [[f32; LANES]; 2],
    pub(super) beta: [f32; LANES],
    pub(super) area: f32,
}

impl<const C: usize> Block<C> {
    #[inline(always)]
    pub(super) fn evaluate(&self, k: usize, slopes: [f32; 2]) -> Quadratic {
        // Loops instead of closures: a closure would not inherit the wide vectors.
        let mut light = [[0.0; 9]; C];
        let mut intensity = [0.0; C];
        for c in 0..C {
            for j in 0..9 {
                light[c][j] = self.light[c][j][k];
            }
            intensity[c] = self.intensity[c][k];
        }
        Pixel::<C> {
            light,
            intensity,
            weight: self.weight[k],
            ray: [self.ray[0][k], self.ray[1][k]],
            target: [self.target[0][k], self.target[1][k]],
            beta: self.beta[k],
            area: self.area,
        }
        .quadratic(slopes)
    }
}
