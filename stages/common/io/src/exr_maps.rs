//! Depth, normals, confidence and linear images as OpenEXR with named channels.
//!
//! | map | channels |
//! |---|---|
//! | depth | `Z` |
//! | normals | `N.X N.Y N.Z` |
//! | confidence | `C` |
//! | linear image | `R G B`, or `Y` for grey |
//!
//! Written as f32 with lossless compression, so that what is read is what was computed, bit for
//! bit. Read from any part of the file and in any sample type; where no channel has the exact
//! name, one that ends in it after a dot (`ViewLayer.Depth.Z`) is taken if it is the only one. A
//! data window smaller than the display window is placed where it belongs, zeros around it.

use crate::claims;
use crate::error::IoError;
use crate::files::{OutputFile, read_regular};
use crate::photo::guard::guarded;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, LineOrder,
    ReadChannels, ReadLayers, WritableImage, f16,
};
use rilievo_scene::{DepthMap, LinearImage, NormalMap, PixelError, PixelSource, Raster};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Names of the channels of a normal map.
const NORMAL_CHANNELS: [&str; 3] = ["N.X", "N.Y", "N.Z"];

/// Pixels of a frame, however little of it is painted, and how many for each painted one beyond
/// that: a small picture in a frame without measure would take the memory of the frame.
const MAX_FRAME_PX: u64 = 64 << 20;
const MAX_FRAME_PER_LAYER: u64 = 64;

/// A file's channels, all of the display window's size.
struct Channels {
    width: usize,
    height: usize,
    named: Vec<(String, Vec<f32>)>,
}

impl Channels {
    fn read(path: &Path) -> Result<Self, IoError> {
        let bytes = read_regular(path)?;
        Self::parse(path, &bytes)
    }

    fn parse(path: &Path, bytes: &[u8]) -> Result<Self, IoError> {
        guarded(path, || Self::decode(path, bytes))
    }

    fn decode(path: &Path, bytes: &[u8]) -> Result<Self, IoError> {
        if bytes.is_empty() {
            return Err(IoError::input(path, "the file is empty (0 bytes)"));
        }
        if !bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            return Err(IoError::input(path, "not an OpenEXR file"));
        }
        let damaged = |error: exr::error::Error| match error {
            exr::error::Error::NotSupported(what) => IoError::input(
                path,
                format!("this kind of OpenEXR is not supported: {what}"),
            ),
            error => IoError::input(path, format!("the OpenEXR file is damaged: {error}")),
        };
        check_size(path, bytes)?;
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .all_layers()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(bytes))
            .map_err(damaged)?;
        let window = image.attributes.display_window;
        let (width, height) = (window.size.0, window.size.1);
        let mut named = Vec::new();
        for layer in image.layer_data {
            let offset = layer.attributes.layer_position - window.position;
            let (layer_width, layer_height) = (layer.size.0, layer.size.1);
            for channel in layer.channel_data.list {
                if channel.sampling.0 != 1 || channel.sampling.1 != 1 {
                    continue;
                }
                let samples: Vec<f32> = channel.sample_data.values_as_f32().collect();
                let in_place = (layer_width, layer_height) == (width, height)
                    && (offset.0, offset.1) == (0, 0);
                let samples = if in_place {
                    samples
                } else {
                    let mut placed = vec![0.0; width * height];
                    for (i, value) in samples.into_iter().enumerate() {
                        let x = (i % layer_width) as i64 + i64::from(offset.0);
                        let y = (i / layer_width) as i64 + i64::from(offset.1);
                        if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                            placed[y as usize * width + x as usize] = value;
                        }
                    }
                    placed
                };
                named.push((channel.name.to_string(), samples));
            }
        }
        Ok(Self {
            width,
            height,
            named,
        })
    }

    /// Takes a channel out by its exact name, or by the only name that ends in it after a dot.
    fn take(&mut self, name: &str) -> Option<Vec<f32>> {
        let exact = self.named.iter().position(|(n, _)| n == name);
        let position = exact.or_else(|| {
            let suffix = format!(".{name}");
            let mut ends = (0..self.named.len()).filter(|&i| self.named[i].0.ends_with(&suffix));
            match (ends.next(), ends.next()) {
                (Some(only), None) => Some(only),
                _ => None,
            }
        })?;
        Some(self.named.swap_remove(position).1)
    }

    fn required(&mut self, path: &Path, name: &str) -> Result<Vec<f32>, IoError> {
        self.take(name).ok_or_else(|| self.missing(path, name))
    }

    fn missing(&self, path: &Path, wanted: &str) -> IoError {
        let mut names: Vec<&str> = self.named.iter().map(|(name, _)| name.as_str()).collect();
        names.sort_unstable();
        let names = names.join(" ");
        let reason = format!("has no channel {wanted}; its channels are: {names}");
        IoError::input(path, reason)
    }
}

/// Three planes as one, pixel by pixel.
pub(crate) fn interleaved([x, y, z]: [Vec<f32>; 3]) -> impl Iterator<Item = [f32; 3]> {
    let pixels = x.into_iter().zip(y).zip(z);
    pixels.map(|((x, y), z)| [x, y, z])
}

/// Refuses headers that claim absurd sizes before anything is allocated for them.
fn check_size(path: &Path, bytes: &[u8]) -> Result<(), IoError> {
    let refuse = |reason: String| IoError::input(path, reason);
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|error| refuse(format!("the OpenEXR file is damaged: {error}")))?;
    // Channels as stored, and as they are handed out: of the frame's size, four bytes a sample.
    let (mut stored, mut placed) = (0_u64, 0_u64);
    for header in &meta.headers {
        let expansion = match header.compression {
            Compression::PIZ => claims::MAX_WAVELET_EXPANSION,
            _ => claims::MAX_EXPANSION,
        };
        let size = |size: exr::math::Vec2<usize>| (size.0 as u64, size.1 as u64);
        let (layer, frame) = (
            size(header.layer_size),
            size(header.shared_attributes.display_window.size),
        );
        let bytes_per_px = header.channels.bytes_per_pixel as u64;
        claims::check(layer, bytes_per_px, 1, bytes.len(), expansion).map_err(refuse)?;
        let (layer_px, frame_px) = (layer.0 * layer.1, frame.0.saturating_mul(frame.1));
        if frame_px > MAX_FRAME_PX.max(MAX_FRAME_PER_LAYER * layer_px) {
            let ((w, h), (layer_w, layer_h)) = (frame, layer);
            let reason = format!("claims a frame of {w} x {h} pixels around {layer_w} x {layer_h}");
            return Err(refuse(reason));
        }
        // Each block has a place in the table of offsets, and a head.
        if header.chunk_count.saturating_mul(16) > bytes.len() {
            let (count, len) = (header.chunk_count, bytes.len());
            return Err(refuse(format!(
                "the OpenEXR file is damaged: it claims {count} blocks in {len} bytes"
            )));
        }
        let num_channels = header.channels.list.len() as u64;
        stored += layer_px * bytes_per_px;
        placed += frame_px * num_channels * 4;
    }
    claims::check_memory(stored.saturating_add(placed))
        .map_err(|reason| refuse(format!("its pixels {reason}")))
}

/// How samples are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Storage {
    /// f32, for maps that are mostly empty or smooth.
    Map,
    /// f32, for photographs: a fifth smaller than as a map and written three times as fast (6 Mpx
    /// of a JPEG: 29 MB in 1.2 s against 35 MB in 4.2 s), read half as fast.
    Photo,
    /// f16, for photographs: as large as f32 compressed, and stages that read every photo, some
    /// several times, spend nothing on it (finding poses: a quarter of its time).
    HalfPhoto,
}

fn channels_file(
    path: &Path,
    (width, height): (usize, usize),
    channels: Vec<(&str, Vec<f32>)>,
    storage: Storage,
) -> Result<OutputFile, IoError> {
    if width == 0 || height == 0 || channels.iter().any(|(_, v)| v.len() != width * height) {
        let reason = format!("the map does not fill its {width} x {height} pixels");
        return Err(IoError::write(path, reason));
    }
    let list = channels
        .into_iter()
        .map(|(name, values)| {
            let samples = match storage {
                Storage::Map | Storage::Photo => FlatSamples::F32(values),
                Storage::HalfPhoto => {
                    FlatSamples::F16(values.into_iter().map(f16::from_f32).collect())
                }
            };
            AnyChannel::new(name, samples)
        })
        .collect();
    let encoding = Encoding {
        compression: match storage {
            Storage::Map => Compression::ZIP16,
            Storage::Photo => Compression::PIZ,
            Storage::HalfPhoto => Compression::Uncompressed,
        },
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let mut bytes = Cursor::new(Vec::new());
    Image::from_encoded_channels((width, height), encoding, AnyChannels::sort(list))
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| IoError::write(path, error))?;
    Ok(OutputFile::new(path, bytes.into_inner()))
}

/// Reads a depth map (channel `Z`).
pub fn read_depth(path: &Path) -> Result<DepthMap, IoError> {
    read_channel(path, "Z")
}

/// Writes a depth map (channel `Z`, f32).
pub fn write_depth(path: &Path, map: &DepthMap) -> Result<(), IoError> {
    write_channel(path, "Z", map)
}

/// Reads a normal map (channels `N.X N.Y N.Z`).
///
/// # Errors
/// When the file cannot be read or lacks a channel.
pub fn read_normal(path: &Path) -> Result<NormalMap, IoError> {
    let mut channels = Channels::read(path)?;
    let mut take = |name: &str| channels.required(path, name);
    let [x, y, z] = NORMAL_CHANNELS;
    let planes = [take(x)?, take(y)?, take(z)?];
    Ok(Raster {
        width: channels.width,
        height: channels.height,
        data: interleaved(planes).collect(),
    })
}

/// Writes a normal map (channels `N.X N.Y N.Z`, f32).
pub fn write_normal(path: &Path, map: &NormalMap) -> Result<(), IoError> {
    normal_file(path, map)?.write()
}

/// A normal map (channels `N.X N.Y N.Z`, f32), to be written.
///
/// # Errors
/// When the normals do not fill the map.
pub fn normal_file(path: &Path, map: &NormalMap) -> Result<OutputFile, IoError> {
    let channels = NORMAL_CHANNELS
        .iter()
        .enumerate()
        .map(|(i, &name)| (name, map.data.iter().map(|normal| normal[i]).collect()))
        .collect();
    channels_file(path, (map.width, map.height), channels, Storage::Map)
}

/// Reads one named channel (`C` of a confidence map, for instance).
pub fn read_channel(path: &Path, channel: &str) -> Result<Raster<f32>, IoError> {
    let mut channels = Channels::read(path)?;
    Ok(Raster {
        data: channels.required(path, channel)?,
        width: channels.width,
        height: channels.height,
    })
}

/// Writes one named channel, f32.
pub fn write_channel(path: &Path, channel: &str, map: &Raster<f32>) -> Result<(), IoError> {
    let channels = vec![(channel, map.data.clone())];
    channels_file(path, (map.width, map.height), channels, Storage::Map)?.write()
}

/// Reads a linear image (`R G B` or `Y`).
///
/// # Errors
/// When the file cannot be read or has neither.
pub fn read_linear(path: &Path) -> Result<LinearImage, IoError> {
    let bytes = read_regular(path)?;
    linear_with_alpha(path, &bytes).map(|(image, _)| image)
}

/// A linear image and its channel `A`, where there is one.
pub(crate) fn linear_with_alpha(
    path: &Path,
    bytes: &[u8],
) -> Result<(LinearImage, Option<Raster<f32>>), IoError> {
    let mut channels = Channels::parse(path, bytes)?;
    let (width, height) = (channels.width, channels.height);
    let alpha = channels.take("A").map(|data| Raster {
        width,
        height,
        data,
    });
    let colors = (channels.take("R"), channels.take("G"), channels.take("B"));
    let (num_channels, data) = match colors {
        (Some(r), Some(g), Some(b)) => (3, interleaved([r, g, b]).flatten().collect()),
        // Luminance with chroma at half resolution has `RY BY` beside `Y`: grey is all we take.
        _ => match channels.take("Y") {
            Some(grey) => (1, grey),
            None => return Err(channels.missing(path, "R G B or Y")),
        },
    };
    let image = LinearImage {
        width,
        height,
        channels: num_channels,
        data,
    };
    Ok((image, alpha))
}

fn linear_as(path: &Path, image: &LinearImage, storage: Storage) -> Result<OutputFile, IoError> {
    let names: &[&str] = match image.channels {
        1 => &["Y"],
        3 => &["R", "G", "B"],
        n => {
            let reason = format!("an image has 1 or 3 channels, not {n}");
            return Err(IoError::write(path, reason));
        }
    };
    let channels = names
        .iter()
        .enumerate()
        .map(|(i, &name)| {
            let values = image.data.iter().skip(i).step_by(names.len());
            (name, values.copied().collect())
        })
        .collect();
    channels_file(path, (image.width, image.height), channels, storage)
}

/// Writes a linear image (`R G B` or `Y`), f32.
pub fn write_linear(path: &Path, image: &LinearImage) -> Result<(), IoError> {
    linear_file(path, image)?.write()
}

/// A linear image (`R G B` or `Y`), f32, to be written.
///
/// # Errors
/// When the image has neither one channel nor three, or its values do not fill it.
pub fn linear_file(path: &Path, image: &LinearImage) -> Result<OutputFile, IoError> {
    linear_as(path, image, Storage::Photo)
}

/// Writes a linear image with 16-bit floats: a relative step of 0.05 %, finer than the 8-bit sRGB
/// steps of a JPEG everywhere, at half the size; uncompressed.
pub fn write_linear_half(path: &Path, image: &LinearImage) -> Result<(), IoError> {
    linear_as(path, image, Storage::HalfPhoto)?.write()
}

/// Pixels that wait in a linear OpenEXR file and are read each time they are asked for.
#[derive(Clone, Debug)]
pub struct LinearFile {
    /// The file, as [`write_linear`] writes it.
    pub path: PathBuf,
}

impl PixelSource for LinearFile {
    fn load(&self) -> Result<Arc<LinearImage>, PixelError> {
        read_linear(&self.path)
            .map(Arc::new)
            .map_err(|error| PixelError {
                name: self.path.display().to_string(),
                reason: error.reason,
            })
    }
}

#[cfg(test)]
mod tests;
