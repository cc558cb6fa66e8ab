//! Writing a stage: everything into a work folder, then one rename.

use super::error::StoreError;
use super::evaluation::drop_evaluation;
use super::files::{create_folder, hash_file, is_inside, write_atomically};
use super::manifest::{FileRecord, Item, MANIFEST, Manifest};
use super::places::{Places, delete_empty, delete_folders};
use rayon::prelude::*;
use rilievo_scene::StageId;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Folder of finished items' records inside the work folder; not part of the result.
const ITEMS: &str = ".items";

/// Item and folder of how far a stage is; no part of the result either.
pub(super) const CHECKPOINT: &str = ".checkpoint";

/// A stage in progress.
#[derive(Debug)]
pub struct StageWriter {
    root: PathBuf,
    places: Places,
    /// Items that an interrupted or an earlier run finished, with the folder that has their files.
    reusable: BTreeMap<String, (PathBuf, Item)>,
    items: Mutex<BTreeMap<String, Item>>,
}

impl StageWriter {
    /// Prepares an empty work folder; what an interrupted run left there is kept as a source of
    /// finished items.
    pub(super) fn begin(root: &Path, stage: StageId) -> Result<Self, StoreError> {
        let Places { work, previous, .. } = Places::of(root, stage);
        if work.exists() {
            if previous.exists() {
                take_along(&previous, &work)?;
                delete_folders(&[&previous])?;
            }
            std::fs::rename(&work, &previous).map_err(StoreError::files("rename", &work))?;
        }
        // The rest would only fill the disk.
        keep_only(&previous, "", &files_of(&finished_items(&previous)))?;
        create_folder(&work.join(ITEMS))?;
        Ok(Self::take_part(root, stage))
    }

    /// Works in the folder that another process has prepared, which also commits the stage.
    pub(super) fn take_part(root: &Path, stage: StageId) -> Self {
        let places = Places::of(root, stage);
        let committed = Manifest::read(&places.result).ok().flatten();
        let committed = committed.into_iter().flat_map(|manifest| manifest.items);
        let committed = committed.map(|(name, item)| (name, (places.result.clone(), item)));
        let left = finished_items(&places.previous).into_iter();
        let left = left.map(|(name, item)| (name, (places.previous.clone(), item)));
        Self {
            root: root.to_path_buf(),
            reusable: committed.chain(left).collect(),
            places,
            items: Mutex::new(BTreeMap::new()),
        }
    }

    /// The items that were finished or taken over here.
    pub fn items(&self) -> BTreeMap<String, Item> {
        let items = self.items.lock().unwrap_or_else(PoisonError::into_inner);
        items.clone()
    }

    /// Adds items that other processes finished in this folder.
    pub fn add(&self, finished: BTreeMap<String, Item>) {
        let mut items = self.items.lock().unwrap_or_else(PoisonError::into_inner);
        items.extend(finished);
    }

    /// Where to write an artifact; creates the folders above it. An existing file is
    /// removed, so that a hard-linked committed one is never written over.
    ///
    /// # Errors
    /// When the folder cannot be created, or an earlier file not be deleted.
    pub fn path(&self, relative: &str) -> Result<PathBuf, StoreError> {
        let path = self.places.work.join(relative);
        if let Some(folder) = path.parent() {
            create_folder(folder)?;
        }
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(StoreError::files("delete", &path)(error))
            }
            _ => Ok(path),
        }
    }

    /// The work folder, where artifacts lie until the commit.
    pub fn dir(&self) -> &Path {
        &self.places.work
    }

    /// Takes over an item that was finished before, when it has the same key and all its files
    /// have the content that they were finished with.
    ///
    /// # Errors
    /// When its files can be neither linked nor copied.
    pub fn reuse(&self, name: &str, key: &str) -> Result<Option<Item>, StoreError> {
        let Some((folder, item)) = self.reusable.get(name).filter(|(_, item)| item.key == key)
        else {
            return Ok(None);
        };
        let whole = item.files.len() == item.hashes.len()
            && item.files.iter().zip(&item.hashes).all(|(file, hash)| {
                let path = folder.join(file);
                let is_file = std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_file());
                is_file && hash_file(&path).is_ok_and(|found| found == *hash)
            });
        if !whole {
            return Ok(None);
        }
        for file in &item.files {
            let (source, target) = (folder.join(file), self.path(file)?);
            // Committed files are never written again, so a link is as good as a copy.
            if std::fs::hard_link(&source, &target).is_err() {
                std::fs::copy(&source, &target).map_err(StoreError::files("copy", &source))?;
            }
        }
        self.record(name, item.clone())?;
        Ok(Some(item.clone()))
    }

    /// Records a finished item, so that an interrupted run need not do it again.
    pub fn finish(&self, name: &str, mut item: Item) -> Result<(), StoreError> {
        item.hashes = item
            .files
            .iter()
            .map(|file| {
                let path = self.places.work.join(file);
                Ok(hash_file(&path)?)
            })
            .collect::<Result<_, StoreError>>()?;
        self.record(name, item)
    }

    fn record(&self, name: &str, item: Item) -> Result<(), StoreError> {
        for file in &item.files {
            sync(&self.places.work.join(file))?;
        }
        let record = self.places.work.join(record_of(name));
        let text = serde_json::to_vec(&(name, &item)).unwrap_or_default();
        write_atomically(&record, &text)?;
        let mut items = self.items.lock().unwrap_or_else(PoisonError::into_inner);
        items.insert(name.to_owned(), item);
        Ok(())
    }

    /// Completes the stage: all files to disk, the manifest last, then one rename.
    ///
    /// # Errors
    /// When something cannot be written; the earlier result is then untouched.
    pub fn commit(self, mut manifest: Manifest) -> Result<(), StoreError> {
        delete_folders(&[&self.places.work.join(ITEMS)])?;
        manifest.items = self
            .items
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        // How far the stage was is no part of its result.
        if manifest.items.remove(CHECKPOINT).is_some() {
            delete_folders(&[&self.places.work.join(CHECKPOINT)])?;
        }
        let mut names = Vec::new();
        collect_and_sync(&self.places.work, "", &mut names)?;
        let records = names.into_par_iter().map(|(name, bytes)| {
            let path = self.places.work.join(&name);
            let blake3 = hash_file(&path)?;
            Ok((name, FileRecord { bytes, blake3 }))
        });
        manifest.files = records.collect::<Result<_, StoreError>>()?;
        let path = self.places.work.join(MANIFEST);
        let text = manifest.to_text();
        let text = text.map_err(|error| StoreError::files("write", &path)(error.into()))?;
        write_atomically(&path, &text)?;
        sync(&self.places.work)?;

        drop_evaluation(&self.root)?;
        let Places {
            result,
            old,
            work,
            previous,
        } = &self.places;
        if result.exists() {
            create_folder(&self.root.join(".old"))?;
            std::fs::rename(result, old).map_err(StoreError::files("rename", result))?;
        }
        std::fs::rename(work, result).map_err(StoreError::files("rename", work))?;
        sync(&self.root)?;

        // From here on the stage is committed; leftovers cost only space, and are cleared again
        // by the next run that opens this folder.
        delete_folders(&[old, previous])?;
        delete_empty(&self.root);
        Ok(())
    }
}

/// Moves finished items of an older abandoned work folder into a newer one that lacks them: files
/// first, the record last, so that a kill in between loses nothing.
fn take_along(older: &Path, newer: &Path) -> Result<(), StoreError> {
    let known: BTreeMap<String, Item> = finished_items(newer).into_iter().collect();
    for (name, item) in finished_items(older) {
        if known.contains_key(&name) {
            continue;
        }
        let record = record_of(&name);
        for file in item.files.iter().chain([&record]) {
            let (source, target) = (older.join(file), newer.join(file));
            if let Some(folder) = target.parent() {
                create_folder(folder)?;
            }
            match std::fs::rename(&source, &target) {
                // A file that is gone is found out by its hash when the item is asked for.
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(StoreError::files("rename", &source)(error));
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// Items whose record is complete in an abandoned work folder.
fn finished_items(work: &Path) -> Vec<(String, Item)> {
    let Ok(entries) = std::fs::read_dir(work.join(ITEMS)) else {
        return Vec::new();
    };
    entries
        .flatten()
        .filter_map(|entry| std::fs::read(entry.path()).ok())
        .filter_map(|text| serde_json::from_slice::<(String, Item)>(&text).ok())
        .filter(|(name, item)| is_inside(name) && item.files.iter().all(|file| is_inside(file)))
        .collect()
}

/// Record of a finished item, relative to the work folder.
fn record_of(name: &str) -> String {
    format!("{ITEMS}/{name}.json")
}

/// Files and records of finished items.
fn files_of(finished: &[(String, Item)]) -> BTreeSet<String> {
    let files = finished.iter().flat_map(|(name, item)| {
        let record = record_of(name);
        item.files.iter().cloned().chain([record])
    });
    files.collect()
}

/// Deletes what is not among `kept` from a folder, which need not exist.
fn keep_only(folder: &Path, prefix: &str, kept: &BTreeSet<String>) -> Result<(), StoreError> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(());
    };
    for entry in entries.flatten() {
        let path = entry.path();
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder {
            keep_only(&path, &format!("{name}/"), kept)?;
        } else if !kept.contains(&name) {
            std::fs::remove_file(&path).map_err(StoreError::files("delete", &path))?;
        }
    }
    Ok(())
}

fn collect_and_sync(
    folder: &Path,
    prefix: &str,
    files: &mut Vec<(String, u64)>,
) -> Result<(), StoreError> {
    let entries = std::fs::read_dir(folder).map_err(StoreError::files("read", folder))?;
    for entry in entries {
        let entry = entry.map_err(StoreError::files("read", folder))?;
        let path = entry.path();
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        let metadata = entry.metadata().map_err(StoreError::files("read", &path))?;
        if metadata.is_dir() {
            collect_and_sync(&path, &format!("{name}/"), files)?;
        } else {
            files.push((name, metadata.len()));
        }
        sync(&path)?;
    }
    Ok(())
}

fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path)
        .and_then(|file| file.sync_all())
        .map_err(StoreError::files("write", path))
}

#[cfg(test)]
mod tests {
    use super::super::{FORMAT_VERSION, Ingredients, Look, RunDir};
    use super::*;

    fn manifest() -> Manifest {
        let ingredients = Ingredients {
            stage: StageId::Features,
            stage_version: 1,
            options: serde_json::Value::Null,
            inputs: BTreeMap::new(),
            upstream: BTreeMap::new(),
        };
        Manifest {
            format_version: FORMAT_VERSION,
            program: String::new(),
            fingerprint: ingredients.fingerprint(),
            ingredients,
            items: BTreeMap::new(),
            seconds: 0.0,
            cpu_seconds: None,
            expected: None,
            threads: 1,
            peak_memory_bytes: None,
            warnings: Vec::new(),
            files: BTreeMap::new(),
            report: serde_json::Value::Null,
        }
    }

    fn item(key: &str) -> Item {
        Item {
            key: key.into(),
            files: vec!["a.bin".into()],
            hashes: Vec::new(),
            facts: serde_json::Value::Null,
        }
    }

    #[test]
    fn a_stage_appears_only_when_it_is_committed_and_items_survive_a_crash() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();

        let writer = run.begin(StageId::Features).unwrap();
        std::fs::write(writer.path("a.bin").unwrap(), b"first").unwrap();
        writer.finish("a", item("k1")).unwrap();
        drop(writer);
        assert_eq!(run.manifest(StageId::Features).unwrap(), None);

        let writer = run.begin(StageId::Features).unwrap();
        assert_eq!(writer.reuse("a", "k2").unwrap(), None);
        let taken = writer.reuse("a", "k1").unwrap().unwrap();
        assert_eq!((&taken.key, taken.hashes.len()), (&"k1".to_owned(), 1));
        writer.commit(manifest()).unwrap();
        let committed = run.manifest(StageId::Features).unwrap().unwrap();
        assert_eq!(committed.files.keys().collect::<Vec<_>>(), ["a.bin"]);
        let stage_dir = run.stage_dir(StageId::Features);
        assert_eq!(committed.damage(&stage_dir, Look::Contents), None);

        // A second commit replaces the first, and takes unchanged items along.
        let writer = run.begin(StageId::Features).unwrap();
        assert!(writer.reuse("a", "k1").unwrap().is_some());
        std::fs::write(writer.path("b/c.bin").unwrap(), b"more").unwrap();
        writer.commit(manifest()).unwrap();
        let committed = run.manifest(StageId::Features).unwrap().unwrap();
        assert_eq!(committed.files.len(), 2);
        std::fs::remove_file(stage_dir.join("a.bin")).unwrap();
        assert_eq!(
            committed.damage(&stage_dir, Look::Sizes),
            Some("a.bin is gone".to_owned())
        );
        // Damage of the same size is found where contents are looked at.
        std::fs::write(stage_dir.join("a.bin"), b"furst").unwrap();
        assert_eq!(committed.damage(&stage_dir, Look::Sizes), None);
        let told = committed.damage(&stage_dir, Look::Contents).unwrap();
        assert!(told.starts_with("a.bin does not have"), "{told}");
    }

    #[test]
    fn items_survive_two_kills_in_a_row() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        for name in ["a", "b"] {
            let writer = run.begin(StageId::Features).unwrap();
            let file = format!("{name}.bin");
            std::fs::write(writer.path(&file).unwrap(), name).unwrap();
            let files = vec![file];
            writer.finish(name, Item { files, ..item("k") }).unwrap();
        }
        let writer = run.begin(StageId::Features).unwrap();
        for name in ["a", "b"] {
            assert!(writer.reuse(name, "k").unwrap().is_some(), "{name}");
        }
    }

    #[test]
    fn what_a_stopped_stage_left_unfinished_does_not_stay() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        let writer = run.begin(StageId::Features).unwrap();
        for file in ["a.bin", "half/b.bin"] {
            std::fs::write(writer.path(file).unwrap(), b"bytes").unwrap();
        }
        writer.finish("a", item("k")).unwrap();
        drop(writer);
        let writer = run.begin(StageId::Features).unwrap();
        let previous = run.root().join(".work/2_features.previous");
        assert!(previous.join("a.bin").exists());
        assert!(!previous.join("half/b.bin").exists());
        assert!(writer.reuse("a", "k").unwrap().is_some());
    }

    #[test]
    fn an_item_that_leads_elsewhere_is_not_taken_over() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        drop(run.begin(StageId::Features).unwrap());
        let hostile = Item {
            files: vec!["../../../evil".into()],
            ..item("k")
        };
        let record = run.root().join(".work/2_features/.items/a.json");
        std::fs::write(record, serde_json::to_vec(&("a", hostile)).unwrap()).unwrap();
        let writer = run.begin(StageId::Features).unwrap();
        assert_eq!(writer.reuse("a", "k").unwrap(), None);
    }

    #[test]
    fn an_item_with_a_damaged_file_is_made_again_and_shares_no_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        let two = || Item {
            files: vec!["a.bin".into(), "b.bin".into()],
            ..item("k")
        };
        let writer = run.begin(StageId::Features).unwrap();
        for file in two().files {
            std::fs::write(writer.path(&file).unwrap(), b"whole").unwrap();
        }
        writer.finish("a", two()).unwrap();
        writer.commit(manifest()).unwrap();
        let committed = run.stage_dir(StageId::Features);
        std::fs::write(committed.join("b.bin"), b"other").unwrap();

        let writer = run.begin(StageId::Features).unwrap();
        assert_eq!(writer.reuse("a", "k").unwrap(), None);
        assert!(!writer.dir().join("a.bin").exists(), "nothing is linked");
        std::fs::write(committed.join("b.bin"), b"whole").unwrap();
        assert!(writer.reuse("a", "k").unwrap().is_some());
        std::fs::write(writer.path("a.bin").unwrap(), b"new").unwrap();
        assert_eq!(std::fs::read(committed.join("a.bin")).unwrap(), b"whole");
    }

    #[test]
    fn a_commit_that_died_between_its_renames_is_undone() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("run");
        let run = RunDir::create_or_open(&root).unwrap();
        run.write_run_file(&"asked").unwrap();
        run.begin(StageId::Poses)
            .unwrap()
            .commit(manifest())
            .unwrap();
        drop(run);
        std::fs::create_dir(root.join(".old")).unwrap();
        std::fs::rename(root.join("3_poses"), root.join(".old/3_poses")).unwrap();
        let run = RunDir::open(&root).unwrap();
        assert!(run.manifest(StageId::Poses).unwrap().is_some());
    }
}
