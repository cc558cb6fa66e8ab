//! Arguments of the command line, as a caller gives them.

use super::failure::CommandFailure;
use crate::cli::{Cli, Command};
use std::ffi::OsString;

/// The command that arguments stand for, the command's name first.
///
/// # Errors
/// When the command line would not take them.
pub(super) fn parsed(arguments: &[OsString]) -> Result<Command, CommandFailure> {
    let program = OsString::from("rilievo");
    let cli = Cli::of([program].into_iter().chain(arguments.iter().cloned()))?;
    Ok(cli.command)
}
