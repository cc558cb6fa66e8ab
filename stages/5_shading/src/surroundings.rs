//! What a run has around it.

use rilievo_scene::{Checkpoint, MemoryScratch, NoCheckpoint, Observer, Scratch};

/// What a run has around it.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// Receives progress and warnings, and may stop the run.
    pub observer: &'a dyn Observer,
    /// Keeps how far the photo model is; the paper's model begins anew.
    pub checkpoint: &'a dyn Checkpoint,
    /// Where fine levels are put aside.
    pub scratch: &'a dyn Scratch,
}

impl<'a> Surroundings<'a> {
    /// Everything in memory, nothing kept.
    pub fn in_memory(observer: &'a dyn Observer) -> Self {
        Self {
            observer,
            checkpoint: &NoCheckpoint,
            scratch: &MemoryScratch,
        }
    }
}
