//! The team of all ranks, over whatever carries their messages.
//!
//! In every exchange each rank brings a frame: bytes of a gathering, the word that its work is done, or its failure.
//! As long as nobody fails, all bring the same kind at the same place of the program. One that fails brings its
//! failure to whatever exchange the others are at, and everybody knows; after that there is no further one but the last.

use super::parting::{PATIENCE, Parting, decisive, is_common};
use crate::exit::Failure;
use crate::interrupt;
use crate::output::to_stderr_of_any_rank;
use rilievo_scene::{Team, TeamError};
use std::fmt::Debug;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What a rank brings to an exchange.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// What the bytes are.
    pub kind: u64,
    pub bytes: Vec<u8>,
}

const DATA: u64 = 0;
const DONE: u64 = 1;
const FAILED: u64 = 2;

/// Carries frames between ranks.
pub trait Wire: Send + Sync {
    /// Number of this rank.
    fn rank(&self) -> usize;
    /// Number of ranks.
    fn size(&self) -> usize;
    /// Everyone's frames, once all are here; `watch` is called while some are not, and may end the program.
    fn exchange(&self, own: Frame, watch: &dyn Fn()) -> Vec<Frame>;
    /// Ends all ranks at once.
    fn abort(&self, code: u8) -> !;
    /// The last that all ranks do together.
    fn end(&self);
}

/// All ranks.
pub struct Group {
    wire: Box<dyn Wire>,
    hosts: Vec<String>,
    /// The lowest item of divided work that failed here; `usize::MAX` for none.
    failed_at: AtomicUsize,
    /// Since when this rank knows that it is to stop.
    interrupted: Mutex<Option<Instant>>,
    /// Failures of all ranks, once one has failed.
    ended: Mutex<Option<Vec<Option<Parting>>>>,
}

impl Debug for Group {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.name(self.rank()))
    }
}

impl Group {
    /// The ranks on a wire; `hosts` are set once they are known.
    pub fn new(wire: Box<dyn Wire>) -> Self {
        Self {
            wire,
            hosts: Vec::new(),
            failed_at: AtomicUsize::new(usize::MAX),
            interrupted: Mutex::new(None),
            ended: Mutex::new(None),
        }
    }

    /// The same, with the hosts of all ranks.
    #[must_use]
    pub fn with_hosts(self, hosts: Vec<String>) -> Self {
        Self { hosts, ..self }
    }

    /// A rank with its host.
    pub fn name(&self, rank: usize) -> String {
        match self.hosts.get(rank) {
            Some(host) => format!("rank {rank} on {host}"),
            None => format!("rank {rank}"),
        }
    }

    fn host(&self, rank: usize) -> String {
        self.hosts.get(rank).cloned().unwrap_or_default()
    }

    /// Exchanges frames; failures among them end the team.
    fn exchange(&self, own: Frame, watch: &dyn Fn()) -> Result<Vec<Frame>, TeamError> {
        if let Some(error) = self.ended() {
            return Err(error);
        }
        let frames = self.wire.exchange(own, watch);
        if frames.iter().all(|frame| frame.kind != FAILED) {
            return Ok(frames);
        }
        let parting = |frame: &Frame| {
            let found =
                || postcard::from_bytes(&frame.bytes).unwrap_or_else(|_| Parting::unknown());
            (frame.kind == FAILED).then(found)
        };
        let partings = frames.iter().map(parting).collect();
        *self.ended.lock().unwrap_or_else(PoisonError::into_inner) = Some(partings);
        match self.ended() {
            Some(error) => Err(error),
            None => Ok(frames),
        }
    }

    /// The failure that ended the team, where one has.
    fn ended(&self) -> Option<TeamError> {
        let ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        let (rank, parting) = decisive(ended.as_deref()?)?;
        Some(TeamError {
            rank,
            host: self.host(rank),
            reason: parting.text.clone(),
        })
    }

    /// The failure that ended the team as an error of this program.
    fn failure(&self) -> Option<anyhow::Error> {
        let ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        let partings = ended.as_deref()?;
        let (rank, parting) = decisive(partings)?;
        let place = (!is_common(partings)).then(|| self.name(rank));
        Some(parting.clone().into_error(place.as_deref()))
    }

    /// The outcome where it is one of all ranks; else the failure of one, the same in all.
    pub fn agree<T>(&self, outcome: anyhow::Result<T>) -> anyhow::Result<T> {
        if let Some(failure) = self.failure() {
            return Err(failure);
        }
        let own = outcome.as_ref().err().map(|error| {
            let item = self.failed_at.load(Ordering::Relaxed);
            Parting::of(error, (item != usize::MAX).then_some(item))
        });
        let frame = match &own {
            None => Frame {
                kind: DONE,
                bytes: Vec::new(),
            },
            Some(parting) => Frame {
                kind: FAILED,
                bytes: postcard::to_stdvec(parting).unwrap_or_default(),
            },
        };
        let began = Instant::now();
        let watch = || match &own {
            Some(parting) if began.elapsed() > PATIENCE => self.end_all(parting.clone()),
            Some(_) => {}
            None => self.watch_for_interruption(),
        };
        match self.exchange(frame, &watch) {
            Err(error) => Err(self.failure().unwrap_or_else(|| error.into())),
            Ok(frames) => match frames.iter().position(|frame| frame.kind != DONE) {
                None => outcome,
                Some(rank) => Err(anyhow::anyhow!(
                    "{} still works where {} is done: the ranks went different ways, which is a defect",
                    self.name(rank),
                    self.name(self.rank()),
                )),
            },
        }
    }

    /// Where this rank was asked to stop while it waits: all are ended, unless they come soon. They may know nothing of
    /// it.
    fn watch_for_interruption(&self) {
        if !interrupt::requested() {
            return;
        }
        let mut since = self
            .interrupted
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if since.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
            self.end_all(Parting::of(&Failure::Interrupted.into(), None));
        }
    }

    /// Reports a failure of this rank, and ends all.
    fn end_all(&self, parting: Parting) {
        let (code, place) = (parting.code, self.name(self.rank()));
        let error = parting.into_error(Some(&place));
        to_stderr_of_any_rank(format_args!("error: {error}"));
        self.wire.abort(code)
    }

    /// Waits for all ranks, so that none is missed before rank 0 has reported how the run ended,
    /// and ends the team.
    pub fn end(&self, code: u8) {
        let own = Frame {
            kind: DONE,
            bytes: Vec::new(),
        };
        let began = Instant::now();
        let watch = || {
            if began.elapsed() > LAST_PATIENCE {
                self.wire.abort(code);
            }
        };
        self.wire.exchange(own, &watch);
        self.wire.end();
    }

    /// Ends all ranks at once.
    pub fn abort(&self, code: u8) -> ! {
        self.wire.abort(code)
    }
}

/// How long ranks wait for the first one to write its report after a failure.
const LAST_PATIENCE: Duration = Duration::from_secs(60);

impl Team for Group {
    fn rank(&self) -> usize {
        self.wire.rank()
    }

    fn size(&self) -> usize {
        self.wire.size()
    }

    fn gather(&self, own: Vec<u8>) -> Result<Vec<Vec<u8>>, TeamError> {
        let own = Frame {
            kind: DATA,
            bytes: own,
        };
        let frames = self.exchange(own, &|| self.watch_for_interruption())?;
        match frames.iter().position(|frame| frame.kind != DATA) {
            None => Ok(frames.into_iter().map(|frame| frame.bytes).collect()),
            Some(rank) => Err(TeamError {
                rank,
                host: self.host(rank),
                reason: format!(
                    "is done where rank {} still works: the ranks went different ways, which is a defect",
                    self.rank()
                ),
            }),
        }
    }

    fn failed_at(&self, item: usize) {
        self.failed_at.fetch_min(item, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::code_of;
    use std::sync::{Arc, Barrier};

    /// Carries frames between threads.
    struct ThreadWire {
        rank: usize,
        frames: Arc<Mutex<Vec<Frame>>>,
        all: Arc<Barrier>,
    }

    impl Wire for ThreadWire {
        fn rank(&self) -> usize {
            self.rank
        }
        fn size(&self) -> usize {
            self.frames.lock().unwrap().len()
        }
        fn exchange(&self, own: Frame, _watch: &dyn Fn()) -> Vec<Frame> {
            self.frames.lock().unwrap()[self.rank] = own;
            self.all.wait();
            let frames = self.frames.lock().unwrap().clone();
            self.all.wait();
            frames
        }
        fn abort(&self, code: u8) -> ! {
            panic!("aborted with {code}")
        }
        fn end(&self) {}
    }

    /// Runs a command on three ranks; how it ends for each.
    fn on_three(
        command: impl Fn(&Group) -> anyhow::Result<usize> + Sync,
    ) -> Vec<anyhow::Result<usize>> {
        let empty = Frame {
            kind: DATA,
            bytes: Vec::new(),
        };
        let frames = Arc::new(Mutex::new(vec![empty; 3]));
        let all = Arc::new(Barrier::new(3));
        let command = &command;
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..3)
                .map(|rank| {
                    let (frames, all) = (Arc::clone(&frames), Arc::clone(&all));
                    let wire = ThreadWire { rank, frames, all };
                    let group = Group::new(Box::new(wire)).with_hosts(vec!["node".to_owned(); 3]);
                    scope.spawn(move || {
                        let outcome = group.agree(command(&group));
                        // Once it has ended, it stays so.
                        let again = group.agree(Ok(0)).map_err(|error| code_of(&error));
                        let first = outcome.as_ref().map(|_| 0).map_err(code_of);
                        assert_eq!(again, first);
                        group.end(0);
                        outcome
                    })
                })
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        })
    }

    #[test]
    fn a_failure_on_one_rank_ends_all_with_its_code_and_its_place() {
        let ended = on_three(|group| {
            group.gather(vec![group.rank() as u8])?;
            if group.rank() == 1 {
                return Err(Failure::ReadOrWrite("disk full".to_owned()).into());
            }
            // The others learn of it here.
            Ok(group.gather(Vec::new())?.len())
        });
        for end in ended {
            let error = end.unwrap_err();
            assert_eq!(code_of(&error), 6);
            assert_eq!(error.to_string(), "rank 1 on node: disk full");
        }
    }

    #[test]
    fn what_all_fail_with_names_no_rank_and_what_none_fails_with_is_done() {
        let ended = on_three(|_| Err(Failure::NoResult("no light".to_owned()).into()));
        for end in ended {
            assert_eq!(end.unwrap_err().to_string(), "no light");
        }
        let done = on_three(|group| {
            let all = group.gather(vec![7; group.rank()])?;
            Ok(all.iter().map(Vec::len).sum())
        });
        assert!(done.into_iter().all(|sum| sum.unwrap() == 3));
    }

    #[test]
    fn ranks_that_go_different_ways_are_a_defect_and_no_hang() {
        let ended = on_three(|group| match group.rank() {
            0 => Ok(0),
            _ => Ok(group.gather(Vec::new())?.len()),
        });
        for end in ended {
            assert!(end.unwrap_err().to_string().contains("different ways"));
        }
    }
}
