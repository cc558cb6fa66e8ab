//! `rilievo mask PHOTOS`: proposes masks of an object, before a plain backdrop by the backdrop, elsewhere by the
//! photos' poses.
//!
//! ```text
//! DIR/NAME.png            the proposed mask, white is object
//! DIR-overlays/NAME.png   the photo with the mask's outline, what it leaves out darkened
//! DIR-run/                the run that the poses come from, where one was needed and none was given
//! ```
//!
//! A mask that is there already is left alone: it may have been corrected by hand.

mod by_poses;
mod of_run;
mod target;

pub use of_run::{with_accepted_masks, with_proposed_masks};

use super::reporting::reporting_found;
use crate::cli::MaskArgs;
use crate::config::{StageOptions, take_over};
use crate::exit::{Failure, Problem};
use crate::observe::Console;
use crate::pipeline::{Context, Inputs, Request, Resources, linear_photo, load_poses, map_photos};
use crate::store::RunDir;
use rilievo_segmentation::{Backdrop, MaskProposal, propose_mask};
use target::{Target, beside};

/// Certainty below which the user is asked to look closely, of a mask before a backdrop.
const CLEAR: f64 = 0.6;

/// Runs the command.
///
/// # Errors
/// [`Failure::Input`] with the photos that cannot be read; [`Failure::NoResult`] when no mask could
/// be proposed for some photo. The others' masks are written first.
pub fn mask(args: &MaskArgs) -> anyhow::Result<()> {
    reporting_found(&Console::new(args.work.json), |console| {
        let mut masks = Vec::new();
        let outcome = propose(args, console, &mut masks);
        (outcome, serde_json::json!({"masks": masks}))
    })
}

/// What became of a photo.
enum Proposed {
    /// A mask was written: the sentence for people and the facts for scripts.
    Made(String, serde_json::Value),
    Kept,
    /// Why there is no mask.
    Without(String),
}

fn propose(
    args: &MaskArgs,
    console: &Console,
    masks: &mut Vec<serde_json::Value>,
) -> anyhow::Result<()> {
    let mut options = StageOptions::default();
    take_over(&mut options.photos.encoding, args.input.encoding.encoding);
    if let Some(run) = &args.run {
        RunDir::open_to_read(run)?;
    }
    if let Some(cameras) = args.input.cameras.as_ref().filter(|path| !path.exists()) {
        return Err(Failure::input(cameras, "does not exist").into());
    }
    let request = Request {
        recursive: args.input.recursive,
        ..Request::of_photos(args.input.photos.clone(), options)
    };
    let inputs = Inputs::scan(&request)?;
    for problem in &inputs.skipped {
        console.note(&format!("  {problem}"));
    }
    let target = Target {
        overlays: beside(&args.output, "-overlays"),
        masks: args.output.clone(),
    };
    let (mut proposed, mut unusable) = by_backdrops(args, &request, &inputs, &target, console)?;
    // Without proposals by poses, those before backdrops are reported all the same.
    let by_poses = by_poses(args, &request, &inputs, &target, console, &mut proposed);
    let mut without = Vec::new();
    for (photo, found) in inputs.photos.iter().zip(proposed) {
        let name = &photo.file_name;
        match found {
            Some(Proposed::Made(sentence, facts)) => {
                console.note(&format!("  {name}: {sentence}"));
                masks.push(facts);
            }
            Some(Proposed::Kept) => console.note(&format!(
                "  {name}: has a mask already, left as it is (--overwrite makes it anew)"
            )),
            Some(Proposed::Without(reason)) => without.push(reason),
            None => {}
        }
    }
    unusable.extend(by_poses?);
    if !unusable.is_empty() {
        without
            .iter()
            .for_each(|reason| console.note(&format!("  {reason}")));
        return Err(Failure::Input(unusable).into());
    }
    if !without.is_empty() {
        without.dedup();
        return Err(Failure::NoResult(without.join("\n")).into());
    }
    console.note(&format!(
        "masks are in {}, pictures to look at in {}; correct the masks by hand where needed",
        target.masks.display(),
        target.overlays.display()
    ));
    Ok(())
}

/// Proposals before a plain backdrop, photo by photo: none for a photo that cannot be read, which
/// is among the problems. Where poses of a run are given, all photos are left to them.
fn by_backdrops(
    args: &MaskArgs,
    request: &Request,
    inputs: &Inputs,
    target: &Target,
    console: &Console,
) -> anyhow::Result<(Vec<Option<Proposed>>, Vec<Problem>)> {
    let outcomes = map_photos(
        inputs,
        Resources::new(&args.work),
        "proposing masks",
        &console.of_command("mask"),
        |photo| -> anyhow::Result<Proposed> {
            if target.mask(&photo.name).exists() && !args.overwrite {
                return Ok(Proposed::Kept);
            }
            if args.run.is_some() {
                return Ok(Proposed::Without(String::new()));
            }
            let image = linear_photo(request, photo)?;
            match propose_mask(&photo.file_name, &image) {
                Ok(proposal) => {
                    target.write(&photo.name, &image, &proposal.mask)?;
                    let facts = facts(&photo.file_name, &proposal);
                    Ok(Proposed::Made(sentence(&proposal), facts))
                }
                Err(error) => Ok(Proposed::Without(error.to_string())),
            }
        },
    )
    .ok_or(Failure::Interrupted)?;
    let mut unusable = inputs.unreadable.clone();
    let mut proposed = Vec::with_capacity(outcomes.len());
    for outcome in outcomes {
        proposed.push(match outcome {
            Ok(found) => Some(found),
            Err(error) => match error.downcast::<Failure>()? {
                Failure::Input(problems) => {
                    unusable.extend(problems);
                    None
                }
                other => return Err(other.into()),
            },
        });
    }
    Ok((proposed, unusable))
}

/// Puts proposals by poses in the place of missing ones, from the run that was given, else from one
/// beside the masks; returns the photos that cannot be used.
fn by_poses(
    args: &MaskArgs,
    request: &Request,
    inputs: &Inputs,
    target: &Target,
    console: &Console,
    proposed: &mut [Option<Proposed>],
) -> anyhow::Result<Vec<Problem>> {
    let without = proposed.iter().map(|found| match found {
        Some(Proposed::Without(reason)) => Some(reason.clone()),
        _ => None,
    });
    let without: Vec<Option<String>> = without.collect();
    // One photo alone has no pose.
    let has_poses = args.run.is_some() || inputs.photos.len() >= 2;
    if without.iter().all(Option::is_none) || !has_poses {
        return Ok(Vec::new());
    }
    let run = match &args.run {
        Some(run) => Ok(RunDir::open_to_read(run)?),
        None => by_poses::posed_here(args, request, console),
    };
    let (found, problems) = match run {
        Ok(run) => {
            let context = Context {
                run: &run,
                request,
                inputs,
                resources: Resources::new(&args.work),
                console,
            };
            by_poses::propose(&context, &load_poses(&run)?, target, &without)?
        }
        Err(error) => match error.downcast::<Failure>()? {
            // Photos that have no poses are no worse off than before; the reason goes with theirs.
            Failure::NoResult(why) => (by_poses::without_poses(&without, &why), Vec::new()),
            other => return Err(other.into()),
        },
    };
    for ((slot, found), photo) in proposed.iter_mut().zip(found).zip(&inputs.photos) {
        match found {
            Some(Ok(proposal)) => {
                let facts = proposal.facts(&photo.file_name);
                *slot = Some(Proposed::Made(proposal.sentence(), facts));
            }
            Some(Err(reason)) => *slot = Some(Proposed::Without(reason)),
            None => {}
        }
    }
    Ok(problems)
}

fn sentence(proposal: &MaskProposal) -> String {
    let backdrop = match proposal.backdrop {
        Backdrop::Dark => "dark",
        Backdrop::Grey => "grey",
        Backdrop::Bright => "bright",
    };
    let mut text = format!(
        "{:.1} % of the frame before a {backdrop} backdrop, certainty {:.2}",
        100.0 * proposal.mask.coverage(),
        proposal.certainty()
    );
    if proposal.certainty() < CLEAR {
        text += "; not clear, look closely";
    }
    if proposal.border_share > 0.0 {
        text += "; the object touches the frame's border";
    }
    text
}

fn facts(photo: &str, proposal: &MaskProposal) -> serde_json::Value {
    serde_json::json!({
        "photo": photo,
        "method": "backdrop",
        "coverage": proposal.mask.coverage(),
        "backdrop": proposal.backdrop,
        "certainty": proposal.certainty(),
        "separability": proposal.separability,
        "doubtful_share": proposal.doubtful_share,
        "border_share": proposal.border_share,
    })
}
