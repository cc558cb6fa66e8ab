//! The program inside another one: its commands without a terminal, with data in memory where that
//! makes sense.
//!
//! Nothing here touches what belongs to the process: signals are the caller's to answer, and
//! nothing is written to stdout. A caller asks a command to stop by the [`Stop`] that it gives it,
//! and takes what there is to show by a function ([`News`]). Every command has threads of its own,
//! which end with it. A panic is a failure like others.

mod arguments;
mod failure;
mod host;
mod poses;
mod results;
mod shade;

pub use crate::commands::ViewParts;
pub use failure::CommandFailure;
pub use host::{News, NewsSink, Stop, decode_raw, decode_raw_with};
pub use poses::{pose_of_rows, pose_rows};
pub use results::RunResults;
pub use rilievo_scene::{
    DecodedPhoto, DepthMap, Distortion, ExifFacts, Intrinsics, Lighting, LinearImage, Mask,
    NormalMap, PointCloud, PosedView, Raster, RigidTransform, Samples, SphericalHarmonics,
};
pub use rilievo_shading::paper::SolvedView;
pub use shade::{ShadeRequest, shade};

use crate::cli::Command;
use crate::commands;
use arguments::parsed;
use host::{console, guarded, in_own_threads};
use std::ffi::OsString;

/// Runs `rilievo reconstruct` or `rilievo synth` with the arguments of its command line, the
/// command's name first.
///
/// # Errors
/// As the command line fails, with its exit code.
pub fn run_command(
    arguments: &[OsString],
    stop: &Stop,
    news: NewsSink,
) -> Result<(), CommandFailure> {
    guarded(|| {
        let command = parsed(arguments)?;
        in_own_threads(command.threads(), || {
            Ok(commands::dispatch_to(&command, &console(stop, news))?)
        })
    })
}

/// `rilievo evaluate` with the arguments of its command line, as JSON; the run's report shows it
/// too.
///
/// # Errors
/// As the command line fails, with its exit code.
pub fn evaluate(
    arguments: &[OsString],
    stop: &Stop,
    news: NewsSink,
) -> Result<serde_json::Value, CommandFailure> {
    guarded(|| {
        let Command::Evaluate(args) = parsed(arguments)? else {
            return Err(CommandFailure::usage("this is not `evaluate`"));
        };
        let Some(truth) = &args.truth else {
            return Err(CommandFailure::usage("there is no truth"));
        };
        let console = console(stop, news);
        in_own_threads(None, || {
            let note = |line: &str| console.note(line);
            let found = commands::evaluation(&args.run, truth, args.align, &note)?;
            Ok(serde_json::to_value(&found).map_err(anyhow::Error::from)?)
        })
    })
}
