//! Paths in JSON, and names of files as text.
//!
//! On Linux a path is any bytes. One that is UTF-8 is a JSON string; another is
//! `{"bytes": "hexadecimal"}`, so that it survives. Where a name must be text (it names a photo's
//! results), bytes that are no UTF-8 are written `%FF`: readable, and distinct for distinct names.

use serde_json::Value;
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

/// A path as JSON.
pub fn to_json(path: &Path) -> Value {
    match path.to_str() {
        Some(text) => text.into(),
        None => {
            let bytes = path.as_os_str().as_bytes().iter();
            let text: String = bytes.map(|byte| format!("{byte:02x}")).collect();
            serde_json::json!({ "bytes": text })
        }
    }
}

/// A path from its JSON.
pub fn from_json(value: &Value) -> Option<PathBuf> {
    if let Some(text) = value.as_str() {
        return Some(text.into());
    }
    let text = value.get("bytes")?.as_str()?;
    let digits = text.as_bytes().chunks(2);
    let bytes: Option<Vec<u8>> = digits
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect();
    Some(OsString::from_vec(bytes?).into())
}

/// A file name as text; empty for none.
pub fn text_of(name: Option<&OsStr>) -> String {
    let mut text = String::new();
    for chunk in name.unwrap_or_default().as_bytes().utf8_chunks() {
        text += chunk.valid();
        for byte in chunk.invalid() {
            text += &format!("%{byte:02X}");
        }
    }
    text
}

/// Serialises a path as people read it, for reports.
pub fn shown<S: serde::Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(&path.display())
}

/// Serialises paths in structs: `#[serde(with = "crate::paths::one")]`.
pub mod one {
    use super::*;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
        to_json(path).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
        from_json(&Value::deserialize(from)?).ok_or_else(|| D::Error::custom("a path is expected"))
    }
}

/// The same for a path that may be absent.
pub mod optional {
    use super::*;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub fn serialize<S: Serializer>(path: &Option<PathBuf>, to: S) -> Result<S::Ok, S::Error> {
        path.as_deref().map(to_json).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
        let value = Option::<Value>::deserialize(from)?;
        let path = value
            .map(|value| from_json(&value).ok_or_else(|| D::Error::custom("a path is expected")));
        path.transpose()
    }
}

/// The same for a list.
pub mod list {
    use super::*;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub fn serialize<S: Serializer>(paths: &[PathBuf], to: S) -> Result<S::Ok, S::Error> {
        let values: Vec<Value> = paths.iter().map(|path| to_json(path)).collect();
        values.serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<PathBuf>, D::Error> {
        let values = Vec::<Value>::deserialize(from)?;
        let paths: Option<Vec<PathBuf>> = values.iter().map(from_json).collect();
        paths.ok_or_else(|| D::Error::custom("a list of paths is expected"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_survives_and_every_name_stays_distinct() {
        for bytes in [
            &b"/a/b c.jpg"[..],
            b"/a/\xff\xfe.jpg",
            "/ä/ß".as_bytes(),
            b"",
        ] {
            let path = PathBuf::from(OsStr::from_bytes(bytes));
            let text = serde_json::to_vec(&to_json(&path)).unwrap();
            let value: Value = serde_json::from_slice(&text).unwrap();
            assert_eq!(from_json(&value), Some(path));
        }
        assert_eq!(from_json(&serde_json::json!({"bytes": "fz"})), None);
        assert_eq!(from_json(&serde_json::json!(3)), None);
        let names = [&b"\xff"[..], b"\xfe", b"a"].map(|n| text_of(Some(OsStr::from_bytes(n))));
        assert_eq!(names, ["%FF", "%FE", "a"]);
    }
}
