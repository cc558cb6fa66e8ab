//! Masks that a run proposes for itself.
//!
//! ```text
//! RUN/masks/NAME.png            the proposed masks, white is object; they may be corrected
//! RUN/masks-overlays/NAME.png   the photos with the masks' outlines
//! RUN/masks-unsure/NAME.png     the proposals in place of `masks` where they are not used
//! RUN/masks.json                the photos that they were made from, and how sure each is
//! ```

use super::by_poses::{PosedProposal, propose};
use super::target::Target;
use crate::cli::WorkArgs;
use crate::commands::bring::bring_run_up_to_date;
use crate::exit::Failure;
use crate::observe::Console;
use crate::pipeline::{
    Context, Inputs, MaskOrigin, PhotoInput, Range, Request, Resources, load_poses,
};
use crate::ranks;
use crate::store::{RunDir, absolute, create_folder, own_file, seal, unseal, write_atomically};
use rilievo_photos::PhotosReport;
use rilievo_scene::StageId;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const FOLDER: &str = "masks";
const UNSURE: &str = "masks-unsure";
const OVERLAYS: &str = "masks-overlays";
const RECORD: &str = "masks.json";
/// Where proposals lie until all are there.
const PARTIAL: &str = "masks.partial";

/// What masks were proposed from, and how they came out.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Record {
    /// The poses that they follow from.
    poses: String,
    /// Why they are not used; `None` where they are.
    unsure: Option<String>,
    /// By the photo's file name.
    photos: BTreeMap<String, Proposed>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Proposed {
    /// Content hash of the photo.
    photo: String,
    /// Agreement with the object's points and with the other photos, 0 to 1; `None` for a photo without a pose, which has
    /// no mask.
    consistency: Option<f64>,
}

/// The request whose masks are the run's own proposals where the user says so with `--masks
/// RUN/masks`; else unchanged.
pub fn with_accepted_masks(request: Request, root: &Path) -> anyhow::Result<Request> {
    let root = &absolute(root)?;
    let is_own = request.masks.as_ref() == Some(&root.join(FOLDER)) && is_used(root);
    Ok(if is_own {
        own(&request, root, MaskOrigin::Accepted)
    } else {
        request
    })
}

/// The request with masks that the run proposes for itself, for a user who has none. They are
/// proposed where a photo lacks one and a stage after the poses is asked for, from poses of the
/// photos without masks. Unchanged, with a warning, where the proposals are not sure; unchanged
/// where the photos carry masks themselves.
///
/// # Errors
/// When a photo cannot be read, there are no poses, or masks cannot be written.
pub fn with_proposed_masks(
    request: Request,
    root: &Path,
    range: Range,
    work: &WorkArgs,
    console: &Console,
) -> anyhow::Result<Request> {
    let root = &absolute(root)?;
    let folder = root.join(FOLDER);
    let record = record_of(root);
    if record.is_none() && is_filled(&folder) {
        return Err(Failure::Usage(format!(
            "{folder} was not proposed by this run: say --masks {folder} to use it",
            folder = folder.display()
        ))
        .into());
    }
    let mut for_poses = request.clone();
    let mut is_complete = false;
    if let Some(record) = record.filter(|record| record.is_used(root)) {
        for_poses = own(&request, root, MaskOrigin::Proposed);
        let inputs = Inputs::scan(&for_poses)?;
        // Where all are there, the poses that they came from need not be made again.
        is_complete = inputs.photos.iter().all(|photo| record.has(photo));
    }
    if is_complete || range.until <= StageId::Poses {
        return Ok(for_poses);
    }
    let poses = Range {
        overwrite: range.overwrite,
        then_masked_until: Some(range.until),
        ..Range::until(StageId::Poses)
    };
    bring_run_up_to_date(&for_poses, root, poses, work, console)?;
    let outcome = if ranks::team().is_first() {
        propose_into(root, &for_poses, work, console)
    } else {
        Ok(())
    };
    ranks::agree(outcome)?;
    Ok(if is_used(root) {
        own(&request, root, MaskOrigin::Proposed)
    } else {
        request
    })
}

/// A request with the run's own masks.
fn own(request: &Request, root: &Path, masks_from: MaskOrigin) -> Request {
    Request {
        masks: Some(root.join(FOLDER)),
        masks_from,
        ..request.clone()
    }
}

/// Whether the run has proposals that are used.
fn is_used(root: &Path) -> bool {
    record_of(root).is_some_and(|record| record.is_used(root))
}

/// Whether a folder is there and holds something.
fn is_filled(folder: &Path) -> bool {
    std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
}

/// What is known of the masks of a run; `None` where none were proposed, or the record is damaged.
fn record_of(root: &Path) -> Option<Record> {
    let text = own_file(&root.join(RECORD)).ok().flatten()?;
    serde_json::from_value(unseal(&text).ok()?).ok()
}

fn propose_into(
    root: &Path,
    request: &Request,
    work: &WorkArgs,
    console: &Console,
) -> anyhow::Result<()> {
    // With its lock: another process must not propose at the same time.
    let run = RunDir::open(root)?;
    let poses = run.manifest(StageId::Poses)?;
    let poses = poses.map_or(String::new(), |manifest| manifest.fingerprint);
    let photos = run.manifest(StageId::Photos)?;
    let photos = photos.map(|manifest| serde_json::from_value::<PhotosReport>(manifest.report));
    let masked = photos
        .transpose()?
        .is_some_and(|report| report.num_masks > 0);
    // Then they are the photos' own, as an alpha channel.
    if masked && request.masks.is_none() {
        return Ok(());
    }
    let before = record_of(root).unwrap_or_default();
    if let Some(why) = before.unsure.as_ref().filter(|_| before.poses == poses) {
        not_used(console, root, why);
        return Ok(());
    }
    let inputs = Inputs::scan(request)?;
    let partial = Target {
        masks: root.join(PARTIAL),
        overlays: root.join(PARTIAL).join(OVERLAYS),
    };
    if partial.masks.exists() {
        std::fs::remove_dir_all(&partial.masks)?;
    }
    let context = Context {
        run: &run,
        request,
        inputs: &inputs,
        resources: Resources::new(work),
        console,
    };
    let all = vec![Some(String::new()); inputs.photos.len()];
    let posed = load_poses(&run)?;
    let (found, problems) = propose(&context, &posed, &partial, &all)?;
    if !problems.is_empty() {
        return Err(Failure::Input(problems).into());
    }
    let with_pose: BTreeSet<&str> = posed.views.iter().map(|v| v.file_name.as_str()).collect();
    let mut record = Record {
        poses,
        ..Record::default()
    };
    for (photo, found) in inputs.photos.iter().zip(found) {
        let proposal = match found {
            Some(Ok(proposal)) => proposal,
            // As long as it has none, stages after the poses have no use for it.
            _ if !with_pose.contains(photo.file_name.as_str()) => {
                record.put(photo, None);
                continue;
            }
            Some(Err(why)) => {
                record.unsure.get_or_insert(why);
                continue;
            }
            None => continue,
        };
        // What lies there may have been corrected, and stays.
        if let Some(known) = before.kept(root, photo) {
            record.photos.insert(photo.file_name.clone(), known.clone());
            continue;
        }
        if !proposal.is_clear() {
            let why = format!("{}: {}", photo.file_name, proposal.sentence());
            record.unsure.get_or_insert(why);
        }
        record.put(photo, Some(&proposal));
    }
    keep(root, &record, &inputs, &before)?;
    match &record.unsure {
        Some(why) => not_used(console, root, why),
        None => console.note(&format!(
            "  masks: proposed by the photos' poses for {} photos; look at {}, correct those in {}, and say --masks {} when \
             they are right",
            record.photos.values().filter(|p| p.consistency.is_some()).count(),
            root.join(OVERLAYS).display(),
            root.join(FOLDER).display(),
            root.join(FOLDER).display(),
        )),
    }
    Ok(())
}

impl Record {
    fn put(&mut self, photo: &PhotoInput, proposal: Option<&PosedProposal>) {
        let made = Proposed {
            photo: photo.hash.clone(),
            consistency: proposal.map(PosedProposal::consistency),
        };
        self.photos.insert(photo.file_name.clone(), made);
    }

    fn is_used(&self, root: &Path) -> bool {
        self.unsure.is_none() && is_filled(&root.join(FOLDER))
    }

    /// What is known of the mask of a photo that is used and lies there.
    fn kept(&self, root: &Path, photo: &PhotoInput) -> Option<&Proposed> {
        let known = self.photos.get(&photo.file_name)?;
        let file = root.join(FOLDER).join(format!("{}.png", photo.name));
        let same = known.photo == photo.hash && known.consistency.is_some();
        (same && self.is_used(root) && file.exists()).then_some(known)
    }

    /// Whether a photo has the mask that was made from it, or was without a pose then.
    fn has(&self, photo: &PhotoInput) -> bool {
        let known = self.photos.get(&photo.file_name);
        let known = known.filter(|known| known.photo == photo.hash);
        known.is_some_and(|known| known.consistency.is_none() || photo.mask.is_some())
    }
}

/// Puts the proposals in their place. A mask of the same photo that lies there stays: it may have been corrected.
fn keep(root: &Path, record: &Record, inputs: &Inputs, before: &Record) -> anyhow::Result<()> {
    let folder = root.join(if record.unsure.is_some() {
        UNSURE
    } else {
        FOLDER
    });
    let overlays = root.join(OVERLAYS);
    let partial = root.join(PARTIAL);
    if !record.photos.is_empty() {
        create_folder(&folder)?;
        create_folder(&overlays)?;
    }
    // Written first: what is missing beside it is proposed again.
    write_atomically(&root.join(RECORD), &seal(record)?)?;
    for photo in &inputs.photos {
        let file = format!("{}.png", photo.name);
        let (from, to) = (partial.join(&file), folder.join(&file));
        let known = before.photos.get(&photo.file_name);
        let same = known.is_some_and(|known| known.photo == photo.hash);
        if from.exists() && !(same && to.exists()) {
            std::fs::rename(partial.join(OVERLAYS).join(&file), overlays.join(&file))?;
            std::fs::rename(from, to)?;
        }
    }
    if partial.exists() {
        std::fs::remove_dir_all(&partial)?;
    }
    Ok(())
}

fn not_used(console: &Console, root: &Path, why: &str) {
    let mut text = format!(
        "warning: no masks are used, since what is the object is not sure ({why}); the whole frame is taken for it. Draw masks"
    );
    if root.join(UNSURE).exists() {
        text += &format!(", or correct those in {}", root.join(UNSURE).display());
    }
    text += ", and give them with --masks DIR; --masks none says that the whole frame is meant";
    console.note(&text);
}
