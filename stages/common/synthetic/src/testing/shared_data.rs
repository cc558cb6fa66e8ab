//! The data folder beside the repository, which may be absent.

use std::path::{Path, PathBuf};

/// A data set of the shared folder; `None`, with a message, where it is absent.
pub fn shared_data(name: &str) -> Option<PathBuf> {
    // The workspace is the topmost folder above the crate that has a manifest.
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .filter(|folder| folder.join("Cargo.toml").exists())
        .last()?;
    let folder = workspace.parent()?.join("shared/data").join(name);
    if !folder.is_dir() {
        eprintln!("skipped: no {}", folder.display());
        return None;
    }
    Some(folder)
}
