//! Files that a command writes where the user says: all of them or none, and nothing is lost that was
//! there.

use crate::exit::Failure;
use crate::store::{RunDir, StoreError, absolute, create_folder, write_atomically};
use rilievo_io::{OutputFile, read_regular};
use rilievo_scene::StageId;
use std::path::{Path, PathBuf};

/// Writes files with the folders that they need. One that has its content already is left alone.
///
/// # Errors
/// When another file is in the place of one, unless it may be overwritten; when a place belongs to a
/// run directory, or holds no file at all; when the disk refuses. Nothing is written where any of
/// them has no place.
pub fn write(files: &[OutputFile], overwrite: bool) -> Result<(), Failure> {
    let mut wanted = Vec::new();
    let mut taken = Vec::new();
    for file in files {
        let place = resolved(&file.path)?;
        refuse_run_files(&place)?;
        match found(&place, &file.content)? {
            Found::Nothing => wanted.push((place, file)),
            Found::Same => {}
            Found::Other => {
                taken.push(format!("\n  {}", file.path.display()));
                wanted.push((place, file));
            }
        }
    }
    if !taken.is_empty() && !overwrite {
        return Err(Failure::Usage(format!(
            "nothing is written, since there is something else already:{}\nname another place with -o, \
             or replace what is there with --overwrite",
            taken.concat()
        )));
    }
    for (place, file) in wanted {
        if let Some(folder) = place.parent() {
            create_folder(folder)?;
        }
        write_atomically(&place, &file.content)?;
    }
    Ok(())
}

/// What is in a file's place.
enum Found {
    Nothing,
    Same,
    Other,
}

fn found(place: &Path, content: &[u8]) -> Result<Found, Failure> {
    let Ok(metadata) = std::fs::symlink_metadata(place) else {
        return Ok(Found::Nothing);
    };
    if metadata.is_dir() {
        let place = place.display();
        let reason = format!("{place} is a folder; name a file in it with -o");
        return Err(Failure::Usage(reason));
    }
    if !metadata.is_file() {
        let place = place.display();
        let reason =
            format!("{place} is no file, and is not replaced by one; choose another with -o");
        return Err(Failure::Usage(reason));
    }
    let same = metadata.len() == content.len() as u64
        && read_regular(place).is_ok_and(|bytes| bytes == content);
    Ok(if same { Found::Same } else { Found::Other })
}

/// The place that a path leads to, by whatever links; what does not exist yet is taken as it stands.
fn resolved(path: &Path) -> Result<PathBuf, Failure> {
    let absolute = absolute(path)?;
    let mut missing = Vec::new();
    let mut there = absolute.as_path();
    loop {
        if let Ok(real) = there.canonicalize() {
            return Ok(missing
                .iter()
                .rev()
                .fold(real, |place, name| place.join(name)));
        }
        match (there.parent(), there.file_name()) {
            (Some(parent), Some(name)) => {
                missing.push(name);
                there = parent;
            }
            _ => return Ok(absolute),
        }
    }
}

/// Refuses a place among the files that a run directory keeps for itself.
fn refuse_run_files(place: &Path) -> Result<(), Failure> {
    for root in place.ancestors().skip(1) {
        let own = place
            .strip_prefix(root)
            .ok()
            .and_then(|inside| inside.components().next())
            .is_some_and(|first| is_run_file(&first.as_os_str().to_string_lossy()));
        if !own {
            continue;
        }
        let is_run = !matches!(
            RunDir::open_to_read(root),
            Err(StoreError::Missing { .. } | StoreError::NotARun { .. })
        );
        if is_run {
            return Err(Failure::Usage(format!(
                "{} is among the run's own files, which only its stages write; name another place with -o",
                place.display()
            )));
        }
    }
    Ok(())
}

/// Whether a run directory has a file or folder of a name for itself.
fn is_run_file(name: &str) -> bool {
    name.starts_with('.')
        || ["run.json", "report.json", "report.html", "evaluation"].contains(&name)
        || StageId::ALL.iter().any(|stage| stage.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &Path, names: &[&str]) -> Vec<OutputFile> {
        let file = |name: &&str| OutputFile {
            path: folder.join(name),
            content: name.as_bytes().to_vec(),
        };
        names.iter().map(file).collect()
    }

    #[test]
    fn nothing_is_replaced_unasked_and_nothing_is_written_then() {
        let dir = tempfile::tempdir().unwrap();
        let set = files(dir.path(), &["a", "new/b", "c"]);
        std::fs::write(dir.path().join("a"), "other").unwrap();
        std::fs::write(dir.path().join("c"), "c").unwrap();
        let error = write(&set, false).unwrap_err();
        assert_eq!(error.code(), 2);
        let message = error.to_string();
        assert!(
            message.contains("/a\n") && message.contains("--overwrite"),
            "{message}"
        );
        assert!(!message.contains("/c"), "{message}");
        assert!(!dir.path().join("new").exists());
        write(&set, true).unwrap();
        assert_eq!(std::fs::read(dir.path().join("a")).unwrap(), b"a");
        assert_eq!(std::fs::read(dir.path().join("new/b")).unwrap(), b"new/b");
        // Again, as a script does.
        write(&set, false).unwrap();
        let set = files(dir.path(), &["new"]);
        assert_eq!(write(&set, true).unwrap_err().code(), 2);
    }

    #[test]
    fn a_runs_own_files_are_never_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("run");
        let run = RunDir::create_or_open(&root).unwrap();
        run.write_run_file(&"asked").unwrap();
        for name in ["run.json", "3_poses/cameras.json", "report.html", ".lock"] {
            let error = write(&files(&root, &[name]), true).unwrap_err();
            assert_eq!(error.code(), 2, "{name}");
            assert!(error.to_string().contains("own files"), "{error}");
        }
        write(&files(&root, &["exported/cameras.txt"]), false).unwrap();
        write(&files(dir.path(), &["run.json", "3_poses/x"]), false).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_devices_kept() {
        let dir = tempfile::tempdir().unwrap();
        let link = |to: &str, name: &str| {
            std::os::unix::fs::symlink(to, dir.path().join(name)).unwrap();
        };
        std::fs::write(dir.path().join("real"), "other").unwrap();
        link("real", "link");
        link("/dev/null", "null");
        write(&files(dir.path(), &["link"]), true).unwrap();
        assert_eq!(std::fs::read(dir.path().join("real")).unwrap(), b"link");
        let error = write(&files(dir.path(), &["null"]), true).unwrap_err();
        assert!(error.to_string().contains("no file"), "{error}");
    }
}
