//! Ranges of options: every number that a user can set is checked here, before anything runs.

use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

/// An option whose value lies outside its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("option {key} = {value} must {expected}")]
pub struct OptionError {
    /// Its key as in the configuration file, after the tables that hold it: `sphere.search_px`.
    pub key: String,
    /// Its value.
    pub value: String,
    /// What is allowed: `lie within 0.1 to 200`.
    pub expected: String,
}

/// A key that a table of the configuration file had once. A file that still has it ends with an error that says what to
/// do instead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetiredKey {
    /// Its path within the stage's table, as `["photo", "num_sweeps"]`.
    pub path: &'static [&'static str],
    /// What replaces it, as the end of a sentence: "use `shading.paper.noise`", "it is fixed at 0.3 px".
    pub instead: &'static str,
}

impl RetiredKey {
    /// A key with what replaces it.
    pub const fn new(path: &'static [&'static str], instead: &'static str) -> Self {
        Self { path, instead }
    }
}

/// Checks one number; NaN lies in no range.
///
/// A range is wide enough for every use that makes sense, and ends where work or memory would no
/// longer be bounded, or numbers no longer be exact.
///
/// # Errors
/// Key, value and range of a number outside its range.
pub fn in_range<T>(key: &str, value: T, range: RangeInclusive<T>) -> Result<(), OptionError>
where
    T: PartialOrd + Debug + Display,
{
    let inside = range.contains(&value);
    let expected = || format!("lie within {} to {}", range.start(), range.end());
    fulfils(key, value, inside, expected)
}

/// Checks what is more than a range; `expected` goes on after "must".
///
/// # Errors
/// Key, value and what is expected, where the value does not fulfil it.
pub fn fulfils<S: Into<String>>(
    key: &str,
    value: impl Debug,
    fulfilled: bool,
    expected: impl FnOnce() -> S,
) -> Result<(), OptionError> {
    if fulfilled {
        return Ok(());
    }
    Err(OptionError {
        key: key.to_owned(),
        // `Debug` writes 1e308 as it is, `Display` with 308 zeros.
        value: format!("{value:?}"),
        expected: expected().into(),
    })
}

/// Checks fields of an options struct, each against its range and under its own name as the key: the first
/// [`OptionError`] leaves the function.
#[macro_export]
macro_rules! check_ranges {
    ($options:expr; $($field:ident in $range:expr),+ $(,)?) => {{
        $($crate::options::in_range(stringify!($field), $options.$field, $range)?;)+
        Ok(())
    }};
}

/// Adds the name of the table that holds the checked options.
pub trait InTable {
    /// The same result, with `table.` before the key.
    ///
    /// # Errors
    /// Those of the check.
    fn in_table(self, table: &str) -> Self;
}

impl InTable for Result<(), OptionError> {
    fn in_table(self, table: &str) -> Self {
        self.map_err(|error| OptionError {
            key: format!("{table}.{}", error.key),
            ..error
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_outside_its_range_is_told_with_key_value_and_range() {
        let told = |result: Result<(), OptionError>| result.err().map(|error| error.to_string());
        assert_eq!(told(in_range("a", 0.1, 0.1..=2.0)), None);
        assert_eq!(told(in_range("a", 7_usize, 0..=7)), None);
        assert_eq!(
            told(in_range("a", 1e308, 0.1..=2.0).in_table("t")),
            Some("option t.a = 1e308 must lie within 0.1 to 2".to_owned())
        );
        for wrong in [f64::NAN, f64::INFINITY, -0.1] {
            assert!(in_range("a", wrong, 0.0..=1.0).is_err(), "{wrong}");
        }
    }
}
