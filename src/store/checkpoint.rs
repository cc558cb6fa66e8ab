//! How far a stage is, kept in its work folder until the stage is committed.
//!
//! Every part of the state is a file with a number of its own; the record of an item names the files that belong
//! together, with their content hashes. So whatever stops the program, the record is that of the last whole state.

use super::error::StoreError;
use super::manifest::Item;
use super::writer::{CHECKPOINT, StageWriter};
use rilievo_scene::team::{from_first, wait_for_all};
use rilievo_scene::{Alone, Checkpoint, CheckpointError, StatePart, Team};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::sync::{Mutex, PoisonError};

/// The files that belong together.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct State {
    /// File of each part.
    files: BTreeMap<String, String>,
    /// States that were kept.
    count: usize,
}

/// The state of a stage in its work folder.
pub struct StageCheckpoint<'a> {
    writer: &'a StageWriter,
    key: String,
    state: Mutex<State>,
    team: &'a dyn Team,
}

impl<'a> StageCheckpoint<'a> {
    /// Takes over the state that a stopped run left, if it was kept under the same `key`: the hash of everything that
    /// decides it.
    ///
    /// # Errors
    /// When its files can be neither linked nor copied.
    pub fn open(writer: &'a StageWriter, key: String) -> Result<Self, StoreError> {
        let kept = writer.reuse(CHECKPOINT, &key)?;
        let state = kept.and_then(|item| serde_json::from_value(item.facts).ok());
        Ok(Self {
            writer,
            key,
            state: Mutex::new(state.unwrap_or_default()),
            team: &Alone,
        })
    }

    /// The same for all processes of a team: the first one keeps what all of them read.
    ///
    /// # Errors
    /// As of [`open`](Self::open), and when another process failed.
    pub fn open_together(
        team: &'a dyn Team,
        writer: &'a StageWriter,
        key: String,
    ) -> anyhow::Result<Self> {
        let mut own = None;
        let state = from_first(team, || {
            let opened = own.insert(Self::open(writer, key.clone())?);
            let state = opened.state.lock().unwrap_or_else(PoisonError::into_inner);
            Ok::<_, anyhow::Error>(state.clone())
        })?;
        let opened = own.unwrap_or(Self {
            writer,
            key,
            state: Mutex::new(state),
            team: &Alone,
        });
        Ok(Self { team, ..opened })
    }

    fn write(&self, parts: &[StatePart<'_>], state: &mut State) -> Result<(), StoreError> {
        let mut next = State {
            count: state.count + 1,
            ..state.clone()
        };
        for part in parts {
            let name = format!("{CHECKPOINT}/{}.{}", part.name, next.count);
            let path = self.writer.path(&name)?;
            File::create(&path)
                .and_then(|mut file| (part.write)(&mut file))
                .map_err(StoreError::files("write", &path))?;
            next.files.insert(part.name.to_owned(), name);
        }
        let item = Item {
            key: self.key.clone(),
            files: next.files.values().cloned().collect(),
            hashes: Vec::new(),
            facts: serde_json::to_value(&next).unwrap_or_default(),
        };
        self.writer.finish(CHECKPOINT, item)?;
        // What the record does not name any more only takes space.
        for (part, old) in &state.files {
            if next.files.get(part) != Some(old) {
                self.writer.path(old)?;
            }
        }
        *state = next;
        Ok(())
    }
}

impl Checkpoint for StageCheckpoint<'_> {
    fn read(&self, part: &str) -> Option<Box<dyn Read>> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let file = File::open(self.writer.dir().join(state.files.get(part)?)).ok()?;
        Some(Box::new(file))
    }

    fn keep(&self, parts: &[StatePart<'_>]) -> Result<(), CheckpointError> {
        // What another process may still read of the last state goes when a new one is there.
        wait_for_all(self.team).map_err(|error| CheckpointError {
            reason: error.to_string(),
        })?;
        if !self.team.is_first() {
            return Ok(());
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        self.write(parts, &mut state)
            .map_err(|error| CheckpointError {
                reason: error.to_string(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::super::RunDir;
    use super::*;
    use rilievo_scene::StageId;

    fn keep(kept: &StageCheckpoint<'_>, parts: &[(&'static str, &str)]) {
        for &(name, text) in parts {
            let write = |to: &mut dyn std::io::Write| to.write_all(text.as_bytes());
            kept.keep(&[StatePart {
                name,
                write: &write,
            }])
            .unwrap();
        }
    }

    fn text(kept: &StageCheckpoint<'_>, part: &str) -> Option<String> {
        let mut text = String::new();
        kept.read(part)?.read_to_string(&mut text).unwrap();
        Some(text)
    }

    #[test]
    fn the_last_whole_state_is_found_again_under_its_key_alone() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        let open = |key: &str, look: &dyn Fn(&StageCheckpoint<'_>)| {
            let writer = run.begin(StageId::Shading).unwrap();
            look(&StageCheckpoint::open(&writer, key.to_owned()).unwrap());
        };
        open("k", &|kept| {
            assert_eq!(text(kept, "light"), None);
            keep(
                kept,
                &[("light", "one"), ("course", "two"), ("course", "three")],
            );
            let failing = |_: &mut dyn std::io::Write| Err(std::io::Error::other("full"));
            let failed = kept.keep(&[StatePart {
                name: "course",
                write: &failing,
            }]);
            assert!(failed.unwrap_err().to_string().contains("full"));
        });
        // A second stop before anything new is kept loses nothing.
        for _ in 0..2 {
            open("k", &|kept| {
                assert_eq!(text(kept, "light").as_deref(), Some("one"));
                assert_eq!(text(kept, "course").as_deref(), Some("three"));
            });
        }
        open("other", &|kept| assert_eq!(text(kept, "course"), None));
    }

    #[test]
    fn a_damaged_state_is_no_state() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunDir::create_or_open(&dir.path().join("run")).unwrap();
        let writer = run.begin(StageId::Shading).unwrap();
        let kept = StageCheckpoint::open(&writer, "k".into()).unwrap();
        keep(&kept, &[("course", "whole")]);
        std::fs::write(writer.dir().join(".checkpoint/course.1"), "whol3").unwrap();
        let writer = run.begin(StageId::Shading).unwrap();
        let kept = StageCheckpoint::open(&writer, "k".into()).unwrap();
        assert_eq!(text(&kept, "course"), None);
    }
}
