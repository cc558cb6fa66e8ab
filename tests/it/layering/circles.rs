//! No circle of imports between the files of a crate: whoever reads a file can read what it needs first.
//!
//! A file imports what its `use` lines and its paths from `crate`, `super` or a module of its own name; what
//! stands under `#[cfg(test)]` does not count. A folder's `mod.rs` is a file like others: what its children
//! need stands in a file of its own.

use super::is_tests_module;
use super::sources::without_tests;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Place of a module in its crate: empty for the root.
type Module = Vec<String>;

#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut crates = vec![root.join("src"), root.join("python/src")];
    for folder in ["stages", "stages/common"] {
        let entries = std::fs::read_dir(root.join(folder)).expect("the folder exists");
        crates.extend(entries.flatten().map(|entry| entry.path().join("src")));
    }
    crates.retain(|source| source.is_dir());
    assert_eq!(
        crates.len(),
        15,
        "the program, the Python package and thirteen crates"
    );
    let mut circles = Vec::new();
    for source in crates {
        let files = modules(&source);
        let imports: BTreeMap<&Module, BTreeSet<Module>> = files
            .iter()
            .map(|(module, path)| {
                let text = std::fs::read_to_string(path).expect("a source file can be read");
                (module, imports(module, &without_tests(&text), &files))
            })
            .collect();
        for module in files.keys() {
            if let Some(way) = way_back(module, &imports) {
                circles.push(format!("{}: {}", source.display(), way.join(" -> ")));
            }
        }
    }
    assert!(circles.is_empty(), "{}", circles.join("\n"));
}

#[test]
fn tests_do_not_count_and_paths_are_found_in_every_shape() {
    let text = "use super::b::{self, C as D, e::{F}};\n#[cfg(test)]\nmod tests {\n    use crate::no::X;\n}\n\
                fn f() -> crate::g::H { child::i() }\n";
    let names = ["a", "b", "g", "no"].map(|name| vec![name.to_owned()]);
    let nested = [
        vec!["a".to_owned(), "child".to_owned()],
        vec!["b".to_owned(), "e".to_owned()],
    ];
    let files: BTreeMap<Module, PathBuf> = names
        .into_iter()
        .chain(nested)
        .map(|module| (module, PathBuf::new()))
        .collect();
    let found = imports(&vec!["a".to_owned()], &without_tests(text), &files);
    let found: Vec<String> = found.iter().map(|module| module.join("::")).collect();
    assert_eq!(found, ["a::child", "b", "b::e", "g"]);
}

/// All modules of a crate that have a file, without those of tests.
fn modules(source: &Path) -> BTreeMap<Module, PathBuf> {
    fn collect(folder: &Path, module: &Module, into: &mut BTreeMap<Module, PathBuf>) {
        for entry in std::fs::read_dir(folder).expect("sources exist").flatten() {
            let path = entry.path();
            let name = path
                .file_stem()
                .expect("a name")
                .to_string_lossy()
                .into_owned();
            let inside = || module.iter().cloned().chain([name.clone()]).collect();
            if path.is_dir() {
                collect(&path, &inside(), into);
            } else if path.extension().is_some_and(|ending| ending == "rs")
                && !is_tests_module(&path)
            {
                // A program beside a library of its own is a file like others: the library is the root.
                let is_folders_own = match name.as_str() {
                    "mod" | "lib" => true,
                    "main" => !folder.join("lib.rs").exists(),
                    _ => false,
                };
                into.insert(
                    if is_folders_own {
                        module.clone()
                    } else {
                        inside()
                    },
                    path,
                );
            }
        }
    }
    let mut found = BTreeMap::new();
    collect(source, &Module::new(), &mut found);
    found
}

/// Modules of the crate that a file imports.
fn imports(module: &Module, text: &str, files: &BTreeMap<Module, PathBuf>) -> BTreeSet<Module> {
    let mut paths = Vec::new();
    let mut rest = String::new();
    for statement in text.split_inclusive(';') {
        let start = statement.rfind("\nuse ").map(|at| at + 1);
        let start = start.or_else(|| statement.rfind(" use ").map(|at| at + 1));
        match start.or_else(|| statement.starts_with("use ").then_some(0)) {
            Some(start) if !statement[start..].contains(['=', '(']) => {
                rest.push_str(&statement[..start]);
                let words = statement[start + "use ".len()..].trim_end_matches(';');
                expand("", words, &mut paths);
            }
            _ => rest.push_str(statement),
        }
    }
    // Paths in code: words joined by `::`.
    let is_word = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let words = rest.split(|c: char| !is_word(c));
    paths.extend(words.filter(|word| word.contains("::")).map(str::to_owned));
    // All that is above a module inside a file is the file itself.
    paths.retain(|path| path != "super::*");
    let mut found = BTreeSet::new();
    for path in paths {
        if let Some(imported) = resolve(module, &path, files)
            && imported != *module
        {
            found.insert(imported);
        }
    }
    found
}

/// The paths of a `use` with its braces opened.
fn expand(before: &str, words: &str, into: &mut Vec<String>) {
    let words = words.trim();
    let Some((start, inside)) = words
        .split_once('{')
        .and_then(|(start, rest)| Some((start, rest.strip_suffix('}')?)))
    else {
        let name = words.split(" as ").next().unwrap_or_default().trim();
        into.push(format!("{before}{name}"));
        return;
    };
    let before = format!("{before}{}", start.trim());
    let (mut depth, mut item) = (0, String::new());
    for c in inside.chars().chain([',']) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !item.trim().is_empty() {
                    expand(&before, &item, into);
                }
                item.clear();
                continue;
            }
            _ => {}
        }
        item.push(c);
    }
}

/// The file that a path leads to, as far as modules have files of their own.
fn resolve(from: &Module, path: &str, files: &BTreeMap<Module, PathBuf>) -> Option<Module> {
    let mut words = path.split("::").filter(|word| !word.is_empty()).peekable();
    let mut at = from.clone();
    match *words.peek()? {
        "crate" => {
            at.clear();
            words.next();
        }
        "self" => {
            words.next();
        }
        "super" => {
            while words.next_if_eq(&"super").is_some() {
                at.pop();
            }
        }
        child => {
            at.push(child.to_owned());
            files.contains_key(&at).then_some(())?;
            words.next();
        }
    }
    for word in words {
        at.push(word.to_owned());
        if !files.contains_key(&at) {
            at.pop();
            break;
        }
    }
    files.contains_key(&at).then_some(at)
}

/// The shortest way from a module along its imports back to it.
fn way_back(start: &Module, imports: &BTreeMap<&Module, BTreeSet<Module>>) -> Option<Vec<String>> {
    let name = |module: &Module| {
        if module.is_empty() {
            "the root".to_owned()
        } else {
            module.join("::")
        }
    };
    let mut came_from: BTreeMap<&Module, &Module> = BTreeMap::new();
    let mut queue = std::collections::VecDeque::from([start]);
    while let Some(at) = queue.pop_front() {
        for next in imports.get(at).into_iter().flatten() {
            if next == start {
                let mut way = vec![name(start)];
                let mut step = at;
                while step != start {
                    way.push(name(step));
                    step = came_from[step];
                }
                way.push(name(start));
                way.reverse();
                return Some(way);
            }
            if !came_from.contains_key(next) {
                came_from.insert(next, at);
                queue.push_back(next);
            }
        }
    }
    None
}
