//! Options of the photo model.

use rilievo_scene::{OptionError, in_range};
use serde::{Deserialize, Serialize};

/// Options of [`super::run`]. Weights follow from the photos themselves; these options bound effort
/// and choose which parts are used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhotoOptions {
    /// Views that each view is compared with, at most 8. Too few leave occluded parts to chance,
    /// more cost time in proportion.
    pub max_num_sources: usize,
    /// Outer iterations of light and shape, from weak shading to its full weight; 0 leaves shading out.
    pub num_outer_iterations: usize,
    /// Masked pixels of a view up to which a finer level is solved as a whole, with a light of its own. Too large
    /// costs time and memory (about 1 kB a pixel).
    pub max_fine_pixels: usize,
    /// Rounds at each level beyond, down to the photos' own pixels, tile by tile under the coarser level's light;
    /// 0 interpolates from the finest level that is solved as a whole, as is done from the level on at which the photos
    /// hold no more detail. More than four change little.
    pub num_relief_rounds: usize,
    /// Light every pixel by what it sees of the environment, instead of nine distant harmonics for all.
    pub visibility: bool,
    /// Use a light that was given also where the photos contradict it.
    pub trust_lighting: bool,
    /// Seed of the dense search.
    pub seed: u64,
    /// Bytes that the run may take, no bound without it: it bounds how many tiles are worked on at once, and refuses
    /// what does not fit. Results do not depend on it.
    #[serde(skip)]
    pub memory: Option<u64>,
    /// Effort that is fixed for photographs.
    #[serde(skip)]
    pub effort: Effort,
}

/// Effort that is no user's to choose: where it was varied, less was worse and more changed
/// nothing. Tests on small photos take less.
#[derive(Clone, Debug, PartialEq)]
pub struct Effort {
    /// Masked pixels of a view at the coarse level, where the surface is found. Too few lose fine
    /// structure, more cost time.
    pub coarse_pixels: usize,
    /// Sweeps of the dense search. Too few leave false depths in plain regions.
    pub num_sweeps: usize,
    /// Largest number of Gauss-Newton rounds of an outer iteration.
    pub max_num_rounds: usize,
    /// Largest number of further outer iterations at full weight; they end earlier where they do
    /// not settle.
    pub max_more_iterations: usize,
    /// Outer iterations in place of the first one, at half the coarse level's resolution, where the
    /// searched depths are noisy: small false minima of shading are overlooked there. Too many lose
    /// the photos' hold on fine structure.
    pub num_half_iterations: usize,
    /// Distance between the views' searched depths, in pixel footprints, from which they count as
    /// noisy.
    pub noisy_search_px: f64,
    /// Search depth again at each finer level that is solved as a whole where the photos' brightness disagrees. Without
    /// it the surface of such photos keeps little more than the coarse level resolves.
    pub finer_search: bool,
    /// Rays per pixel of the visibility light.
    pub num_rays: usize,
}

impl Default for PhotoOptions {
    fn default() -> Self {
        Self {
            max_num_sources: 4,
            num_outer_iterations: 3,
            max_fine_pixels: 450_000,
            num_relief_rounds: 3,
            visibility: true,
            trust_lighting: false,
            seed: 0,
            memory: None,
            effort: Effort::default(),
        }
    }
}

impl Default for Effort {
    fn default() -> Self {
        Self {
            coarse_pixels: 90_000,
            num_sweeps: 4,
            max_num_rounds: 10,
            max_more_iterations: 3,
            num_half_iterations: 3,
            noisy_search_px: 0.65,
            finer_search: true,
            num_rays: 256,
        }
    }
}

impl PhotoOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("max_num_sources", self.max_num_sources, 1..=8)?;
        in_range("num_outer_iterations", self.num_outer_iterations, 0..=100)?;
        in_range("max_fine_pixels", self.max_fine_pixels, 0..=1_000_000_000)?;
        in_range("num_relief_rounds", self.num_relief_rounds, 0..=100)
    }
}
