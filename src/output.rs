//! Text on stdout and stderr that survives a reader who goes away.
//!
//! `println!` panics when the pipe is closed (`rilievo status RUN | head -1`); here that is no
//! failure, while a full disk behind a redirected stdout is one. Of several ranks the first one speaks.

use crate::exit::Failure;
use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether another rank speaks for this one.
static MUTE: AtomicBool = AtomicBool::new(false);

/// From here on another rank speaks for this one.
#[cfg(feature = "mpi")]
pub fn mute() {
    MUTE.store(true, Ordering::Relaxed);
}

fn is_mute() -> bool {
    MUTE.load(Ordering::Relaxed)
}

/// Writes a line to stdout.
///
/// # Errors
/// When it cannot be written although somebody reads.
pub fn to_stdout(line: Arguments<'_>) -> Result<(), Failure> {
    if is_mute() {
        return Ok(());
    }
    match writeln!(std::io::stdout().lock(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::ReadOrWrite(format!(
            "cannot write to stdout: {error}"
        ))),
        _ => Ok(()),
    }
}

/// Writes a line to stderr; what cannot be written there can be written nowhere.
pub fn to_stderr(line: Arguments<'_>) {
    if !is_mute() {
        to_stderr_of_any_rank(line);
    }
}

/// The same where no other rank can write it.
pub fn to_stderr_of_any_rank(line: Arguments<'_>) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// A line on stdout, as `println!`, with a result.
macro_rules! say {
    ($($text:tt)*) => { $crate::output::to_stdout(format_args!($($text)*)) };
}

/// A line on stderr, as `eprintln!`.
macro_rules! tell {
    ($($text:tt)*) => { $crate::output::to_stderr(format_args!($($text)*)) };
}
