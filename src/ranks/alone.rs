//! One process: a build without MPI.

use super::launcher::Launch;
use crate::cli::Command;
use crate::exit::Failure;
use rilievo_scene::{Alone, Team};
use std::num::NonZeroUsize;

/// Refuses to be one of several processes, which would work against each other in one run directory.
///
/// # Errors
/// With what to do.
pub fn join(_command: &Command) -> Result<(), Failure> {
    let Some(Launch {
        size,
        rank,
        variable,
    }) = Launch::found()
    else {
        return Ok(());
    };
    if rank > 0 {
        // The launcher ends all with the first one that ends: let that be the one that says why.
        std::thread::sleep(std::time::Duration::from_millis(500));
    }
    Err(Failure::Usage(format!(
        "this is one of {size} processes ({variable}), but this build cannot divide a run among processes: build \
         it with `cargo build --release --features mpi` (Debian: .ci/setup mpi), or start one process without the \
         launcher; where every process has a run directory of its own, start it with `env -u {variable}`"
    )))
}

/// This process.
pub fn team() -> &'static dyn Team {
    &Alone
}

/// The outcome.
pub fn agree<T>(outcome: anyhow::Result<T>) -> anyhow::Result<T> {
    outcome
}

/// Nothing has to be ended.
pub fn end(_code: u8) {}

/// A single process needs no name.
pub fn name() -> Option<String> {
    None
}

/// All cores are this process's.
pub fn threads() -> Option<NonZeroUsize> {
    None
}

/// Nobody else shares this host.
pub fn on_this_host() -> usize {
    1
}
