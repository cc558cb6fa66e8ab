//! What a run costs: expected and measured.

use serde::{Deserialize, Serialize};

/// What a run is expected to cost, or did cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// CPU time of all threads, seconds.
    pub cpu_seconds: f64,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: f64,
    /// Size of the finished run directory, bytes.
    pub disk_bytes: f64,
}

/// What a run is expected to cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// With all steps that some photos need.
    #[serde(flatten)]
    pub cost: Cost,
    /// CPU time without the finer search of photos whose brightness disagrees, and without relief at pixels that hold no
    /// more detail than coarser ones, seconds.
    pub least_cpu_seconds: f64,
    /// Disk space that is used besides while the run goes on, bytes.
    pub working_disk_bytes: f64,
}
