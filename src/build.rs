//! Tells the program which commit it is built from, where it is built from a repository.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=src/build.rs");
    // Where HEAD stands: its own file and, for a branch, the log of its moves.
    for file in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", file]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let commit = git(&["show", "--no-patch", "--format=%h of %cs", "HEAD"]);
    let version = env!("CARGO_PKG_VERSION");
    println!(
        "cargo::rustc-env=RILIEVO_VERSION={}",
        commit.map_or(version.to_owned(), |commit| format!("{version} ({commit})"))
    );
}

/// What git says; nothing where there is no git or no repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}
