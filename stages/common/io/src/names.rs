//! Which names of photos a format can hold: what would be read back as another name, or as another
//! line, is refused by name.

use crate::error::IoError;
use std::path::Path;

/// How a format keeps names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Names {
    /// As a path in a text with quotes, or after its length; readers take what stands behind its
    /// last slash or backslash.
    Path,
    /// Up to a zero byte.
    Terminated,
    /// In an attribute of XML, which has no control characters but tabs and line breaks.
    Xml,
    /// As the rest of a line.
    Line,
    /// As the first word of a line, in which `#` would begin a comment.
    Word,
}

impl Names {
    /// Refuses a name that the format cannot hold; `path` is the file to be written.
    pub(crate) fn check(self, path: &Path, format: &str, name: &str) -> Result<(), IoError> {
        let unprintable = |c: char| c.is_control();
        let obstacle = match self {
            Self::Path if name.contains('\\') => "a backslash",
            Self::Terminated if name.contains('\0') => "a zero",
            Self::Xml if name.contains(|c| c < ' ' && !matches!(c, '\t' | '\n' | '\r')) => {
                "a control character"
            }
            Self::Line | Self::Word if name.contains(unprintable) => {
                "a line break or another control character"
            }
            Self::Word if name.contains(char::is_whitespace) => "a space",
            Self::Word if name.starts_with('#') => "a # at its beginning",
            Self::Line if name.trim() != name => "a space at its beginning or end",
            _ => return Ok(()),
        };
        let reason = format!("{format} cannot hold the photo's name {name:?}: it has {obstacle}");
        Err(IoError::input(path, reason).with_hint("rename the photo, or choose another format"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_way_of_keeping_names_has_its_own_obstacles() {
        let allowed = |names: Names, name: &str| names.check(Path::new("x"), "It", name).is_ok();
        let ways = [
            Names::Path,
            Names::Terminated,
            Names::Xml,
            Names::Line,
            Names::Word,
        ];
        for (name, expected) in [
            ("IMG_1.jpg", [true; 5]),
            ("a/ü石.jpg", [true; 5]),
            ("a\nb.jpg", [true, true, true, false, false]),
            ("a\u{1}b.jpg", [true, true, false, false, false]),
            ("a\0b.jpg", [true, false, false, false, false]),
            ("a b.jpg", [true, true, true, true, false]),
            (" a.jpg", [true, true, true, false, false]),
            ("#1.jpg", [true, true, true, true, false]),
            ("a\\b.jpg", [false, true, true, true, true]),
        ] {
            assert_eq!(ways.map(|way| allowed(way, name)), expected, "{name:?}");
        }
        let error = Names::Line.check(Path::new("o/images.txt"), "COLMAP's text", "a\nb.jpg");
        let message = error.unwrap_err().to_string();
        assert!(
            message.contains("images.txt") && message.contains(r#""a\nb.jpg""#),
            "{message}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}
