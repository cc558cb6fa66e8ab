//! Options of the photo model.

use rilievo_scene::{OptionError, in_range};
use serde::{Deserialize, Serialize};

/// Options of [`super::run`]. Weights follow from the photos themselves; what stands here bounds
/// effort and says which parts are used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhotoOptions {
    /// Views that each view is compared with, at most 8. Too few leave occluded parts to chance,
    /// more cost time in proportion.
    pub max_num_sources: usize,
    /// Masked pixels of a view at the coarse level, where the surface is found. Too few lose fine
    /// structure, more cost time.
    pub coarse_pixels: usize,
    /// Sweeps of the dense search. Too few leave false depths in plain regions.
    pub num_sweeps: usize,
    /// Mean change of depth in a Gauss-Newton round over all views, in pixel footprints, below which
    /// the outer iteration may end. Too large leaves the surface on its way, too small costs rounds that change
    /// nothing that the photos tell.
    pub round_move_px: f64,
    /// Mean turn of the normals in a round, degrees, below which an outer iteration with shading may end; a tenth of
    /// what normals err in the end.
    pub round_turn_deg: f64,
    /// Largest number of rounds of an outer iteration.
    pub max_num_rounds: usize,
    /// Outer iterations of light and shape, from weak shading to its full weight; 0 leaves shading out.
    #[serde(alias = "num_laps")]
    pub num_outer_iterations: usize,
    /// Mean turn of the normals in the last of these outer iterations, degrees, above which another one follows at
    /// full weight: light and shape still change each other. Too small repeats outer iterations for nothing.
    #[serde(alias = "lap_turn_deg")]
    pub outer_turn_deg: f64,
    /// Largest number of such further outer iterations; they end earlier where they do not settle.
    #[serde(alias = "max_more_laps")]
    pub max_more_iterations: usize,
    /// Outer iterations in place of the first one, at half the coarse level's resolution, where the searched depths
    /// are noisy: small false minima of shading are overlooked there. Too many lose the photos' hold on
    /// fine structure.
    #[serde(alias = "num_half_laps")]
    pub num_half_iterations: usize,
    /// Distance between the views' searched depths, in pixel footprints, from which they count as noisy.
    pub noisy_search_px: f64,
    /// Masked pixels of a view up to which a finer level is solved as a whole, with a light of its own. Too large
    /// costs time and memory (about 1 kB a pixel).
    pub max_fine_pixels: usize,
    /// Rounds at each level beyond, down to the photos' own pixels, tile by tile under the coarser level's light;
    /// 0 interpolates from the finest level that is solved as a whole, as is done where the photos' brightness
    /// disagrees. More than four change little.
    pub num_relief_rounds: usize,
    /// Search depth again at each finer level where the photos' brightness disagrees. Without it the
    /// surface of such photos keeps no more than the coarse level resolves; it takes as long as the
    /// first search at four times the pixels.
    pub finer_search: bool,
    /// Light every pixel by what it sees of the environment, instead of nine distant harmonics for all.
    pub visibility: bool,
    /// Rays per pixel of the visibility light.
    pub num_rays: usize,
    /// Use a light that was given also where the photos contradict it.
    pub trust_lighting: bool,
    /// Seed of the dense search.
    pub seed: u64,
    /// Bytes that the run may take, no bound without it: it bounds how many tiles are worked on at once, and refuses
    /// what does not fit. Results do not depend on it.
    #[serde(skip)]
    pub memory: Option<u64>,
}

impl Default for PhotoOptions {
    fn default() -> Self {
        Self {
            max_num_sources: 4,
            coarse_pixels: 90_000,
            num_sweeps: 4,
            round_move_px: 0.1,
            round_turn_deg: 0.4,
            max_num_rounds: 10,
            num_outer_iterations: 3,
            outer_turn_deg: 2.0,
            max_more_iterations: 3,
            num_half_iterations: 3,
            noisy_search_px: 0.65,
            max_fine_pixels: 450_000,
            num_relief_rounds: 3,
            finer_search: true,
            visibility: true,
            num_rays: 256,
            trust_lighting: false,
            seed: 0,
            memory: None,
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
        in_range("coarse_pixels", self.coarse_pixels, 1000..=1_000_000_000)?;
        in_range("num_sweeps", self.num_sweeps, 1..=100)?;
        in_range("round_move_px", self.round_move_px, 0.0..=1000.0)?;
        in_range("round_turn_deg", self.round_turn_deg, 0.0..=180.0)?;
        in_range("max_num_rounds", self.max_num_rounds, 1..=1000)?;
        in_range("num_outer_iterations", self.num_outer_iterations, 0..=100)?;
        in_range("outer_turn_deg", self.outer_turn_deg, 0.0..=180.0)?;
        in_range("max_more_iterations", self.max_more_iterations, 0..=100)?;
        in_range("num_half_iterations", self.num_half_iterations, 0..=100)?;
        in_range("noisy_search_px", self.noisy_search_px, 0.0..=1e6)?;
        in_range("max_fine_pixels", self.max_fine_pixels, 0..=1_000_000_000)?;
        in_range("num_relief_rounds", self.num_relief_rounds, 0..=100)?;
        in_range("num_rays", self.num_rays, 16..=1024)
    }
}
