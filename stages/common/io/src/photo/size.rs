//! Columns and rows of a photo by its header alone.

use super::guard::guarded;
use super::heic;
use super::names::is_raw_name;
use crate::claims::MAX_PIXELS;
use crate::error::IoError;
use crate::files::{open_regular, read_regular};
use image::{ImageFormat, ImageReader};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// Bytes by which a format is recognised; those of PNG hold the size already.
const HEAD_LEN: usize = 24;

/// Columns and rows of a photo by its header alone; `None` where it has none that can be read, or that no photo has. Headers
/// of camera RAW files tell of their previews.
pub fn photo_size(path: &Path) -> Option<(usize, usize)> {
    if is_raw_name(path) {
        return None;
    }
    let mut file = open_regular(path).ok()?;
    let mut head = [0; HEAD_LEN];
    file.read_exact(&mut head).ok()?;
    file.rewind().ok()?;
    let size = guarded(path, || {
        let size = if heic::is_heif(&head) {
            read_regular(path).ok().and_then(|bytes| heic::size(&bytes))
        } else {
            image::guess_format(&head)
                .ok()
                .and_then(|format| of_format(format, &head, file))
        };
        size.ok_or_else(|| IoError::input(path, "tells no size"))
    });
    let num_px = |&(width, height): &(usize, usize)| (width as u64).saturating_mul(height as u64);
    size.ok()
        .filter(|size| (1..=MAX_PIXELS).contains(&num_px(size)))
}

fn of_format(format: ImageFormat, head: &[u8; HEAD_LEN], file: File) -> Option<(usize, usize)> {
    let file = BufReader::new(file);
    match format {
        // The library would inflate the colour profile before it tells the size.
        ImageFormat::Png => {
            let number =
                |at: usize| Some(u32::from_be_bytes(head.get(at..at + 4)?.try_into().ok()?));
            Some((number(16)? as usize, number(20)? as usize))
        }
        ImageFormat::Tiff => {
            let size = tiff::decoder::Decoder::new(file).ok()?.dimensions().ok()?;
            Some((size.0 as usize, size.1 as usize))
        }
        ImageFormat::OpenExr => {
            let meta = exr::meta::MetaData::read_from_buffered(file, false).ok()?;
            let size = meta.headers.first()?.shared_attributes.display_window.size;
            Some((size.0, size.1))
        }
        ImageFormat::Jpeg | ImageFormat::Hdr => {
            let reader = ImageReader::with_format(file, format);
            let (width, height) = reader.into_dimensions().ok()?;
            Some((width as usize, height as usize))
        }
        _ => None,
    }
}
