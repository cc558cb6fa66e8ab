//! Photos are loaded a few at a time.
//!
//! A loaded photo takes 12 bytes a pixel and its preparation as much again, what is kept of it far
//! less: with a thread per core the loaded ones would outweigh all that is kept.

use rayon::prelude::*;

/// Photos that are held in memory at once.
const MAX_NUM_LOADED: usize = 3;

/// Maps items in parallel, a few at once, in their order.
pub fn map_few_at_once<T: Sync, R: Send, E: Send>(
    items: &[T],
    work: impl Fn(&T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let mut results = Vec::with_capacity(items.len());
    for few in items.chunks(MAX_NUM_LOADED) {
        let done: Result<Vec<R>, E> = few.par_iter().map(&work).collect();
        results.extend(done?);
    }
    Ok(results)
}
