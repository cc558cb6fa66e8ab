//! Bringing stages up to date, in order: load what a stage reads, run it, commit what it makes.

use super::context::Context;
use super::plan::{Plan, StageState, upstream};
use super::{features, fusion, lighting, photos, poses, shading};
use crate::exit::Failure;
use crate::observe::StageNews;
use crate::store::{FORMAT_VERSION, Look, Manifest, StageWriter};
use crate::system;
use rilievo_scene::team::{from_first, gathered};
use rilievo_scene::{Observer, StageId};
use serde::Serialize;
use std::time::Instant;

/// Which stages to bring up to date.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Range {
    /// Redo from here on even where results are valid.
    pub redo_from: Option<StageId>,
    /// Last stage.
    pub until: StageId,
    /// Results of other photos may be replaced.
    pub overwrite: bool,
    /// Last stage of the whole run, where it goes on after these with masks that follow from them.
    /// Only for how long it will take.
    pub then_masked_until: Option<StageId>,
}

impl Range {
    /// All stages up to one, where they are not valid.
    pub fn until(until: StageId) -> Self {
        Self {
            redo_from: None,
            until,
            overwrite: false,
            then_masked_until: None,
        }
    }
}

/// Brings stages up to date in order; returns those that were redone.
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
        let forced = range.redo_from.is_some_and(|from| stage >= from);
        let reason = from_first(context.console.team(), || {
            reason_to_run(context, plan, stage, forced)
        })?;
        let Some(reason) = reason else {
            context.console.stage(stage, &StageNews::Reused);
            continue;
        };
        run_stage(context, plan, stage, &reason)?;
        redone.push(stage);
    }
    Ok(redone)
}

/// Why a stage is run; `None` where its result is kept, whose remains of a stopped run then go.
fn reason_to_run(
    context: &Context<'_>,
    plan: &Plan,
    stage: StageId,
    forced: bool,
) -> anyhow::Result<Option<String>> {
    Ok(match plan.state(context.run, stage, Look::Contents)? {
        StageState::Valid if !forced => {
            context.run.drop_unfinished(stage)?;
            None
        }
        StageState::Valid => Some("redone as asked".to_owned()),
        StageState::Missing => Some("starting".to_owned()),
        StageState::Damaged { reason } => Some(format!("redoing, because it is damaged: {reason}")),
        StageState::Stale { reasons } => Some(format!("redoing, because {}", reasons.join("; "))),
    })
}

/// Runs one stage and commits its result. Of several processes all work, and the first one commits.
///
/// # Errors
/// When the stage fails; its earlier result is then untouched.
pub fn run_stage(
    context: &Context<'_>,
    plan: &Plan,
    stage: StageId,
    reason: &str,
) -> anyhow::Result<()> {
    context.console.flow().ok_or(Failure::Interrupted)?;
    context
        .console
        .stage(stage, &StageNews::Started(reason.to_owned()));
    let team = context.console.team();
    let (began, cpu_before) = (Instant::now(), system::cpu_seconds());
    system::give_back_freed_memory();
    system::forget_peak_memory();
    let mut begun = None;
    from_first(team, || {
        whole_upstream(context, plan, stage)?;
        begun = Some(context.run.begin(stage)?);
        Ok::<_, anyhow::Error>(())
    })?;
    let writer = begun.unwrap_or_else(|| context.run.take_part(stage));
    let report = dispatch(context, plan, stage, &writer)?;
    context.console.flow().ok_or(Failure::Interrupted)?;
    for items in gathered(team, &serde_json::to_string(&writer.items())?)? {
        writer.add(serde_json::from_str(&items)?);
    }
    let warnings = context.console.take_warnings(stage);
    let ingredients = plan.of(stage).clone();
    let seconds = began.elapsed().as_secs_f64();
    let manifest = Manifest {
        format_version: FORMAT_VERSION,
        program: system::PROGRAM.to_owned(),
        fingerprint: ingredients.fingerprint(),
        ingredients,
        items: Default::default(),
        seconds,
        cpu_seconds: Some(system::cpu_seconds() - cpu_before),
        expected: plan.expected,
        threads: rayon::current_num_threads(),
        peak_memory_bytes: system::peak_memory(),
        warnings,
        files: Default::default(),
        report,
    };
    from_first(team, || Ok::<_, anyhow::Error>(writer.commit(manifest)?))?;
    context.console.stage(stage, &StageNews::Finished(seconds));
    Ok(())
}

/// Refuses a stage one of whose sources is damaged.
fn whole_upstream(context: &Context<'_>, plan: &Plan, stage: StageId) -> anyhow::Result<()> {
    for &of in upstream(stage) {
        if let StageState::Damaged { reason } = plan.state(context.run, of, Look::Contents)? {
            return Err(Failure::RunDirectory(format!(
                "stage {stage} reads {of}, which is damaged: {reason}; `rilievo reconstruct` makes \
                 it again"
            ))
            .into());
        }
    }
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
