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
    let data = folder.display();
    assert!(
        named.is_none(),
        "{} needs {data}, which RILIEVO_DATA promises",
        this_test()
    );
    not_tested(&format!("{data}, which is not there"));
    None
}

/// Says that the test that runs needs something and does nothing without: in a line on stderr that the test harness does not
/// capture, and in the file that `RILIEVO_NOT_TESTED` names, whose lines a suite can count at its end.
pub fn not_tested(needs: &str) {
    let line = format!("NOT TESTED: {} needs {needs}\n", this_test());
    // Written as it is, since the harness would swallow `eprintln`.
    let _ = std::io::stderr().lock().write_all(line.as_bytes());
    if let Some(list) = std::env::var_os("RILIEVO_NOT_TESTED") {
        let list = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(list);
        let _ = list.and_then(|mut list| list.write_all(line.as_bytes()));
    }
}

fn this_test() -> String {
    std::thread::current().name().unwrap_or("a test").to_owned()
}

/// The topmost folder above this crate that has a manifest.
fn workspace() -> Option<&'static Path> {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .filter(|folder| folder.join("Cargo.toml").exists())
        .last()
}
