//! The data folder beside the repository, which may be absent.

use std::io::Write;
use std::path::{Path, PathBuf};

/// A data set of the folder that `RILIEVO_DATA` names, or else of `shared/data` beside the repository; `None` where it is
/// absent, with a line on stderr that the test harness does not capture.
///
/// # Panics
/// Where `RILIEVO_DATA` is set and lacks the data set: who names the folder wants the tests that need it.
pub fn shared_data(name: &str) -> Option<PathBuf> {
    let named = std::env::var_os("RILIEVO_DATA").map(PathBuf::from);
    let folder = match &named {
        Some(data) => data.join(name),
        None => workspace()?.parent()?.join("shared/data").join(name),
    };
    if folder.is_dir() {
        return Some(folder);
    }
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    let data = folder.display();
    assert!(
        named.is_none(),
        "{test} needs {data}, which RILIEVO_DATA promises"
    );
    let line = format!("NOT TESTED: {test} needs {data}, which is not there\n");
    // Written as it is, since the harness would swallow `eprintln`.
    let _ = std::io::stderr().lock().write_all(line.as_bytes());
    None
}

/// The topmost folder above this crate that has a manifest.
fn workspace() -> Option<&'static Path> {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .filter(|folder| folder.join("Cargo.toml").exists())
        .last()
}
