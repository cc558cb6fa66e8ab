//! Messages between ranks, by MPI.

use super::group::{Frame, Wire};
use mpi::Threading;
use mpi::collective::CommunicatorCollectives;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::{Communicator, SimpleCommunicator};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Bytes that all ranks together exchange in one call of MPI, whose counts are 32-bit numbers.
const AT_ONCE: usize = 1 << 30;
/// Waiting ranks look for news this often: what other ranks on the same cores compute goes before.
const FIRST_PAUSE: Duration = Duration::from_micros(20);
const LONGEST_PAUSE: Duration = Duration::from_millis(2);

/// All processes that were started together.
pub struct MpiWire {
    rank: usize,
    size: usize,
    /// Taken out to end it; MPI's functions are called by one thread at a time.
    universe: Mutex<Option<Universe>>,
}

impl MpiWire {
    /// Starts MPI; `None` where it was started before.
    pub fn start() -> Option<Self> {
        let (universe, _) = mpi::initialize_with_threading(Threading::Serialized)?;
        let world = universe.world();
        Some(Self {
            rank: usize::try_from(world.rank()).unwrap_or(0),
            size: usize::try_from(world.size()).unwrap_or(1),
            universe: Mutex::new(Some(universe)),
        })
    }

    /// Name of this host.
    pub fn host() -> String {
        mpi::environment::processor_name().unwrap_or_else(|_| "an unnamed host".to_owned())
    }

    /// Everyone's kind and length of frame, once all are here; `watch` is called while some are not.
    fn meet(&self, world: &SimpleCommunicator, own: [u64; 2], watch: &dyn Fn()) -> Vec<u64> {
        let mut headers = vec![0; 2 * self.size];
        mpi::request::scope(|scope| {
            let mut request = world.immediate_all_gather_into(scope, &own[..], &mut headers[..]);
            let mut pause = FIRST_PAUSE;
            while let Err(pending) = request.test() {
                request = pending;
                watch();
                std::thread::sleep(pause);
                pause = (pause * 3 / 2).min(LONGEST_PAUSE);
            }
        });
        headers
    }
}

impl Wire for MpiWire {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn exchange(&self, own: Frame, watch: &dyn Fn()) -> Vec<Frame> {
        let _alone = self.universe.lock().unwrap_or_else(PoisonError::into_inner);
        let world = SimpleCommunicator::world();
        let header = [own.kind, own.bytes.len() as u64];
        let headers = self.meet(&world, header, watch);
        let mut frames: Vec<Frame> = headers
            .chunks_exact(2)
            .map(|header| Frame {
                kind: header[0],
                bytes: Vec::with_capacity(header[1] as usize),
            })
            .collect();
        let lengths: Vec<usize> = headers.chunks_exact(2).map(|h| h[1] as usize).collect();
        let longest = lengths.iter().copied().max().unwrap_or(0);
        let step = (AT_ONCE / self.size).max(1);
        for from in (0..longest).step_by(step) {
            let part = |length: usize| from.min(length)..(from + step).min(length);
            let counts: Vec<i32> = lengths.iter().map(|&l| part(l).len() as i32).collect();
            let mut total = 0;
            let places: Vec<i32> = counts
                .iter()
                .map(|count| {
                    let place = total;
                    total += count;
                    place
                })
                .collect();
            let mut received = vec![0_u8; total as usize];
            let mut partition = PartitionMut::new(&mut received[..], &counts[..], &places[..]);
            let sent = &own.bytes[part(own.bytes.len())];
            world.all_gather_varcount_into(sent, &mut partition);
            for ((frame, &count), &place) in frames.iter_mut().zip(&counts).zip(&places) {
                let place = place as usize;
                frame
                    .bytes
                    .extend_from_slice(&received[place..place + count as usize]);
            }
        }
        frames
    }

    fn abort(&self, code: u8) -> ! {
        SimpleCommunicator::world().abort(i32::from(code))
    }

    fn end(&self) {
        let universe = self
            .universe
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        drop(universe);
    }
}
