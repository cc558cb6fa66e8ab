//! What every stage of a run may look at.

use super::inputs::Inputs;
use super::parallel::Resources;
use super::request::Request;
use crate::observe::Console;
use crate::store::RunDir;

/// What every stage may look at.
pub struct Context<'a> {
    /// The run directory.
    pub run: &'a RunDir,
    /// What was asked for.
    pub request: &'a Request,
    /// The files from outside.
    pub inputs: &'a Inputs,
    /// Threads and memory.
    pub resources: Resources,
    /// Where events go.
    pub console: &'a Console,
}
