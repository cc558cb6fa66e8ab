//! How far a whole run is, and how long the rest will take.
//!
//! A run is a list of steps with the time that each is expected to take. What was expected of the steps that are
//! behind, against the time that they took, tells how much slower or faster this run is than expected; the rest is
//! scaled by it. Steps that turn out not to be needed are dropped.

use rilievo_scene::StageId;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Weight of the expectation against what was measured, as a share of the whole: it counts while little is behind.
const TRUST: f64 = 0.15;

/// Most of a step that counts as done by time alone, where it does not report how far it is.
const MOST_BY_TIME: f64 = 0.95;

/// A share done that falls below this share of what was reported is a new start of the step; threads report a little out
/// of order.
const NEW_START: f64 = 0.5;

/// A step of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedStep {
    /// Name of the stage, or of the command where it belongs to none.
    pub of: &'static str,
    /// The step, as its progress names it.
    pub step: &'static str,
    /// Time that it is expected to take, seconds.
    pub seconds: f64,
    /// Whether only some runs take it: it counts once it begins.
    pub is_optional: bool,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlook {
    /// Share of the run's time that is behind, 0 to 1.
    pub share: f64,
    /// Time that is left.
    pub left: Duration,
}

/// The step at hand.
#[derive(Clone, Debug)]
struct Current {
    step: ExpectedStep,
    began: Instant,
    /// Share of it that was reported to be done.
    reported: f64,
}

/// The steps of a run, those behind and those to come.
#[derive(Clone, Debug)]
pub struct Forecast {
    began: Instant,
    /// Time that was expected of the whole at the start, seconds.
    expected: f64,
    done: Vec<ExpectedStep>,
    current: Option<Current>,
    to_come: VecDeque<ExpectedStep>,
    /// Time of what follows these steps and is not known step by step yet, seconds.
    later: f64,
}

impl Forecast {
    /// A run that begins now, with the time of what follows these steps.
    pub fn new(steps: Vec<ExpectedStep>, later: f64, now: Instant) -> Self {
        Self {
            began: now,
            expected: expected(&steps) + later,
            done: Vec::new(),
            current: None,
            to_come: steps.into(),
            later,
        }
    }

    /// Puts better known steps in the place of those to come.
    pub fn replace(&mut self, steps: Vec<ExpectedStep>, later: f64) {
        self.leave_current();
        self.to_come = steps.into();
        self.later = later;
    }

    /// A step reports how far it is.
    pub fn progress(&mut self, of: &str, step: &str, done: usize, total: usize, now: Instant) {
        let is = |expected: &ExpectedStep| expected.of == of && expected.step == step;
        let reported = done as f64 / total.max(1) as f64;
        if let Some(current) = &mut self.current
            && is(&current.step)
        {
            if total > 1 && reported >= NEW_START * current.reported {
                current.reported = current.reported.max(reported);
                return;
            }
            self.leave_current();
        }
        let mut to_come = self.to_come.iter();
        let next = if let Some(at) = to_come.position(is) {
            self.to_come.drain(..=at).next_back()
        } else {
            // One round more than expected.
            let mut current = self.current.iter().map(|current| &current.step);
            let known = self.done.iter().rfind(|step| is(step));
            known.or_else(|| current.find(|step| is(step))).cloned()
        };
        if let Some(step) = next {
            self.leave_current();
            self.current = Some(Current {
                step,
                began: now,
                reported,
            });
        }
    }

    /// A stage is done, or was kept.
    pub fn stage_ends(&mut self, stage: StageId) {
        let is = |step: &ExpectedStep| step.of == stage.name();
        if self
            .current
            .as_ref()
            .is_some_and(|current| is(&current.step))
        {
            self.leave_current();
        }
        self.to_come.retain(|step| !is(step));
    }

    /// How far the run is; `None` where nothing is behind and nothing is left.
    pub fn outlook(&self, now: Instant) -> Option<Outlook> {
        let seconds = |from: Instant, to: Instant| (to - from).as_secs_f64();
        let elapsed = seconds(self.began, now);
        let trusted = TRUST * self.expected;
        let rate = |elapsed: f64, behind: f64| (elapsed + trusted) / (behind + trusted).max(1e-9);
        let done: f64 = self.done.iter().map(|step| step.seconds).sum();
        let (mut behind, mut of_current) = (done, 0.0);
        if let Some(Current {
            step,
            began,
            reported,
        }) = &self.current
        {
            let before = rate(seconds(self.began, *began), done);
            let by_time = seconds(*began, now) / (step.seconds * before).max(1e-9);
            let of_step = reported.max(by_time.min(MOST_BY_TIME)) * step.seconds;
            behind += of_step;
            of_current = step.seconds - of_step;
        }
        let to_come = of_current + expected(&self.to_come) + self.later;
        let left = rate(elapsed, behind) * to_come;
        (elapsed + left > 0.0).then(|| Outlook {
            share: elapsed / (elapsed + left),
            left: Duration::from_secs_f64(left.clamp(0.0, 1e9)),
        })
    }

    fn leave_current(&mut self) {
        if let Some(current) = self.current.take() {
            self.done.push(current.step);
        }
    }
}

/// The forecast of the run at hand, where there is one; a bar looks at it between events.
pub type SharedForecast = Arc<Mutex<Option<Forecast>>>;

/// How far the run at hand is.
pub fn outlook(forecast: &SharedForecast) -> Option<Outlook> {
    locked(forecast).as_ref()?.outlook(Instant::now())
}

/// What a mutex guards, also after a thread that held it panicked: what it says is still worth showing.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Time of the steps that every run takes.
fn expected<'a>(steps: impl IntoIterator<Item = &'a ExpectedStep>) -> f64 {
    let steps = steps.into_iter().filter(|step| !step.is_optional);
    steps.map(|step| step.seconds).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PHOTOS: &str = "1_photos";
    const SHADING: &str = "5_shading";

    fn step(of: &'static str, step: &'static str, seconds: f64) -> ExpectedStep {
        ExpectedStep {
            of,
            step,
            seconds,
            is_optional: false,
        }
    }

    fn forecast(now: Instant) -> Forecast {
        Forecast::new(
            vec![
                step(PHOTOS, "reading", 10.0),
                step(SHADING, "searching", 30.0),
                step(SHADING, "light", 10.0),
                step(SHADING, "shape", 20.0),
                step(SHADING, "light", 10.0),
                step(SHADING, "shape", 20.0),
            ],
            0.0,
            now,
        )
    }

    fn left(forecast: &Forecast, now: Instant) -> f64 {
        forecast.outlook(now).unwrap().left.as_secs_f64()
    }

    #[test]
    fn a_run_as_expected_counts_down() {
        let start = Instant::now();
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        let mut forecast = forecast(start);
        assert!((left(&forecast, start) - 100.0).abs() < 1e-9);
        forecast.progress(PHOTOS, "reading", 0, 2, start);
        forecast.progress(PHOTOS, "reading", 1, 2, at(5));
        assert!((left(&forecast, at(5)) - 95.0).abs() < 1e-6);
        forecast.progress(SHADING, "searching", 0, 1, at(10));
        // A step in one go is as far as its time says.
        assert!((left(&forecast, at(25)) - 75.0).abs() < 3.0);
        forecast.progress(SHADING, "light", 0, 1, at(40));
        forecast.progress(SHADING, "shape", 0, 10, at(50));
        forecast.progress(SHADING, "shape", 10, 10, at(70));
        forecast.progress(SHADING, "light", 0, 1, at(70));
        forecast.progress(SHADING, "shape", 0, 10, at(80));
        let outlook = forecast.outlook(at(80)).unwrap();
        assert!((outlook.share - 0.8).abs() < 1e-9, "{outlook:?}");
        // A round that was not expected.
        forecast.progress(SHADING, "light", 0, 1, at(100));
        assert!((left(&forecast, at(100)) - 10.0).abs() < 1e-6);
        forecast.stage_ends(StageId::Shading);
        assert!(left(&forecast, at(110)) < 1e-9);
    }

    #[test]
    fn a_slower_run_takes_longer_in_all_its_steps() {
        let start = Instant::now();
        let mut forecast = forecast(start);
        forecast.progress(PHOTOS, "reading", 0, 2, start);
        let end = start + Duration::from_secs(30);
        forecast.progress(SHADING, "searching", 0, 1, end);
        // Ten seconds took thirty; the expectation has more than half of the vote.
        let left = left(&forecast, end);
        assert!((150.0..=200.0).contains(&left), "{left}");
    }

    #[test]
    fn what_is_kept_or_left_out_costs_nothing() {
        let start = Instant::now();
        let mut forecast = forecast(start);
        forecast.stage_ends(StageId::Photos);
        assert!((left(&forecast, start) - 90.0).abs() < 1e-9);
        forecast.to_come.push_front(ExpectedStep {
            is_optional: true,
            ..step(SHADING, "guessing", 50.0)
        });
        assert!((left(&forecast, start) - 90.0).abs() < 1e-9);
        let mut other = forecast.clone();
        other.progress(SHADING, "guessing", 0, 1, start);
        assert!((left(&other, start) - 140.0).abs() < 1e-9);
        // Resumed at its last round.
        forecast.progress(SHADING, "light", 0, 1, start);
        assert!((left(&forecast, start) - 60.0).abs() < 1e-9);
        forecast.progress(SHADING, "unknown", 1, 2, start);
        assert!((left(&forecast, start) - 60.0).abs() < 1e-9);
        let later = start + Duration::from_secs(10);
        forecast.replace(vec![step(SHADING, "shape", 5.0)], 0.0);
        assert!((left(&forecast, later) - 5.0).abs() < 1e-6);
    }

    #[test]
    fn threads_that_report_out_of_order_begin_nothing_anew() {
        let start = Instant::now();
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        let mut forecast = Forecast::new(
            vec![
                step(PHOTOS, "reading", 10.0),
                step(SHADING, "shape", 20.0),
                step(SHADING, "light", 10.0),
                step(SHADING, "shape", 20.0),
            ],
            40.0,
            start,
        );
        for done in [1, 3, 2, 4] {
            forecast.progress(PHOTOS, "reading", done, 4, at(10));
        }
        assert!((left(&forecast, at(10)) - 90.0).abs() < 1e-6);
        for done in [1, 4, 3, 10, 9] {
            forecast.progress(SHADING, "shape", done, 10, at(30));
        }
        assert!((left(&forecast, at(30)) - 70.0).abs() < 1e-6);
        // The next round.
        forecast.progress(SHADING, "shape", 0, 10, at(40));
        assert!((left(&forecast, at(40)) - 60.0).abs() < 20.0);
        assert_eq!(forecast.to_come.len(), 0);
        forecast.replace(vec![step(SHADING, "shape", 5.0)], 0.0);
        assert_eq!(forecast.to_come.len(), 1);
    }
}
