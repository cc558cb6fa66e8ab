//! Which decoder camera RAW files go through.
//!
//! A RAW library reads the formats of dozens of makers, and a damaged or hostile file can make it
//! ask for more memory than there is, which ends the process: no check around it can help. Used
//! alone, this crate decodes in the calling process all the same; a program that must outlive such
//! files installs a decoder that works in a process of its own ([`set_raw_decoder`]), which calls
//! [`decode_raw_here`].

use super::guard::guarded;
use crate::error::{IoError, IoErrorKind};
use rilievo_scene::DecodedPhoto;
use std::path::Path;
use std::sync::OnceLock;

/// Decodes the content of a RAW file, which the path names: its ending names the maker, its name
/// goes into messages, and nothing is read from there.
///
/// # Errors
/// Of kind [`IoErrorKind::Input`] when the content cannot be decoded, which is the file's fault and
/// stays so; of kind [`IoErrorKind::Read`] when decoding was kept from ending, and may do so
/// another time.
pub type RawDecoder = fn(&Path, &[u8]) -> Result<DecodedPhoto, IoError>;

static INSTALLED: OnceLock<RawDecoder> = OnceLock::new();

/// How a RAW file becomes a photo whose samples are proportional to light. LibRaw's `-4` writes 16
/// bits without tone curve and automatic brightness, `-o 0` keeps the camera's colours, so that the
/// file has no statement of its colours and is taken as linear.
const RAW_HINT: &str = "develop all photos alike to linear 16-bit TIFF, as with LibRaw's \
     dcraw_emu -T -4 -o 0 -w FILE, or in RawTherapee or darktable with a linear output profile and \
     no tone curve";

/// Lets all RAW files of this process go through a decoder; once, before the first is decoded. Says
/// whether it was the first.
pub fn set_raw_decoder(decoder: RawDecoder) -> bool {
    INSTALLED.set(decoder).is_ok()
}

/// Decodes in this process; a panic of the RAW library is a refusal.
///
/// # Errors
/// When the content cannot be decoded, or this crate was built without the feature `raw`.
pub fn decode_raw_here(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    guarded(path, || library(path, bytes))
}

/// Decodes by what is installed.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let decoder = INSTALLED.get().copied().unwrap_or(decode_raw_here);
    decoder(path, bytes).map_err(|error| match error.kind {
        IoErrorKind::Input => error.with_hint(RAW_HINT),
        IoErrorKind::Read | IoErrorKind::Write => error,
    })
}

#[cfg(feature = "raw")]
use super::raw::decode as library;

#[cfg(not(feature = "raw"))]
fn library(path: &Path, _: &[u8]) -> Result<DecodedPhoto, IoError> {
    let reason = "this program was built without the reader of camera RAW files (feature `raw`)";
    Err(IoError::input(path, reason))
}
