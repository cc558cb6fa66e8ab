//! Processes that share the work of one run, and work that is divided among them.
//!
//! All processes of a team run the same program on the same input and hold the same state; only
//! work on many items (photos, pairs, views, tiles) is divided, and everyone gets all its results.
//! So what is found does not depend on their number, and what is not divided is merely done by each
//! of them.
//!
//! Who fails returns its error and comes to no further [`gather`](Team::gather); whoever runs the
//! processes lets the others know, whose gathering then ends with a [`TeamError`]. An error of
//! divided work therefore ends the run: what a stage can go on without is no error, but a result.

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What ended the work of a team.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("rank {rank} on {host}: {reason}")]
pub struct TeamError {
    /// The process.
    pub rank: usize,
    /// The machine that it runs on.
    pub host: String,
    /// What happened there.
    pub reason: String,
}

/// The processes of a run, as one of them sees them.
pub trait Team: Sync + Debug {
    /// Number of this process, from 0; the first one owns the results.
    fn rank(&self) -> usize;

    /// How many there are.
    fn size(&self) -> usize;

    /// Waits for all, and hands everyone's bytes to everyone, in the order of ranks. All of the
    /// team call it equally often, each from one thread at a time.
    ///
    /// # Errors
    /// When one of them failed.
    fn gather(&self, own: Vec<u8>) -> Result<Vec<Vec<u8>>, TeamError>;

    /// Notes which item of divided work failed here: where several processes fail, the lowest item
    /// decides which error the run ends with.
    fn failed_at(&self, _item: usize) {}

    /// Whether this process owns the results: the only one of a run that is not divided.
    fn is_first(&self) -> bool {
        self.rank() == 0
    }
}

/// A process of its own.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Team for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn gather(&self, own: Vec<u8>) -> Result<Vec<Vec<u8>>, TeamError> {
        Ok(vec![own])
    }
}

/// The items of this process's share: every `size`-th, since neighbours cost about the same.
fn share(team: &dyn Team, num_items: usize) -> impl Iterator<Item = usize> + use<> {
    (team.rank()..num_items).step_by(team.size().max(1))
}

/// Works on the items `0..num_items`, each in one process of the team and at most `at_once` in each
/// at a time, and gives all results to all processes, in the items' order. `work` gives the same
/// wherever it runs, and warns of nothing: what an item deserves a warning for is part of its
/// result. It may be called inside no parallel work, since all processes have to come to the same
/// calls in the same order.
///
/// # Errors
/// That of the lowest item that fails; in the other processes a [`TeamError`] with its text.
pub fn divided<T, E>(
    team: &dyn Team,
    num_items: usize,
    at_once: usize,
    work: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E>
where
    T: Serialize + DeserializeOwned + Send,
    E: From<TeamError> + Send,
{
    let items: Vec<usize> = share(team, num_items).collect();
    let own = in_parallel(&items, at_once, work).map_err(|(item, error)| {
        team.failed_at(item);
        error
    })?;
    if team.size() <= 1 {
        return Ok(own);
    }
    let parts = gathered(team, &own)?.into_iter();
    drop(own);
    let mut parts: Vec<_> = parts.map(Vec::into_iter).collect();
    let in_order = (0..num_items).map(|item| {
        let rank = item % team.size();
        let next = parts.get_mut(rank).and_then(Iterator::next);
        next.ok_or_else(|| unreadable(rank, &"too few results").into())
    });
    in_order.collect()
}

/// A value of each process, in the order of ranks.
///
/// # Errors
/// When one of them failed.
pub fn gathered<T: Serialize + DeserializeOwned>(
    team: &dyn Team,
    own: &T,
) -> Result<Vec<T>, TeamError> {
    let bytes = postcard::to_stdvec(own).map_err(|error| unreadable(team.rank(), &error))?;
    let values = team.gather(bytes)?.into_iter().enumerate();
    let read = |bytes: Vec<u8>| postcard::from_bytes(&bytes);
    values
        .map(|(rank, bytes)| read(bytes).map_err(|error| unreadable(rank, &error)))
        .collect()
}

/// What the first process alone finds out, handed to all.
///
/// # Errors
/// Its error there, and a [`TeamError`] in the others.
pub fn from_first<T, E>(team: &dyn Team, find: impl FnOnce() -> Result<T, E>) -> Result<T, E>
where
    T: Serialize + DeserializeOwned,
    E: From<TeamError>,
{
    if team.size() <= 1 {
        return find();
    }
    if team.is_first() {
        let found = find()?;
        let bytes = postcard::to_stdvec(&found).map_err(|error| unreadable(0, &error))?;
        team.gather(bytes)?;
        return Ok(found);
    }
    let bytes = team.gather(Vec::new())?.into_iter().next();
    let found = postcard::from_bytes(&bytes.unwrap_or_default());
    Ok(found.map_err(|error| unreadable(0, &error))?)
}

/// Waits until all processes are here.
///
/// # Errors
/// When one of them failed.
pub fn wait_for_all(team: &dyn Team) -> Result<(), TeamError> {
    team.gather(Vec::new()).map(|_| ())
}

fn unreadable(rank: usize, why: &dyn std::fmt::Display) -> TeamError {
    TeamError {
        rank,
        host: "its host".to_owned(),
        reason: format!("sent what cannot be understood ({why})"),
    }
}

/// Results in the order of `items`, or the lowest item that fails with its error. After a failure
/// only items below it are still worked on, which may fail too.
fn in_parallel<T: Send, E: Send>(
    items: &[usize],
    at_once: usize,
    work: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, (usize, E)> {
    let lowest_failed = AtomicUsize::new(usize::MAX);
    let one = |&item: &usize| {
        if item > lowest_failed.load(Ordering::Relaxed) {
            return None;
        }
        let result = work(item);
        if result.is_err() {
            lowest_failed.fetch_min(item, Ordering::Relaxed);
        }
        Some(result)
    };
    let at_once = if at_once < rayon::current_num_threads() {
        at_once.max(1)
    } else {
        items.len().max(1)
    };
    let mut results = Vec::with_capacity(items.len());
    for some in items.chunks(at_once) {
        let done: Vec<Option<Result<T, E>>> = some.par_iter().map(one).collect();
        // In order, so that the first error is that of the lowest item; nothing before it was left
        // out.
        for (result, &item) in done.into_iter().zip(some) {
            if let Some(result) = result {
                results.push(result.map_err(|error| (item, error))?);
            }
        }
    }
    Ok(results)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Condvar, Mutex};

    /// What a process brings to a gathering.
    #[derive(Clone)]
    enum Brought {
        Bytes(Vec<u8>),
        /// It failed: at this item, for this reason.
        Failure(usize, String),
    }

    /// Where threads meet that play the processes.
    #[derive(Default)]
    struct Meeting {
        state: Mutex<(Vec<Option<Brought>>, usize)>,
        all_here: Condvar,
    }

    struct Thread<'a> {
        meeting: &'a Meeting,
        rank: usize,
        size: usize,
        failed_at: AtomicUsize,
    }

    impl Debug for Thread<'_> {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            write!(f, "thread {}", self.rank)
        }
    }

    impl Thread<'_> {
        /// Everyone's, once all are here.
        fn meet(&self, own: Brought) -> Vec<Brought> {
            let mut state = self.meeting.state.lock().unwrap();
            // Until all have gone from the last meeting.
            while state.0.get(self.rank).is_some_and(Option::is_some) {
                state = self.meeting.all_here.wait(state).unwrap();
            }
            state.0.resize(self.size, None);
            state.0[self.rank] = Some(own);
            self.meeting.all_here.notify_all();
            while state.0.iter().any(Option::is_none) {
                state = self.meeting.all_here.wait(state).unwrap();
            }
            let all = state.0.iter().flatten().cloned().collect();
            state.1 += 1;
            if state.1 == self.size {
                *state = (vec![None; self.size], 0);
                self.meeting.all_here.notify_all();
            } else {
                let left = state.1;
                while state.1 >= left {
                    state = self.meeting.all_here.wait(state).unwrap();
                }
            }
            all
        }

        fn failure(all: &[Brought]) -> Option<TeamError> {
            let failed = all
                .iter()
                .enumerate()
                .filter_map(|(rank, brought)| match brought {
                    Brought::Failure(item, reason) => Some((*item, rank, reason.clone())),
                    Brought::Bytes(_) => None,
                });
            failed.min().map(|(_, rank, reason)| TeamError {
                rank,
                host: "here".to_owned(),
                reason,
            })
        }
    }

    impl Team for Thread<'_> {
        fn rank(&self) -> usize {
            self.rank
        }
        fn size(&self) -> usize {
            self.size
        }
        fn gather(&self, own: Vec<u8>) -> Result<Vec<Vec<u8>>, TeamError> {
            let all = self.meet(Brought::Bytes(own));
            match Self::failure(&all) {
                Some(error) => Err(error),
                None => Ok(all
                    .into_iter()
                    .filter_map(|brought| match brought {
                        Brought::Bytes(bytes) => Some(bytes),
                        Brought::Failure(..) => None,
                    })
                    .collect()),
            }
        }
        fn failed_at(&self, item: usize) {
            self.failed_at.store(item, Ordering::Relaxed);
        }
    }

    /// An error of divided work, or what was told of one.
    #[derive(Debug, PartialEq)]
    enum Error {
        Own(String),
        Team(TeamError),
    }

    impl From<TeamError> for Error {
        fn from(error: TeamError) -> Self {
            Self::Team(error)
        }
    }

    /// Runs the same program in several threads; what each ends with. One that fails tells the
    /// others.
    fn ranks<R: Send>(
        size: usize,
        program: impl Fn(&dyn Team) -> Result<R, Error> + Sync,
    ) -> Vec<Result<R, TeamError>> {
        let meeting = Meeting::default();
        let (meeting, program) = (&meeting, &program);
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..size)
                .map(|rank| {
                    scope.spawn(move || {
                        let team = Thread {
                            meeting,
                            rank,
                            size,
                            failed_at: AtomicUsize::new(usize::MAX),
                        };
                        program(&team).map_err(|error| match error {
                            Error::Team(told) => told,
                            Error::Own(reason) => {
                                let item = team.failed_at.load(Ordering::Relaxed);
                                let all = team.meet(Brought::Failure(item, reason));
                                Thread::failure(&all).unwrap()
                            }
                        })
                    })
                })
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        })
    }

    #[test]
    fn everyone_gets_all_results_in_order_whatever_the_number_of_processes() {
        for size in [1, 2, 3, 5] {
            for (num_items, at_once) in [(0, 1), (1, 4), (4, 1), (23, 2), (23, 64)] {
                let told = ranks(size, |team| {
                    let squares = divided(team, num_items, at_once, |i| Ok::<_, Error>(i * i))?;
                    let texts = divided(team, num_items, at_once, |i| {
                        Ok::<_, Error>(format!("{}", squares[i]))
                    })?;
                    wait_for_all(team)?;
                    Ok(texts)
                });
                let expected: Vec<String> = (0..num_items).map(|i| format!("{}", i * i)).collect();
                assert!(told.iter().all(|found| found.as_ref() == Ok(&expected)));
            }
        }
    }

    #[test]
    fn the_lowest_item_that_fails_decides_and_nobody_is_left_waiting() {
        for size in [2, 3, 5] {
            let ended = ranks(size, |team| {
                divided(team, 20, 1, |i| match i {
                    7 | 11 | 16 => Err(Error::Own(format!("item {i}"))),
                    _ => Ok(i),
                })
            });
            for end in &ended {
                let error = end.as_ref().unwrap_err();
                assert_eq!(
                    (error.rank, error.reason.as_str()),
                    (7 % size, "item 7"),
                    "{size}"
                );
            }
        }
        let alone = divided(&Alone, 20, 1, |i| match i {
            7.. => Err(Error::Own(format!("item {i}"))),
            _ => Ok(i),
        });
        assert_eq!(alone, Err(Error::Own("item 7".to_owned())));
    }

    #[test]
    fn who_stops_between_divided_work_ends_the_others_there() {
        let ended = ranks(3, |team| {
            let first = divided(team, 9, 1, Ok::<_, Error>)?;
            if team.rank() == 2 {
                return Err(Error::Own("interrupted".to_owned()));
            }
            divided(team, first.len(), 1, Ok::<_, Error>)
        });
        for end in ended {
            let error = end.unwrap_err();
            assert_eq!((error.rank, error.reason.as_str()), (2, "interrupted"));
        }
    }

    #[test]
    fn what_the_first_finds_out_is_told_to_all() {
        let found = ranks(3, |team| {
            let rank = team.rank();
            from_first(team, || {
                assert_eq!(rank, 0);
                Ok::<_, Error>(vec![0.1_f64, f64::NAN])
            })
        });
        for found in found {
            let bits: Vec<u64> = found.unwrap().into_iter().map(f64::to_bits).collect();
            assert_eq!(bits, [0.1_f64, f64::NAN].map(f64::to_bits));
        }
        let ended = ranks(3, |team| {
            from_first(team, || Err::<u8, _>(Error::Own("no file".to_owned())))
        });
        for end in ended {
            assert_eq!(end.unwrap_err().reason, "no file");
        }
    }
}
