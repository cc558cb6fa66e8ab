//! `rilievo`: photographs of a plain, matte object to an accurate, finely detailed 3D model.
//!
//! The program knows files, flags and the terminal; the stages in `stages/` are functions from data
//! to data. See ARCHITECTURE.md for how data flow.

#[macro_use]
mod output;

mod cli;
mod commands;
mod config;
mod cost;
mod exit;
mod interrupt;
mod observe;
mod panics;
mod paths;
mod pipeline;
mod ranks;
mod raw_child;
mod report;
mod store;
mod system;

use clap::Parser;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::ExitCode;

fn main() -> ExitCode {
    panics::install();
    let cli = cli::Cli::parse();
    if let cli::Command::DecodeRaw(args) = &cli.command {
        return raw_child::serve(&args.name);
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

/// Exit code of a panic.
const PANICKED: u8 = 101;
