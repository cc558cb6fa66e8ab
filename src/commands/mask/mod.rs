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

use super::reporting::reporting_found;
use crate::cli::MaskArgs;
use crate::config::{StageOptions, take_over};
use crate::exit::{Failure, Problem};
use crate::observe::Console;
use crate::pipeline::{Inputs, Request, Resources, linear_photo, map_photos};
use crate::store::create_folder;
use by_poses::PosedProposal;
use rilievo_io::{Preview, write_mask, write_preview_png};
use rilievo_photos::{Backdrop, MaskProposal, propose_mask};
use rilievo_scene::{LinearImage, Mask};
use std::path::{Path, PathBuf};

/// Certainty below which the user is asked to look closely, of a mask before a backdrop.
const CLEAR: f64 = 0.6;

/// Longer side of the pictures to look at.
const OVERLAY_SIDE_PX: usize = 1600;

/// Brightness of what the mask leaves out, in the pictures.
const OUTSIDE: f32 = 0.25;

/// Linear red of the outline.
const OUTLINE: [f32; 3] = [1.0, 0.05, 0.02];

/// Runs the command.
///
/// # Errors
/// [`Failure::Input`] with the photos that cannot be read; [`Failure::NoResult`] when no mask could
/// be proposed for some photo. The others' masks are written first.
pub fn mask(args: &MaskArgs) -> anyhow::Result<()> {
    reporting_found(args.work.json, |console| {
        let mut told = Vec::new();
        let outcome = propose(args, console, &mut told);
        (outcome, serde_json::json!({"masks": told}))
    })
}

/// What became of a photo.
enum Proposed {
    Before(MaskProposal),
    ByPoses(PosedProposal),
    Kept,
    /// Why there is no mask.
    Without(String),
}

/// Where masks and the pictures to look at go.
struct Target {
    masks: PathBuf,
    overlays: PathBuf,
}

impl Target {
    fn mask(&self, name: &str) -> PathBuf {
        self.masks.join(format!("{name}.png"))
    }

    fn write(&self, name: &str, image: &LinearImage, mask: &Mask) -> Result<(), Failure> {
        // Made only now, so that nothing is left where no mask is found.
        for folder in [&self.masks, &self.overlays] {
            create_folder(folder)?;
        }
        write_mask(&self.mask(name), mask)?;
        let overlay = overlay(image, mask);
        let picture = self.overlays.join(format!("{name}.png"));
        write_preview_png(&picture, Preview::Linear(&overlay), OVERLAY_SIDE_PX)?;
        Ok(())
    }
}

fn propose(
    args: &MaskArgs,
    console: &Console,
    told: &mut Vec<serde_json::Value>,
) -> anyhow::Result<()> {
    let mut options = StageOptions::default();
    take_over(&mut options.photos.encoding, args.encoding);
    let request = Request::of_photos(args.photos.clone(), options);
    let inputs = Inputs::scan(&request)?;
    for problem in &inputs.skipped {
        console.note(&format!("  {problem}"));
    }
    let target = Target {
        overlays: beside(&args.output, "-overlays"),
        masks: args.output.clone(),
    };
    let resources = Resources::new(&args.work);
    let outcomes = map_photos(
        &inputs,
        resources,
        "proposing masks",
        &console.of_command("mask"),
        |photo| -> anyhow::Result<Proposed> {
            if target.mask(&photo.name).exists() && !args.overwrite {
                return Ok(Proposed::Kept);
            }
            if args.run.is_some() {
                return Ok(Proposed::Without(String::new()));
            }
            let image = linear_photo(&request, photo)?;
            match propose_mask(&photo.file_name, &image) {
                Ok(proposal) => {
                    target.write(&photo.name, &image, &proposal.mask)?;
                    Ok(Proposed::Before(proposal))
                }
                Err(error) => Ok(Proposed::Without(error.to_string())),
            }
        },
    )
    .ok_or(Failure::Interrupted)?;

    let mut unusable: Vec<Problem> = inputs.unreadable.clone();
    let mut proposed = Vec::with_capacity(outcomes.len());
    for outcome in outcomes {
        proposed.push(match outcome {
            Ok(found) => Some(found),
            Err(error) => match error.downcast_ref::<Failure>() {
                Some(Failure::Input(problems)) => {
                    unusable.extend(problems.iter().cloned());
                    None
                }
                _ => return Err(error),
            },
        });
    }
    by_poses::propose(args, &request, &inputs, &target, console, &mut proposed)?;

    let mut without = Vec::new();
    for (photo, found) in inputs.photos.iter().zip(&proposed) {
        let name = &photo.file_name;
        match found {
            Some(Proposed::Before(proposal)) => {
                console.note(&format!("  {name}: {}", sentence(proposal)));
                told.push(facts(name, proposal));
            }
            Some(Proposed::ByPoses(proposal)) => {
                console.note(&format!("  {name}: {}", proposal.sentence()));
                told.push(proposal.facts(name));
            }
            Some(Proposed::Kept) => console.note(&format!(
                "  {name}: has a mask already, left as it is (--overwrite makes it anew)"
            )),
            Some(Proposed::Without(reason)) => without.push(reason.clone()),
            None => {}
        }
    }
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

/// `masks-overlays` beside `masks`: among the masks, the pictures would be taken for masks.
fn beside(masks: &Path, ending: &str) -> PathBuf {
    let mut name = masks.file_name().unwrap_or_default().to_os_string();
    name.push(ending);
    masks.with_file_name(name)
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

/// The photo in colours, darkened outside the mask, with its outline.
fn overlay(image: &LinearImage, mask: &Mask) -> LinearImage {
    let mut picture = LinearImage::filled(image.width, image.height, 3, 0.0);
    // As wide as a line of the picture that is shown.
    let reach = (image.width.max(image.height) / OVERLAY_SIDE_PX) as isize + 1;
    for y in 0..image.height {
        for x in 0..image.width {
            let inside = *mask.at(x, y);
            let (px, py) = (x as isize, y as isize);
            let on_outline = inside
                && [(reach, 0), (-reach, 0), (0, reach), (0, -reach)]
                    .iter()
                    .any(|(dx, dy)| !mask.contains(px + dx, py + dy));
            let light = if inside { 1.0 } else { OUTSIDE };
            let from = image.pixel(x, y);
            let to = picture.pixel_mut(x, y);
            for (channel, value) in to.iter_mut().enumerate() {
                *value = light * from[channel.min(image.channels - 1)];
            }
            if on_outline {
                to.copy_from_slice(&OUTLINE);
            }
        }
    }
    picture
}
