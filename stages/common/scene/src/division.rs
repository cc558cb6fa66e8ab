//! A step of a stage whose items are divided among processes, with its progress for the observer.

use crate::events::{Flow, Observer, StageId};
use crate::team::{TeamError, divided};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A step whose progress is reported item by item.
#[derive(Clone, Copy)]
pub struct DividedStep<'a> {
    observer: &'a dyn Observer,
    stage: StageId,
    step: &'a str,
    num_before: usize,
    /// Items of the whole step, where this is a part of it.
    num_in_all: Option<usize>,
}

impl<'a> DividedStep<'a> {
    /// A step of a stage ("detecting keypoints").
    pub fn new(observer: &'a dyn Observer, stage: StageId, step: &'a str) -> Self {
        Self {
            observer,
            stage,
            step,
            num_before: 0,
            num_in_all: None,
        }
    }

    /// The same after so many items that were done before.
    #[must_use]
    pub fn after(self, num_before: usize) -> Self {
        Self { num_before, ..self }
    }

    /// The same as a part of a step of so many items in all.
    #[must_use]
    pub fn of(self, num_in_all: usize) -> Self {
        Self {
            num_in_all: Some(num_in_all),
            ..self
        }
    }

    /// Works on the items as [`divided`] does, until the observer asks to stop. The progress that
    /// is reported is this process's, taken for that of all.
    ///
    /// # Errors
    /// As of [`divided`]; `interrupted` when the observer asked to stop.
    pub fn run<T, E>(
        self,
        num_items: usize,
        at_once: usize,
        interrupted: impl Fn() -> E + Sync,
        work: impl Fn(usize) -> Result<T, E> + Sync,
    ) -> Result<Vec<T>, E>
    where
        T: Serialize + DeserializeOwned + Send,
        E: From<TeamError> + Send,
    {
        let team = self.observer.team();
        let num_done = AtomicUsize::new(0);
        let one = |item: usize| {
            if self.observer.flow() == Flow::Stop {
                return Err(interrupted());
            }
            let result = work(item)?;
            let done = (num_done.fetch_add(1, Ordering::Relaxed) + 1) * team.size();
            match self.report(done.min(num_items), num_items) {
                Flow::Continue => Ok(result),
                Flow::Stop => Err(interrupted()),
            }
        };
        divided(team, num_items, at_once, one)
    }

    fn report(self, done: usize, num_items: usize) -> Flow {
        let num_in_all = self.num_in_all.unwrap_or(self.num_before + num_items);
        let done = (self.num_before + done, num_in_all);
        self.observer.progress(self.stage, self.step, done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::{Event, Silent};

    #[derive(Debug, PartialEq)]
    struct Stopped;

    impl From<TeamError> for Stopped {
        fn from(_: TeamError) -> Self {
            Self
        }
    }

    /// Asks to stop after the third item.
    struct Impatient(AtomicUsize);

    impl Observer for Impatient {
        fn event(&self, _event: Event) -> Flow {
            self.0.fetch_add(1, Ordering::Relaxed);
            self.flow()
        }
        fn flow(&self) -> Flow {
            match self.0.load(Ordering::Relaxed) {
                0..3 => Flow::Continue,
                _ => Flow::Stop,
            }
        }
    }

    #[test]
    fn a_step_ends_when_the_observer_asks() {
        let all = DividedStep::new(&Silent, StageId::Photos, "x");
        assert_eq!(all.run(4, 1, || Stopped, Ok), Ok(vec![0, 1, 2, 3]));
        let impatient = Impatient(AtomicUsize::new(0));
        let step = DividedStep::new(&impatient, StageId::Photos, "x");
        assert_eq!(step.run(9, 1, || Stopped, Ok), Err(Stopped));
        assert!(impatient.0.load(Ordering::Relaxed) < 9);
    }
}
