//! `rilievo status RUN` and `rilievo why RUN STAGE`: what is valid, stale, damaged or missing, and why.

use super::stored::stored_request;
use crate::cli::{StageArgs, StatusArgs};
use crate::exit::Failure;
use crate::pipeline::{Inputs, Plan, StageState, upstream};
use crate::store::{Look, RunDir};
use rilievo_scene::StageId;
use serde_json::json;
use std::collections::BTreeMap;

/// `rilievo status`
///
/// # Errors
/// When the run directory or its inputs cannot be read; where a stage is damaged, after the state of
/// all stages was printed.
pub fn status(args: &StatusArgs) -> anyhow::Result<()> {
    let run = RunDir::open_to_read(&args.run)?;
    let plan = plan(&run)?;
    let look = if args.verify {
        Look::Contents
    } else {
        Look::Sizes
    };
    let states: BTreeMap<StageId, Result<StageState, Failure>> = StageId::ALL
        .into_iter()
        .map(|stage| (stage, plan.state(&run, stage, look)))
        .collect();
    let mut lines = serde_json::Map::new();
    for (stage, state) in &states {
        let lacks = lacking(*stage, &states);
        if args.json {
            let mut line = match state {
                Ok(state) => serde_json::to_value(state)?,
                Err(failure) => json!({"state": "damaged", "reason": failure.to_string()}),
            };
            if !lacks.is_empty() {
                line["lacks"] = json!(lacks);
            }
            lines.insert(stage.name().to_owned(), line);
        } else {
            match state {
                Ok(state) if lacks.is_empty() => say!("{:<12} {state}", stage.name())?,
                Ok(state) => say!(
                    "{:<12} {state}, but {} that it was made from is gone: `rilievo reconstruct` makes \
                     it again",
                    stage.name(),
                    lacks.join(", ")
                )?,
                Err(failure) => say!("{:<12} {failure}", stage.name())?,
            }
        }
    }
    if args.json {
        let run = args.run.display().to_string();
        say!("{}", json!({"run": run, "stages": lines}))?;
    }
    let damaged: Vec<&str> = states
        .iter()
        .filter(|(_, state)| matches!(state, Ok(StageState::Damaged { .. })))
        .map(|(stage, _)| stage.name())
        .collect();
    if !damaged.is_empty() {
        return Err(Failure::RunDirectory(format!(
            "damaged: {}; `rilievo reconstruct` makes what is damaged again",
            damaged.join(", ")
        ))
        .into());
    }
    states
        .into_values()
        .find_map(Result::err)
        .map_or(Ok(()), |failure| Err(failure.into()))
}

/// What a valid stage was made from and is not there any more: its result stands, but cannot be redone.
fn lacking(
    stage: StageId,
    states: &BTreeMap<StageId, Result<StageState, Failure>>,
) -> Vec<&'static str> {
    if !matches!(states.get(&stage), Some(Ok(StageState::Valid))) {
        return Vec::new();
    }
    upstream(stage)
        .iter()
        .filter(|of| matches!(states.get(of), Some(Ok(StageState::Missing))))
        .map(|of| of.name())
        .collect()
}

/// `rilievo why`
///
/// # Errors
/// When the run directory or its inputs cannot be read.
pub fn why(args: &StageArgs) -> anyhow::Result<()> {
    let run = RunDir::open_to_read(&args.run)?;
    let plan = plan(&run)?;
    let stage = args.stage;
    match plan.state(&run, stage, Look::Contents)? {
        StageState::Valid => {
            say!("{stage} would be kept: it was made from exactly what it would be made from now")?
        }
        StageState::Missing => say!("{stage} would be run: it has no result yet")?,
        StageState::Damaged { reason } => say!("{stage} would be redone: {reason}")?,
        StageState::Stale { reasons } => {
            say!("{stage} would be redone:")?;
            for reason in reasons {
                say!("  {reason}")?;
            }
        }
    }
    for &of in upstream(stage) {
        say!(
            "it reads {of}, which is {}",
            plan.state(&run, of, Look::Sizes)?
        )?;
    }
    Ok(())
}

fn plan(run: &RunDir) -> anyhow::Result<Plan> {
    let request = stored_request(run)?;
    Ok(Plan::new(&request, &Inputs::scan(&request)?))
}
