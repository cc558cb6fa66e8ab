//! Arguments of the command line, as a caller gives them.

use super::failure::CommandFailure;
use crate::cli::{Cli, Command};
use clap::Parser;
use std::ffi::OsString;

/// The command that arguments stand for, the command's name first.
///
/// # Errors
/// When the command line would not take them.
pub(super) fn parsed(arguments: &[OsString]) -> Result<Command, CommandFailure> {
    let program = OsString::from("rilievo");
    let cli = Cli::try_parse_from(std::iter::once(&program).chain(arguments))?;
    Ok(cli.command)
}
