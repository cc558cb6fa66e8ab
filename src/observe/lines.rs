//! Plain lines on stderr, for logs and pipes: rare enough to read.

use super::display::{Display, StageNews};
use super::forecast::Outlook;
use super::pace::{Pace, in_words};
use rilievo_scene::{Event, StageId};
use std::time::Duration;

/// A line at most this often within one step.
const INTERVAL: Duration = Duration::from_secs(5);

/// Prints one line per noteworthy event.
#[derive(Default)]
pub struct Lines {
    pace: Option<Pace>,
}

impl Lines {
    /// The pace of a step, which is new where another one was at hand.
    fn pace(&mut self, step: &str, done: usize) -> &mut Pace {
        self.pace = self.pace.take().filter(|pace| pace.is_of(step));
        self.pace.get_or_insert_with(|| Pace::new(step, done))
    }
}

impl Display for Lines {
    fn stage(&mut self, stage: StageId, news: &StageNews) {
        self.pace = None;
        match news {
            StageNews::Started(reason) => tell!("{stage}: {reason}"),
            StageNews::Reused => tell!("{stage}: kept, nothing changed"),
            StageNews::Finished(seconds) => tell!("{stage}: done in {seconds:.1} s"),
        }
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
                if self.pace("iterating", *iteration).due(INTERVAL) {
                    tell!(
                        "{stage}: iteration {} of at most {max_num_iterations}, energy {energy:.4e}",
                        iteration + 1
                    );
                }
            }
            Event::Warning { stage, message } => tell!("{stage}: warning: {message}"),
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
        let pace = self.pace(step, done);
        if pace.due(INTERVAL) || done == total {
            let left = match outlook {
                Some(Outlook { share, left }) => format!(
                    " ({:.0} % of the run, about {} left)",
                    100.0 * share,
                    in_words(Duration::from_secs(left.as_secs()))
                ),
                None => {
                    let left = pace.left(done, total).filter(|_| done < total);
                    left.map_or(String::new(), |d| format!(", {} left", in_words(d)))
                }
            };
            match (done, total) {
                // A step in one go has nothing to count.
                (0, 1) => tell!("{of}: {step}{left}"),
                _ => tell!("{of}: {step} {done}/{total}{left}"),
            }
        }
    }

    fn note(&mut self, message: &str) {
        tell!("{message}");
    }
}
