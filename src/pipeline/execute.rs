//! Bringing stages up to date, in order: load what a stage reads, run it, commit what it makes.

use super::context::Context;
use super::plan::{Plan, StageState, upstream};
use super::{features, fusion, lighting, photos, poses, shading};
use crate::exit::Failure;
use crate::interrupt;
use crate::observe::StageNews;
use crate::store::{FORMAT_VERSION, Look, Manifest, StageWriter};
use crate::system;
use rilievo_scene::StageId;
use std::time::Instant;

/// Which stages to bring up to date.
#[derive(Clone, Copy, Debug)]
pub struct Range {
    /// Redo from here on even where results are valid.
    pub redo_from: Option<StageId>,
    /// Last stage.
    pub until: StageId,
}

/// Brings stages up to date in order; tells which were redone.
///
/// # Errors
/// The first failure; stages before it stay committed.
pub fn bring_up_to_date(
    context: &Context<'_>,
    plan: &Plan,
    range: Range,
) -> anyhow::Result<Vec<StageId>> {
    let mut redone = Vec::new();
    for stage in StageId::ALL {
        if stage > range.until {
            break;
        }
        let state = plan.state(context.run, stage, Look::Contents)?;
        let forced = range.redo_from.is_some_and(|from| stage >= from);
        let reason = match state {
            StageState::Valid if !forced => {
                context.run.drop_unfinished(stage)?;
                context.console.stage(stage, &StageNews::Reused);
                continue;
            }
            StageState::Valid => "redone as asked".to_owned(),
            StageState::Missing => "starting".to_owned(),
            StageState::Damaged { reason } => format!("redoing, because it is damaged: {reason}"),
            StageState::Stale { reasons } => format!("redoing, because {}", reasons.join("; ")),
        };
        run_stage(context, plan, stage, &reason)?;
        redone.push(stage);
    }
    Ok(redone)
}

/// Runs one stage and commits its result.
///
/// # Errors
/// When the stage fails; its earlier result is then untouched.
pub fn run_stage(
    context: &Context<'_>,
    plan: &Plan,
    stage: StageId,
    reason: &str,
) -> anyhow::Result<()> {
    if interrupt::requested() {
        return Err(Failure::Interrupted.into());
    }
    context
        .console
        .stage(stage, &StageNews::Started(reason.to_owned()));
    for &of in upstream(stage) {
        if let StageState::Damaged { reason } = plan.state(context.run, of, Look::Contents)? {
            return Err(Failure::RunDirectory(format!(
                "stage {stage} reads {of}, which is damaged: {reason}; `rilievo reconstruct` makes \
                 it again"
            ))
            .into());
        }
    }
    let began = Instant::now();
    system::forget_peak_memory();
    let writer = context.run.begin(stage)?;
    let report = dispatch(context, plan, stage, &writer)?;
    if interrupt::requested() {
        return Err(Failure::Interrupted.into());
    }
    let ingredients = plan.of(stage).clone();
    let seconds = began.elapsed().as_secs_f64();
    let manifest = Manifest {
        format_version: FORMAT_VERSION,
        program: system::PROGRAM.to_owned(),
        fingerprint: ingredients.fingerprint(),
        ingredients,
        items: Default::default(),
        seconds,
        threads: rayon::current_num_threads(),
        peak_memory_bytes: system::peak_memory(),
        warnings: context.console.take_warnings(stage),
        files: Default::default(),
        report,
    };
    writer.commit(manifest)?;
    context.console.stage(stage, &StageNews::Finished(seconds));
    Ok(())
}

/// Loads, runs and saves one stage; returns its report.
fn dispatch(
    context: &Context<'_>,
    plan: &Plan,
    stage: StageId,
    writer: &StageWriter,
) -> anyhow::Result<serde_json::Value> {
    match stage {
        StageId::Photos => photos::run(context, writer),
        StageId::Features => features::run(context, writer),
        StageId::Poses => poses::run(context, writer),
        StageId::Lighting => lighting::run(context, writer),
        StageId::Shading => shading::run(context, &plan.of(stage).fingerprint(), writer),
        StageId::Fusion => fusion::run(context, writer),
    }
}
