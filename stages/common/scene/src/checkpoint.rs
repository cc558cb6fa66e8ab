//! What a long stage has worked out so far, kept so that a stopped run goes on from there.

use std::io::{self, Read, Write};

/// Why the state of a stage could not be kept.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("how far the stage is could not be kept: {reason}")]
pub struct CheckpointError {
    /// What went wrong, and where.
    pub reason: String,
}

/// A part of a state: its name, and what writes its content.
pub struct StatePart<'a> {
    /// A word of letters and digits.
    pub name: &'a str,
    /// Writes the content.
    pub write: &'a (dyn Fn(&mut dyn Write) -> io::Result<()> + Sync),
}

/// Keeps the last state of a stage. A state has parts, so that those which have not changed need not be written
/// again.
pub trait Checkpoint: Sync {
    /// Content of a part of the state that was kept last; `None` where there is none.
    fn read(&self, part: &str) -> Option<Box<dyn Read>>;

    /// Replaces parts of the state, all of them or none; the other parts stay.
    ///
    /// # Errors
    /// When they cannot be written; the state that was kept before is then still there.
    fn keep(&self, parts: &[StatePart<'_>]) -> Result<(), CheckpointError>;
}

/// Keeps nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoCheckpoint;

impl Checkpoint for NoCheckpoint {
    fn read(&self, _part: &str) -> Option<Box<dyn Read>> {
        None
    }

    fn keep(&self, _parts: &[StatePart<'_>]) -> Result<(), CheckpointError> {
        Ok(())
    }
}
