//! What kind of file a photo is: by its name where the first bytes cannot say (camera RAW is TIFF
//! or worse), else by its first bytes.

use super::names::{FOREIGN_ENDINGS, ending, is_raw_name};
use crate::error::IoError;
use image::ImageFormat;
use std::path::Path;

/// Brands of still pictures in HEIF (ISO/IEC 23008-12, annex B) of HEVC or any codec.
const HEIF_BRANDS: [&[u8; 4]; 8] = [
    b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1",
];

/// Beginnings of TIFF with places of 64 bits, in both orders of bytes.
const BIG_TIFF: [&[u8; 4]; 2] = [b"II+\0", b"MM\0+"];

/// Bytes by which a format is recognised; those of PNG hold the size already.
pub(super) const HEAD_LEN: usize = 24;

/// Kinds of photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// Camera RAW of any maker.
    Raw,
    Heif,
    OpenExr,
    Jpeg,
    Png,
    Tiff,
    Hdr,
}

impl Format {
    /// The kind of a file that begins so; `None` where it is none of ours.
    pub(super) fn of(path: &Path, head: &[u8]) -> Option<Self> {
        if head.is_empty() || foreign(path).is_some() {
            return None;
        }
        if is_raw_name(path) {
            return Some(Self::Raw);
        }
        let is_heif = HEIF_BRANDS
            .iter()
            .any(|brand| head.get(8..12) == Some(*brand));
        if head.get(4..8) == Some(b"ftyp") && is_heif {
            return Some(Self::Heif);
        }
        if BIG_TIFF.iter().any(|begin| head.starts_with(*begin)) {
            return Some(Self::Tiff);
        }
        match image::guess_format(head).ok()? {
            ImageFormat::OpenExr => Some(Self::OpenExr),
            ImageFormat::Jpeg => Some(Self::Jpeg),
            ImageFormat::Png => Some(Self::Png),
            ImageFormat::Tiff => Some(Self::Tiff),
            ImageFormat::Hdr => Some(Self::Hdr),
            _ => None,
        }
    }
}

/// What a file is by its name, where it is a photo that cannot be decoded.
fn foreign(path: &Path) -> Option<&'static str> {
    let ending = ending(path);
    let mut known = FOREIGN_ENDINGS.iter();
    known
        .find(|(name, _)| *name == ending)
        .map(|(_, kind)| *kind)
}

/// The refusal of a file that is no photo of ours.
pub(super) fn unknown(path: &Path, bytes: &[u8]) -> IoError {
    if bytes.is_empty() {
        return IoError::input(path, "the file is empty (0 bytes)");
    }
    match foreign(path) {
        Some(kind) => IoError::input(path, format!("{kind} files cannot be decoded"))
            .with_hint("convert to 16-bit TIFF, OpenEXR or JPEG with one fixed development"),
        None => {
            let reason = "not a JPEG, HEIC, PNG, TIFF, Radiance HDR or OpenEXR image";
            IoError::input(path, reason)
        }
    }
}
