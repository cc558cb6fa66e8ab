//! Stage 1: `linear/NAME.exr`, `masks/NAME.png`, and the preflight in the manifest.

use super::artifacts::{checked_names, not_there};
use super::context::Context;
use super::errors::from_photos;
use super::inputs::{Inputs, PhotoInput};
use super::parallel::{Resources, divide_items, map_items};
use super::request::{MaskOrigin, Request};
use crate::exit::{Failure, Problem};
use crate::observe::Console;
use crate::store::{Item, StageWriter, StoreError, hash_bytes, hash_json};
use rayon::prelude::*;
use rilievo_io::{
    IoErrorKind, LinearFile, decode_photo_bytes, photo_size, read_mask, write_linear,
    write_linear_half, write_mask,
};
use rilievo_photos::{
    CutOut, GivenCamera, GivenMask, PhotoFacts, PhotosError, PhotosReport, PreparedPhoto,
    RejectedPhoto,
};
use rilievo_scene::{LinearImage, Observer, PhotoSet, Recorder, Silent, StageId};
use rilievo_segmentation::{Surroundings, surroundings};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Bytes per pixel while a photo is decoded, made linear and looked at.
const BYTES_PER_PX: u64 = 48;

/// What the manifest keeps of a photo.
#[derive(Debug, Serialize, Deserialize)]
enum Kept {
    Usable { facts: Box<PhotoFacts>, mask: bool },
    Rejected(RejectedPhoto),
}

/// Why one photo could not be prepared.
enum Trouble {
    /// The photo is left out; the others go on.
    Photo(Problem),
    /// A mask or camera that was asked for cannot be used: never go on silently without it.
    Request(Problem),
    /// The program or the disk failed.
    Fatal(anyhow::Error),
}

impl From<StoreError> for Trouble {
    fn from(error: StoreError) -> Self {
        Self::Fatal(error.into())
    }
}

/// Prepares every photo and reports on the set.
///
/// # Errors
/// Unusable masks, or no usable photo.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let inputs = context.inputs;
    for problem in &inputs.skipped {
        context.console.warn(StageId::Photos, problem.to_string());
    }
    for warning in &inputs.warnings {
        context.console.warn(StageId::Photos, warning);
    }
    let options = serde_json::to_value(&context.request.options.photos)?;
    let at_once = at_once(inputs, context.resources);
    let step = (StageId::Photos, "reading photos");
    let prepared = divide_items(&inputs.photos, at_once, step, context.console, |photo| {
        let key = hash_json(&(
            StageId::Photos.name(),
            rilievo_photos::VERSION,
            &options,
            Inputs::photo_hash(photo),
            photo.mask.is_some() || context.request.needs_masks(),
            context.request.masks_from == MaskOrigin::None,
        ));
        match one(context, writer, photo, key) {
            Ok(kept) => Ok(Ok(kept)),
            Err(Trouble::Request(problem)) => Ok(Err(problem)),
            Err(Trouble::Photo(problem)) => Ok(Ok(Kept::Rejected(rejected_photo(&problem)))),
            Err(Trouble::Fatal(error)) => Err(error),
        }
    })?;

    let mut usable = Vec::new();
    let mut rejected: Vec<RejectedPhoto> = inputs.unreadable.iter().map(rejected_photo).collect();
    let mut problems = Vec::new();
    for outcome in prepared {
        match outcome {
            Ok(Kept::Usable { facts, mask }) => {
                usable.push(from_disk(writer.dir(), *facts, mask)?);
            }
            Ok(Kept::Rejected(photo)) => rejected.push(photo),
            Err(problem) => problems.push(problem),
        }
    }
    if !problems.is_empty() {
        return Err(Failure::Input(problems).into());
    }
    for photo in &rejected {
        context.console.warn(
            StageId::Photos,
            format!("{} is left out: {}", photo.file, photo.reason),
        );
    }
    if usable.is_empty() {
        let problems = rejected.into_iter().map(|photo| Problem {
            file: photo.file.into(),
            reason: photo.reason,
        });
        return Err(Failure::Input(problems.collect()).into());
    }
    let options = &context.request.options.photos;
    let (_, mut report) =
        rilievo_photos::assemble(usable, options, context.console).map_err(from_photos)?;
    report.rejected = rejected;
    preflight(&report, context.console);
    Ok(serde_json::to_value(report)?)
}

/// Works on every photo, as many at a time as memory allows; `None` when the user asked to stop.
pub fn map_photos<R: Send>(
    inputs: &Inputs,
    resources: Resources,
    step: &str,
    observer: &dyn Observer,
    work: impl Fn(&PhotoInput) -> R + Sync,
) -> Option<Vec<R>> {
    map_items(
        &inputs.photos,
        at_once(inputs, resources),
        StageId::Photos,
        step,
        observer,
        work,
    )
}

fn at_once(inputs: &Inputs, resources: Resources) -> usize {
    resources.at_once(largest_photo_px(inputs) * BYTES_PER_PX)
}

/// The preflight alone: what the photos are, what to warn of, and every file that cannot be used,
/// without keeping anything.
///
/// # Errors
/// When the user asked to stop, or no photo is left to report on.
pub fn check(
    request: &Request,
    inputs: &Inputs,
    resources: Resources,
    console: &Console,
) -> anyhow::Result<(PhotosReport, Vec<String>, Vec<Problem>)> {
    let checked = map_photos(inputs, resources, "reading photos", console, |photo| {
        // Only the facts are kept: a large set need not fit into memory.
        prepare(request, photo).map(|prepared| PreparedPhoto {
            pixels: Arc::new(LinearFile {
                path: photo.path.clone(),
            }),
            ..prepared
        })
    })
    .ok_or(Failure::Interrupted)?;
    let mut usable = Vec::new();
    let mut problems = inputs.unreadable.clone();
    for outcome in checked {
        match outcome {
            Ok(prepared) => usable.push(prepared),
            Err(Trouble::Photo(problem) | Trouble::Request(problem)) => problems.push(problem),
            Err(Trouble::Fatal(error)) => return Err(error),
        }
    }
    if usable.is_empty() {
        return Err(Failure::Input(problems).into());
    }
    // The preflight's table has a place for them.
    let events = Recorder::default();
    let (_, mut report) =
        rilievo_photos::assemble(usable, &request.options.photos, &events).map_err(from_photos)?;
    report.rejected = problems.iter().map(rejected_photo).collect();
    Ok((report, events.warnings(), problems))
}

/// A photo's linear pixels, without keeping anything.
///
/// # Errors
/// Why the photo, or the mask or camera that was asked for with it, cannot be used.
pub fn linear_photo(request: &Request, photo: &PhotoInput) -> anyhow::Result<Arc<LinearImage>> {
    match prepare(request, photo) {
        Ok(prepared) => Ok(prepared.pixels.load()?),
        Err(Trouble::Photo(problem) | Trouble::Request(problem)) => {
            Err(Failure::Input(vec![problem]).into())
        }
        Err(Trouble::Fatal(error)) => Err(error),
    }
}

/// Photos of a committed stage 1.
pub fn load(context: &Context<'_>) -> anyhow::Result<PhotoSet> {
    load_with(context, true)
}

/// The same; without their masks, which all lie in memory, unless `masks`.
pub fn load_with(context: &Context<'_>, masks: bool) -> anyhow::Result<PhotoSet> {
    let dir = context.run.stage_dir(StageId::Photos);
    let manifest = context
        .run
        .manifest(StageId::Photos)?
        .ok_or_else(|| not_there(StageId::Photos))?;
    let names = manifest.items.keys().map(String::as_str);
    checked_names(context.run, StageId::Photos, "manifest.json", names)?;
    let mut usable = Vec::new();
    for item in manifest.items.into_values() {
        let kept = serde_json::from_value(item.facts).map_err(|error| StoreError::Damaged {
            path: dir.join("manifest.json"),
            reason: error.to_string(),
        })?;
        if let Kept::Usable { facts, mask } = kept {
            let name = [&*facts.name];
            checked_names(context.run, StageId::Photos, "manifest.json", name)?;
            usable.push(from_disk(&dir, *facts, mask && masks)?);
        }
    }
    // Stage 1 has issued the warnings.
    let options = &context.request.options.photos;
    let (set, _) = rilievo_photos::assemble(usable, options, &Silent).map_err(from_photos)?;
    Ok(set)
}

fn from_disk(dir: &Path, facts: PhotoFacts, mask: bool) -> Result<PreparedPhoto, Failure> {
    let mask = mask.then(|| read_mask(&dir.join(mask_file(&facts.name))));
    let mask = mask.transpose()?;
    Ok(PreparedPhoto {
        pixels: Arc::new(LinearFile {
            path: dir.join(linear_file(&facts.name)),
        }),
        mask: mask.map(|mask| Arc::new(mask.packed())),
        facts,
    })
}

fn rejected_photo(problem: &Problem) -> RejectedPhoto {
    RejectedPhoto {
        file: problem.file.display().to_string(),
        reason: problem.reason.clone(),
    }
}

fn linear_file(name: &str) -> String {
    format!("linear/{name}.exr")
}

fn mask_file(name: &str) -> String {
    format!("masks/{name}.png")
}

/// One photo: taken over from an earlier run, or decoded, checked and written.
fn one(
    context: &Context<'_>,
    writer: &StageWriter,
    photo: &PhotoInput,
    key: String,
) -> Result<Kept, Trouble> {
    if let Some(item) = writer.reuse(&photo.name, &key)?
        && let Ok(kept) = serde_json::from_value(item.facts)
    {
        return Ok(kept);
    }
    let (kept, files) = match prepare(context.request, photo) {
        Ok(prepared) => write(writer, prepared)?,
        Err(Trouble::Photo(problem)) => (Kept::Rejected(rejected_photo(&problem)), Vec::new()),
        Err(other) => return Err(other),
    };
    let facts = serde_json::to_value(&kept).map_err(|error| Trouble::Fatal(error.into()))?;
    let item = Item {
        key,
        files,
        hashes: Vec::new(),
        facts,
    };
    writer.finish(&photo.name, item)?;
    Ok(kept)
}

fn prepare(request: &Request, photo: &PhotoInput) -> Result<PreparedPhoto, Trouble> {
    let of_photo = |reason: String| Problem {
        file: photo.path.clone(),
        reason,
    };
    let bytes = std::fs::read(&photo.path)
        .map_err(|error| Trouble::Photo(of_photo(format!("cannot be read: {error}"))))?;
    // The key of the photo's share holds the hash from the scan: refuse a file that changed since.
    if hash_bytes(&bytes) != photo.hash {
        let reason = "was replaced while it was read; run the same command again";
        return Err(Trouble::Request(of_photo(reason.to_owned())));
    }
    let mut decoded =
        decode_photo_bytes(&photo.path, &bytes).map_err(|error| match error.kind {
            IoErrorKind::Input => Trouble::Photo(of_photo(Problem::from(error).reason)),
            // Not the photo's fault: to leave it out would be remembered.
            IoErrorKind::Read | IoErrorKind::Write => Trouble::Fatal(Failure::from(error).into()),
        })?;
    decoded.file_name.clone_from(&photo.file_name);
    let mut mask_path = photo.path.clone();
    let mut cut_out = None;
    let mask = match &photo.mask {
        Some((path, _)) => {
            mask_path = path.clone();
            Some(GivenMask {
                mask: read_mask(path).map_err(|error| Trouble::Request(error.into()))?,
                may_be_upright: request.masks_from == MaskOrigin::Given,
            })
        }
        None if decoded.alpha.is_some() => decoded.alpha.clone().map(GivenMask::as_stored),
        None => match &request.masks {
            Some(folder) if request.needs_masks() => {
                return Err(Trouble::Request(of_photo(format!(
                    "has no mask in {}; name it {}.png",
                    folder.display(),
                    photo.name
                ))));
            }
            _ if request.masks_from == MaskOrigin::None => None,
            _ => {
                let found = surroundings(&decoded);
                match found.map_err(|error| Trouble::Fatal(error.into()))? {
                    Surroundings::Photographed => None,
                    Surroundings::Unsure { .. } => {
                        cut_out = Some(CutOut::Unsure);
                        None
                    }
                    Surroundings::Flat { mask, .. } => {
                        cut_out = Some(CutOut::Taken);
                        Some(GivenMask::as_stored(mask))
                    }
                }
            }
        },
    };
    let camera = photo.camera.as_ref().map(|camera| GivenCamera {
        intrinsics: camera.intrinsics,
        cam_from_world: camera.cam_from_world,
    });
    let options = &request.options.photos;
    let prepared = rilievo_photos::prepare(decoded, mask, camera, options);
    let prepared = prepared.map(|mut prepared| {
        prepared.facts.cut_out = cut_out;
        prepared
    });
    prepared.map_err(|error| match error {
        PhotosError::MaskMissing { .. }
        | PhotosError::MaskSize { .. }
        | PhotosError::MaskEmpty { .. }
        | PhotosError::MaskFull { .. }
        | PhotosError::MaskInverted { .. }
        | PhotosError::MaskNoise { .. } => Trouble::Request(Problem {
            file: mask_path,
            reason: error.to_string(),
        }),
        PhotosError::CameraSize { .. } | PhotosError::CameraFocal { .. } => {
            Trouble::Request(Problem {
                file: request
                    .cameras
                    .clone()
                    .unwrap_or_else(|| photo.path.clone()),
                reason: error.to_string(),
            })
        }
        other => Trouble::Photo(of_photo(other.to_string())),
    })
}

/// Share of a value by which rounding to 16-bit floats may lower it.
const HALF_ROUNDING: f32 = 1.0 / 2048.0;

fn write(
    writer: &StageWriter,
    mut prepared: PreparedPhoto,
) -> Result<(Kept, Vec<String>), Trouble> {
    let name = prepared.facts.name.clone();
    let image = prepared
        .pixels
        .load()
        .map_err(|error| Trouble::Fatal(error.into()))?;
    let fatal = |error| Trouble::Fatal(Failure::from(error).into());
    let linear = linear_file(&name);
    let write_image = if prepared.facts.bits == 8 {
        // A clipped value may be stored a little lower; the code below it lies much lower still.
        prepared.facts.clip_level *= 1.0 - HALF_ROUNDING;
        write_linear_half
    } else {
        write_linear
    };
    write_image(&writer.path(&linear)?, &image).map_err(fatal)?;
    let mut files = vec![linear];
    if let Some(mask) = &prepared.mask {
        let file = mask_file(&name);
        write_mask(&writer.path(&file)?, &mask.unpacked()).map_err(fatal)?;
        files.push(file);
    }
    let kept = Kept::Usable {
        mask: prepared.mask.is_some(),
        facts: Box::new(prepared.facts),
    };
    Ok((kept, files))
}

/// Pixels of the largest photo, by the files' headers; a file whose header lacks them (camera RAW)
/// holds a byte a pixel and more.
fn largest_photo_px(inputs: &Inputs) -> u64 {
    inputs
        .photos
        .par_iter()
        .filter_map(|photo| match photo_size(&photo.path) {
            Some((width, height)) => Some((width * height) as u64),
            None => Some(std::fs::metadata(&photo.path).ok()?.len()),
        })
        .max()
        .unwrap_or(0)
}

/// One line per photo: what was found before anything is computed.
fn preflight(report: &PhotosReport, console: &Console) {
    for photo in &report.photos {
        let mask = photo.mask_coverage.map_or("no mask".to_owned(), |share| {
            format!("mask {:.1} %", 100.0 * share)
        });
        let of_object = photo
            .clipped_share_on_object
            .map_or(String::new(), |share| {
                format!("{:.2} % of the object clipped, ", 100.0 * share)
            });
        console.note(&format!(
            "  {}: {} x {}, focal {:.0} px ({}), {mask}, {of_object}{:.2} % of the photo clipped",
            photo.file_name,
            photo.width,
            photo.height,
            photo.intrinsics.focal_px(),
            photo.focal_note,
            100.0 * photo.clipped_share,
        ));
    }
    if report.num_masks > 0 {
        console.note(&format!(
            "  masks: {}/{} matched, mean coverage {:.1} %",
            report.num_masks,
            report.photos.len(),
            100.0 * report.mean_mask_coverage.unwrap_or(0.0)
        ));
    }
}
