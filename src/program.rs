//! The program as a shell calls it: one command, its signals, its exit code.

use crate::{cli, commands, exit, interrupt, panics, pipeline, ranks, raw_child};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::ExitCode;

/// Exit code of a panic.
const PANICKED: u8 = 101;

/// Runs the command that this process was started with; returns its exit code.
pub fn program() -> ExitCode {
    panics::install();
    let cli = cli::Cli::of(std::env::args_os()).unwrap_or_else(|error| error.exit());
    if let cli::Command::DecodeRaw(args) = &cli.command {
        return raw_child::serve(&args.name).into();
    }
    rilievo_io::set_raw_decoder(raw_child::decode);
    let joined = ranks::join(&cli.command);
    interrupt::listen();
    let work = || {
        joined?;
        pipeline::start_threads(cli.command.threads())?;
        commands::dispatch(cli.command)
    };
    let outcome = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(outcome) => ranks::agree(outcome),
        Err(panic) => {
            ranks::end(PANICKED);
            resume_unwind(panic)
        }
    };
    let code = match &outcome {
        Ok(()) => 0,
        Err(error) => {
            tell!("error: {error:#}");
            exit::code_of(error)
        }
    };
    ranks::end(code);
    ExitCode::from(code)
}
