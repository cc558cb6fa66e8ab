//! Stage 2: `keypoints/NAME.bin` (postcard), `pairs.bin`.

use super::artifacts::{from_binary, not_there, read_binary, write_binary};
use super::context::Context;
use super::errors::from_features;
use super::parallel::divide_items;
use crate::store::{Item, RunDir, StageWriter, StoreError, hash_json};
use anyhow::Context as _;
use rilievo_features::FeaturesOptions;
use rilievo_scene::{FeatureMatches, Observer, PairMatches, Photo, PhotoKeypoints, StageId};

/// Bytes per pixel at the peak of SIFT with its upsampled octave.
const BYTES_PER_PX: u64 = 260;

const PAIRS: &str = "pairs.bin";

/// Detects keypoints photo by photo and matches them.
pub fn run(context: &Context<'_>, writer: &StageWriter) -> anyhow::Result<serde_json::Value> {
    let photos = super::photos::load(context)?;
    let options = &context.request.options.features;
    let manifest = context
        .run
        .manifest(StageId::Photos)?
        .ok_or_else(|| not_there(StageId::Photos))?;
    let largest = photos
        .photos
        .iter()
        .map(|photo| (photo.intrinsics.width * photo.intrinsics.height) as u64)
        .max()
        .unwrap_or(0);
    let gains = &manifest.report["exposure_gains"];
    let numbered: Vec<(usize, &Photo)> = photos.photos.iter().enumerate().collect();
    let keypoints = divide_items(
        &numbered,
        context.resources.at_once(largest * BYTES_PER_PX),
        (StageId::Features, "detecting keypoints"),
        context.console,
        |&(idx, photo)| {
            let key = hash_json(&(
                StageId::Features.name(),
                rilievo_features::VERSION,
                detection_options(options),
                manifest.items.get(&photo.name).map(|item| &item.key),
                // The exposure gain is not the photo's own: it depends on the others.
                gains.get(idx),
            ));
            one(context, writer, photo, key)
        },
    )?;
    let (matches, report) =
        rilievo_features::match_photos(&photos, keypoints, options, context.console)
            .map_err(from_features)?;
    if context.console.team().is_first() {
        write_binary(writer, PAIRS, &matches.pairs)?;
    }
    Ok(serde_json::to_value(report)?)
}

/// Keypoints and matches of a committed stage 2, for the photos of stage 1.
pub fn load(context: &Context<'_>, photos: &[Photo]) -> anyhow::Result<FeatureMatches> {
    let keypoints = photos
        .iter()
        .map(|photo| load_keypoints(context.run, &photo.name))
        .collect::<anyhow::Result<Vec<_>>>()?;
    Ok(FeatureMatches {
        photos: keypoints,
        pairs: load_pairs(context.run)?,
    })
}

/// What decides the keypoints; options of matching alone redo no detection. Every option is named,
/// so that a new one is put on one side or the other.
fn detection_options(options: &FeaturesOptions) -> impl serde::Serialize {
    let FeaturesOptions {
        region,
        max_num_keypoints,
        contrast_threshold,
        max_detection_mpx,
        max_ratio: _,
        pairs: _,
        pair_limits: _,
    } = options.clone();
    (
        region,
        max_num_keypoints,
        contrast_threshold,
        max_detection_mpx,
    )
}

fn keypoints_file(name: &str) -> String {
    format!("keypoints/{name}.bin")
}

fn one(
    context: &Context<'_>,
    writer: &StageWriter,
    photo: &Photo,
    key: String,
) -> anyhow::Result<PhotoKeypoints> {
    let file = keypoints_file(&photo.name);
    if writer.reuse(&photo.name, &key)?.is_some() {
        let path = writer.dir().join(&file);
        let bytes = std::fs::read(&path).map_err(StoreError::files("read", &path))?;
        return from_binary(&path, &bytes);
    }
    let keypoints = rilievo_features::detect(photo, &context.request.options.features)
        .map_err(from_features)
        .with_context(|| format!("detecting keypoints in {}", photo.file_name))?;
    write_binary(writer, &file, &keypoints)?;
    let item = Item {
        key,
        files: vec![file],
        hashes: Vec::new(),
        facts: serde_json::json!({"num_keypoints": keypoints.keypoints.len()}),
    };
    writer.finish(&photo.name, item)?;
    Ok(keypoints)
}

/// Keypoints of one photo, by its name without ending.
pub fn load_keypoints(run: &RunDir, name: &str) -> anyhow::Result<PhotoKeypoints> {
    read_binary(run, StageId::Features, &keypoints_file(name))
}

/// Verified matches of all pairs.
pub fn load_pairs(run: &RunDir) -> anyhow::Result<Vec<PairMatches>> {
    read_binary(run, StageId::Features, PAIRS)
}
