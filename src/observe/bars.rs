//! Progress bars on a terminal: stage, step, items, rate and time left.

use super::display::{Display, StageNews};
use super::pace::in_words;
use indicatif::{ProgressBar, ProgressStyle};
use rilievo_scene::{Event, StageId};
use std::time::Duration;

const TEMPLATE: &str = "{prefix} {msg} [{bar:30}] {pos}/{len} {per_sec}, {eta} left";

/// Of a step in one go, which has nothing to count.
const SPINNER: &str = "{prefix} {msg} {spinner} {elapsed}";

/// One bar at a time, for the step at hand.
pub struct Bars {
    bar: Option<(String, ProgressBar)>,
}

impl Bars {
    /// No bar yet.
    pub fn new() -> Self {
        Self { bar: None }
    }

    fn bar(&mut self, of: &str, step: &str, done: usize, total: usize) -> &ProgressBar {
        let same = matches!(&self.bar, Some((current, _)) if current == step);
        if !same {
            self.clear();
        }
        let (_, bar) = self.bar.get_or_insert_with(|| {
            let style = ProgressStyle::with_template(if total == 1 { SPINNER } else { TEMPLATE })
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::new(total as u64)
                .with_style(style)
                .with_position(done as u64);
            // What was done before says nothing of the rate.
            bar.reset_eta();
            bar.set_prefix(of.to_owned());
            bar.set_message(step.to_owned());
            // The bar's own thread may be refused, which would end the program.
            if std::thread::Builder::new().spawn(|| ()).is_ok() {
                bar.enable_steady_tick(Duration::from_millis(500));
            }
            (step.to_owned(), bar)
        });
        bar.set_length(total as u64);
        bar
    }

    fn clear(&mut self) {
        if let Some((_, bar)) = self.bar.take() {
            bar.finish_and_clear();
        }
    }

    fn line(&mut self, text: &str) {
        match &self.bar {
            Some((_, bar)) => bar.suspend(|| tell!("{text}")),
            None => tell!("{text}"),
        }
    }
}

impl Display for Bars {
    fn stage(&mut self, stage: StageId, news: &StageNews) {
        self.clear();
        match news {
            StageNews::Started(reason) => tell!("{stage}: {reason}"),
            StageNews::Reused => tell!("{stage}: kept, nothing changed"),
            StageNews::Finished(seconds) => {
                tell!(
                    "{stage}: done in {}",
                    in_words(Duration::from_secs_f64(*seconds))
                );
            }
        }
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Progress {
                stage,
                step,
                done,
                total,
            } => self.progress(stage.name(), step, *done, *total),
            Event::Iteration {
                stage,
                iteration,
                max_num_iterations,
                energy,
                ..
            } => {
                let bar = self.bar(stage.name(), "iterating", *iteration, *max_num_iterations);
                bar.set_position(*iteration as u64 + 1);
                bar.set_message(format!("iterating, energy {energy:.3e}"));
            }
            Event::Warning { stage, message } => {
                let text = format!("{stage}: warning: {message}");
                self.line(&text);
            }
        }
    }

    fn progress(&mut self, of: &str, step: &str, done: usize, total: usize) {
        self.bar(of, step, done, total).set_position(done as u64);
    }

    fn note(&mut self, message: &str) {
        self.line(message);
    }

    fn finished(&mut self, _summary: &serde_json::Value) {
        self.clear();
    }
}
