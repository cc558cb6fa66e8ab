//! What can go wrong with a file, as facts: which file, which place in it, why, and what to try.

use std::path::{Path, PathBuf};

/// What kind of failure it was; the program maps it to its exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IoErrorKind {
    /// The file is missing or its content cannot be used.
    Input,
    /// The system refused to read.
    Read,
    /// The system refused to write.
    Write,
}

/// A file that could not be read, used or written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IoError {
    /// The file.
    pub path: PathBuf,
    /// What kind of failure.
    pub kind: IoErrorKind,
    /// Why, with the key and value where the content is refused.
    pub reason: String,
    /// What to try.
    pub hint: Option<String>,
}

impl std::fmt::Display for IoError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.reason)?;
        match &self.hint {
            Some(hint) => write!(f, " ({hint})"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for IoError {}

impl IoError {
    fn new(path: &Path, kind: IoErrorKind, reason: impl Into<String>) -> Self {
        Self {
            path: path.to_path_buf(),
            kind,
            reason: reason.into(),
            hint: None,
        }
    }

    /// Content that cannot be used.
    pub fn input(path: &Path, reason: impl Into<String>) -> Self {
        Self::new(path, IoErrorKind::Input, reason)
    }

    /// A failed read; a file that does not exist, or cannot by its name, is unusable input.
    pub fn read(path: &Path, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let (kind, reason) = match error.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => {
                (IoErrorKind::Input, "there is no such file".to_owned())
            }
            ErrorKind::UnexpectedEof => (IoErrorKind::Input, "the file ends too early".to_owned()),
            ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::InvalidFilename => {
                (IoErrorKind::Input, format!("cannot be read: {error}"))
            }
            _ => (IoErrorKind::Read, format!("cannot be read: {error}")),
        };
        Self::new(path, kind, reason)
    }

    /// A failed write.
    pub fn write(path: &Path, error: impl std::fmt::Display) -> Self {
        let reason = format!("cannot be written: {error}");
        Self::new(path, IoErrorKind::Write, reason)
    }

    /// Adds what to try.
    #[must_use]
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}
