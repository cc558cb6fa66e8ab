//! The chunks of a PNG before its image data: its encoding by `cICP`, `sRGB` and `gAMA`, and
//! how large its colour profile is.
//!
//! PNG specification, third edition, section 4.3: `cICP` outranks `iCCP`, which outranks `sRGB`,
//! which outranks `gAMA`. Profiles (`iCCP`) are read by the decoder and judged elsewhere.

use super::icc::{MAX_PROFILE_BYTES, profile_too_large};
use flate2::read::ZlibDecoder;
use std::io::Read;

/// Kinds and data of the chunks before the image data; ends where the file does.
fn chunks(bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    let mut at = 8;
    let next = move || -> Option<(&[u8], &[u8])> {
        let length = u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize;
        let kind = bytes.get(at + 4..at + 8)?;
        let data = bytes.get(at + 8..at.checked_add(8)?.checked_add(length)?)?;
        at = at.checked_add(12)?.checked_add(length)?;
        (kind != b"IDAT" && kind != b"IEND").then_some((kind, data))
    };
    std::iter::from_fn(next)
}

/// Refuses a compressed colour profile that is larger than any, before the decoder inflates it
/// whole: some kilobytes can stand for gigabytes.
pub(super) fn check_profile(bytes: &[u8]) -> Result<(), String> {
    for (kind, data) in chunks(bytes) {
        // A name, a zero, and the method of compression go before the compressed profile.
        let Some(name_len) = data.iter().position(|&byte| byte == 0) else {
            continue;
        };
        let Some(compressed) = data.get(name_len + 2..).filter(|_| kind == b"iCCP") else {
            continue;
        };
        let mut profile = ZlibDecoder::new(compressed).take(MAX_PROFILE_BYTES as u64 + 1);
        // Where it is damaged, the decoder refuses it, or passes it over.
        let length = std::io::copy(&mut profile, &mut std::io::sink()).unwrap_or(0);
        if length > MAX_PROFILE_BYTES as u64 {
            return Err(profile_too_large());
        }
    }
    Ok(())
}

/// The encoding that chunks state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PngColor {
    /// Samples are proportional to light.
    Linear,
    /// sRGB, or a display curve that is as good as it.
    Encoded,
    /// `linear = stored^gamma`.
    Gamma(f64),
}

/// The encoding that the chunks up to the image data state, where they do.
pub(super) fn color(bytes: &[u8]) -> Option<PngColor> {
    let mut by_gamma = None;
    let mut by_srgb = None;
    for (kind, data) in chunks(bytes) {
        match kind {
            // Transfer characteristics of ITU-T H.273: 8 is linear, 13 is sRGB, and the others
            // that cameras write (1, 6, 14) are close to it.
            b"cICP" => {
                return data.get(1).map(|&transfer| match transfer {
                    8 => PngColor::Linear,
                    _ => PngColor::Encoded,
                });
            }
            b"sRGB" => by_srgb = Some(PngColor::Encoded),
            b"gAMA" => {
                let stored = u32::from_be_bytes(data.get(..4)?.try_into().ok()?);
                by_gamma = match stored {
                    0 => None,
                    99_000..=101_000 => Some(PngColor::Linear),
                    // 1 / 2.2, written beside or instead of `sRGB`.
                    45_000..=46_000 => Some(PngColor::Encoded),
                    other => Some(PngColor::Gamma(1e5 / f64::from(other))),
                };
            }
            _ => {}
        }
    }
    by_srgb.or(by_gamma)
}
