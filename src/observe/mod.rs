//! What the program shows while it works: one stream of events, three ways to show it.
//!
//! Bars on a terminal, plain lines in a pipe, one JSON object a line with `--json`. Text for
//! people goes to stderr; stdout carries results and the JSON lines. Inside another program all of it goes to
//! a function of that program, which has its own way to ask for a stop.

mod bars;
mod display;
mod forecast;
mod json;
mod lines;
mod pace;

pub use display::StageNews;
pub use forecast::ExpectedStep;
pub use json::JsonSink;

use crate::interrupt;
use crate::ranks;
use display::Display;
use forecast::{Forecast, SharedForecast, locked, outlook};
use json::{JsonEvents, Stdout};
use rilievo_scene::{Event, Flow, Observer, StageId, Team};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// The observer of a whole command.
pub struct Console {
    display: Mutex<Box<dyn Display>>,
    warnings: Mutex<Vec<(StageId, String)>>,
    forecast: SharedForecast,
    /// Set by who runs this command alone and asks it to stop; signals stop all commands of the program.
    stop: Option<Arc<AtomicBool>>,
}

impl Console {
    /// A console that suits where the output goes; of several ranks the first one shows what all do.
    pub fn new(json: bool) -> Self {
        let forecast = SharedForecast::default();
        let display: Box<dyn Display> = if !ranks::team().is_first() {
            Box::new(display::Quiet)
        } else if json {
            Box::new(JsonEvents(Stdout))
        } else if std::io::stderr().is_terminal() {
            Box::new(bars::Bars::new(forecast.clone()))
        } else {
            Box::new(lines::Lines::default())
        };
        Self::showing(display, forecast, None)
    }

    /// The console of a command inside another program, which takes what there is to show and sets `stop` to end it.
    pub fn embedded(sink: impl JsonSink + 'static, stop: Arc<AtomicBool>) -> Self {
        let display = Box::new(JsonEvents(sink));
        Self::showing(display, SharedForecast::default(), Some(stop))
    }

    fn showing(
        display: Box<dyn Display>,
        forecast: SharedForecast,
        stop: Option<Arc<AtomicBool>>,
    ) -> Self {
        Self {
            display: Mutex::new(display),
            warnings: Mutex::new(Vec::new()),
            forecast,
            stop,
        }
    }

    /// Takes what the run is expected to do from here on, and the seconds of what follows then, so
    /// that the time it will take can be shown.
    pub fn expect(&self, steps: Vec<ExpectedStep>, later: f64) {
        match &mut *locked(&self.forecast) {
            Some(forecast) => forecast.replace(steps, later),
            none => *none = Some(Forecast::new(steps, later, Instant::now())),
        }
    }

    /// Shows how far a step is, and the run with it.
    fn show_progress(&self, of: &str, step: &str, done: usize, total: usize) {
        if let Some(forecast) = &mut *locked(&self.forecast) {
            forecast.progress(of, step, done, total, Instant::now());
        }
        let outlook = outlook(&self.forecast);
        self.with(|display| display.progress(of, step, (done, total), outlook));
    }

    /// Shows where a stage stands.
    pub fn stage(&self, stage: StageId, news: &StageNews) {
        if let (StageNews::Reused | StageNews::Finished(_), Some(forecast)) =
            (news, &mut *locked(&self.forecast))
        {
            forecast.stage_ends(stage);
        }
        self.with(|display| display.stage(stage, news));
    }

    /// An observer whose progress is shown as the command's own, and not as a stage's.
    pub fn of_command(&self, command: &'static str) -> OfCommand<'_> {
        OfCommand {
            console: self,
            command,
        }
    }

    /// A sentence for people.
    pub fn note(&self, message: &str) {
        self.with(|display| display.note(message));
    }

    /// A warning that is shown now and kept for the report.
    pub fn warn(&self, stage: StageId, message: impl Into<String>) {
        // Whether to stop is asked again by the next event.
        let _ = Observer::warn(self, stage, message.into());
    }

    /// The last word, for scripts.
    pub fn finished(&self, summary: &serde_json::Value) {
        self.with(|display| display.finished(summary));
    }

    /// Takes the warnings of a stage out, for its manifest.
    pub fn take_warnings(&self, stage: StageId) -> Vec<String> {
        let mut warnings = locked(&self.warnings);
        let (taken, kept) = warnings.drain(..).partition(|(of, _)| *of == stage);
        *warnings = kept;
        let taken: Vec<(StageId, String)> = taken;
        taken.into_iter().map(|(_, message)| message).collect()
    }

    fn with(&self, show: impl FnOnce(&mut dyn Display)) {
        show(locked(&self.display).as_mut());
    }
}

impl Observer for Console {
    fn event(&self, event: Event) -> Flow {
        if let Event::Warning { stage, message } = &event {
            locked(&self.warnings).push((*stage, message.clone()));
        }
        if let Event::Progress {
            stage,
            step,
            done,
            total,
        } = &event
        {
            self.show_progress(stage.name(), step, *done, *total);
        } else {
            self.with(|display| display.event(&event));
        }
        self.flow()
    }

    fn flow(&self) -> Flow {
        let asked = self.stop.as_ref();
        if interrupt::requested() || asked.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
            Flow::Stop
        } else {
            Flow::Continue
        }
    }

    fn team(&self) -> &dyn Team {
        ranks::team()
    }
}

/// The console for work that is no stage's, though it may be done by the same functions.
pub struct OfCommand<'a> {
    console: &'a Console,
    command: &'static str,
}

impl Observer for OfCommand<'_> {
    fn event(&self, event: Event) -> Flow {
        let Event::Progress {
            step, done, total, ..
        } = &event
        else {
            return self.console.event(event);
        };
        self.console
            .show_progress(self.command, step, *done, *total);
        self.flow()
    }

    fn flow(&self) -> Flow {
        self.console.flow()
    }
}
