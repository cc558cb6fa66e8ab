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
const TRUST: f64 = 0.05;

/// Most of a step that counts as done by time alone, where it does not tell how far it is.
const MOST_BY_TIME: f64 = 0.95;

/// A step of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Name of the stage, or of the command where it belongs to none.
    pub of: &'static str,
    /// The step, as its progress names it.
    pub step: &'static str,
    /// Time that it is expected to take, seconds.
    pub seconds: f64,
    /// The later step that it replaces where it comes, which is not expected; `None` where it is.
    pub instead_of: Option<&'static str>,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Share of the run's time that is behind, 0 to 1.
    pub share: f64,
    /// Time that is left.
    pub left: Duration,
}

/// The step at hand.
#[derive(Clone, Debug)]
struct Current {
    part: Part,
    began: Instant,
    /// Share of it that was told to be done.
    told: f64,
}

/// The steps of a run, those behind and those to come.
#[derive(Clone, Debug)]
pub struct Course {
    began: Instant,
    /// Time that was expected of the whole at the start, seconds.
    expected: f64,
    done: Vec<Part>,
    current: Option<Current>,
    to_come: VecDeque<Part>,
}

impl Course {
    /// A run that begins now.
    pub fn new(parts: Vec<Part>, now: Instant) -> Self {
        Self {
            began: now,
            expected: expected(&parts),
            done: Vec::new(),
            current: None,
            to_come: parts.into(),
        }
    }

    /// Puts better known steps in the place of those to come.
    pub fn replace(&mut self, parts: Vec<Part>) {
        self.leave_current();
        self.to_come = parts.into();
    }

    /// A step tells how far it is.
    pub fn progress(&mut self, of: &str, step: &str, done: usize, total: usize, now: Instant) {
        let is = |part: &Part| part.of == of && part.step == step;
        let told = done as f64 / total.max(1) as f64;
        // The same step comes again where its count starts over.
        if let Some(current) = &mut self.current
            && is(&current.part)
            && told >= current.told
        {
            current.told = told;
            return;
        }
        let mut to_come = self.to_come.iter();
        let next = if let Some(at) = to_come.position(is) {
            self.to_come.drain(..=at).next_back()
        } else {
            // One round more than expected.
            self.done.iter().rfind(|part| is(part)).cloned()
        };
        if let Some(part) = next {
            self.leave_current();
            if let Some(replaced) = part.instead_of {
                self.to_come.retain(|part| part.step != replaced);
            }
            self.current = Some(Current {
                part,
                began: now,
                told,
            });
        }
    }

    /// A stage is done, or was kept.
    pub fn stage_ends(&mut self, stage: StageId) {
        let is = |part: &Part| part.of == stage.name();
        if self
            .current
            .as_ref()
            .is_some_and(|current| is(&current.part))
        {
            self.leave_current();
        }
        // Of a run whose first stages come twice, those of the first time.
        while self.to_come.front().is_some_and(is) {
            self.to_come.pop_front();
        }
    }

    /// How far the run is; `None` before it has anything to do.
    pub fn standing(&self, now: Instant) -> Option<Standing> {
        let seconds = |from: Instant, to: Instant| (to - from).as_secs_f64();
        let elapsed = seconds(self.began, now);
        let trusted = TRUST * self.expected;
        let rate = |elapsed: f64, behind: f64| (elapsed + trusted) / (behind + trusted).max(1e-9);
        let done: f64 = self.done.iter().map(|part| part.seconds).sum();
        let (mut behind, mut of_current) = (done, 0.0);
        if let Some(Current { part, began, told }) = &self.current {
            let before = rate(seconds(self.began, *began), done);
            let by_time = seconds(*began, now) / (part.seconds * before).max(1e-9);
            let of_part = told.max(by_time.min(MOST_BY_TIME)) * part.seconds;
            behind += of_part;
            of_current = part.seconds - of_part;
        }
        let to_come = of_current + expected(&self.to_come);
        let left = rate(elapsed, behind) * to_come;
        (elapsed + left > 0.0).then(|| Standing {
            share: elapsed / (elapsed + left),
            left: Duration::from_secs_f64(left.clamp(0.0, 1e9)),
        })
    }

    fn leave_current(&mut self) {
        if let Some(current) = self.current.take() {
            self.done.push(current.part);
        }
    }
}

/// The course of the run at hand, where it is known; a bar looks at it between events.
pub type SharedCourse = Arc<Mutex<Option<Course>>>;

/// How far the run is.
pub fn standing(course: &SharedCourse) -> Option<Standing> {
    locked(course).as_ref()?.standing(Instant::now())
}

/// What a mutex guards, also after a thread that held it panicked: what it says is still worth showing.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Time of the steps that are expected.
fn expected<'a>(parts: impl IntoIterator<Item = &'a Part>) -> f64 {
    let parts = parts.into_iter();
    let expected = parts.filter(|part| part.instead_of.is_none());
    expected.map(|part| part.seconds).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PHOTOS: &str = "1_photos";
    const SHADING: &str = "5_shading";

    fn part(of: &'static str, step: &'static str, seconds: f64) -> Part {
        Part {
            of,
            step,
            seconds,
            instead_of: None,
        }
    }

    fn course(now: Instant) -> Course {
        Course::new(
            vec![
                part(PHOTOS, "reading", 10.0),
                part(SHADING, "searching", 30.0),
                part(SHADING, "light", 10.0),
                part(SHADING, "shape", 20.0),
                part(SHADING, "light", 10.0),
                part(SHADING, "shape", 20.0),
            ],
            now,
        )
    }

    fn left(course: &Course, now: Instant) -> f64 {
        course.standing(now).unwrap().left.as_secs_f64()
    }

    #[test]
    fn a_run_as_expected_counts_down() {
        let start = Instant::now();
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        let mut course = course(start);
        assert!((left(&course, start) - 100.0).abs() < 1e-9);
        course.progress(PHOTOS, "reading", 0, 2, start);
        course.progress(PHOTOS, "reading", 1, 2, at(5));
        assert!((left(&course, at(5)) - 95.0).abs() < 1e-6);
        course.progress(SHADING, "searching", 0, 1, at(10));
        // A step in one go is as far as its time says.
        assert!((left(&course, at(25)) - 75.0).abs() < 3.0);
        course.progress(SHADING, "light", 0, 1, at(40));
        course.progress(SHADING, "shape", 0, 10, at(50));
        course.progress(SHADING, "shape", 10, 10, at(70));
        course.progress(SHADING, "light", 0, 1, at(70));
        course.progress(SHADING, "shape", 0, 10, at(80));
        let standing = course.standing(at(80)).unwrap();
        assert!((standing.share - 0.8).abs() < 1e-9, "{standing:?}");
        // A round that was not expected.
        course.progress(SHADING, "light", 0, 1, at(100));
        assert!((left(&course, at(100)) - 10.0).abs() < 1e-6);
        course.stage_ends(StageId::Shading);
        assert!(left(&course, at(110)) < 1e-9);
    }

    #[test]
    fn a_slower_run_takes_longer_in_all_its_steps() {
        let start = Instant::now();
        let mut course = course(start);
        course.progress(PHOTOS, "reading", 0, 2, start);
        let end = start + Duration::from_secs(30);
        course.progress(SHADING, "searching", 0, 1, end);
        // Ten seconds took thirty; the expectation has a third of a vote.
        let left = left(&course, end);
        assert!((200.0..=270.0).contains(&left), "{left}");
    }

    #[test]
    fn what_is_kept_or_left_out_costs_nothing() {
        let start = Instant::now();
        let mut course = course(start);
        course.stage_ends(StageId::Photos);
        assert!((left(&course, start) - 90.0).abs() < 1e-9);
        course.to_come.push_front(Part {
            instead_of: Some("searching"),
            ..part(SHADING, "guessing", 50.0)
        });
        assert!((left(&course, start) - 90.0).abs() < 1e-9);
        let mut other = course.clone();
        other.progress(SHADING, "guessing", 0, 1, start);
        assert!((left(&other, start) - 110.0).abs() < 1e-9);
        // Resumed at its last round.
        course.progress(SHADING, "light", 0, 1, start);
        assert!((left(&course, start) - 60.0).abs() < 1e-9);
        course.progress(SHADING, "unknown", 1, 2, start);
        assert!((left(&course, start) - 60.0).abs() < 1e-9);
        let later = start + Duration::from_secs(10);
        course.replace(vec![part(SHADING, "shape", 5.0)]);
        assert!((left(&course, later) - 5.0).abs() < 1e-6);
    }
}
