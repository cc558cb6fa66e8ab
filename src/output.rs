//! Text on stdout and stderr that survives a reader who goes away.
//!
//! `println!` panics when the pipe is closed (`rilievo status RUN | head -1`); here that is no
//! failure, while a full disk behind a redirected stdout is one.

use crate::exit::Failure;
use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// Writes a line to stdout.
///
/// # Errors
/// When it cannot be written although somebody reads.
pub fn to_stdout(line: Arguments<'_>) -> Result<(), Failure> {
    match writeln!(std::io::stdout().lock(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::ReadOrWrite(format!(
            "cannot write to stdout: {error}"
        ))),
        _ => Ok(()),
    }
}

/// Writes a line to stderr; what cannot be told there can be told nowhere.
pub fn to_stderr(line: Arguments<'_>) {
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
