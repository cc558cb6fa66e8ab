//! Nothing: another rank shows what all do.

use super::display::{Display, StageNews};
use super::forecast::Outlook;
use rilievo_scene::{Event, StageId};

/// Shows nothing.
pub struct Quiet;

impl Display for Quiet {
    fn stage(&mut self, _stage: StageId, _news: &StageNews) {}
    fn event(&mut self, _event: &Event) {}
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
