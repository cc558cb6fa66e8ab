//! What `rilievo evaluate` leaves in a run directory; it goes with the results that it judged.

use super::error::StoreError;
use std::path::{Path, PathBuf};

/// Where `rilievo evaluate` writes the cloud coloured by its errors.
pub fn deviation_file(root: &Path) -> PathBuf {
    root.join("evaluation").join("deviation.ply")
}

/// Deletes an evaluation, since the results that it judged go.
pub fn drop_evaluation(root: &Path) -> Result<(), StoreError> {
    let file = deviation_file(root);
    match std::fs::remove_file(&file) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(StoreError::files("delete", &file)(error));
        }
        _ => {}
    }
    if let Some(folder) = file.parent() {
        // Fails when somebody else has something there, as it should.
        let _ = std::fs::remove_dir(folder);
    }
    Ok(())
}
