//! Text files of words and numbers: every refusal names the file and the line.

use crate::error::IoError;
use std::path::Path;
use std::str::FromStr;

/// The words of one line, with messages that name file and line.
pub(crate) struct Line<'a> {
    pub file: &'a Path,
    /// From one.
    pub number: usize,
    /// What has not been read yet.
    pub rest: &'a str,
}

impl<'a> Line<'a> {
    pub fn refuse(&self, reason: impl std::fmt::Display) -> IoError {
        IoError::input(self.file, format!("line {}: {reason}", self.number))
    }

    pub fn word(&mut self, what: &str) -> Result<&'a str, IoError> {
        let trimmed = self.rest.trim_start();
        if trimmed.is_empty() {
            return Err(self.refuse(format!("{what} is missing")));
        }
        let end = trimmed.find(char::is_whitespace).unwrap_or(trimmed.len());
        self.rest = &trimmed[end..];
        Ok(&trimmed[..end])
    }

    pub fn parse<T: FromStr>(&mut self, what: &str) -> Result<T, IoError> {
        let word = self.word(what)?;
        word.parse()
            .map_err(|_| self.refuse(format!("{what} is \"{word}\"")))
    }

    pub fn number(&mut self, what: &str) -> Result<f64, IoError> {
        let value: f64 = self.parse(what)?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(self.refuse(format!("{what} is {value}")))
        }
    }

    /// The next `N` numbers.
    pub fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], IoError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number(what)?;
        }
        Ok(values)
    }

    pub fn is_done(&self) -> bool {
        self.rest.trim().is_empty()
    }
}

/// Numbers with a space between them.
pub(crate) fn spaced<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    let words: Vec<String> = values.into_iter().map(f64::to_string).collect();
    words.join(" ")
}

/// Lines that carry data; empty ones stay with `keep_empty`, where they mean something.
pub(crate) fn lines<'a>(
    file: &'a Path,
    text: &'a str,
    keep_empty: bool,
) -> impl Iterator<Item = Line<'a>> {
    text.lines()
        .enumerate()
        .filter(move |(_, line)| {
            let line = line.trim_start();
            !line.starts_with('#') && (keep_empty || !line.is_empty())
        })
        .map(move |(i, line)| Line {
            file,
            number: i + 1,
            rest: line.trim_end(),
        })
}
