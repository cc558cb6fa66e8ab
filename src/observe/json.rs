//! Every event as one JSON object, for other programs: a line on stdout, or handed over in this process.

use super::display::{Display, StageNews};
use super::forecast::Outlook;
use rilievo_scene::{Event, StageId};
use serde_json::Value;
use std::io::Write;

/// Takes events as JSON.
pub trait JsonSink: Send {
    /// Takes an event.
    fn event(&mut self, event: &Value);
    /// Takes a sentence for people.
    fn note(&mut self, message: &str);
}

/// Lines on stdout, sentences on stderr.
pub struct Stdout;

impl JsonSink for Stdout {
    fn event(&mut self, event: &Value) {
        // A reader that went away must not end the run.
        let _ = writeln!(std::io::stdout().lock(), "{event}");
    }

    fn note(&mut self, message: &str) {
        tell!("{message}");
    }
}

/// Hands every event over as it is.
pub struct JsonEvents<S>(pub S);

impl<S: JsonSink> Display for JsonEvents<S> {
    fn stage(&mut self, stage: StageId, news: &StageNews) {
        self.0.event(&match news {
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
            self.0.event(&value);
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
        self.0.event(&line);
    }

    fn note(&mut self, message: &str) {
        self.0.note(message);
    }

    fn finished(&mut self, summary: &serde_json::Value) {
        let mut line = serde_json::json!({"event": "finished"});
        if let (Some(line), Some(summary)) = (line.as_object_mut(), summary.as_object()) {
            line.extend(summary.clone());
        }
        self.0.event(&line);
    }
}
