//! Camera RAW files, decoded by a child process of this program. Inside another program the child is what that one says
//! ([`set_child`]): started again, it would not know the command.
//!
//! The RAW library reads what people's disks hold, and a damaged file can make it ask for more memory than
//! there is, or never end; neither can be caught in the process where it happens, and the other photos
//! would be lost with it. So `rilievo decode-raw NAME` takes a file's content on its stdin, bounds its own
//! memory and time, and answers on its stdout:
//!
//! ```text
//! u32      number of bytes of the head
//! head     postcard: the photo without its samples, or why there is none
//! f32...   samples, little endian
//! ```
//!
//! What the child prints is shown to nobody. It has a process group of its own: Ctrl-C is this program's
//! alone to answer.

use rilievo_io::{IoError, IoErrorKind, decode_raw_here};
use rilievo_scene::{DecodedPhoto, Samples};
use rustix::process::{Resource, Rlimit, Signal, getrlimit, setrlimit};
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::io::{Read, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;

/// Address space that any photo may take, and more for each byte of its file. A pixel takes some 48 bytes
/// while it is decoded, and the smallest files (lossy ones) hold five pixels in a byte: a hundred megapixels
/// have half as much again as they need.
const BASE_MEMORY: u64 = 4 << 30;
const MEMORY_PER_BYTE: u64 = 128;

/// Seconds of computing that any photo may take, and further bytes that one more second stands for:
/// twenty times what present machines need.
const BASE_SECONDS: u64 = 60;
const BYTES_PER_SECOND: u64 = 1 << 20;

/// Samples that are moved at a time.
const CHUNK: usize = 1 << 14;

/// Exit code of a child whose pipes fail.
const READ_OR_WRITE: u8 = 6;

/// The child's program with its first arguments, where it is not the one that runs.
static CHILD: OnceLock<Vec<OsString>> = OnceLock::new();

/// What comes before the samples.
#[derive(Serialize, Deserialize)]
struct Head {
    outcome: Result<DecodedPhoto, String>,
}

/// Decodes in a child process, as a [`rilievo_io::RawDecoder`].
///
/// # Errors
/// [`IoErrorKind::Input`] when the file cannot be decoded; [`IoErrorKind::Read`] when the child could not
/// be started or was ended by somebody else: the file may be good.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let mut child = start(path).map_err(|error| {
        let reason = format!("its decoder, another process of this program, cannot start: {error}");
        kept_from_ending(path, reason)
    })?;
    let answer = converse(&mut child, bytes);
    let status = child.wait().map_err(|error| {
        kept_from_ending(path, format!("its decoder cannot be waited for: {error}"))
    })?;
    match (status.success(), answer) {
        (true, Ok(photo)) => photo.map_err(|reason| IoError::input(path, reason)),
        (true, Err(error)) => Err(kept_from_ending(
            path,
            format!("its decoder's answer cannot be read: {error}"),
        )),
        (false, _) => Err(failed(path, status)),
    }
}

fn kept_from_ending(path: &Path, reason: String) -> IoError {
    IoError {
        path: path.to_path_buf(),
        kind: IoErrorKind::Read,
        reason,
        hint: Some("run the same command again; --threads 1 needs least memory".to_owned()),
    }
}

/// Has another program than the running one be the child: `program` with its arguments, to which the file's name is
/// added, calls [`serve`]. Once, before the first file is decoded.
pub fn set_child(program: Vec<OsString>) {
    // The first one said is as good as a later one.
    let _ = CHILD.set(program);
}

/// The child's program with its arguments, but for the file's name.
fn program() -> std::io::Result<Vec<OsString>> {
    if let Some(program) = CHILD.get() {
        return Ok(program.clone());
    }
    // The running program, also where its file has been replaced since.
    let running = Path::new("/proc/self/exe");
    let program = if running.exists() {
        running.to_path_buf()
    } else {
        std::env::current_exe()?
    };
    Ok(vec![program.into(), "decode-raw".into(), "--".into()])
}

fn start(path: &Path) -> std::io::Result<Child> {
    let program = program()?;
    let (program, arguments) = program
        .split_first()
        .ok_or_else(|| std::io::Error::other("it has no name"))?;
    let mut command = Command::new(program);
    command
        .args(arguments)
        .arg(path.file_name().unwrap_or_default())
        // Photos are decoded side by side already; and each thread takes address space.
        .env("RAYON_NUM_THREADS", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    command.process_group(0);
    command.spawn()
}

/// Gives the child the file and reads its answer; the reason where the child says that there is none.
fn converse(child: &mut Child, bytes: &[u8]) -> std::io::Result<Result<DecodedPhoto, String>> {
    let lost = || std::io::Error::other("its pipes are closed");
    let mut stdin = child.stdin.take().ok_or_else(lost)?;
    let mut stdout = child.stdout.take().ok_or_else(lost)?;
    // The child reads all before it answers. Its status shows one that is gone.
    let _ = stdin.write_all(bytes);
    drop(stdin);
    read_answer(&mut stdout)
}

/// Why a child gave no answer.
fn failed(path: &Path, status: ExitStatus) -> IoError {
    if is_files_fault(status) {
        let reason = "the RAW file cannot be decoded: its decoder failed, or asked for more memory or \
                      time than any photo needs";
        return IoError::input(path, reason);
    }
    let reason = format!(
        "its decoder, another process of this program, was ended from outside ({status}), as by a system \
         that is out of memory"
    );
    kept_from_ending(path, reason)
}

/// Whether a child failed by what it does to itself, or what its own bounds do to it. Every other signal
/// comes from elsewhere, and an exit code but that of a panic is the system's.
fn is_files_fault(status: ExitStatus) -> bool {
    /// Of a Rust program that panicked.
    const PANICKED: i32 = 101;
    let own = [
        Signal::ABORT,
        Signal::SEGV,
        Signal::BUS,
        Signal::FPE,
        Signal::ILL,
        Signal::SYS,
        Signal::TRAP,
        Signal::XCPU,
    ];
    match status.signal() {
        Some(signal) => own.iter().any(|own| own.as_raw() == signal),
        None => status.code() == Some(PANICKED),
    }
}

/// The child: `rilievo decode-raw NAME`. Answers with its exit code.
pub fn serve(name: &Path) -> u8 {
    let mut bytes = Vec::new();
    if std::io::stdin().lock().read_to_end(&mut bytes).is_err() || bound_self(bytes.len()).is_err()
    {
        return READ_OR_WRITE;
    }
    let outcome = decode_raw_here(name, &bytes).map_err(|error| error.reason);
    let stdout = std::io::stdout().lock();
    match write_answer(stdout, outcome) {
        Ok(()) => 0,
        Err(_) => READ_OR_WRITE,
    }
}

/// Bounds memory and time of this process by a file's size, and ends it with its parent.
fn bound_self(file_len: usize) -> std::io::Result<()> {
    let lower = |resource: Resource, to: u64| {
        // Bounds that the process has already may be lower.
        let Rlimit { current, maximum } = getrlimit(resource);
        let least = [current, maximum].into_iter().flatten().fold(to, u64::min);
        let limit = Rlimit {
            current: Some(least),
            maximum,
        };
        setrlimit(resource, limit)
    };
    let file_len = file_len as u64;
    lower(Resource::As, BASE_MEMORY + MEMORY_PER_BYTE * file_len)?;
    lower(Resource::Cpu, BASE_SECONDS + file_len / BYTES_PER_SECOND)?;
    // A file that its decoder fails on is no reason to fill the disk.
    lower(Resource::Core, 0)?;
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL))?;
    Ok(())
}

fn write_answer(mut out: impl Write, outcome: Result<DecodedPhoto, String>) -> std::io::Result<()> {
    let mut samples = Vec::new();
    let outcome = outcome.and_then(|mut photo| match &mut photo.samples {
        Samples::F32(values) => {
            samples = std::mem::take(values);
            Ok(photo)
        }
        // None is given by the library's decoder.
        _ => Err("the RAW file has samples of an unknown kind".to_owned()),
    });
    let head = postcard::to_stdvec(&Head { outcome }).map_err(std::io::Error::other)?;
    out.write_all(&(head.len() as u32).to_le_bytes())?;
    out.write_all(&head)?;
    let mut buffer = Vec::with_capacity(4 * CHUNK);
    for chunk in samples.chunks(CHUNK) {
        buffer.clear();
        buffer.extend(chunk.iter().flat_map(|value| value.to_le_bytes()));
        out.write_all(&buffer)?;
    }
    out.flush()
}

fn read_answer(from: &mut impl Read) -> std::io::Result<Result<DecodedPhoto, String>> {
    let mut length = [0; 4];
    from.read_exact(&mut length)?;
    let mut head = Vec::new();
    from.take(u64::from(u32::from_le_bytes(length)))
        .read_to_end(&mut head)?;
    let Head { outcome } = postcard::from_bytes(&head).map_err(std::io::Error::other)?;
    let mut photo = match outcome {
        Ok(photo) => photo,
        Err(reason) => return Ok(Err(reason)),
    };
    let num = [photo.width, photo.height, photo.channels]
        .into_iter()
        .try_fold(1_usize, usize::checked_mul)
        .ok_or_else(|| std::io::Error::other("its size is too large"))?;
    let mut samples = Vec::new();
    samples
        .try_reserve_exact(num)
        .map_err(std::io::Error::other)?;
    let mut buffer = vec![0; 4 * CHUNK];
    while samples.len() < num {
        let piece = &mut buffer[..4 * CHUNK.min(num - samples.len())];
        from.read_exact(piece)?;
        let (values, _) = piece.as_chunks::<4>();
        samples.extend(values.iter().map(|&value| f32::from_le_bytes(value)));
    }
    photo.samples = Samples::F32(samples);
    Ok(Ok(photo))
}

/// Arguments of the child.
#[derive(Debug, clap::Args)]
pub struct DecodeRawArgs {
    /// The file's name, whose ending shows the maker
    pub name: PathBuf,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::ExifFacts;

    fn photo() -> DecodedPhoto {
        DecodedPhoto {
            file_name: "ä.dng".to_owned(),
            width: 217,
            height: 113,
            channels: 3,
            samples: Samples::F32((0..217 * 113 * 3).map(|i| (i as f32).sin()).collect()),
            linear_by_metadata: true,
            saturates_at_white: true,
            encoding_reason: "camera RAW".to_owned(),
            profile_curve: None,
            alpha: None,
            exif: ExifFacts {
                iso: Some(100.0),
                ..ExifFacts::default()
            },
        }
    }

    #[test]
    fn an_answer_comes_back_bit_for_bit_and_a_part_of_it_is_none() {
        let mut bytes = Vec::new();
        write_answer(&mut bytes, Ok(photo())).unwrap();
        assert_eq!(read_answer(&mut &bytes[..]).unwrap(), Ok(photo()));
        for end in [0, 3, 20, bytes.len() / 2, bytes.len() - 1] {
            assert!(read_answer(&mut &bytes[..end]).is_err(), "{end}");
        }
        let mut bytes = Vec::new();
        write_answer(&mut bytes, Err("no".to_owned())).unwrap();
        assert_eq!(read_answer(&mut &bytes[..]).unwrap(), Err("no".to_owned()));
    }

    #[test]
    fn whoever_ends_the_decoder_decides_whether_the_file_is_to_blame() {
        let kind = |status: i32| failed(Path::new("a.dng"), ExitStatus::from_raw(status)).kind;
        // SIGABRT, SIGSEGV, SIGXCPU, and the exit code of a panic.
        for own in [6, 11, 24, 101 << 8] {
            assert_eq!(kind(own), IoErrorKind::Input, "{own}");
        }
        // SIGHUP, SIGINT, SIGKILL, SIGTERM, and the exit codes of a full pipe and a broken installation.
        for foreign in [1, 2, 9, 15, 6 << 8, 127 << 8] {
            assert_eq!(kind(foreign), IoErrorKind::Read, "{foreign}");
        }
    }
}
