//! Photos are loaded a few at a time.
//!
//! A loaded photo takes 12 bytes a pixel and its preparation as much again, what is kept of it far
//! less: with a thread per core the loaded ones would outweigh all that is kept.

use crate::photos::PhotoSet;
use rayon::prelude::*;

/// Photos that are held in memory at once at most.
const MAX_NUM_LOADED: usize = 3;
/// Bytes per pixel of a photo that is loaded and made ready.
const BYTES_PER_PIXEL: u64 = 28;

/// How many photos may be loaded at once: a few, or as many as a third of the memory holds, but always one.
pub fn num_at_once(photos: &PhotoSet, memory: Option<u64>) -> usize {
    let pixels = photos.photos.iter();
    let pixels = pixels.map(|p| (p.intrinsics.width * p.intrinsics.height) as u64);
    let each = BYTES_PER_PIXEL * pixels.max().unwrap_or(0).max(1);
    let fitting = memory.map_or(u64::MAX, |bytes| bytes / 3 / each);
    fitting.clamp(1, MAX_NUM_LOADED as u64) as usize
}

/// Maps items in parallel, a few at once, in their order.
///
/// # Errors
/// That of an item of the first few that fail.
pub fn map_few_at_once<T: Sync, R: Send, E: Send>(
    items: &[T],
    at_once: usize,
    work: impl Fn(&T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let mut results = Vec::with_capacity(items.len());
    for few in items.chunks(at_once.max(1)) {
        let done: Result<Vec<R>, E> = few.par_iter().map(&work).collect();
        results.extend(done?);
    }
    Ok(results)
}
