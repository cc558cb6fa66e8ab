//! COLMAP's dense arrays: the text `width&height&channels&`, then f32 little endian, one whole
//! channel after the other, each row by row.
//!
//! Source: COLMAP documentation, "Output format", section on dense reconstruction.

use super::pixels::{floats, num_pixels};
use crate::error::IoError;
use crate::exr_maps::interleaved;
use crate::files::read_regular;
use rilievo_scene::{DepthMap, NormalMap, Raster};
use std::path::Path;

/// Reads a depth map.
///
/// # Errors
/// When the file cannot be read, or is no array of one channel.
pub fn read_colmap_depth(path: &Path) -> Result<DepthMap, IoError> {
    let (width, height, [data]) = read(path)?;
    Ok(Raster {
        width,
        height,
        data,
    })
}

/// Reads a normal map.
///
/// # Errors
/// When the file cannot be read, or is no array of three channels.
pub fn read_colmap_normal(path: &Path) -> Result<NormalMap, IoError> {
    let (width, height, planes) = read(path)?;
    Ok(Raster {
        width,
        height,
        data: interleaved(planes).collect(),
    })
}

type Planes<const N: usize> = (usize, usize, [Vec<f32>; N]);

fn read<const N: usize>(path: &Path) -> Result<Planes<N>, IoError> {
    let bytes = read_regular(path)?;
    let refuse = |reason: String| IoError::input(path, reason);
    let mut sizes = [0_usize; 3];
    let mut at = 0;
    for size in &mut sizes {
        // Longer numbers than this are no size.
        let end = bytes[at..].iter().take(12).position(|&b| b == b'&');
        let number = end
            .and_then(|end| std::str::from_utf8(&bytes[at..at + end]).ok())
            .and_then(|text| text.trim().parse().ok());
        let (Some(end), Some(number)) = (end, number) else {
            return Err(refuse(
                "does not begin with COLMAP's width&height&channels&".to_owned(),
            ));
        };
        *size = number;
        at += end + 1;
    }
    let [width, height, channels] = sizes;
    let num = num_pixels(path, width, height)?;
    if channels != N {
        return Err(refuse(format!(
            "has {channels} channel(s), where {N} are needed"
        )));
    }
    let data = &bytes[at..];
    if data.len() != 4 * num * N {
        return Err(refuse(format!(
            "{width} x {height} x {channels} values need {} bytes, and {} are there",
            4 * num * N,
            data.len()
        )));
    }
    let planes = std::array::from_fn(|c| floats(&data[4 * num * c..4 * num * (c + 1)]).collect());
    Ok((width, height, planes))
}
