//! `manifest.json` of a committed stage: what it was made from, what it found, and the content of
//! every file, so that damage is found before it is read.

use super::error::StoreError;
use super::files::{hash_file, is_inside, own_file};
use super::fingerprint::Ingredients;
use super::sealed::{seal, unseal};
use crate::cost::Estimate;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the layout and of the manifests; another one is refused, never guessed at.
pub const FORMAT_VERSION: u64 = 2;

/// One photo's share of a stage that works photo by photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Item {
    /// Hash of everything that decides this item.
    pub key: String,
    /// Its files, relative to the stage's folder.
    pub files: Vec<String>,
    /// Content hashes of `files`, in their order; the store fills them in.
    #[serde(default)]
    pub hashes: Vec<String>,
    /// What the program needs to know of it beside the files.
    pub facts: serde_json::Value,
}

/// A file as it was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Size.
    pub bytes: u64,
    /// Content hash, hexadecimal.
    pub blake3: String,
}

/// How closely a stage's files are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// That they are there with their sizes: no file is read.
    Sizes,
    /// That they have the content that they were written with.
    Contents,
}

/// Contents of `manifest.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the run directory's format.
    pub format_version: u64,
    /// Program and version that wrote it.
    pub program: String,
    /// Hash of `ingredients`.
    pub fingerprint: String,
    /// What decided the result.
    pub ingredients: Ingredients,
    /// Photo by photo results, by photo name.
    pub items: BTreeMap<String, Item>,
    /// Wall time of the stage, seconds.
    pub seconds: f64,
    /// CPU time of the process during the stage, seconds; of several processes the first one's. `None` in manifests that
    /// lack it.
    #[serde(default)]
    pub cpu_seconds: Option<f64>,
    /// What the whole run was expected to cost when the stage was made, where that was estimated.
    #[serde(default)]
    pub expected: Option<Estimate>,
    /// Threads that worked on it.
    pub threads: usize,
    /// Largest resident memory while the stage ran, bytes; `None` where the system does not report
    /// it.
    pub peak_memory_bytes: Option<u64>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Every artifact, by its path relative to the stage's folder.
    pub files: BTreeMap<String, FileRecord>,
    /// The stage's report.
    pub report: serde_json::Value,
}

/// File name inside a stage's folder.
pub const MANIFEST: &str = "manifest.json";

impl Manifest {
    /// Reads the manifest of a stage's folder; `None` when there is none.
    ///
    /// # Errors
    /// When it cannot be read, does not have the content that it was written with, or is of another
    /// version.
    pub fn read(stage_dir: &Path) -> Result<Option<Self>, StoreError> {
        let path = stage_dir.join(MANIFEST);
        let text = match own_file(&path)? {
            None => return Ok(None),
            Some(text) => text,
        };
        let damaged = |reason| StoreError::Damaged {
            path: path.clone(),
            reason,
        };
        let value = unseal(&text).map_err(damaged)?;
        match value["format_version"].as_u64() {
            Some(FORMAT_VERSION) => {}
            found => {
                return Err(StoreError::OtherVersion {
                    path: stage_dir.to_path_buf(),
                    found: found.unwrap_or_default(),
                    known: FORMAT_VERSION,
                });
            }
        }
        let manifest: Self =
            serde_json::from_value(value).map_err(|error| damaged(error.to_string()))?;
        let items = manifest.items.values().flat_map(|item| &item.files);
        match items.chain(manifest.files.keys()).find(|f| !is_inside(f)) {
            Some(outside) => Err(damaged(format!("{outside:?} is no file of this folder"))),
            None => Ok(Some(manifest)),
        }
    }

    /// The text of `manifest.json`.
    pub(super) fn to_text(&self) -> serde_json::Result<Vec<u8>> {
        seal(self)
    }

    /// First artifact that is gone or damaged, with the reason.
    pub fn damage(&self, stage_dir: &Path, look: Look) -> Option<String> {
        self.files
            .par_iter()
            .find_map_first(|(name, record)| record.damage(stage_dir, name, look))
    }
}

impl FileRecord {
    fn damage(&self, stage_dir: &Path, name: &str, look: Look) -> Option<String> {
        let path = stage_dir.join(name);
        let Ok(found) = std::fs::symlink_metadata(&path) else {
            return Some(format!("{name} is gone"));
        };
        if !found.is_file() {
            return Some(format!("{name} is no file"));
        }
        if found.len() != self.bytes {
            return Some(format!(
                "{name} has {} bytes instead of {}",
                found.len(),
                self.bytes
            ));
        }
        if look == Look::Sizes {
            return None;
        }
        match hash_file(&path) {
            Err(error) => Some(error.to_string()),
            Ok(hash) if hash != self.blake3 => Some(format!(
                "{name} does not have the content that it was written with"
            )),
            Ok(_) => None,
        }
    }
}
