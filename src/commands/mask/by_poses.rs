//! Masks from the photos' poses: what stands in the middle of what the photos look at.

use super::{Proposed, Target, beside};
use crate::cli::MaskArgs;
use crate::commands::reconstruct::{Allowed, bring_run_up_to_date};
use crate::exit::Failure;
use crate::observe::Console;
use crate::pipeline::{
    Inputs, PhotoInput, Range, Request, Resources, linear_photo, load_poses, map_photos,
};
use crate::store::RunDir;
use rilievo_scene::{LinearImage, PosedView, PosedViews, StageId};
use rilievo_segmentation::{Consensus, SeenPoints, SegmentationError, outline, sketch};
use std::collections::BTreeMap;

/// Certainty below which the user is asked to look closely.
const CLEAR: f64 = 0.9;

/// How sure a proposed mask is.
pub struct PosedProposal {
    coverage: f64,
    /// Share of the object's matched points inside.
    inside: f64,
    /// Share of the mask near a matched point.
    covered: f64,
    /// Share of the mask inside the other photos' outlines, where there are enough of them.
    agreement: Option<f64>,
}

impl PosedProposal {
    /// Trust in one number, 0 to 1.
    fn certainty(&self) -> f64 {
        self.inside
            .min(self.covered)
            .min(self.agreement.unwrap_or(1.0))
    }

    /// For people.
    pub fn sentence(&self) -> String {
        let mut text = format!(
            "{:.1} % of the frame by the photos' poses, certainty {:.2}",
            100.0 * self.coverage,
            self.certainty()
        );
        let worst = self.certainty();
        if worst < CLEAR {
            text += "; not clear, look closely: ";
            text += match self {
                _ if self.inside <= worst => "it may lack a part",
                _ if self.agreement.is_some_and(|share| share <= worst) => {
                    "it holds what other photos' masks leave out"
                }
                _ => "much of it is far from any matched point",
            };
        }
        text
    }

    /// For scripts.
    pub fn facts(&self, photo: &str) -> serde_json::Value {
        serde_json::json!({
            "photo": photo,
            "method": "poses",
            "coverage": self.coverage,
            "certainty": self.certainty(),
            "points_inside_share": self.inside,
            "near_points_share": self.covered,
            "agreement_share": self.agreement,
        })
    }
}

/// Proposes masks for the photos that are without, and writes them. The poses come from the run that was given, else from
/// one beside the masks.
///
/// # Errors
/// When there are no poses, a photo cannot be read again, or a mask cannot be written.
pub fn propose(
    args: &MaskArgs,
    request: &Request,
    inputs: &Inputs,
    target: &Target,
    console: &Console,
    proposed: &mut [Option<Proposed>],
) -> anyhow::Result<()> {
    let is_without = |found: &Option<Proposed>| matches!(found, Some(Proposed::Without(_)));
    // One photo alone has no pose.
    if !proposed.iter().any(is_without) || inputs.photos.len() < 2 {
        return Ok(());
    }
    let posed = match &args.run {
        Some(run) => load_poses(&RunDir::open_to_read(run)?)?,
        None => match posed_here(args, request, console) {
            Ok(posed) => posed,
            // Photos that have no poses are no worse off than before; why is told with them.
            Err(error) if matches!(error.downcast_ref(), Some(Failure::NoResult(_))) => {
                for found in proposed.iter_mut() {
                    if let Some(Proposed::Without(reason)) = found {
                        *reason += &format!("; nor do the photos' poses tell it: {error:#}");
                    }
                }
                return Ok(());
            }
            Err(error) => return Err(error),
        },
    };
    let views = &posed.views;
    let points = SeenPoints::new(&posed).part(views);
    let points = points.map_err(|error| Failure::NoResult(error.to_string()))?;
    let wanted: BTreeMap<&str, usize> = (inputs.photos.iter().zip(proposed.iter()))
        .filter(|(_, found)| is_without(found))
        .filter_map(|(photo, _)| {
            let has_name = |view: &PosedView| view.file_name == photo.file_name;
            Some((photo.file_name.as_str(), views.iter().position(has_name)?))
        })
        .collect();
    let mut cut = Cut {
        request,
        inputs,
        resources: Resources::new(&args.work),
        console,
        views,
        wanted: &wanted,
        reasons: BTreeMap::new(),
    };
    let sketches = cut.each("sketching the object", |index, _, image| {
        Ok(sketch(&points, index, &views[index], image)?)
    })?;
    let consensus = Consensus::of(&points, views, &sketches)?;
    let outlines = cut.each("outlining the object", |index, photo, image| {
        let own = sketches[index].as_ref();
        let own = own.ok_or_else(|| SegmentationError::NotInPhoto {
            photo: photo.file_name.clone(),
        })?;
        let found = outline(
            &points,
            index,
            &views[index],
            image,
            (own, consensus.as_ref()),
        )?;
        target.write(&photo.name, image, &found.mask)?;
        let proposal = PosedProposal {
            coverage: found.mask.coverage(),
            inside: found.inside,
            covered: found.covered,
            agreement: None,
        };
        Ok((proposal, found.sketch))
    })?;
    let (mut proposals, last): (Vec<_>, Vec<_>) = outlines.into_iter().map(Option::unzip).unzip();
    if let Some(consensus) = Consensus::of(&points, views, &last)? {
        for ((proposal, sketch), view) in proposals.iter_mut().zip(&last).zip(views) {
            if let (Some(proposal), Some(sketch)) = (proposal, sketch) {
                proposal.agreement = Some(consensus.agreement(view, sketch)?);
            }
        }
    }
    for (photo, found) in inputs.photos.iter().zip(proposed.iter_mut()) {
        if !is_without(found) {
            continue;
        }
        let name = photo.file_name.as_str();
        let index = wanted.get(name);
        *found = Some(match index.and_then(|&index| proposals[index].take()) {
            Some(proposal) => Proposed::ByPoses(proposal),
            None => Proposed::Without(match index.and_then(|index| cut.reasons.remove(index)) {
                Some(reason) => reason,
                None => format!("{name} has no pose in the run; draw its mask in an image editor"),
            }),
        });
    }
    Ok(())
}

/// What photos are cut with.
struct Cut<'a> {
    request: &'a Request,
    inputs: &'a Inputs,
    resources: Resources,
    console: &'a Console,
    views: &'a [PosedView],
    /// The photos that are to be cut, by file name, with the number of their view.
    wanted: &'a BTreeMap<&'a str, usize>,
    /// Why views have no mask.
    reasons: BTreeMap<usize, String>,
}

impl Cut<'_> {
    /// Works on the views of all wanted photos, given number, photo and pixels. A view in which the object cannot be told
    /// has no result and a reason.
    fn each<R: Send>(
        &mut self,
        step: &str,
        work: impl Fn(usize, &PhotoInput, &LinearImage) -> anyhow::Result<R> + Sync,
    ) -> anyhow::Result<Vec<Option<R>>> {
        let outcomes = map_photos(
            self.inputs,
            self.resources,
            step,
            &self.console.of_command("mask"),
            |photo| {
                let index = *self.wanted.get(photo.file_name.as_str())?;
                Some((index, self.one(index, photo, &work)))
            },
        )
        .ok_or(Failure::Interrupted)?;
        let mut results: Vec<Option<R>> = self.views.iter().map(|_| None).collect();
        for (index, outcome) in outcomes.into_iter().flatten() {
            match outcome {
                Ok(result) => results[index] = Some(result),
                Err(error) => match error.downcast_ref::<SegmentationError>() {
                    Some(reason) => {
                        self.reasons.entry(index).or_insert(reason.to_string());
                    }
                    None => return Err(error),
                },
            }
        }
        Ok(results)
    }

    fn one<R>(
        &self,
        index: usize,
        photo: &PhotoInput,
        work: &impl Fn(usize, &PhotoInput, &LinearImage) -> anyhow::Result<R>,
    ) -> anyhow::Result<R> {
        let image = linear_photo(self.request, photo)?;
        let camera = &self.views[index].intrinsics;
        if (camera.width, camera.height) != (image.width, image.height) {
            let reason = format!(
                "is {}x{}, in the run {}x{}: give the run of these photos",
                image.width, image.height, camera.width, camera.height
            );
            return Err(Failure::input(&photo.path, reason).into());
        }
        work(index, photo, &image)
    }
}

/// The photos' poses, from a run beside the masks.
fn posed_here(args: &MaskArgs, request: &Request, console: &Console) -> anyhow::Result<PosedViews> {
    let root = beside(&args.output, "-run");
    console.note(&format!(
        "  some photos have no plain backdrop: the object is told by the photos' poses, in {}",
        root.display()
    ));
    let range = Range {
        redo_from: None,
        until: StageId::Poses,
    };
    let allowed = Allowed { overwrite: false };
    let request = Request {
        cameras: args.cameras.clone(),
        ..request.clone()
    };
    bring_run_up_to_date(&request, &root, range, allowed, &args.work, console)?;
    load_poses(&RunDir::open_to_read(&root)?)
}
