//! Several processes on one run, started by a launcher of MPI (`mpirun`, `srun`) as its ranks.
//!
//! Every rank runs the same command; `rilievo_scene::team` says what they divide. Rank 0 owns the run directory and the
//! terminal: it alone takes the lock, commits stages, writes reports and prints. The other ranks write what they make
//! of their own items into the work folder of the stage at hand, which lies on shared storage.
//!
//! A rank that fails comes to the others' next gathering with its failure ([`agree`]): all end with
//! it, and rank 0 reports it. Where the others are busy for longer than `parting::PATIENCE`, it
//! reports the failure itself and has MPI end them. A rank that is killed is noticed by the
//! launcher, which ends the others.
//!
//! Without the feature `mpi` there is one process, and a start as one of several is refused.

mod launcher;

#[cfg(feature = "mpi")]
mod group;
#[cfg(feature = "mpi")]
mod mpi_wire;
#[cfg(feature = "mpi")]
mod parting;
#[cfg(feature = "mpi")]
mod processors;
#[cfg(feature = "mpi")]
mod together;
#[cfg(feature = "mpi")]
pub use together::{agree, end, join, name, on_this_host, team, threads};

#[cfg(not(feature = "mpi"))]
mod alone;
#[cfg(not(feature = "mpi"))]
pub use alone::{agree, end, join, name, on_this_host, team, threads};
