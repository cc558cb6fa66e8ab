//! Whether a JPEG file is whole: a walk over its markers from the first to the end-of-image.
//!
//! Decoders fill the missing part of a cut-off JPEG with grey and report success; as a photo that
//! is worse than none. The end-of-image marker (ITU-T T.81, section B.1.1.3) is always the last
//! thing that a camera writes, so its absence tells.

/// What is wrong with a JPEG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Defect {
    /// The file ends before its end-of-image marker.
    #[error("the JPEG is cut off: it ends after {0} bytes without its end marker")]
    CutOff(usize),
    /// Four colour components.
    #[error("CMYK images have no red, green and blue to measure")]
    Cmyk,
    /// A frame of zero size, a lossless or arithmetic frame, or no frame at all.
    #[error("the JPEG is damaged: {0}")]
    Damaged(&'static str),
}

/// Walks over the markers.
pub(super) fn check(bytes: &[u8]) -> Result<(), Defect> {
    let cut_off = || Defect::CutOff(bytes.len());
    let mut at = 2; // After the start-of-image marker that the format was recognised by.
    let mut seen_frame = false;
    let mut seen_scan = false;
    loop {
        // Markers may be preceded by any number of fill bytes; some cameras pad between segments.
        while *bytes.get(at).ok_or_else(cut_off)? != 0xFF {
            at += 1;
        }
        while *bytes.get(at).ok_or_else(cut_off)? == 0xFF {
            at += 1;
        }
        let marker = *bytes.get(at).ok_or_else(cut_off)?;
        at += 1;
        match marker {
            0xD9 if seen_scan => return Ok(()),
            0xD9 => return Err(Defect::Damaged("it has no image data")),
            // A stuffed zero, a restart marker or a lone marker carries no length.
            0x00 | 0x01 | 0xD0..=0xD8 => {}
            _ => {
                let length = match bytes.get(at..at + 2) {
                    Some([high, low]) => usize::from(*high) << 8 | usize::from(*low),
                    _ => return Err(cut_off()),
                };
                let segment = bytes.get(at + 2..at + length.max(2)).ok_or_else(cut_off)?;
                // Start of frame; C4, C8 and CC are tables.
                if (0xC0..=0xCF).contains(&marker) && !matches!(marker, 0xC4 | 0xC8 | 0xCC) {
                    seen_frame = true;
                    match segment.get(5) {
                        Some(1 | 3) => {}
                        Some(4) => return Err(Defect::Cmyk),
                        _ => return Err(Defect::Damaged("it has neither 1 nor 3 components")),
                    }
                }
                if marker == 0xDA {
                    if !seen_frame {
                        return Err(Defect::Damaged("its image data come before its frame"));
                    }
                    seen_scan = true;
                }
                at += length.max(2);
            }
        }
    }
}
