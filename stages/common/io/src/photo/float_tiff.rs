//! Floating-point TIFF of the kinds that the image library leaves out: one channel, and 16 or 64
//! bits a sample.

use crate::claims;
use std::io::Cursor;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

/// Width, height, channels (1 or 3, alpha left out) and samples, white at 1; `None` where the file
/// is no such TIFF or is damaged.
pub(super) fn read(bytes: &[u8]) -> Option<(usize, usize, usize, Vec<f32>)> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let (stored, channels) = match decoder.colortype().ok()? {
        ColorType::Gray(16 | 32 | 64) => (1, 1),
        ColorType::GrayA(16 | 32 | 64) => (2, 1),
        ColorType::RGB(16 | 32 | 64) => (3, 3),
        ColorType::RGBA(16 | 32 | 64) => (4, 3),
        _ => return None,
    };
    let (width, height) = decoder.dimensions().ok()?;
    let num_px = u64::from(width) * u64::from(height);
    // Eight bytes a sample, and their four.
    let size = (u64::from(width), u64::from(height));
    claims::check(
        size,
        8 * stored as u64,
        2,
        bytes.len(),
        claims::MAX_EXPANSION,
    )
    .ok()?;
    // Bounds what a damaged header can ask for: eight bytes a sample.
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(num_px).ok()?.checked_mul(8 * stored)?;
    let mut decoder = decoder.with_limits(limits);
    let samples: Vec<f32> = match decoder.read_image().ok()? {
        DecodingResult::F16(v) => v.into_iter().map(f32::from).collect(),
        DecodingResult::F32(v) => v,
        DecodingResult::F64(v) => v.into_iter().map(|value| value as f32).collect(),
        _ => return None,
    };
    let (width, height) = (width as usize, height as usize);
    // Planes stored one after the other hold more or less than this.
    (samples.len() == width * height * stored).then_some(())?;
    let samples = if stored == channels {
        samples
    } else {
        samples
            .chunks_exact(stored)
            .flat_map(|pixel| pixel[..channels].iter().copied())
            .collect()
    };
    Some((width, height, channels, samples))
}
