//! Columns and rows of a photo by its header alone.

use super::format::{Format, HEAD_LEN};
use super::guard::guarded;
use super::heic;
use crate::claims::MAX_PIXELS;
use crate::error::IoError;
use crate::files::{open_regular, read_regular};
use image::{ImageFormat, ImageReader};
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// Columns and rows of a photo by its header alone; `None` where it has none that can be read, or
/// that no photo has. Headers of camera RAW files describe their previews.
pub fn photo_size(path: &Path) -> Option<(usize, usize)> {
    let mut file = open_regular(path).ok()?;
    let mut head = [0; HEAD_LEN];
    file.read_exact(&mut head).ok()?;
    file.rewind().ok()?;
    let size = guarded(path, || {
        of_format(path, &head, file).ok_or_else(|| IoError::input(path, "names no size"))
    });
    let num_px = |&(width, height): &(usize, usize)| (width as u64).saturating_mul(height as u64);
    size.ok()
        .filter(|size| (1..=MAX_PIXELS).contains(&num_px(size)))
}

fn of_format(path: &Path, head: &[u8; HEAD_LEN], file: File) -> Option<(usize, usize)> {
    let file = BufReader::new(file);
    let by_library = |file, format| {
        ImageReader::with_format(file, format)
            .into_dimensions()
            .ok()
    };
    let (width, height) = match Format::of(path, head)? {
        Format::Raw => return None,
        Format::Heif => return heic::size(&read_regular(path).ok()?),
        // The library would inflate the colour profile before it returns the size.
        Format::Png => {
            let number = |at: usize| Some(u32::from_be_bytes(*head[at..].first_chunk()?));
            (number(16)?, number(20)?)
        }
        Format::Tiff => tiff::decoder::Decoder::new(file).ok()?.dimensions().ok()?,
        Format::OpenExr => {
            let meta = exr::meta::MetaData::read_from_buffered(file, false).ok()?;
            let size = meta.headers.first()?.shared_attributes.display_window.size;
            return Some((size.0, size.1));
        }
        Format::Jpeg => by_library(file, ImageFormat::Jpeg)?,
        Format::Hdr => by_library(file, ImageFormat::Hdr)?,
    };
    Some((width as usize, height as usize))
}
