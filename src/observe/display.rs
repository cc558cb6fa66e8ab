//! What a way to show events has to show.

use super::forecast::Outlook;
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

/// One way to show events; what it does not show it passes over.
pub trait Display: Send {
    fn stage(&mut self, _stage: StageId, _news: &StageNews) {}
    /// An iteration or a warning.
    fn event(&mut self, _event: &Event) {}
    /// Progress of a step of a stage, or of a command where it belongs to none: what is done of how much, and how far the
    /// whole run is.
    fn progress(
        &mut self,
        _of: &str,
        _step: &str,
        _counts: (usize, usize),
        _outlook: Option<Outlook>,
    ) {
    }
    fn note(&mut self, _message: &str) {}
    fn finished(&mut self, _summary: &serde_json::Value) {}
}

/// Shows nothing: another rank shows what all do.
pub struct Quiet;

impl Display for Quiet {}
