//! Reading and writing what stages hand to each other, as JSON or in compact binary form.

use crate::exit::Failure;
use crate::store::{RunDir, StageWriter, StoreError, is_name, own_file};
use rilievo_scene::StageId;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Writes bytes to a file of a stage.
pub fn write(writer: &StageWriter, file: &str, bytes: &[u8]) -> Result<(), StoreError> {
    let path = writer.path(file)?;
    std::fs::write(&path, bytes).map_err(StoreError::files("write", &path))
}

/// Writes a value as JSON.
pub fn write_json(writer: &StageWriter, file: &str, value: &impl Serialize) -> anyhow::Result<()> {
    Ok(write(writer, file, &serde_json::to_vec(value)?)?)
}

/// The same with line breaks, for files that people read.
pub fn write_text(writer: &StageWriter, file: &str, value: &impl Serialize) -> anyhow::Result<()> {
    Ok(write(writer, file, &serde_json::to_vec_pretty(value)?)?)
}

/// Writes a value in the compact binary form that is kept for descriptors.
pub fn write_binary(
    writer: &StageWriter,
    file: &str,
    value: &impl Serialize,
) -> anyhow::Result<()> {
    Ok(write(writer, file, &postcard::to_stdvec(value)?)?)
}

/// A value of a committed stage that was written as JSON.
pub fn read_json<T: DeserializeOwned>(
    run: &RunDir,
    stage: StageId,
    file: &str,
) -> anyhow::Result<T> {
    let path = run.stage_dir(stage).join(file);
    let text = own_file(&path)?.ok_or_else(|| not_there(stage))?;
    Ok(serde_json::from_slice(&text).map_err(damaged(&path))?)
}

/// A value of a committed stage that was written in binary form.
pub fn read_binary<T: DeserializeOwned>(
    run: &RunDir,
    stage: StageId,
    file: &str,
) -> anyhow::Result<T> {
    let path = run.stage_dir(stage).join(file);
    let bytes = own_file(&path)?.ok_or_else(|| not_there(stage))?;
    from_binary(&path, &bytes)
}

/// A value in binary form.
///
/// # Errors
/// When the bytes are damaged; `path` names them.
pub fn from_binary<T: DeserializeOwned>(path: &Path, bytes: &[u8]) -> anyhow::Result<T> {
    Ok(postcard::from_bytes(bytes).map_err(damaged(path))?)
}

/// Refuses a name that results are called by and that would lead elsewhere.
///
/// # Errors
/// Names the file that holds it.
pub fn checked_names<'a>(
    run: &RunDir,
    stage: StageId,
    file: &str,
    names: impl IntoIterator<Item = &'a str>,
) -> Result<(), StoreError> {
    match names.into_iter().find(|name| !is_name(name)) {
        None => Ok(()),
        Some(name) => Err(damaged(&run.stage_dir(stage).join(file))(format!(
            "{name:?} is no photo's name"
        ))),
    }
}

fn damaged<E: std::fmt::Display>(path: &Path) -> impl FnOnce(E) -> StoreError {
    let path = path.to_path_buf();
    move |reason| StoreError::Damaged {
        path,
        reason: reason.to_string(),
    }
}

/// The result of a stage that another one needs does not exist.
pub fn not_there(stage: StageId) -> Failure {
    Failure::RunDirectory(format!(
        "stage {stage} has no result yet; `rilievo reconstruct` makes it, or `rilievo run {stage}`"
    ))
}
