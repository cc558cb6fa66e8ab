//! Portable float maps: one or three f32 channels, rows from the bottom up.
//!
//! Header `Pf` (grey) or `PF` (colour), width and height, and a scale whose sign tells the byte
//! order (negative: little endian). Used by MVSNet and the Middlebury benchmarks for depth.

use crate::error::IoError;
use crate::files::read_regular;
use rilievo_scene::Raster;
use std::path::Path;

/// Writes a grey map.
///
/// # Errors
/// When the file cannot be written.
pub fn write_pfm(path: &Path, map: &Raster<f32>) -> Result<(), IoError> {
    let mut bytes = format!("Pf\n{} {}\n-1.0\n", map.width, map.height).into_bytes();
    for row in map.data.chunks(map.width.max(1)).rev() {
        for value in row {
            bytes.extend(value.to_le_bytes());
        }
    }
    std::fs::write(path, bytes).map_err(|error| IoError::write(path, error))
}

/// Reads a grey map. Infinite and undefined values, which others write for "no value", become 0.
///
/// # Errors
/// When the file cannot be read or is no grey PFM.
pub fn read_pfm(path: &Path) -> Result<Raster<f32>, IoError> {
    let bytes = read_regular(path)?;
    parse(&bytes).map_err(|reason| IoError::input(path, reason))
}

fn parse(bytes: &[u8]) -> Result<Raster<f32>, String> {
    let mut at = 0;
    let mut word = || -> Result<&str, String> {
        let begin = at
            + bytes[at..]
                .iter()
                .take_while(|b| b.is_ascii_whitespace())
                .count();
        let len = bytes[begin..]
            .iter()
            .take_while(|b| !b.is_ascii_whitespace())
            .count();
        at = begin + len;
        std::str::from_utf8(&bytes[begin..at]).map_err(|_| "not a PFM file".to_owned())
    };
    match word()? {
        "Pf" => {}
        "PF" => return Err("a colour PFM, where one channel is needed".to_owned()),
        _ => return Err("not a PFM file".to_owned()),
    }
    let mut size = || -> Result<usize, String> {
        let text = word()?;
        text.parse()
            .ok()
            .filter(|&n| n > 0 && n <= 1_000_000)
            .ok_or_else(|| format!("its size is \"{text}\""))
    };
    let (width, height) = (size()?, size()?);
    let scale = word()?;
    let scale: f64 = scale
        .parse()
        .map_err(|_| format!("its scale is \"{scale}\""))?;
    // One white space ends the header.
    let body = bytes.get(at + 1..).unwrap_or_default();
    let expected = width * height * 4;
    if body.len() < expected {
        return Err(format!(
            "ends too early: {} bytes for {width} x {height} pixels",
            body.len()
        ));
    }
    let value = |index: usize| {
        let word = [
            body[index],
            body[index + 1],
            body[index + 2],
            body[index + 3],
        ];
        let value = if scale < 0.0 {
            f32::from_le_bytes(word)
        } else {
            f32::from_be_bytes(word)
        };
        if value.is_finite() { value } else { 0.0 }
    };
    Ok(Raster::from_fn(width, height, |x, y| {
        value(4 * ((height - 1 - y) * width + x))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_survive_the_disk_and_begin_at_the_bottom() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.pfm");
        let map = Raster::from_fn(5, 3, |x, y| x as f32 + 10.0 * y as f32);
        write_pfm(&path, &map).unwrap();
        assert_eq!(read_pfm(&path).unwrap(), map);
        let bytes = std::fs::read(&path).unwrap();
        let first = f32::from_le_bytes(bytes[bytes.len() - 60..][..4].try_into().unwrap());
        assert_eq!(first, *map.at(0, 2));
        for end in 0..bytes.len() {
            assert!(parse(&bytes[..end]).is_err(), "{end}");
        }
    }

    #[test]
    fn big_endian_and_missing_values() {
        let mut bytes = b"Pf 2 1 1.0\n".to_vec();
        bytes.extend(2.5f32.to_be_bytes());
        bytes.extend(f32::INFINITY.to_be_bytes());
        assert_eq!(parse(&bytes).unwrap().data, [2.5, 0.0]);
        assert!(parse(b"PF 1 1 -1\n0000").is_err());
        assert!(parse(b"Pf 0 1 -1\n").is_err());
    }
}
