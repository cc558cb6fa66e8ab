//! One file per command of the command line.

mod bring;
mod cameras;
mod check;
mod clean;
mod completions;
mod demo;
mod diligent;
mod evaluate;
mod fuse;
mod handshake;
mod man;
mod mask;
mod output_files;
mod reconstruct;
mod reporting;
mod run;
mod shade;
mod status;
mod stored;
mod synth;

#[cfg(test)]
pub use synth::SynthOptions;

pub use evaluate::evaluation;
pub use reporting::reporting;
pub use shade::{Described, ViewParts, options as shade_options, solve as solve_shading};

use crate::cli::Command;
use crate::exit::Failure;
use crate::observe::Console;

/// Runs the command of a command line.
///
/// # Errors
/// Whatever makes the command fail; [`crate::exit::code_of`] knows its exit code.
pub fn dispatch(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::demo(&args),
        Command::Reconstruct(args) => reconstruct::reconstruct(&args),
        Command::Run(args) => run::run(&args),
        Command::Status(args) => status::status(&args),
        Command::Why(args) => status::why(&args),
        Command::Clean(args) => clean::clean(&args),
        Command::Shade(args) => shade::shade(&args),
        Command::Evaluate(args) => evaluate::evaluate(&args),
        Command::Fuse(args) => fuse::fuse(&args),
        Command::Synth(args) => synth::synth(&args),
        Command::Check(args) => check::check(&args),
        Command::Mask(args) => mask::mask(&args),
        Command::Import(args) => cameras::import(&args),
        Command::Export(args) => cameras::export(&args),
        Command::Completions(args) => completions::completions(&args),
        Command::Man(args) => man::man(&args),
        // Answered before any command: it is no work of the user's.
        Command::DecodeRaw(_) => Ok(()),
    }
}

/// Runs a command inside another program, on that one's console.
///
/// # Errors
/// As [`dispatch`]; and for a command that has results for a terminal only.
pub fn dispatch_to(command: &Command, console: &Console) -> anyhow::Result<()> {
    match command {
        Command::Reconstruct(args) => reconstruct::reconstruct_to(args, console),
        Command::Synth(args) => synth::synth_to(args, console),
        _ => {
            let reason = "only reconstruct and synth run inside another program; the command line has the others";
            Err(Failure::Usage(reason.to_owned()).into())
        }
    }
}
