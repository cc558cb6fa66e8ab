//! Memory that a run needs, told before it begins.
//!
//! Bytes per pixel were measured as the largest resident memory of runs on 4 photos of 4 and of 18 megapixels.

use super::options::PhotoOptions;
use super::views::Scene;
use crate::error::ShadingError;
use crate::photo_of::photo_of;
use rilievo_scene::{PhotoSet, PosedView, PosedViews};
use rilievo_stereo::stored::StoredView;
use rilievo_stereo::tile::MARGIN_PX;
use rilievo_stereo::window::Window;

/// Side of a tile's core, pixels: its margin adds a sixth to the work.
pub(crate) const CORE_PX: usize = 768;

/// A pixel of a view's crop over all levels: colours, grey, numbers of pixels, marks.
const CROP_BYTES: f64 = 4.0 / 3.0 * 25.0;
/// A masked pixel over all levels: its place, log depth and whether it is known, twice while a level begins.
const MASKED_BYTES: f64 = 4.0 / 3.0 * 8.0 + 2.5 * 9.0;
/// A pixel of a tile with what its sources see, while its step is solved.
const TILE_BYTES: f64 = 650.0;
/// A pixel of a view's crop while its surface goes from one level to the next.
const VIEW_BYTES: f64 = 60.0;
/// A masked pixel at a level that is solved as a whole, in all views: system, factors, light.
const WHOLE_BYTES: f64 = 900.0;
/// A pixel of a photo whose maps are made and written, or that is loaded.
const FRAME_BYTES: f64 = 75.0;

/// What decides the memory, in pixels.
struct Sizes {
    num_views: usize,
    crops: f64,
    masked: f64,
    largest_frame: f64,
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
                    let window = Window::around(mask, 0).unwrap_or_default();
                    let masked = mask.data.iter().filter(|&&is| is).count();
                    ((window.width * window.height) as f64, masked as f64)
                }
                None => (frame, frame),
            };
            sizes.crops += crop;
            sizes.masked += masked;
            sizes.largest_frame = sizes.largest_frame.max(frame);
        }
        Ok(sizes)
    }

    /// Masked pixels of all views at the finest level that is solved as a whole.
    fn whole(&self, options: &PhotoOptions) -> f64 {
        let mut mean = self.masked / self.num_views.max(1) as f64;
        while mean > options.max_fine_pixels.max(options.coarse_pixels) as f64 {
            mean /= 4.0;
        }
        mean * self.num_views as f64
    }

    /// The smallest memory with which the run can go on to its end.
    fn needed(&self, options: &PhotoOptions) -> f64 {
        let at_a_time = [
            tile_bytes(),
            WHOLE_BYTES * self.whole(options),
            FRAME_BYTES * self.largest_frame,
        ];
        resident(self.crops, self.masked) + at_a_time.into_iter().fold(0.0, f64::max)
    }
}

/// Memory that is in use throughout, for the pixels of all views' crops and the masked ones among them.
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
    let needed = Sizes::of(photos, posed)?.needed(options);
    match options.memory {
        Some(given) if (given as f64) < needed => Err(ShadingError::OutOfMemory {
            given_mib: given >> 20,
            needed_mib: (needed / MIB).ceil() as u64,
        }),
        _ => Ok(()),
    }
}

/// Items of `bytes_each` that may be worked on at once, at least one and at most `most`: the memory given, if any, less
/// what is `in_use`.
fn at_once(options: &PhotoOptions, in_use: f64, bytes_each: f64, most: usize) -> usize {
    let Some(given) = options.memory else {
        return most;
    };
    (((given as f64 - in_use) / bytes_each).max(1.0) as usize).min(most)
}

/// Photos that may be loaded at once.
pub(crate) fn photos_at_once(posed: &PosedViews, options: &PhotoOptions) -> usize {
    let frame = |view: &PosedView| view.intrinsics.width * view.intrinsics.height;
    let largest = posed.views.iter().map(frame).max().unwrap_or(1);
    let threads = rayon::current_num_threads();
    at_once(options, 0.0, FRAME_BYTES * largest as f64, threads)
}

/// Tiles that may be worked on at once.
pub(crate) fn tiles_at_once(options: &PhotoOptions, scene: &Scene) -> usize {
    let most = 2 * rayon::current_num_threads();
    at_once(options, scene.bytes(), tile_bytes(), most)
}

/// Views of which everything at level `at` may be in memory at once.
pub(crate) fn views_at_once(scene: &Scene, at: usize, options: &PhotoOptions) -> usize {
    let crop = |view: &StoredView| view.size(at).0 * view.size(at).1;
    let largest = scene.stored.iter().map(crop).max().unwrap_or(1);
    let threads = rayon::current_num_threads();
    at_once(options, scene.bytes(), VIEW_BYTES * largest as f64, threads)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(bytes: f64) -> PhotoOptions {
        PhotoOptions {
            memory: Some(bytes as u64),
            ..PhotoOptions::default()
        }
    }

    #[test]
    fn tiles_are_as_many_as_fit_and_at_least_one() {
        let most = 2 * rayon::current_num_threads();
        let in_use = 1e9;
        let tiles = |options: &PhotoOptions| at_once(options, in_use, tile_bytes(), most);
        assert_eq!(tiles(&PhotoOptions::default()), most);
        assert_eq!(tiles(&given(1e12)), most);
        assert_eq!(tiles(&given(in_use)), 1);
        assert_eq!(tiles(&given(in_use + 1.5 * tile_bytes())), 1);
        let two = tiles(&given(in_use + 2.5 * tile_bytes()));
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
            sizes.needed(&PhotoOptions::default())
        };
        assert!(needed(4, 6e6) > 2.0 * needed(4, 1e6));
        assert!(needed(8, 6e6) > 1.5 * needed(4, 6e6));
        // 8 photos of 18 megapixels, a third of them object.
        assert!(needed(8, 6e6) < 7e9, "{}", needed(8, 6e6));
    }
}
