//! One JSON object a line on stdout, for other programs.

use super::display::{Display, StageNews};
use super::forecast::Outlook;
use rilievo_scene::{Event, StageId};
use std::io::Write;

/// Prints every event as it is.
pub struct JsonLines;

impl JsonLines {
    fn print(value: &serde_json::Value) {
        // A reader that went away must not end the run.
        let _ = writeln!(std::io::stdout().lock(), "{value}");
    }
}

impl Display for JsonLines {
    fn stage(&mut self, stage: StageId, news: &StageNews) {
        Self::print(&match news {
            StageNews::Started(reason) => {
                serde_json::json!({"event": "stage_started", "stage": stage, "reason": reason})
            }
            StageNews::Reused => {
                serde_json::json!({"event": "stage_finished", "stage": stage, "reused": true})
            }
            StageNews::Finished(seconds) => serde_json::json!({
                "event": "stage_finished", "stage": stage, "reused": false, "seconds": seconds
            }),
        });
    }

    fn event(&mut self, event: &Event) {
        // An event is plain data; it always has a JSON form.
        if let Ok(value) = serde_json::to_value(event) {
            Self::print(&value);
        }
    }

    fn progress(
        &mut self,
        of: &str,
        step: &str,
        (done, total): (usize, usize),
        outlook: Option<Outlook>,
    ) {
        let mut line = serde_json::json!({
            "event": "progress", "stage": of, "step": step, "done": done, "total": total
        });
        if let Some(Outlook { share, left }) = outlook {
            line["run_share"] = share.into();
            line["run_seconds_left"] = left.as_secs_f64().into();
        }
        Self::print(&line);
    }

    fn note(&mut self, message: &str) {
        tell!("{message}");
    }

    fn finished(&mut self, summary: &serde_json::Value) {
        let mut line = serde_json::json!({"event": "finished"});
        if let (Some(line), Some(summary)) = (line.as_object_mut(), summary.as_object()) {
            line.extend(summary.clone());
        }
        Self::print(&line);
    }
}
