//! JSON values that know their place: every refusal names the file, the key and the value.

use crate::error::IoError;
use crate::files::{OutputFile, read_regular};
use serde_json::{Map, Value};
use std::path::Path;

/// Longest piece of a refused value that a message repeats.
const MAX_SHOWN: usize = 60;

/// Reads a JSON file.
pub(crate) fn read(path: &Path) -> Result<Value, IoError> {
    let bytes = read_regular(path)?;
    if bytes.is_empty() {
        return Err(IoError::input(path, "the file is empty (0 bytes)"));
    }
    let text = std::str::from_utf8(&bytes)
        .map_err(|_| IoError::input(path, "not a JSON file: its bytes are no text"))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    serde_json::from_str(text)
        .map_err(|error| IoError::input(path, format!("broken JSON: {error}")))
}

/// A JSON file, indented, with a line feed at its end.
pub(crate) fn file(path: &Path, value: &Value) -> Result<OutputFile, IoError> {
    let mut text =
        serde_json::to_string_pretty(value).map_err(|error| IoError::write(path, error))?;
    text.push('\n');
    Ok(OutputFile::new(path, text))
}

/// A value with its place in its file.
#[derive(Clone, Debug)]
pub(crate) struct Node<'a> {
    pub file: &'a Path,
    /// `cameras[3].K[0][1]`; empty at the root.
    pub key: String,
    pub value: &'a Value,
}

impl<'a> Node<'a> {
    pub fn root(file: &'a Path, value: &'a Value) -> Self {
        Self {
            file,
            key: String::new(),
            value,
        }
    }

    /// The refusal of this value.
    pub fn refuse(&self, reason: impl std::fmt::Display) -> IoError {
        let key = if self.key.is_empty() {
            "the top level"
        } else {
            &self.key
        };
        let mut shown = self.value.to_string();
        if shown.chars().count() > MAX_SHOWN {
            shown = shown.chars().take(MAX_SHOWN).collect::<String>() + "…";
        }
        IoError::input(self.file, format!("{key}: {shown} {reason}"))
    }

    fn child(&self, name: &str, value: &'a Value) -> Node<'a> {
        let key = match self.key.as_str() {
            "" => name.to_owned(),
            parent => format!("{parent}.{name}"),
        };
        Node {
            file: self.file,
            key,
            value,
        }
    }

    pub fn object(&self) -> Result<&'a Map<String, Value>, IoError> {
        self.value
            .as_object()
            .ok_or_else(|| self.refuse("is not an object { ... }"))
    }

    /// A member; `null` counts as absent.
    pub fn opt(&self, name: &str) -> Result<Option<Node<'a>>, IoError> {
        Ok(self
            .object()?
            .get(name)
            .filter(|value| !value.is_null())
            .map(|value| self.child(name, value)))
    }

    /// What a member holds, where it is there.
    pub fn opt_as<T>(
        &self,
        name: &str,
        read: impl FnOnce(&Node<'a>) -> Result<T, IoError>,
    ) -> Result<Option<T>, IoError> {
        self.opt(name)?.as_ref().map(read).transpose()
    }

    /// The entries of a list that may be absent.
    pub fn list(&self, name: &str) -> Result<Vec<Node<'a>>, IoError> {
        Ok(self.opt_as(name, Node::array)?.unwrap_or_default())
    }

    pub fn get(&self, name: &str) -> Result<Node<'a>, IoError> {
        self.opt(name)?.ok_or_else(|| {
            let place = match self.key.as_str() {
                "" => String::new(),
                parent => format!(" in {parent}"),
            };
            IoError::input(self.file, format!("the key \"{name}\" is missing{place}"))
        })
    }

    pub fn members(&self) -> Result<Vec<(&'a str, Node<'a>)>, IoError> {
        Ok(self
            .object()?
            .iter()
            .map(|(name, value)| (name.as_str(), self.child(name, value)))
            .collect())
    }

    pub fn array(&self) -> Result<Vec<Node<'a>>, IoError> {
        let values = self
            .value
            .as_array()
            .ok_or_else(|| self.refuse("is not a list [ ... ]"))?;
        Ok(values
            .iter()
            .enumerate()
            .map(|(i, value)| Node {
                file: self.file,
                key: format!("{}[{i}]", self.key),
                value,
            })
            .collect())
    }

    pub fn text(&self) -> Result<&'a str, IoError> {
        self.value
            .as_str()
            .ok_or_else(|| self.refuse("is not a text in quotes"))
    }

    pub fn number(&self) -> Result<f64, IoError> {
        self.value
            .as_f64()
            .filter(|number| number.is_finite())
            .ok_or_else(|| self.refuse("is not a finite number"))
    }

    pub fn positive(&self) -> Result<f64, IoError> {
        let number = self.number()?;
        if number > 0.0 {
            Ok(number)
        } else {
            Err(self.refuse("is not greater than zero"))
        }
    }

    /// A positive whole number.
    pub fn count(&self) -> Result<usize, IoError> {
        self.whole(self.number()?)
    }

    /// The positive whole number that the value was read as.
    pub fn whole(&self, number: f64) -> Result<usize, IoError> {
        if number >= 1.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0 {
            Ok(number as usize)
        } else {
            Err(self.refuse("is not a positive whole number"))
        }
    }

    pub fn numbers<const N: usize>(&self) -> Result<[f64; N], IoError> {
        let nodes = self.array()?;
        if nodes.len() != N {
            return Err(self.refuse(format!("has {} numbers, not {N}", nodes.len())));
        }
        let mut numbers = [0.0; N];
        for (number, node) in numbers.iter_mut().zip(&nodes) {
            *number = node.number()?;
        }
        Ok(numbers)
    }

    /// A 3 x 3 matrix, row by row.
    pub fn matrix(&self) -> Result<nalgebra::Matrix3<f64>, IoError> {
        let rows = self.array()?;
        let [first, second, third] = &rows[..] else {
            return Err(self.refuse(format!("has {} rows, not 3", rows.len())));
        };
        let rows: [[f64; 3]; 3] = [first.numbers()?, second.numbers()?, third.numbers()?];
        Ok(nalgebra::Matrix3::from_row_slice(rows.as_flattened()))
    }
}
