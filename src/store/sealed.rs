//! JSON files that show their own damage: an object with a `checksum` over everything else in it.
//!
//! The checksum is the hash of the object's compact JSON without that key, so that it follows the
//! meaning and not the white space.

use super::fingerprint::hash_json;
use serde::Serialize;
use serde_json::Value;

const CHECKSUM: &str = "checksum";

/// The text of an object, with its checksum.
pub fn seal(object: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut value = serde_json::to_value(object)?;
    let checksum = hash_json(&value);
    if let Some(members) = value.as_object_mut() {
        members.insert(CHECKSUM.to_owned(), checksum.into());
    }
    serde_json::to_vec_pretty(&value)
}

/// The object in a text, when it is what was sealed.
///
/// # Errors
/// What is wrong with the text, as a clause.
pub fn unseal(text: &[u8]) -> Result<Value, String> {
    let mut value: Value =
        serde_json::from_slice(text).map_err(|error| format!("is no JSON: {error}"))?;
    let stated = value
        .as_object_mut()
        .and_then(|members| members.remove(CHECKSUM))
        .ok_or("has no checksum")?;
    if stated != hash_json(&value).as_str() {
        return Err("does not have the content that it was written with".to_owned());
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_changed_byte_that_changes_the_meaning_is_found() {
        let object = json!({"a": 1.25, "b": {"c": ["x", null, true]}, "d": 0.1});
        let text = seal(&object).unwrap();
        assert_eq!(unseal(&text), Ok(object.clone()));
        for (at, bit) in (0..text.len()).flat_map(|at| (0..8).map(move |bit| (at, bit))) {
            let mut damaged = text.clone();
            damaged[at] ^= 1 << bit;
            match unseal(&damaged) {
                Err(_) => {}
                Ok(found) => assert_eq!(found, object, "bit {bit} of byte {at}"),
            }
        }
        assert!(unseal(b"{}").is_err() && unseal(b"3").is_err() && unseal(b"").is_err());
    }
}
