//! This process as one of the ranks of MPI.

use super::group::Group;
use super::launcher::Launch;
use super::mpi_wire::MpiWire;
use super::processors::{self, Place};
use crate::cli::Command;
use crate::exit::Failure;
use crate::output;
use rilievo_scene::team::gathered;
use rilievo_scene::{Alone, Team};
use std::num::NonZeroUsize;
use std::sync::OnceLock;

static GROUP: OnceLock<Group> = OnceLock::new();
static SHARE: OnceLock<Share> = OnceLock::new();

/// What this rank may take of its host.
struct Share {
    threads: NonZeroUsize,
    num_ranks: usize,
}

/// Joins the other ranks, where this process was started as one of several.
///
/// # Errors
/// When the command divides nothing, the launcher and MPI do not know each other, or the ranks are of different
/// versions.
pub fn join(command: &Command) -> anyhow::Result<()> {
    let Some(launch) = Launch::found() else {
        return Ok(());
    };
    let Launch { size, variable, .. } = launch;
    if !matches!(command, Command::Reconstruct(_) | Command::Run(_)) {
        return Err(refused(
            &launch,
            format!(
                "this is one of {size} processes ({variable}), among which only `rilievo reconstruct` and `rilievo \
                 run` divide their work: start one process without the launcher"
            ),
        ));
    }
    let Some(wire) = MpiWire::start() else {
        return Ok(());
    };
    let group = Group::new(Box::new(wire));
    if group.size() != size {
        return Err(refused(
            &launch,
            format!(
                "the launcher started {size} processes ({variable}), of which MPI sees {}: start them with the \
                 launcher of the MPI that this program is built with (`mpirun`), under Slurm with `srun --mpi=pmix` \
                 or `srun --mpi=pmi2` as far as both know it (`srun --mpi=list`)",
                group.size()
            ),
        ));
    }
    if !group.is_first() {
        output::mute();
    }
    let versions = gathered(&group, &version())?;
    let places = gathered(&group, &Place::of(MpiWire::host()))?;
    let available = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    // Set once, as the group is.
    let _ = SHARE.set(Share {
        threads: processors::threads(&places, group.rank(), available),
        num_ranks: processors::on_one_host(&places, group.rank()),
    });
    let hosts = places.into_iter().map(|place| place.host).collect();
    let group = GROUP.get_or_init(|| group.with_hosts(hosts));
    match versions.iter().position(|other| *other != versions[0]) {
        None => Ok(()),
        Some(rank) => Err(Failure::Usage(format!(
            "the ranks are of different versions: {} is {}, {} is {}; start the same program on every host",
            group.name(0),
            versions[0],
            group.name(rank),
            versions[rank],
        ))
        .into()),
    }
}

/// A refusal before the ranks know each other.
fn refused(launch: &Launch, why: String) -> anyhow::Error {
    if launch.rank > 0 {
        // The launcher ends all with the first one that ends: let that be the one that says why.
        std::thread::sleep(std::time::Duration::from_millis(500));
    }
    Failure::Usage(why).into()
}

/// What must be the same for the same results.
fn version() -> String {
    let decodes = if cfg!(feature = "raw") {
        ""
    } else {
        ", without raw"
    };
    format!("{}{decodes}", env!("RILIEVO_VERSION"))
}

/// All ranks, or this process alone.
pub fn team() -> &'static dyn Team {
    match GROUP.get() {
        Some(group) => group,
        None => &Alone,
    }
}

/// The outcome where no rank failed; else the failure of one, the same in all.
pub fn agree<T>(outcome: anyhow::Result<T>) -> anyhow::Result<T> {
    match GROUP.get() {
        Some(group) => group.agree(outcome),
        None => outcome,
    }
}

/// The last that ranks do together, before they end with an exit code; [`PANICKED`] ends all at once, since the
/// others know nothing of it.
pub fn end(code: u8) {
    match GROUP.get() {
        Some(group) if code == PANICKED => group.abort(code),
        Some(group) => group.end(code),
        None => {}
    }
}

/// Exit code of a panic.
const PANICKED: u8 = 101;

/// This rank with its host, where there are several.
pub fn name() -> Option<String> {
    let group = GROUP.get()?;
    Some(group.name(group.rank()))
}

/// Threads that this rank starts by default, where several share a host.
pub fn threads() -> Option<NonZeroUsize> {
    SHARE.get().map(|share| share.threads)
}

/// Ranks on this host, this one among them.
pub fn on_this_host() -> usize {
    SHARE.get().map_or(1, |share| share.num_ranks)
}
