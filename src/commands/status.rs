//! `rilievo status RUN` and `rilievo why RUN STAGE`: what is valid, stale or missing, and why.

use super::stored_request;
use crate::cli::{StageArgs, StatusArgs};
use crate::pipeline::{Inputs, Plan, StageState, upstream};
use crate::store::{Contents, RunDir};
use rilievo_scene::StageId;
use serde_json::json;

/// `rilievo status`
///
/// # Errors
/// When the run directory or its inputs cannot be read.
pub fn status(args: &StatusArgs) -> anyhow::Result<()> {
    let run = RunDir::open_to_read(&args.run)?;
    let plan = plan(&run)?;
    let mut lines = serde_json::Map::new();
    for stage in StageId::ALL {
        let state = plan.state(&run, stage)?;
        if args.json {
            lines.insert(stage.name().to_owned(), serde_json::to_value(&state)?);
        } else {
            say!("{:<12} {state}", stage.name())?;
        }
    }
    if args.json {
        say!("{}", json!({"run": args.run, "stages": lines}))?;
    }
    Ok(())
}

/// `rilievo why`
///
/// # Errors
/// As [`status`].
pub fn why(args: &StageArgs) -> anyhow::Result<()> {
    let run = RunDir::open_to_read(&args.run)?;
    let plan = plan(&run)?;
    let stage = args.stage;
    match plan.state(&run, stage)? {
        StageState::Valid => {
            say!("{stage} would be kept: it was made from exactly what it would be made from now")?
        }
        StageState::Missing => say!("{stage} would be run: it has no result yet")?,
        StageState::Stale { reasons } => {
            say!("{stage} would be redone:")?;
            for reason in reasons {
                say!("  {reason}")?;
            }
        }
    }
    for &of in upstream(stage) {
        say!("it reads {of}, which is {}", plan.state(&run, of)?)?;
    }
    Ok(())
}

fn plan(run: &RunDir) -> anyhow::Result<Plan> {
    let request = stored_request(run)?;
    let mut contents = Contents::load(run.root());
    let inputs = Inputs::scan(&request, &mut contents)?;
    Ok(Plan::new(&request, &inputs))
}
