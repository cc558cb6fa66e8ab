//! Progress on a terminal: one bar for the whole run where its forecast is known, else one for the step at hand.

use super::display::{Display, StageNews};
use super::forecast::{Outlook, SharedForecast, outlook};
use super::pace::in_words;
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use rilievo_scene::{Event, StageId};
use std::fmt::Write;
use std::time::Duration;

/// Of a whole run: how far it is, then the step at hand.
const RUN: &str = "{run} {wide_msg}";

/// Of a step that belongs to no run.
const STEP: &str = "{prefix} {msg} [{bar:30}] {pos}/{len} {per_sec}, {eta} left";

/// Of such a step in one go, which has nothing to count.
const SPINNER: &str = "{prefix} {msg} {spinner} {elapsed}";

/// Characters of the bar of a run.
const WIDTH: usize = 10;

/// Columns of a terminal that does not report how many it has.
const DEFAULT_COLUMNS: usize = 80;

/// Fewest columns that words are wrapped into.
const MIN_COLUMNS: usize = 20;

/// One bar at a time.
pub struct Bars {
    /// With the step that it shows, or nothing where it shows the whole run.
    bar: Option<(Option<String>, ProgressBar)>,
    forecast: SharedForecast,
}

impl Bars {
    /// No bar yet.
    pub fn new(forecast: SharedForecast) -> Self {
        Self {
            bar: None,
            forecast,
        }
    }

    /// The bar of a step, or of the whole run.
    fn bar(&mut self, step: Option<&str>, begin: impl FnOnce() -> ProgressBar) -> &ProgressBar {
        let same = matches!(&self.bar, Some((current, _)) if current.as_deref() == step);
        if !same {
            self.clear();
        }
        let (_, bar) = self.bar.get_or_insert_with(|| {
            let bar = begin();
            // The bar's own thread may be refused, which would end the program.
            if std::thread::Builder::new().spawn(|| ()).is_ok() {
                bar.enable_steady_tick(Duration::from_millis(500));
            }
            (step.map(str::to_owned), bar)
        });
        bar
    }

    fn run_bar(&mut self) -> &ProgressBar {
        let forecast = self.forecast.clone();
        self.bar(None, || {
            let drawn = move |_: &ProgressState, out: &mut dyn Write| {
                // Where this fails, there is nowhere left to report it.
                let _ = out.write_str(&bar_of(outlook(&forecast)));
            };
            let style = ProgressStyle::with_template(RUN)
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .with_key("run", drawn);
            ProgressBar::new_spinner().with_style(style)
        })
    }

    fn step_bar(&mut self, of: &str, step: &str, done: usize, total: usize) -> &ProgressBar {
        let bar = self.bar(Some(step), || {
            let style = ProgressStyle::with_template(if total == 1 { SPINNER } else { STEP })
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::new(total as u64)
                .with_style(style)
                .with_position(done as u64);
            // What was done before says nothing of the rate.
            bar.reset_eta();
            bar.set_prefix(of.to_owned());
            bar.set_message(step.to_owned());
            bar
        });
        bar.set_length(total as u64);
        bar
    }

    fn has_forecast(&self) -> bool {
        outlook(&self.forecast).is_some()
    }

    fn clear(&mut self) {
        if let Some((_, bar)) = self.bar.take() {
            bar.finish_and_clear();
        }
    }

    fn line(&mut self, text: &str) {
        let columns = console::Term::stderr().size_checked();
        let columns = columns.map_or(DEFAULT_COLUMNS, |(_, columns)| usize::from(columns));
        let text = wrapped(text, columns.max(MIN_COLUMNS));
        let warning = console::style("warning:").for_stderr().yellow().bold();
        let text = text.replacen("warning:", &warning.to_string(), 1);
        match &self.bar {
            Some((_, bar)) => bar.suspend(|| tell!("{text}")),
            None => tell!("{text}"),
        }
    }
}

/// How far the run is, as a bar.
fn bar_of(outlook: Option<Outlook>) -> String {
    let Some(Outlook { share, left }) = outlook else {
        return String::new();
    };
    let filled = ((share * WIDTH as f64) as usize).min(WIDTH);
    format!(
        "[{}{}] {:.0} %, {} left;",
        "#".repeat(filled),
        "-".repeat(WIDTH - filled),
        100.0 * share,
        in_words(Duration::from_secs(left.as_secs()))
    )
}

/// A text in lines of so many columns, broken between words, the further ones indented by two more than the first. A word
/// that is longer than a line stays whole, and so does a line that is set in columns.
fn wrapped(text: &str, columns: usize) -> String {
    let indent = text.len() - text.trim_start().len();
    let is_table = text.trim_start().contains("  ");
    if is_table || text.chars().count() <= columns {
        return text.to_owned();
    }
    let mut out = " ".repeat(indent);
    let mut column = indent;
    for (k, word) in text.split_whitespace().enumerate() {
        let length = word.chars().count();
        if k > 0 && column + 1 + length > columns {
            out.push('\n');
            out.push_str(&" ".repeat(indent + 2));
            column = indent + 2;
        } else if k > 0 {
            out.push(' ');
            column += 1;
        }
        out.push_str(word);
        column += length;
    }
    out
}

impl Display for Bars {
    fn stage(&mut self, stage: StageId, news: &StageNews) {
        if !self.has_forecast() {
            self.clear();
        }
        let text = match news {
            StageNews::Started(reason) => format!("{stage}: {reason}"),
            StageNews::Reused => format!("{stage}: kept, nothing changed"),
            StageNews::Finished(seconds) => {
                format!(
                    "{stage}: done in {}",
                    in_words(Duration::from_secs_f64(*seconds))
                )
            }
        };
        self.line(&text);
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Iteration {
                stage,
                iteration,
                max_num_iterations,
                energy,
                ..
            } => {
                let text = format!("iterating, energy {energy:.3e}");
                if self.has_forecast() {
                    self.run_bar().set_message(format!("{stage}: {text}"));
                } else {
                    let bar =
                        self.step_bar(stage.name(), "iterating", *iteration, *max_num_iterations);
                    bar.set_position(*iteration as u64 + 1);
                    bar.set_message(text);
                }
            }
            Event::Warning { stage, message } => {
                let text = format!("{stage}: warning: {message}");
                self.line(&text);
            }
            Event::Progress { .. } => {}
        }
    }

    fn progress(
        &mut self,
        of: &str,
        step: &str,
        (done, total): (usize, usize),
        outlook: Option<Outlook>,
    ) {
        if outlook.is_some() {
            let counts = match total {
                0 | 1 => String::new(),
                _ => format!(" {done}/{total}"),
            };
            self.run_bar().set_message(format!("{of}: {step}{counts}"));
        } else {
            self.step_bar(of, step, done, total)
                .set_position(done as u64);
        }
    }

    fn note(&mut self, message: &str) {
        self.line(message);
    }

    fn finished(&mut self, _summary: &serde_json::Value) {
        self.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_break_between_words() {
        let text = "  3_poses: warning: the photo keeps few of its matches";
        let expected = "  3_poses: warning:\n    the photo keeps\n    few of its\n    matches";
        assert_eq!(wrapped(text, 20), expected);
        assert_eq!(wrapped(text, 80), text);
        assert_eq!(wrapped("", 20), "");
        let row = "  IMG_0001.jpg    640 x 480     768.0    17.9";
        assert_eq!(wrapped(row, 30), row);
        assert_eq!(
            wrapped("/a/very/long/path/of/a/file", 20),
            "/a/very/long/path/of/a/file"
        );
    }

    #[test]
    fn the_bar_fills_with_the_run() {
        let outlook = |share| {
            Some(Outlook {
                share,
                left: Duration::from_secs(300),
            })
        };
        assert_eq!(bar_of(outlook(0.5)), "[#####-----] 50 %, 5 min left;");
        assert_eq!(bar_of(None), "");
    }
}
