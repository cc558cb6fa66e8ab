//! What the ranks of a run must have in common before they work on it: the run directory, the options, the photos.
//!
//! One process has everything in common with itself; all checks then end at once.

use crate::exit::{Failure, Problem};
use crate::pipeline::{Inputs, Plan};
use crate::ranks;
use crate::store::{Ingredients, RunDir};
use rilievo_scene::StageId;
use rilievo_scene::team::{from_first, gathered, wait_for_all};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long a rank looks for the first one's marker: a network file system may show it late.
const MARKER_PATIENCE: Duration = Duration::from_secs(2);

/// Opens a run directory: the first rank by `open`, the others to read, after they have seen there what the first one
/// wrote.
///
/// # Errors
/// When it cannot be opened, or is another one for some rank.
pub fn open_run(
    root: &Path,
    open: impl FnOnce() -> anyhow::Result<RunDir>,
) -> anyhow::Result<RunDir> {
    let team = ranks::team();
    if team.size() == 1 {
        return open();
    }
    let mut owned = None;
    let marker = from_first(team, || {
        let run = owned.insert(open()?);
        Ok::<_, anyhow::Error>(run.mark()?)
    })?;
    let run = match owned {
        Some(run) => run,
        None => see_marker(root, &marker).and_then(|()| Ok(RunDir::open_to_read(root)?))?,
    };
    wait_for_all(team)?;
    if team.is_first() {
        run.unmark()?;
    }
    Ok(run)
}

fn see_marker(root: &Path, marker: &str) -> Result<(), Failure> {
    let began = Instant::now();
    loop {
        let found = RunDir::marker(root)?;
        if found.as_deref() == Some(marker) {
            return Ok(());
        }
        if began.elapsed() > MARKER_PATIENCE {
            let found = found.unwrap_or_else(|| "none".to_owned());
            return Err(Failure::RunDirectory(format!(
                "{} is another folder here: the first rank's marker in it is {marker}, here it is {found}; all \
                 ranks need one run directory, on storage that all hosts share",
                root.display()
            )));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Refuses to go on where the ranks were not asked for the same.
///
/// # Errors
/// With the differing options and both values.
pub fn check_options(asked: &impl Serialize) -> anyhow::Result<()> {
    let texts = gathered(ranks::team(), &serde_json::to_string(asked)?)?;
    for (rank, text) in texts.iter().enumerate() {
        if *text == texts[0] {
            continue;
        }
        let [first, own] = [&texts[0], text].map(|text| serde_json::from_str(text));
        let mut differences = Vec::new();
        compare("", &first?, &own?, &mut |key, first, own| {
            differences.push(format!(
                "{key} is {first} for rank 0 and {own} for rank {rank}"
            ));
        });
        return Err(Failure::Usage(format!(
            "the ranks were asked for different things: {}; start all with the same options",
            differences.join("; ")
        ))
        .into());
    }
    Ok(())
}

/// Hands every value that differs to `found`, by its keys.
fn compare(key: &str, first: &Value, own: &Value, found: &mut impl FnMut(&str, &Value, &Value)) {
    let (Value::Object(a), Value::Object(b)) = (first, own) else {
        if first != own {
            found(key.trim_start_matches('.'), first, own);
        }
        return;
    };
    let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    for next in keys {
        let of =
            |values: &serde_json::Map<String, Value>| values.get(next).cloned().unwrap_or_default();
        compare(&format!("{key}.{next}"), &of(a), &of(b), found);
    }
}

/// Refuses to go on where a rank lacks a photo or another file, or has another one in its place.
///
/// # Errors
/// With the rank, its host and the file.
pub fn check_inputs(inputs: &Inputs, plan: &Plan) -> anyhow::Result<()> {
    let team = ranks::team();
    if team.size() == 1 {
        return Ok(());
    }
    let own: Vec<(String, String)> = inputs
        .photos
        .iter()
        .map(|photo| (photo.path.display().to_string(), photo.hash.clone()))
        .collect();
    let first = from_first(team, || Ok::<_, anyhow::Error>(own.clone()))?;
    let problem = |file: &str, reason: &str| Problem {
        file: file.into(),
        reason: reason.to_owned(),
    };
    let mut problems = Vec::new();
    for (file, hash) in &first {
        match own.iter().find(|(own, _)| own == file) {
            None => problems.push(problem(
                file,
                "is not there or cannot be read, as it can for rank 0; all ranks need all photos",
            )),
            Some((_, own)) if own != hash => {
                problems.push(problem(file, "has another content than for rank 0"));
            }
            Some(_) => {}
        }
    }
    for (file, _) in &own {
        if !first.iter().any(|(other, _)| other == file) {
            problems.push(problem(file, "is there, but not for rank 0"));
        }
    }
    if !problems.is_empty() {
        return Err(Failure::Input(problems).into());
    }
    check_plan(plan)
}

/// The same for what else decides the results: masks, cameras, sphere and lighting files.
fn check_plan(plan: &Plan) -> anyhow::Result<()> {
    let own: Vec<&Ingredients> = StageId::ALL.iter().map(|&stage| plan.of(stage)).collect();
    let texts = gathered(ranks::team(), &serde_json::to_string(&own)?)?;
    let first: Vec<Ingredients> = serde_json::from_str(&texts[0])?;
    let mut differences = Vec::new();
    for (own, first) in own.iter().zip(&first) {
        differences.extend(own.changes_since(first));
    }
    if differences.is_empty() {
        return Ok(());
    }
    Err(Failure::Input(vec![Problem {
        file: "masks, cameras, sphere or lighting".into(),
        reason: format!("are not those of rank 0: {}", differences.join("; ")),
    }])
    .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_named_with_both_values() {
        let first = serde_json::json!({"a": 1, "b": {"c": 2, "d": [3]}});
        let own = serde_json::json!({"a": 1, "b": {"c": 4, "d": [3]}, "e": "x"});
        let mut told = Vec::new();
        compare("", &first, &own, &mut |key, first, own| {
            told.push(format!("{key} {first} {own}"));
        });
        assert_eq!(told, ["b.c 2 4", "e null \"x\""]);
    }
}
