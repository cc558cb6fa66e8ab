//! How long a step will still take, from the rate that was measured.

use std::time::{Duration, Instant};

/// Progress of one step since it began.
#[derive(Clone, Debug)]
pub struct Pace {
    step: String,
    began: Instant,
    /// Items that were done when it began: they say nothing of the rate.
    done_at_start: usize,
    shown: Option<Instant>,
}

impl Pace {
    /// A step that begins now, with so much done before.
    pub fn new(step: &str, done_at_start: usize) -> Self {
        Self {
            step: step.to_owned(),
            began: Instant::now(),
            done_at_start,
            shown: None,
        }
    }

    /// Whether this is the step's pace.
    pub fn is_of(&self, step: &str) -> bool {
        self.step == step
    }

    /// Time left when `done` of `total` are done; `None` before there is a rate.
    pub fn left(&self, done: usize, total: usize) -> Option<Duration> {
        let before = self.done_at_start;
        left(
            self.began.elapsed(),
            done.checked_sub(before)?,
            total.checked_sub(before)?,
        )
    }

    /// Whether enough time went by since the last time this said yes.
    pub fn due(&mut self, interval: Duration) -> bool {
        let due = self.shown.is_none_or(|shown| shown.elapsed() >= interval);
        if due {
            self.shown = Some(Instant::now());
        }
        due
    }
}

fn left(elapsed: Duration, done: usize, total: usize) -> Option<Duration> {
    (done > 0 && total >= done).then(|| elapsed.mul_f64((total - done) as f64 / done as f64))
}

/// A duration in words, as short as is useful.
pub fn in_words(duration: Duration) -> String {
    let seconds = duration.as_secs_f64();
    if seconds < 10.0 {
        format!("{seconds:.1} s")
    } else if seconds < 120.0 {
        format!("{seconds:.0} s")
    } else if seconds < 7200.0 {
        format!("{:.0} min", seconds / 60.0)
    } else {
        format!("{:.1} h", seconds / 3600.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_follows_from_the_rate() {
        let elapsed = Duration::from_secs(10);
        assert_eq!(left(elapsed, 5, 20), Some(Duration::from_secs(30)));
        assert_eq!(left(elapsed, 20, 20), Some(Duration::ZERO));
        assert_eq!(left(elapsed, 0, 20), None);
        assert_eq!(in_words(Duration::from_secs(90)), "90 s");
        assert_eq!(in_words(Duration::from_secs(600)), "10 min");
    }
}
