//! `rilievo`: photographs of a plain, matte object to an accurate, finely detailed 3D model.
//!
//! The program knows files, flags and the terminal; the stages in `stages/` are functions from data
//! to data. See ARCHITECTURE.md for how data flow.
//!
//! This library is the program: [`program()`] is all of it, as it is called from a shell, and [`embedded`]
//! is what another program can call in its own process.

#[macro_use]
mod output;

mod cli;
mod commands;
mod config;
mod cost;
pub mod embedded;
mod exit;
mod interrupt;
mod observe;
mod panics;
mod paths;
mod pipeline;
mod program;
mod ranks;
mod raw_child;
mod report;
mod store;
mod system;

pub use program::program;
