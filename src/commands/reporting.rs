//! Reports how a command ended.

use crate::exit::Failure;
use crate::observe::Console;
use crate::ranks;
use crate::report::Judgement;
use rilievo_scene::Verdict;

/// Runs a command, and reports to scripts how it ended: its exit code, its error, and what `facts`
/// names of it.
pub fn reporting(
    console: &Console,
    facts: serde_json::Value,
    command: impl FnOnce(&Console) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    reporting_found(console, |console| (command(console), facts))
}

/// As [`reporting`], with facts that the command finds, whether it fails or not.
pub fn reporting_found(
    console: &Console,
    command: impl FnOnce(&Console) -> (anyhow::Result<()>, serde_json::Value),
) -> anyhow::Result<()> {
    let (outcome, facts) = command(console);
    let outcome = ranks::agree(outcome);
    let mut line = serde_json::json!({ "exit_code": 0 });
    if let (Some(line), serde_json::Value::Object(facts)) = (line.as_object_mut(), facts) {
        line.extend(facts);
    }
    if let Err(error) = &outcome {
        line["exit_code"] = crate::exit::code_of(error).into();
        line["error"] = format!("{error:#}").into();
    }
    console.finished(&line);
    outcome
}

/// As [`reporting`], for a command that judges its result: the verdict goes to people and to
/// scripts. Of several processes only the first one judges. With `strict`, a result that is not to
/// be trusted is a failure.
pub fn reporting_judged(
    console: &Console,
    strict: bool,
    mut facts: serde_json::Value,
    command: impl FnOnce(&Console) -> anyhow::Result<Option<Judgement>>,
) -> anyhow::Result<()> {
    reporting_found(console, |console| {
        let outcome = command(console).and_then(|judgement| {
            let Some(judgement) = judgement else {
                return Ok(());
            };
            judgement.lines().for_each(|line| console.note(&line));
            facts["verdict"] = serde_json::to_value(&judgement)?;
            if strict && judgement.verdict == Verdict::NotToBeTrusted {
                let why = judgement.reasons.join("; ");
                let failure = format!("the result is not to be trusted (--strict): {why}");
                return Err(Failure::NoResult(failure).into());
            }
            Ok(())
        });
        (outcome, facts)
    })
}
