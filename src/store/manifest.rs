//! `manifest.json` of a committed stage: what it was made from, and what it found.

use super::error::StoreError;
use super::fingerprint::Ingredients;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

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
    /// Seed of every random stream.
    pub seed: u64,
    /// Wall time of the stage, seconds.
    pub seconds: f64,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Size in bytes of every artifact, by its path relative to the stage's folder.
    pub files: BTreeMap<String, u64>,
    /// The stage's report.
    pub report: serde_json::Value,
}

/// File name inside a stage's folder.
pub const MANIFEST: &str = "manifest.json";

impl Manifest {
    /// Reads the manifest of a stage's folder; `None` when there is none.
    ///
    /// # Errors
    /// When it cannot be read or understood.
    pub fn read(stage_dir: &Path) -> Result<Option<Self>, StoreError> {
        let path = stage_dir.join(MANIFEST);
        let text = match std::fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(StoreError::files("read", &path)(error)),
        };
        serde_json::from_slice(&text)
            .map(Some)
            .map_err(|error| StoreError::Damaged {
                path,
                reason: error.to_string(),
            })
    }

    /// First artifact that is gone or has another size, with the reason.
    pub fn damage(&self, stage_dir: &Path) -> Option<String> {
        self.files.iter().find_map(
            |(name, size)| match std::fs::metadata(stage_dir.join(name)) {
                Err(_) => Some(format!("{name} is gone")),
                Ok(found) if found.len() != *size => Some(format!(
                    "{name} has {} bytes instead of {size}",
                    found.len()
                )),
                Ok(_) => None,
            },
        )
    }
}
