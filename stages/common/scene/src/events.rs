//! Typed events that stages emit; the program renders them as bars, lines or JSON.

use crate::team::{Alone, Team};
use serde::{Deserialize, Serialize};
use std::sync::{Mutex, PoisonError};

/// The six stages, in the order in which data flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StageId {
    /// `1_photos`
    #[serde(rename = "1_photos")]
    Photos,
    /// `2_features`
    #[serde(rename = "2_features")]
    Features,
    /// `3_poses`
    #[serde(rename = "3_poses")]
    Poses,
    /// `4_lighting`
    #[serde(rename = "4_lighting")]
    Lighting,
    /// `5_shading`
    #[serde(rename = "5_shading")]
    Shading,
    /// `6_fusion`
    #[serde(rename = "6_fusion")]
    Fusion,
}

impl StageId {
    /// All stages in order.
    pub const ALL: [Self; 6] = [
        Self::Photos,
        Self::Features,
        Self::Poses,
        Self::Lighting,
        Self::Shading,
        Self::Fusion,
    ];

    /// Name, as of the folder in a run directory.
    pub fn name(self) -> &'static str {
        match self {
            Self::Photos => "1_photos",
            Self::Features => "2_features",
            Self::Poses => "3_poses",
            Self::Lighting => "4_lighting",
            Self::Shading => "5_shading",
            Self::Fusion => "6_fusion",
        }
    }
}

impl std::fmt::Display for StageId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// What a stage reports while it works.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// Part of a stage's work is done.
    Progress {
        /// The stage.
        stage: StageId,
        /// What is being done ("detecting keypoints").
        step: String,
        /// Items done.
        done: usize,
        /// Items in all.
        total: usize,
    },
    /// One iteration of a solver.
    Iteration {
        /// The stage.
        stage: StageId,
        /// Zero-based.
        iteration: usize,
        /// At most this many will follow from the start.
        max_num_iterations: usize,
        /// Energy.
        energy: f64,
        /// Primal residual, where the solver has one.
        primal_residual: Option<f64>,
        /// Dual residual, where the solver has one.
        dual_residual: Option<f64>,
        /// Penalty, where the solver has one.
        beta: Option<f64>,
    },
    /// Something the user should know; the stage goes on.
    Warning {
        /// The stage.
        stage: StageId,
        /// What, about which photo or file, and what to try.
        message: String,
    },
}

/// An observer's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Flow {
    /// Go on.
    Continue,
    /// Stop soon, leaving nothing half done.
    Stop,
}

impl Flow {
    /// The stage's `Interrupted` error where it should stop.
    ///
    /// # Errors
    /// `interrupted`, for [`Flow::Stop`].
    pub fn ok_or<E>(self, interrupted: E) -> Result<(), E> {
        match self {
            Self::Continue => Ok(()),
            Self::Stop => Err(interrupted),
        }
    }
}

/// Who a stage works for: receives events, from any thread, and knows whether to go on and who
/// shares the work.
pub trait Observer: Sync {
    /// Takes one event; [`Flow::Stop`] asks the stage to end with its `Interrupted` error.
    fn event(&self, event: Event) -> Flow;

    /// Tells that so many of all items of a step are done.
    fn progress(&self, stage: StageId, step: &str, (done, total): (usize, usize)) -> Flow {
        self.event(Event::Progress {
            stage,
            step: step.to_owned(),
            done,
            total,
        })
    }

    /// Whether the stage should stop, without an event.
    fn flow(&self) -> Flow {
        Flow::Continue
    }

    /// The processes among which a stage may divide its work.
    fn team(&self) -> &dyn Team {
        &Alone
    }

    /// Warns the user; the only way that a warning takes. Each comes once, in an order
    /// that does not depend on threads.
    fn warn(&self, stage: StageId, message: String) -> Flow {
        self.event(Event::Warning { stage, message })
    }
}

/// An observer that ignores everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {
    fn event(&self, _event: Event) -> Flow {
        Flow::Continue
    }
}

/// An observer that keeps the warnings and ignores everything else, for callers without a terminal.
#[derive(Debug, Default)]
pub struct Recorder {
    warnings: Mutex<Vec<String>>,
}

impl Recorder {
    /// The messages of all warnings so far, in their order.
    pub fn warnings(&self) -> Vec<String> {
        let warnings = self.warnings.lock();
        warnings.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Observer for Recorder {
    fn event(&self, event: Event) -> Flow {
        if let Event::Warning { message, .. } = event {
            let warnings = self.warnings.lock();
            warnings
                .unwrap_or_else(PoisonError::into_inner)
                .push(message);
        }
        Flow::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorder_keeps_each_warning_as_often_as_it_was_told_and_nothing_else() {
        let told = Recorder::default();
        let progress = Event::Progress {
            stage: StageId::Photos,
            step: "reading".to_owned(),
            done: 1,
            total: 2,
        };
        for message in ["b", "a", "b"] {
            assert_eq!(
                told.warn(StageId::Poses, message.to_owned()),
                Flow::Continue
            );
            assert_eq!(told.event(progress.clone()), Flow::Continue);
        }
        assert_eq!(told.warnings(), ["b", "a", "b"]);
    }

    #[test]
    fn only_stop_is_an_error() {
        assert_eq!(Flow::Continue.ok_or("stopped"), Ok(()));
        assert_eq!(Flow::Stop.ok_or("stopped"), Err("stopped"));
    }
}
