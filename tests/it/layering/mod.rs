//! The layering of ARCHITECTURE.md, read from manifests and sources: a stage never imports another one, nor
//! anything that knows files; the Python package imports the program alone; and no files of a crate import each other
//! in a circle.

mod circles;
mod sources;

use sources::{rust_files, without_tests};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Crates of this workspace that a manifest depends on outside its tests; the program is one of them.
fn own_dependencies(manifest: &Path) -> (String, BTreeSet<String>) {
    let text = std::fs::read_to_string(manifest).expect("a manifest can be read");
    let value: toml::Table = text.parse().expect("a manifest is TOML");
    let name = value["package"]["name"]
        .as_str()
        .expect("a name")
        .to_owned();
    let dependencies = value
        .get("dependencies")
        .and_then(toml::Value::as_table)
        .into_iter()
        .flat_map(|table| table.keys().cloned())
        .filter(|name| name == "rilievo" || name.starts_with("rilievo-"))
        .collect();
    (name, dependencies)
}

fn manifests(folder: &str) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut found: Vec<PathBuf> = std::fs::read_dir(&root)
        .expect("the folder exists")
        .flatten()
        .map(|entry| entry.path().join("Cargo.toml"))
        .filter(|path| path.exists())
        .collect();
    found.sort();
    found
}

fn allowed(name: &str) -> BTreeSet<&'static str> {
    match name {
        "rilievo-scene" => [].into(),
        "rilievo-photometry"
        | "rilievo-numerics"
        | "rilievo-stereo"
        | "rilievo-io"
        | "rilievo-segmentation" => ["rilievo-scene", "rilievo-numerics"].into(),
        "rilievo-synthetic" => ["rilievo-scene", "rilievo-numerics"].into(),
        _ => [
            "rilievo-scene",
            "rilievo-photometry",
            "rilievo-numerics",
            "rilievo-stereo",
        ]
        .into(),
    }
}

#[test]
fn every_crate_imports_only_what_its_layer_may() {
    let mut seen = 0;
    for manifest in manifests("stages")
        .into_iter()
        .chain(manifests("stages/common"))
    {
        let (name, dependencies) = own_dependencies(&manifest);
        let allowed = allowed(&name);
        for dependency in &dependencies {
            assert!(
                allowed.contains(dependency.as_str()) && *dependency != name,
                "{name} must not depend on {dependency}; allowed are {allowed:?}"
            );
        }
        seen += 1;
    }
    assert_eq!(seen, 13, "six stages and seven common crates");
}

/// What the package reaches of the program is what the program's library offers to be embedded, and nothing of a stage.
#[test]
fn the_python_package_knows_the_program_alone() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/Cargo.toml");
    let (_, dependencies) = own_dependencies(&manifest);
    assert_eq!(dependencies, ["rilievo".to_owned()].into());
}

#[test]
fn stages_neither_read_files_nor_print() {
    let forbidden = ["std::fs", "File::open", "println!", "print!(", "eprint!"];
    for manifest in manifests("stages") {
        let source = manifest.parent().expect("a folder").join("src");
        for file in rust_files(&source) {
            let text = std::fs::read_to_string(&file).expect("a source file can be read");
            if file.components().any(|part| part.as_os_str() == "tests") || is_tests_module(&file) {
                continue;
            }
            for line in without_tests(&text).lines() {
                for word in forbidden {
                    assert!(!line.contains(word), "{}: {line}", file.display());
                }
            }
        }
    }
}

fn is_tests_module(file: &Path) -> bool {
    file.file_stem()
        .and_then(|stem| stem.to_str())
        .is_some_and(|stem| stem == "tests" || stem.ends_with("_tests") || stem == "test_scene")
}
