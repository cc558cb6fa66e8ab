//! Memory that a run needs, checked before it begins.
//!
//! Bytes per pixel were measured as the largest resident memory of runs on 4 photos of 4 and of 18 megapixels.

use super::options::PhotoOptions;
use crate::error::ShadingError;
use crate::photo_of::photo_of;
use rilievo_scene::{PhotoSet, PosedView, PosedViews};
use rilievo_stereo::level::Level;
use rilievo_stereo::stored::StoredView;
use rilievo_stereo::tile::MARGIN_PX;
use rilievo_stereo::window::Window;

/// Side of a tile's core, pixels: its margin adds a sixth to the work.
pub(crate) const CORE_PX: usize = 768;

/// A pixel of a view's crop over all levels: colours, grey, numbers of pixels, marks.
const CROP_BYTES: f64 = 4.0 / 3.0 * 25.0;
/// A masked pixel at the finest level that is solved as a whole: its place, log depths of three steps, surfaces, pigment,
/// and the light of a quarter of the pixels.
const MASKED_BYTES: f64 = 120.0;
/// A pixel of a tile with what its sources see, while its step is solved.
const TILE_BYTES: f64 = 650.0;
/// A pixel of a view's crop while its surface goes from one level to the next.
const VIEW_BYTES: f64 = 60.0;
/// A masked pixel of a view whose system is factorised.
const FACTOR_BYTES: f64 = 1300.0;
/// A masked pixel of a view that is searched.
const SEARCH_BYTES: f64 = 250.0;
/// A masked pixel of a view whose solver is kept.
const SOLVER_BYTES: f64 = 150.0;
/// A pixel of a photo whose maps are made and written, or that is loaded.
const FRAME_BYTES: f64 = 75.0;

/// What decides the memory, in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Number of views.
    pub num_views: usize,
    /// Pixels of all views' crops to their masks.
    pub crops: f64,
    /// Masked pixels of all views.
    pub masked: f64,
    /// Pixels of the largest photo.
    pub largest_frame: f64,
}

impl Sizes {
    fn of(photos: &PhotoSet, posed: &PosedViews) -> Result<Self, ShadingError> {
        let mut sizes = Self {
            num_views: posed.views.len(),
            crops: 0.0,
            masked: 0.0,
            largest_frame: 0.0,
        };
        for view in &posed.views {
            let frame = (view.intrinsics.width * view.intrinsics.height) as f64;
            let (crop, masked) = match &photo_of(photos, view)?.mask {
                Some(mask) => {
                    let window = Window::around(&mask.unpacked(), 0).unwrap_or_default();
                    ((window.width * window.height) as f64, mask.count() as f64)
                }
                None => (frame, frame),
            };
            sizes.crops += crop;
            sizes.masked += masked;
            sizes.largest_frame = sizes.largest_frame.max(frame);
        }
        Ok(sizes)
    }

    /// Share of the pixels that the finest level has which is solved as a whole.
    pub fn whole_share(&self, options: &PhotoOptions) -> f64 {
        self.share_within(options.max_fine_pixels.max(options.effort.coarse_pixels))
    }

    /// Share of the pixels that the finest level has at which the surface is found.
    pub fn coarse_share(&self, options: &PhotoOptions) -> f64 {
        self.share_within(options.effort.coarse_pixels)
    }

    /// Share of the finest level's pixels that the first level of at most so many pixels a view has.
    fn share_within(&self, max_pixels: usize) -> f64 {
        let mean = self.masked / self.num_views.max(1) as f64;
        let mut share = 1.0;
        while mean * share > max_pixels as f64 {
            share /= 4.0;
        }
        share
    }

    /// Memory that a run takes which solves so many views at once, bytes; with one it is the
    /// smallest that will do.
    pub fn taken(&self, options: &PhotoOptions, at_once: usize) -> f64 {
        let share = self.whole_share(options);
        let solved = share * self.masked * at_once as f64 / self.num_views.max(1) as f64;
        let at_a_time = [
            tile_bytes(),
            FACTOR_BYTES * solved,
            FRAME_BYTES * self.largest_frame,
        ];
        resident(share * self.crops, share * self.masked)
            + at_a_time.into_iter().fold(0.0, f64::max)
    }
}

/// Memory that is in use throughout, for the pixels of all views' crops and the masked ones among them at the finest level
/// that is solved as a whole.
pub(crate) fn resident(crops: f64, masked: f64) -> f64 {
    CROP_BYTES * crops + MASKED_BYTES * masked
}

fn tile_bytes() -> f64 {
    TILE_BYTES * ((CORE_PX + 2 * MARGIN_PX) as f64).powi(2)
}

/// Refuses a run that does not fit into the memory that it is given.
///
/// # Errors
/// [`ShadingError::OutOfMemory`] with the smallest memory that would do.
pub(crate) fn refuse_too_little(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &PhotoOptions,
) -> Result<(), ShadingError> {
    const MIB: f64 = (1_u64 << 20) as f64;
    let needed = Sizes::of(photos, posed)?.taken(options, 1);
    match options.memory {
        Some(given) if (given as f64) < needed => Err(ShadingError::OutOfMemory {
            given_mib: given >> 20,
            needed_mib: (needed / MIB).ceil() as u64,
        }),
        _ => Ok(()),
    }
}

/// Masked pixels of a level's largest view.
fn largest(level: &Level) -> f64 {
    let largest = level.views.iter().map(|view| view.pixels.len()).max();
    largest.unwrap_or(0) as f64
}

/// Memory of a view of a level whose system is made and solved exactly.
pub(crate) fn solve_bytes(level: &Level) -> f64 {
    FACTOR_BYTES * largest(level)
}

/// Memory of a view of a level that is searched.
pub(crate) fn search_bytes(level: &Level) -> f64 {
    SEARCH_BYTES * largest(level)
}

/// The memory that a run was given, and the part of it that is in use throughout, bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Budget {
    pub given: Option<u64>,
    pub in_use: f64,
}

impl Budget {
    /// Items of `bytes_each` that may be worked on at once, at least one; any number where no
    /// memory was given.
    pub fn at_once(self, bytes_each: f64) -> usize {
        self.given.map_or(usize::MAX, |given| {
            ((given as f64 - self.in_use) / bytes_each).max(1.0) as usize
        })
    }

    /// Photos that may be loaded at once.
    pub fn photos(self, posed: &PosedViews) -> usize {
        let frame = |view: &PosedView| view.intrinsics.width * view.intrinsics.height;
        let largest = posed.views.iter().map(frame).max().unwrap_or(1);
        let at_once = self.at_once(FRAME_BYTES * largest as f64);
        at_once.min(rayon::current_num_threads())
    }

    /// Tiles that may be worked on at once.
    pub fn tiles(self) -> usize {
        self.at_once(tile_bytes())
            .min(2 * rayon::current_num_threads())
    }

    /// Views of which everything at level `at` may be in memory at once.
    pub fn views(self, views: &[StoredView], at: usize) -> usize {
        let crop = |view: &StoredView| view.size(at).0 * view.size(at).1;
        let largest = views.iter().map(crop).max().unwrap_or(1);
        let at_once = self.at_once(VIEW_BYTES * largest as f64);
        at_once.min(rayon::current_num_threads())
    }

    /// Whether exact solvers of all views at a level may be kept between the rounds.
    pub fn keeps_solvers(self, level: &Level) -> bool {
        let masked: usize = level.views.iter().map(|v| v.pixels.len()).sum();
        let in_work = solve_bytes(level) * rayon::current_num_threads() as f64;
        let in_use = self.in_use + in_work + SOLVER_BYTES * masked as f64;
        self.given.is_none_or(|given| given as f64 > in_use)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_as_many_as_fit_and_at_least_one() {
        let most = 2 * rayon::current_num_threads();
        let in_use = 1e9;
        let tiles = |given: Option<f64>| {
            let given = given.map(|bytes| bytes as u64);
            Budget { given, in_use }.tiles()
        };
        assert_eq!(tiles(None), most);
        assert_eq!(tiles(Some(1e12)), most);
        assert_eq!(tiles(Some(in_use)), 1);
        assert_eq!(tiles(Some(in_use + 1.5 * tile_bytes())), 1);
        let two = tiles(Some(in_use + 2.5 * tile_bytes()));
        assert_eq!(two, 2.min(most));
    }

    #[test]
    fn larger_photos_and_more_of_them_need_more() {
        let needed = |num_views: usize, masked: f64| {
            let sizes = Sizes {
                num_views,
                crops: 1.5 * masked * num_views as f64,
                masked: masked * num_views as f64,
                largest_frame: 3.0 * masked,
            };
            sizes.taken(&PhotoOptions::default(), 1)
        };
        assert!(needed(8, 6e6) > 1.1 * needed(4, 6e6));
        assert!(needed(40, 6e6) > 1.8 * needed(8, 6e6));
        // 21 photos of 18 megapixels, a third of them object.
        assert!(needed(21, 6e6) < 3e9, "{}", needed(21, 6e6));
    }
}
