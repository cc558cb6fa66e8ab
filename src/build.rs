//! Names the commit it is built from, where it is built from a repository, and with which features.

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
    let features = features();
    let version = env!("CARGO_PKG_VERSION");
    let (short, long) = match commit {
        Some(commit) => (
            format!("{version} ({commit})"),
            format!("{version} ({commit}; {features})"),
        ),
        None => (version.to_owned(), format!("{version} ({features})")),
    };
    println!("cargo::rustc-env=RILIEVO_VERSION={short}");
    println!("cargo::rustc-env=RILIEVO_LONG_VERSION={long}");
}

/// The optional features of this build, as cargo names them.
fn features() -> String {
    let mut names: Vec<String> = std::env::vars_os()
        .filter_map(|(name, _)| name.into_string().ok())
        .filter_map(|name| Some(name.strip_prefix("CARGO_FEATURE_")?.to_lowercase()))
        .filter(|name| name != "default")
        .collect();
    names.sort();
    match names.as_slice() {
        [] => "no optional features".to_owned(),
        names => format!("features: {}", names.join(", ")),
    }
}

/// What git says; nothing where there is no git or no repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}
