//! Opening files that others name: regular files alone.
//!
//! A named pipe among photos blocks whoever opens it until somebody writes, a device may give bytes
//! without end; neither ends by a signal that only asks to stop. So nothing but a regular file, or
//! a link to one, is opened here, and every reader of this crate opens its files here.
//!
//! What is to be written can be had as [`OutputFile`]s first: a program looks at all of them before
//! it touches the disk, and decides what may be replaced.

use crate::error::IoError;
use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};

/// More bytes than any file has that is read as a whole: a hundred megapixels of three 32-bit
/// floats take 1.2 GB.
const MAX_BYTES: u64 = 16 << 30;

/// A file that is not written yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputFile {
    /// Where it belongs.
    pub path: PathBuf,
    /// Its content.
    pub content: Vec<u8>,
}

impl OutputFile {
    pub(crate) fn new(path: impl Into<PathBuf>, content: impl Into<Vec<u8>>) -> Self {
        Self {
            path: path.into(),
            content: content.into(),
        }
    }

    /// Writes it, into a folder that exists.
    pub fn write(&self) -> Result<(), IoError> {
        std::fs::write(&self.path, &self.content).map_err(|error| IoError::write(&self.path, error))
    }
}

/// Writes a large file piece by piece, into a folder that exists.
pub(crate) fn write_pieces(
    path: &Path,
    body: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
) -> Result<(), IoError> {
    let write = || {
        let mut out = BufWriter::new(File::create(path)?);
        body(&mut out)?;
        out.flush()
    };
    write().map_err(|error| IoError::write(path, error))
}

/// Writes files with the folders that they need.
pub(crate) fn write_all(files: &[OutputFile]) -> Result<(), IoError> {
    for file in files {
        if let Some(folder) = file.path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| IoError::write(folder, error))?;
        }
        file.write()?;
    }
    Ok(())
}

/// Opens a regular file, or what a link to one leads to.
///
/// # Errors
/// When it is no regular file (a folder, a named pipe, a socket, a device), does not exist or may
/// not be read; names what it is.
pub fn open_regular(path: &Path) -> Result<File, IoError> {
    let failed = |error: std::io::Error| IoError::read(path, &error);
    // Looked at first, since opening a device can already do something to it.
    check(path, &std::fs::metadata(path).map_err(failed)?)?;
    let mut options = OpenOptions::new();
    options.read(true);
    // Should a named pipe have taken its place since: opened so, it does not block.
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        let flags = rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::CLOEXEC;
        options.custom_flags(flags.bits() as i32);
    }
    let file = options.open(path).map_err(failed)?;
    check(path, &file.metadata().map_err(failed)?)?;
    Ok(file)
}

/// A regular file's content.
///
/// # Errors
/// As [`open_regular`]; and when it is larger than any file that is read as a whole.
pub fn read_regular(path: &Path) -> Result<Vec<u8>, IoError> {
    let failed = |error: std::io::Error| IoError::read(path, &error);
    let file = open_regular(path)?;
    let size = file.metadata().map_err(failed)?.len();
    if size > MAX_BYTES {
        let reason = format!("has {size} bytes, more than any file of its kind");
        return Err(IoError::input(path, reason));
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size as usize).map_err(|_| {
        let reason = format!("has {size} bytes, for which there is not enough memory");
        IoError::input(path, reason)
    })?;
    // A file that grows while it is read ends where it did, or is found too large.
    let limit = MAX_BYTES + 1;
    file.take(limit).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 == limit {
        return Err(IoError::input(path, "has more bytes than its size tells"));
    }
    Ok(bytes)
}

/// A regular text file's content.
///
/// # Errors
/// As [`read_regular`]; and when its bytes are no UTF-8.
pub fn read_regular_text(path: &Path) -> Result<String, IoError> {
    String::from_utf8(read_regular(path)?)
        .map_err(|_| IoError::input(path, "its bytes are no text (UTF-8)"))
}

fn check(path: &Path, metadata: &Metadata) -> Result<(), IoError> {
    if metadata.is_file() {
        return Ok(());
    }
    let what = kind_name(metadata.file_type());
    let reason = if path.is_symlink() {
        format!("is a link to {what}, not to a file")
    } else {
        format!("is {what}, not a file")
    };
    Err(IoError::input(path, reason))
}

fn kind_name(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a named pipe";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if kind.is_dir() {
        "a folder"
    } else {
        "something else"
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::error::IoErrorKind;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    #[test]
    fn only_regular_files_are_opened_and_the_others_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let pipe = at("pipe.jpg");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        let _listener = UnixListener::bind(at("socket.jpg")).unwrap();
        symlink("/dev/zero", at("zero.jpg")).unwrap();
        symlink(&pipe, at("link.jpg")).unwrap();
        for (name, expected) in [
            ("pipe.jpg", "is a named pipe, not a file"),
            ("socket.jpg", "is a socket, not a file"),
            ("zero.jpg", "is a link to a device, not to a file"),
            ("link.jpg", "is a link to a named pipe, not to a file"),
            (".", "is a folder, not a file"),
        ] {
            let error = read_regular(&at(name)).unwrap_err();
            assert_eq!(error.kind, IoErrorKind::Input, "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
        std::fs::write(at("text"), "a").unwrap();
        for (name, expected) in [
            ("none", "no such file"),
            ("text/inside", "no such file"),
            ("a\0b", "cannot be read"),
            (&"long".repeat(100), "cannot be read"),
        ] {
            let error = read_regular(&at(name)).unwrap_err();
            assert_eq!(error.kind, IoErrorKind::Input, "{error}");
            assert!(error.to_string().contains(expected), "{error}");
        }
        std::fs::write(at("text"), "grün").unwrap();
        symlink(at("text"), at("good")).unwrap();
        assert_eq!(read_regular_text(&at("good")).unwrap(), "grün");
        std::fs::write(at("text"), [0xFF]).unwrap();
        assert!(read_regular_text(&at("text")).is_err());
    }

    #[test]
    fn a_file_larger_than_any_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.jpg");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let error = read_regular(&path).unwrap_err().to_string();
        assert!(error.contains("1099511627776 bytes"), "{error}");
    }
}
