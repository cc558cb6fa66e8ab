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
mod panics;
mod paths;
mod pipeline;
mod raw_child;
mod report;
mod store;
mod system;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    panics::install();
    let cli = cli::Cli::parse();
    if let cli::Command::DecodeRaw(args) = &cli.command {
        return raw_child::serve(&args.name);
    }
    rilievo_io::set_raw_decoder(raw_child::decode);
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
