//! TIFF of the kinds that the image library leaves out: floating point of one channel, or of 16 or 64 bits; integers of
//! 32 bits; and brightness with colour differences, as JPEG in TIFF has them.

use crate::claims;
use rilievo_scene::Samples;
use std::io::Cursor;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{SampleFormat, Tag};

/// Width, height and channels (1 or 3, alpha left out) of a picture, and its samples.
pub(super) type Picture = ((usize, usize, usize), Samples);

/// Whether samples are integers of 32 bits, whose bits the image library would take for those of floating point.
pub(super) fn has_wide_integers(bytes: &[u8]) -> bool {
    let Ok(mut decoder) = Decoder::new(Cursor::new(bytes)) else {
        return false;
    };
    if !decoder
        .colortype()
        .is_ok_and(|color| color.bit_depth() == 32)
    {
        return false;
    }
    let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat);
    let float = SampleFormat::IEEEFP.to_u16();
    !matches!(formats, Ok(Some(formats)) if formats.contains(&float))
}

/// The picture of a TIFF of such a kind, floating point with white at 1; `None` where the file is no such TIFF or is
/// damaged. Integers of 32 bits become floating point, which holds the counts of an instrument however few they are.
pub(super) fn read(bytes: &[u8]) -> Option<Picture> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let (stored, channels) = match decoder.colortype().ok()? {
        ColorType::Gray(16 | 32 | 64) => (1, 1),
        ColorType::GrayA(16 | 32 | 64) => (2, 1),
        ColorType::RGB(16 | 32 | 64) => (3, 3),
        ColorType::RGBA(16 | 32 | 64) => (4, 3),
        ColorType::YCbCr(8) => (3, 3),
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
    let is_ycbcr = decoder.colortype().ok()? == ColorType::YCbCr(8);
    let samples: Vec<f32> = match decoder.read_image().ok()? {
        DecodingResult::U8(mut v) if is_ycbcr => {
            let size = (width as usize, height as usize, 3);
            v.as_chunks_mut()
                .0
                .iter_mut()
                .for_each(|pixel| *pixel = rgb_of(*pixel));
            return (v.len() == size.0 * size.1 * 3).then_some((size, Samples::U8(v)));
        }
        DecodingResult::U32(v) => v
            .into_iter()
            .map(|value| (f64::from(value) / f64::from(u32::MAX)) as f32)
            .collect(),
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
    Some(((width, height, channels), Samples::F32(samples)))
}

/// Red, green and blue of brightness and colour differences, in the full range (JFIF 1.02, the default of TIFF 6.0 too).
fn rgb_of([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    let (y, cb, cr) = (f32::from(y), f32::from(cb) - 128.0, f32::from(cr) - 128.0);
    let rgb = [
        y + 1.402 * cr,
        y - 0.344_136 * cb - 0.714_136 * cr,
        y + 1.772 * cb,
    ];
    rgb.map(|value| value.round().clamp(0.0, 255.0) as u8)
}
