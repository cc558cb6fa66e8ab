//! Options of the photo model.

use crate::error::ShadingError;
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
    /// Largest number of Gauss-Newton rounds over all views per lap.
    pub max_num_rounds: usize,
    /// A round that moves the surface by less (RMS, in pixel footprints) ends its lap.
    pub round_tolerance: f64,
    /// Laps of light and shape; 0 leaves shading out.
    pub num_laps: usize,
    /// Laps in place of the first one, at half the coarse level's resolution, where the searched depths
    /// are noisy: small false minima of shading are overlooked there. Too many lose the photos' hold on
    /// fine structure.
    pub num_half_laps: usize,
    /// Distance between the views' searched depths, in pixel footprints, from which they count as noisy.
    pub noisy_search_px: f64,
    /// Masked pixels of a view up to which a finer level is solved; larger photos are interpolated
    /// from the finest such level. Too large costs time and memory (about 1 kB a pixel).
    pub max_fine_pixels: usize,
    /// Search depth again at each finer level where the photos' brightness disagrees. Without it the
    /// surface of such photos keeps no more than the coarse level resolves; it takes about a third more
    /// time.
    pub finer_search: bool,
    /// Rounds at each finer level.
    pub num_fine_rounds: usize,
    /// Light every pixel by what it sees of the environment, instead of nine distant harmonics for all.
    pub visibility: bool,
    /// Rays per pixel of the visibility light.
    pub num_rays: usize,
    /// Seed of the dense search.
    pub seed: u64,
}

impl Default for PhotoOptions {
    fn default() -> Self {
        Self {
            max_num_sources: 4,
            coarse_pixels: 90_000,
            num_sweeps: 4,
            max_num_rounds: 6,
            round_tolerance: 0.02,
            num_laps: 3,
            num_half_laps: 3,
            noisy_search_px: 0.65,
            max_fine_pixels: 450_000,
            finer_search: true,
            num_fine_rounds: 3,
            visibility: true,
            num_rays: 256,
            seed: 0,
        }
    }
}

impl PhotoOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ShadingError::InvalidOption`] names the first option outside its range.
    pub fn validate(&self) -> Result<(), ShadingError> {
        let check = |ok: bool, option: &'static str, value: String, expected: &'static str| {
            if ok {
                Ok(())
            } else {
                Err(ShadingError::InvalidOption {
                    option,
                    value,
                    expected,
                })
            }
        };
        check(
            (1..=8).contains(&self.max_num_sources),
            "photo.max_num_sources",
            self.max_num_sources.to_string(),
            "1 to 8",
        )?;
        check(
            self.coarse_pixels >= 1000,
            "photo.coarse_pixels",
            self.coarse_pixels.to_string(),
            "at least 1000",
        )?;
        check(
            self.num_sweeps > 0,
            "photo.num_sweeps",
            self.num_sweeps.to_string(),
            "positive",
        )?;
        check(
            self.max_num_rounds > 0,
            "photo.max_num_rounds",
            self.max_num_rounds.to_string(),
            "positive",
        )?;
        check(
            self.round_tolerance.is_finite() && self.round_tolerance >= 0.0,
            "photo.round_tolerance",
            self.round_tolerance.to_string(),
            "zero or positive",
        )?;
        check(
            self.noisy_search_px >= 0.0,
            "photo.noisy_search_px",
            self.noisy_search_px.to_string(),
            "zero or positive",
        )?;
        check(
            (16..=1024).contains(&self.num_rays),
            "photo.num_rays",
            self.num_rays.to_string(),
            "16 to 1024",
        )
    }
}
