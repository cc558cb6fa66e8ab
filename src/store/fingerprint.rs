//! A fingerprint names a result by everything that decides it:
//!
//! `fingerprint = blake3(stage, stage version, options, inputs' contents, upstream fingerprints)`
//!
//! Threads, memory and verbosity stay out, so that they never redo anything.

use rilievo_scene::StageId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Everything that decides a stage's result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ingredients {
    pub stage: StageId,
    /// Raised whenever the stage's method changes its results.
    pub stage_version: u32,
    /// Options that affect the result.
    pub options: serde_json::Value,
    /// Content hashes of files from outside the run directory, by the role they play.
    pub inputs: BTreeMap<String, String>,
    /// Fingerprints of the stages that this one reads, by stage name.
    pub upstream: BTreeMap<String, String>,
}

impl Ingredients {
    /// The fingerprint of these ingredients.
    pub fn fingerprint(&self) -> String {
        hash_json(self)
    }

    /// Differences from earlier ingredients, each in words; empty when nothing differs.
    pub fn changes_since(&self, earlier: &Self) -> Vec<String> {
        let mut changes = Vec::new();
        if self.stage_version != earlier.stage_version {
            changes.push(format!(
                "the stage's method changed (version {} to {})",
                earlier.stage_version, self.stage_version
            ));
        }
        compare_values("option", &earlier.options, &self.options, &mut changes);
        compare_maps(&earlier.inputs, &self.inputs, &mut changes, |role, what| {
            format!("{role} {what}")
        });
        compare_maps(
            &earlier.upstream,
            &self.upstream,
            &mut changes,
            |stage, _| format!("stage {stage} was redone"),
        );
        changes
    }
}

/// Hash of bytes, in hexadecimal.
pub fn hash_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Hash of a value's JSON; structs keep their order and maps are sorted, so it is stable.
pub fn hash_json(value: &impl Serialize) -> String {
    // A value that has no JSON form (a map with odd keys) cannot occur in options and reports;
    // an empty text then only means "never equal to an earlier run".
    let text = serde_json::to_vec(value).unwrap_or_default();
    hash_bytes(&text)
}

fn compare_values(
    path: &str,
    earlier: &serde_json::Value,
    now: &serde_json::Value,
    changes: &mut Vec<String>,
) {
    use serde_json::Value;
    match (earlier, now) {
        (Value::Object(a), Value::Object(b)) => {
            let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
            keys.sort();
            keys.dedup();
            for key in keys {
                compare_values(
                    &format!("{path} {key}"),
                    a.get(key).unwrap_or(&Value::Null),
                    b.get(key).unwrap_or(&Value::Null),
                    changes,
                );
            }
        }
        (a, b) if a != b => changes.push(format!("{path} changed from {a} to {b}")),
        _ => {}
    }
}

fn compare_maps(
    earlier: &BTreeMap<String, String>,
    now: &BTreeMap<String, String>,
    changes: &mut Vec<String>,
    say: impl Fn(&str, &str) -> String,
) {
    for (key, value) in now {
        match earlier.get(key) {
            None => changes.push(say(key, "is new")),
            Some(old) if old != value => changes.push(say(key, "has another content")),
            Some(_) => {}
        }
    }
    for key in earlier.keys().filter(|key| !now.contains_key(*key)) {
        changes.push(say(key, "is gone"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ingredients() -> Ingredients {
        Ingredients {
            stage: StageId::Shading,
            stage_version: 1,
            options: serde_json::json!({"beta": 0.02, "light": {"order": 2}}),
            inputs: [("photo a.jpg".into(), "11".into())].into(),
            upstream: [("4_lighting".into(), "22".into())].into(),
        }
    }

    #[test]
    fn every_ingredient_changes_the_fingerprint_and_is_named() {
        let base = ingredients();
        let mut variants = vec![base.clone(); 4];
        variants[0].stage_version = 2;
        variants[1].options = serde_json::json!({"beta": 0.02, "light": {"order": 1}});
        variants[2].inputs.insert("photo a.jpg".into(), "12".into());
        variants[3]
            .upstream
            .insert("4_lighting".into(), "23".into());
        for variant in &variants {
            assert_ne!(variant.fingerprint(), base.fingerprint());
            assert_eq!(variant.changes_since(&base).len(), 1, "{variant:?}");
        }
        let said = variants[1].changes_since(&base).remove(0);
        assert_eq!(said, "option light order changed from 2 to 1");
        assert!(base.changes_since(&base).is_empty());
    }
}
