//! `rilievo`: photographs of a plain, matte object to an accurate, finely detailed 3D model.
//!
//! The program knows files, flags and the terminal; the stages in `stages/` are functions from data
//! to data. See ARCHITECTURE.md for how data flow.

#[macro_use]
mod output;

mod cli;
mod commands;
mod config;
mod exit;
mod interrupt;
mod observe;
mod paths;
mod pipeline;
mod report;
mod store;
mod system;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    interrupt::listen();
    let outcome = pipeline::start_threads(cli.command.threads());
    match outcome.and_then(|()| commands::dispatch(cli.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell!("error: {error:#}");
            ExitCode::from(exit::code_of(&error))
        }
    }
}
