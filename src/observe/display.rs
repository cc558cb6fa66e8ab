//! What a way to show events has to show.

use rilievo_scene::{Event, StageId};

/// How a stage came to its result.
#[derive(Clone, Debug)]
pub enum StageNews {
    /// Work starts, for this reason.
    Started(String),
    /// The earlier result is kept.
    Reused,
    /// Work ended after so many seconds.
    Finished(f64),
}

/// One way to show events.
pub trait Display: Send {
    fn stage(&mut self, stage: StageId, news: &StageNews);
    fn event(&mut self, event: &Event);
    /// Progress of a step of a command that belongs to no stage.
    fn progress(&mut self, command: &str, step: &str, done: usize, total: usize);
    fn note(&mut self, message: &str);
    fn finished(&mut self, summary: &serde_json::Value);
}
