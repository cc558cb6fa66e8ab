//! Work photo by photo on all cores, as far as memory allows.

use crate::cli::WorkArgs;
use crate::exit::Failure;
use crate::ranks;
use rayon::prelude::*;
use rilievo_scene::{DividedStep, Flow, Observer, StageId};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Threads and memory of a command; results do not depend on either.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Bytes that photos worked on at once may take in stages 1 to 3.
    pub memory: u64,
    /// Bytes that stage 5 may take; as many as it needs where nothing is said.
    pub given: Option<u64>,
}

impl Default for Resources {
    /// Half of the free memory, divided among the ranks of this host.
    fn default() -> Self {
        Self {
            memory: half_of_free_memory() / ranks::on_this_host() as u64,
            given: None,
        }
    }
}

impl Resources {
    /// Reads the memory limit.
    pub fn new(args: &WorkArgs) -> Self {
        args.memory.map_or_else(Self::default, |memory| Self {
            memory,
            given: Some(memory),
        })
    }

    /// How many items of a size can be worked on at once: at least one, or nothing would move.
    pub fn at_once(self, bytes_each: u64) -> usize {
        let fitting = self.memory / bytes_each.max(1);
        (fitting.max(1) as usize).min(rayon::current_num_threads())
    }
}

/// Starts the threads of the whole program; without a number as many as there are cores, of which ranks on one host
/// take a share each.
pub fn start_threads(number: Option<u16>) -> anyhow::Result<()> {
    let share = || ranks::threads().map_or(0, NonZeroUsize::get);
    let threads = number.map_or_else(share, usize::from);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|error| anyhow::anyhow!("cannot start the threads ({error}); try --threads 1"))
}

/// Half of what the system says is available; 2 GiB where it does not say.
fn half_of_free_memory() -> u64 {
    let available = std::fs::read_to_string("/proc/meminfo")
        .ok()
        .and_then(|text| {
            let line = text
                .lines()
                .find(|line| line.starts_with("MemAvailable:"))?;
            line.split_whitespace().nth(1)?.parse::<u64>().ok()
        });
    available.map_or(2 << 30, |kib| kib * 1024 / 2)
}

/// Maps items in parallel, at most `at_once` at a time, and reports progress; results come in
/// the items' order. `None` when the observer asked to stop.
pub fn map_items<T: Sync, R: Send>(
    items: &[T],
    at_once: usize,
    stage: StageId,
    step: &str,
    observer: &dyn Observer,
    work: impl Fn(&T) -> R + Sync,
) -> Option<Vec<R>> {
    let done = AtomicUsize::new(0);
    let next = |item: &T| {
        if observer.flow() == Flow::Stop {
            return None;
        }
        let result = work(item);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        match observer.progress(stage, step, (done, items.len())) {
            Flow::Continue => Some(result),
            Flow::Stop => None,
        }
    };
    if at_once >= rayon::current_num_threads() {
        return items.par_iter().map(next).collect();
    }
    let mut results = Vec::with_capacity(items.len());
    for chunk in items.chunks(at_once) {
        let part: Option<Vec<R>> = chunk.par_iter().map(next).collect();
        results.extend(part?);
    }
    Some(results)
}

/// As [`map_items`], divided among the ranks of the run; everyone gets all results.
///
/// # Errors
/// That of the first item that fails, or [`Failure::Interrupted`].
pub fn divide_items<T: Sync, R: Serialize + DeserializeOwned + Send>(
    items: &[T],
    at_once: usize,
    (stage, step): (StageId, &str),
    observer: &dyn Observer,
    work: impl Fn(&T) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let interrupted = || Failure::Interrupted.into();
    DividedStep::new(observer, stage, step)
        .run(items.len(), at_once, interrupted, |idx| work(&items[idx]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Silent;

    #[test]
    fn results_keep_the_order_whatever_runs_at_once() {
        let items: Vec<usize> = (0..50).collect();
        for at_once in [1, 3, 64] {
            let squares = map_items(&items, at_once, StageId::Photos, "x", &Silent, |i| i * i);
            let expected: Vec<usize> = items.iter().map(|i| i * i).collect();
            assert_eq!(squares, Some(expected));
        }
    }
}
