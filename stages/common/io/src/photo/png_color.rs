//! What a PNG says of its encoding: chunks `cICP`, `sRGB`, `gAMA` before the image data.
//!
//! PNG specification, third edition, section 4.3: `cICP` outranks `iCCP`, which outranks `sRGB`,
//! which outranks `gAMA`. Profiles (`iCCP`) are read by the decoder and judged elsewhere.

/// What the chunks say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PngColor {
    /// Samples are proportional to light.
    Linear,
    /// sRGB, or a display curve that is as good as it.
    Encoded,
    /// `linear = stored^gamma`.
    Gamma(f64),
}

/// Reads the chunks up to the image data; `None` where they say nothing.
pub(super) fn read(bytes: &[u8]) -> Option<PngColor> {
    let mut at = 8;
    let mut by_gamma = None;
    let mut by_srgb = None;
    loop {
        let length = u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize;
        let kind = bytes.get(at + 4..at + 8)?;
        let data = bytes.get(at + 8..at.checked_add(8)?.checked_add(length)?)?;
        match kind {
            b"IDAT" | b"IEND" => return by_srgb.or(by_gamma),
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
        at = at.checked_add(12)?.checked_add(length)?;
    }
}
