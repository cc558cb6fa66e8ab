//! `run.json`: what was asked for. It is kept twice, since without it no stage can be continued.

use super::error::StoreError;
use super::files::{absolute, own_file, write_atomically};
use super::manifest::FORMAT_VERSION;
use super::sealed::{seal, unseal};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// File that marks a run directory.
const RUN_FILE: &str = "run.json";
/// Its copy.
const COPY: &str = ".run.json";

/// What was asked for, as it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct RunFile {
    pub request: Value,
    /// Where the run directory stood when it was written, absolute.
    pub root: Value,
    /// Why it was taken from the copy, where it was.
    pub repaired: Option<String>,
}

impl RunFile {
    /// Whether a folder is marked as a run directory.
    pub fn marks(root: &Path) -> bool {
        [RUN_FILE, COPY]
            .iter()
            .any(|name| std::fs::symlink_metadata(root.join(name)).is_ok())
    }

    /// Reads `run.json`, or its copy where it is damaged or gone.
    ///
    /// # Errors
    /// When both are absent, damaged, or of another program or version.
    pub fn read(root: &Path) -> Result<Self, StoreError> {
        let why = match read_one(&root.join(RUN_FILE)) {
            Ok(found) => return Ok(found),
            Err(why) => why,
        };
        match read_one(&root.join(COPY)) {
            Ok(copy) => Ok(Self {
                repaired: Some(match why {
                    StoreError::DamagedRequest { reason, .. } => format!(
                        "{} is damaged ({reason}): its copy is used",
                        root.join(RUN_FILE).display()
                    ),
                    other => format!("{other}: its copy {COPY} is used"),
                }),
                ..copy
            }),
            Err(_) => Err(why),
        }
    }

    /// Writes what is asked, the copy first; untouched where both say the same already.
    pub fn write(root: &Path, request: &impl Serialize) -> Result<(), StoreError> {
        let file = root.join(RUN_FILE);
        let place = absolute(root)?;
        let text = seal(&serde_json::json!({
            "program": "rilievo",
            "format_version": FORMAT_VERSION,
            "root": crate::paths::to_json(&place),
            "request": request,
        }));
        let text = text.map_err(|error| StoreError::files("write", &file)(error.into()))?;
        for path in [root.join(COPY), file] {
            // What cannot be read makes way.
            if own_file(&path).ok().flatten().as_deref() != Some(&text) {
                write_atomically(&path, &text)?;
            }
        }
        Ok(())
    }
}

fn read_one(path: &Path) -> Result<RunFile, StoreError> {
    let root = || path.parent().map_or(PathBuf::new(), Path::to_path_buf);
    let text = own_file(path)?.ok_or_else(|| StoreError::Missing {
        path: root(),
        holds_results: false,
    })?;
    // Another program's or version's file need not hold a checksum.
    if let Ok(value) = serde_json::from_slice::<Value>(&text) {
        let version = value["format_version"].as_u64();
        match (value["program"].as_str(), version) {
            (Some("rilievo"), Some(found)) if found != FORMAT_VERSION => {
                return Err(StoreError::OtherVersion {
                    path: root(),
                    found,
                    known: FORMAT_VERSION,
                });
            }
            (Some(program), _) if program != "rilievo" && value.get("checksum").is_none() => {
                return Err(StoreError::NotARun { path: root() });
            }
            _ => {}
        }
    }
    let mut value = unseal(&text).map_err(|reason| StoreError::DamagedRequest {
        path: path.to_path_buf(),
        reason,
    })?;
    Ok(RunFile {
        request: value["request"].take(),
        root: value["root"].take(),
        repaired: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Value {
        serde_json::json!({"photos": ["a"], "noise": 0.02})
    }

    #[test]
    fn one_damaged_file_costs_nothing_and_two_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        assert!(matches!(
            RunFile::read(root),
            Err(StoreError::Missing { .. })
        ));
        RunFile::write(root, &request()).unwrap();
        let whole = std::fs::read(root.join(RUN_FILE)).unwrap();
        assert_eq!(RunFile::read(root).unwrap().request, request());

        let digit = String::from_utf8(whole.clone())
            .unwrap()
            .replace("0.02", "0.03");
        for text in ["", "{}", "{\"program\": \"ril", digit.as_str()] {
            std::fs::write(root.join(RUN_FILE), text).unwrap();
            let found = RunFile::read(root).unwrap();
            assert_eq!(found.request, request(), "{text}");
            assert!(found.repaired.unwrap().contains("damaged"), "{text}");
        }
        std::fs::remove_file(root.join(RUN_FILE)).unwrap();
        assert!(RunFile::read(root).unwrap().repaired.is_some());
        RunFile::write(root, &request()).unwrap();
        assert_eq!(std::fs::read(root.join(RUN_FILE)).unwrap(), whole);

        std::fs::write(root.join(RUN_FILE), "{}").unwrap();
        std::fs::write(root.join(COPY), "{}").unwrap();
        assert!(matches!(
            RunFile::read(root),
            Err(StoreError::DamagedRequest { .. })
        ));
    }

    #[test]
    fn another_version_is_told_and_a_flipped_digit_of_it_is_damage() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let newer = r#"{"program": "rilievo", "format_version": 99}"#;
        std::fs::write(root.join(RUN_FILE), newer).unwrap();
        assert!(matches!(
            RunFile::read(root),
            Err(StoreError::OtherVersion { found: 99, .. })
        ));
        RunFile::write(root, &request()).unwrap();
        std::fs::write(root.join(RUN_FILE), newer).unwrap();
        assert_eq!(RunFile::read(root).unwrap().request, request());
    }
}
