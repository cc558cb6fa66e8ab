//! Masks from the photos' poses: what stands in the middle of what the photos look at.

use super::target::{Target, beside};
use crate::cli::MaskArgs;
use crate::commands::bring::bring_run_up_to_date;
use crate::commands::stored::stored_request;
use crate::exit::{Failure, Problem};
use crate::observe::Console;
use crate::pipeline::{
    Context, LightingInput, PhotoInput, Range, Request, SphereInput, linear_photo, map_photos,
    photo_role,
};
use crate::store::{Manifest, RunDir};
use rilievo_scene::{LinearImage, PosedView, PosedViews, StageId};
use rilievo_segmentation::{Consensus, SeenPoints, SegmentationError, Sketch, outline, sketch};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Consistency below which the user is asked to look closely.
const CLEAR: f64 = 0.9;

/// How well a proposed mask agrees with the object's points and with the other photos. Errors that
/// all photos share do not show.
#[derive(Clone)]
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
    /// The least of the shares.
    pub fn consistency(&self) -> f64 {
        self.inside
            .min(self.covered)
            .min(self.agreement.unwrap_or(1.0))
    }

    /// Whether it needs no closer look.
    pub fn is_clear(&self) -> bool {
        self.consistency() >= CLEAR
    }

    /// For people.
    pub fn sentence(&self) -> String {
        let mut text = format!(
            "{:.1} % of the frame by the photos' poses, consistency with points and other photos {:.2}",
            100.0 * self.coverage,
            self.consistency()
        );
        let worst = self.consistency();
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
            "consistency": self.consistency(),
            "points_inside_share": self.inside,
            "near_points_share": self.covered,
            "agreement_share": self.agreement,
        })
    }
}

/// Proposes masks for the photos that are without, by the poses of a run, and writes them. All photos with a pose vote on
/// what is the object, those with a mask too, so that a mask does not depend on which others are there already.
///
/// `without` has why a photo is without a mask, for those that are. Returns a proposal or a new reason for these, and the
/// photos that cannot be read or are not those of the run.
///
/// # Errors
/// When the run is damaged, or a mask cannot be written.
pub fn propose(
    context: &Context<'_>,
    posed: &PosedViews,
    target: &Target,
    without: &[Option<String>],
) -> anyhow::Result<(Vec<Found>, Vec<Problem>)> {
    let Context { run, inputs, .. } = context;
    let sane = posed.check();
    sane.map_err(|error| Failure::RunDirectory(error.to_string()))?;
    let views = &posed.views;
    let points = match SeenPoints::new(posed).part(views) {
        Ok(points) => points,
        Err(error) => return Ok((without_poses(without, &error.to_string()), Vec::new())),
    };
    let index_of: BTreeMap<&str, usize> = (views.iter().enumerate())
        .map(|(index, view)| (view.file_name.as_str(), index))
        .collect();
    let to_cut: BTreeSet<usize> = (inputs.photos.iter().zip(without))
        .filter(|(_, reason)| reason.is_some())
        .filter_map(|(photo, _)| index_of.get(photo.file_name.as_str()).copied())
        .collect();
    let mut cut = Cut {
        context,
        made_from: run.manifest(StageId::Photos)?,
        views,
        index_of: &index_of,
        reasons: BTreeMap::new(),
        problems: Vec::new(),
    };
    let all = |_: usize| Some(());
    let sketches = cut.each("sketching the object", all, |index, (), _, image| {
        Ok(sketch(&points, index, &views[index], image)?)
    })?;
    let consensus = Consensus::of(&points, views, &sketches)?;
    let sketch_of = |index: usize| sketches[index].as_ref().filter(|_| to_cut.contains(&index));
    let outlines = cut.each(
        "outlining the object",
        sketch_of,
        |index, own, photo, image| {
            let known = (own, consensus.as_ref());
            let found = outline(&points, index, &views[index], image, known)?;
            target.write(&photo.name, image, &found.mask)?;
            let proposal = PosedProposal {
                coverage: found.mask.coverage(),
                inside: found.inside,
                covered: found.covered,
                agreement: None,
            };
            Ok((proposal, found.sketch))
        },
    )?;
    let (mut proposals, last): (Vec<_>, Vec<_>) = outlines.into_iter().map(Option::unzip).unzip();
    // Photos with a mask of their own vote with their sketch.
    let last: Vec<Option<Sketch>> = (last.into_iter().zip(sketches))
        .map(|(last, first)| last.or(first))
        .collect();
    if let Some(consensus) = Consensus::of(&points, views, &last)? {
        for ((proposal, sketch), view) in proposals.iter_mut().zip(&last).zip(views) {
            if let (Some(proposal), Some(sketch)) = (proposal, sketch) {
                proposal.agreement = consensus.agreement(view, sketch)?;
            }
        }
    }
    let found = inputs.photos.iter().zip(without).map(|(photo, reason)| {
        reason.as_ref()?;
        let name = photo.file_name.as_str();
        let index = index_of.get(name);
        let proposal = index.and_then(|&index| proposals[index].take());
        Some(proposal.ok_or_else(|| {
            let reason = index.and_then(|index| cut.reasons.remove(index));
            reason.unwrap_or_else(|| {
                format!("{name} has no pose in the run; draw its mask in an image editor")
            })
        }))
    });
    Ok((found.collect(), cut.problems))
}

/// What became of a photo that was without a mask.
pub type Found = Option<Result<PosedProposal, String>>;

/// Why photos are without a mask: for each the reason that it has already, and why their poses do
/// not help.
pub fn without_poses(without: &[Option<String>], why: &str) -> Vec<Found> {
    let both = |reason: &String| match reason.is_empty() {
        true => why.to_owned(),
        false => format!("{reason}; nor do the photos' poses tell it: {why}"),
    };
    let each = without.iter();
    each.map(|reason| Some(Err(both(reason.as_ref()?))))
        .collect()
}

/// What photos are cut with.
struct Cut<'a> {
    context: &'a Context<'a>,
    /// The photos that the run was made from.
    made_from: Option<Manifest>,
    views: &'a [PosedView],
    /// Number of the view of a photo, by file name.
    index_of: &'a BTreeMap<&'a str, usize>,
    /// Why views have no mask.
    reasons: BTreeMap<usize, String>,
    /// Photos that cannot be used.
    problems: Vec<Problem>,
}

impl Cut<'_> {
    /// Works on the views for which `with` returns something: `work` takes the view's number, that,
    /// the photo and its pixels. A view in which the object is not found has no result and a
    /// reason.
    fn each<T, R: Send>(
        &mut self,
        step: &str,
        with: impl Fn(usize) -> Option<T> + Sync,
        work: impl Fn(usize, T, &PhotoInput, &LinearImage) -> anyhow::Result<R> + Sync,
    ) -> anyhow::Result<Vec<Option<R>>> {
        let outcomes = map_photos(
            self.context.inputs,
            self.context.resources,
            step,
            &self.context.console.of_command("mask"),
            |photo| {
                let index = *self.index_of.get(photo.file_name.as_str())?;
                let given = with(index)?;
                let image = self.image(index, photo);
                let result = image.and_then(|image| work(index, given, photo, &image));
                Some((index, result))
            },
        )
        .ok_or(Failure::Interrupted)?;
        let mut results: Vec<Option<R>> = self.views.iter().map(|_| None).collect();
        for (index, outcome) in outcomes.into_iter().flatten() {
            match outcome {
                Ok(result) => results[index] = Some(result),
                Err(error) => {
                    if let Some(reason) = error.downcast_ref::<SegmentationError>() {
                        self.reasons.insert(index, reason.to_string());
                    } else if let Some(Failure::Input(problems)) = error.downcast_ref() {
                        let mut problems = problems.clone();
                        let reason = problems.iter().map(ToString::to_string).collect();
                        self.reasons.insert(index, reason);
                        self.problems.append(&mut problems);
                    } else {
                        return Err(error);
                    }
                }
            }
        }
        Ok(results)
    }

    /// The pixels of the photo that the run was made from.
    fn image(&self, index: usize, photo: &PhotoInput) -> anyhow::Result<Arc<LinearImage>> {
        let other = || {
            let reason = "is not the photo of that name that the run was made from; give the run of these photos";
            Err(Failure::input(&photo.path, reason).into())
        };
        let made_from = self.made_from.as_ref().map(|made| &made.ingredients.inputs);
        let hash = made_from.and_then(|inputs| inputs.get(&photo_role(&photo.file_name)));
        if hash.is_some_and(|hash| *hash != photo.hash) {
            return other();
        }
        let image = linear_photo(self.context.request, photo)?;
        let camera = &self.views[index].intrinsics;
        if (camera.width, camera.height) != (image.width, image.height) {
            return other();
        }
        Ok(image)
    }
}

/// A run beside the masks, with the photos' poses.
///
/// # Errors
/// When the photos have no poses, or the folder holds somebody's run.
pub fn posed_here(args: &MaskArgs, request: &Request, console: &Console) -> anyhow::Result<RunDir> {
    let root = beside(&args.output, "-run");
    console.note(&format!(
        "  some photos have no plain backdrop: the object is told by the photos' poses, in {}",
        root.display()
    ));
    if is_of_somebody(&root)? {
        return Err(Failure::Usage(format!(
            "{root} holds a run with masks, a sphere, a light or shapes, which finding poses there would replace: say --run \
             {root} to use its poses, or choose another folder with -o",
            root = root.display()
        ))
        .into());
    }
    let request = Request {
        cameras: args.input.cameras.clone(),
        ..request.clone()
    };
    let range = Range::until(StageId::Poses);
    bring_run_up_to_date(&request, &root, range, &args.work, console)?;
    Ok(RunDir::open_to_read(&root)?)
}

/// Whether a folder holds a run that was not made to find poses for masks.
fn is_of_somebody(root: &Path) -> anyhow::Result<bool> {
    if !root.join("run.json").exists() {
        return Ok(false);
    }
    let run = RunDir::open_to_read(root)?;
    let asked = stored_request(&run)?;
    Ok(asked.masks.is_some()
        || asked.sphere != SphereInput::None
        || asked.lighting != LightingInput::Found
        || run.manifest(StageId::Lighting)?.is_some())
}
