//! Source files, and what of them counts.

use std::path::{Path, PathBuf};

/// Source text without comments and without items under `#[cfg(test)]`, which formatted sources end with
/// `;` or with a brace as far to the right as they begin.
pub fn without_tests(text: &str) -> String {
    let mut kept = String::new();
    let mut end: Option<String> = None;
    for line in text.lines() {
        let indent = &line[..line.len() - line.trim_start().len()];
        match &end {
            Some(brace) => {
                let is_short = line.ends_with(';')
                    && line.starts_with(brace.trim_end_matches('}'))
                    && !line[brace.len() - 1..].starts_with(' ');
                if line == brace.as_str() || is_short {
                    end = None;
                }
            }
            None if line.trim() == "#[cfg(test)]" => end = Some(format!("{indent}}}")),
            None => {
                kept.push_str(line.split("//").next().unwrap_or_default());
                kept.push('\n');
            }
        }
    }
    kept
}

pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).expect("sources exist").flatten() {
        let path = entry.path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            files.push(path);
        }
    }
    files
}
