//! Pictures for people: depth, normals, linear images and error maps as PNG, or JPEG of few bytes.
//!
//! | map | colours |
//! |---|---|
//! | depth | near is bright, far is dark (viridis), between the 1st and 99th percentile of the map |
//! | normals | `(n1, −n2, −n3)` from −1…1 to 0…255: right is red, up is green, towards the camera is blue |
//! | linear image | the sRGB curve |
//! | errors | 0 is black, `max` and above is bright (inferno) |
//!
//! Pixels without a value are black in depth and normals, grey in error maps.

use crate::error::IoError;
use crate::files::OutputFile;
use crate::mask::encode_png;
use colorous::{Gradient, INFERNO, VIRIDIS};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{ExtendedColorType, RgbImage};
use rilievo_scene::{DepthMap, LinearImage, NormalMap, Raster, srgb};
use std::path::Path;

type Rgb = [u8; 3];

/// Colour of "no value" in error maps: neither small nor large.
const NO_ERROR_VALUE: Rgb = [128, 128, 128];

/// What to show.
#[derive(Clone, Copy, Debug)]
pub enum Preview<'a> {
    /// Depth: near is bright; range from the map's own percentiles.
    Depth(&'a DepthMap),
    /// Normals: the usual colours, towards the camera is blue.
    Normal(&'a NormalMap),
    /// A linear image, shown as sRGB.
    Linear(&'a LinearImage),
    /// An error map: 0 is dark, `max` and above is bright; negative or not finite is "no value".
    Error {
        /// The errors.
        map: &'a Raster<f32>,
        /// The brightest value.
        max: f32,
    },
}

/// Writes a picture as PNG, at most `max_side` pixels on its longer side (0: full size).
pub fn write_preview_png(
    path: &Path,
    preview: Preview<'_>,
    max_side: usize,
) -> Result<(), IoError> {
    OutputFile::new(path, encode_preview_png(preview, max_side)).write()
}

/// The same as bytes of a PNG file; of a map without pixels one black pixel.
fn encode_preview_png(preview: Preview<'_>, max_side: usize) -> Vec<u8> {
    let whole = paint(preview);
    let longer = whole.width().max(whole.height());
    let picture = match max_side {
        0 => reduced(&whole, longer),
        most => reduced(&whole, longer.min(most as u32)),
    };
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    encode_png(picture.as_raw(), width, height, ExtendedColorType::Rgb8).unwrap_or_default()
}

const JPEG_QUALITY: u8 = 85;
/// A picture below this side, in pixels, shows nothing: it is not reduced further.
const LEAST_SIDE: u32 = 48;

/// A picture as bytes of a JPEG file, to embed elsewhere, at most `max_side` pixels on its longer
/// side, and reduced until it has at most `max_bytes`; of a map without pixels one black pixel.
pub fn encode_preview_jpeg(preview: Preview<'_>, max_side: usize, max_bytes: usize) -> Vec<u8> {
    reduced_jpeg(&paint(preview), max_side, max_bytes)
}

/// The same of a picture file's bytes; `None` where they are no picture.
pub fn picture_as_jpeg(bytes: &[u8], max_side: usize, max_bytes: usize) -> Option<Vec<u8>> {
    let whole = image::load_from_memory(bytes).ok()?.to_rgb8();
    Some(reduced_jpeg(&whole, max_side, max_bytes))
}

/// A picture of so many pixels on its longer side; one black pixel in the place of none.
fn reduced(whole: &RgbImage, side: u32) -> RgbImage {
    let (width, height) = whole.dimensions();
    let longer = width.max(height);
    if width == 0 || height == 0 {
        return RgbImage::new(1, 1);
    }
    if side == longer {
        return whole.clone();
    }
    let scale = f64::from(side) / f64::from(longer);
    let scaled = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
    imageops::resize(whole, scaled(width), scaled(height), FilterType::Triangle)
}

fn reduced_jpeg(whole: &RgbImage, max_side: usize, max_bytes: usize) -> Vec<u8> {
    let longer = whole.width().max(whole.height());
    let mut side = longer.min(max_side as u32).max(1);
    loop {
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
        // What is too large for JPEG is reduced until it is not.
        let written = reduced(whole, side).write_with_encoder(encoder);
        if written.is_ok() && bytes.len() <= max_bytes || side <= LEAST_SIDE {
            return bytes;
        }
        // Bytes grow a little more slowly than pixels.
        let share = (max_bytes as f64 / bytes.len().max(1) as f64).sqrt();
        side = (f64::from(side) * (0.95 * share).clamp(0.3, 0.95)) as u32;
    }
}

fn map_color(gradient: Gradient, share: f32) -> Rgb {
    let share = f64::from(share).clamp(0.0, 1.0);
    gradient.eval_continuous(share).into_array()
}

fn paint(preview: Preview<'_>) -> RgbImage {
    match preview {
        Preview::Depth(map) => {
            let (near, far) = depth_range(map);
            let scale = 1.0 / (far - near).max(f32::MIN_POSITIVE);
            painted(map, |&depth| {
                if depth > 0.0 && depth.is_finite() {
                    map_color(VIRIDIS, (far - depth) * scale)
                } else {
                    [0, 0, 0]
                }
            })
        }
        Preview::Normal(map) => painted(map, |&[x, y, z]| {
            if [x, y, z] == [0.0; 3] {
                return [0, 0, 0];
            }
            [x, -y, -z].map(|n| (127.5 * (1.0 + n.clamp(-1.0, 1.0))).round() as u8)
        }),
        Preview::Error { map, max } => painted(map, |&error| {
            if error >= 0.0 && error.is_finite() {
                map_color(INFERNO, error / max.max(f32::MIN_POSITIVE))
            } else {
                NO_ERROR_VALUE
            }
        }),
        Preview::Linear(image) => {
            let pixels = image.data.chunks_exact(image.channels.max(1));
            picture(
                image.width,
                image.height,
                pixels.map(|pixel| {
                    std::array::from_fn(|c| {
                        let value = pixel.get(c).or(pixel.first()).copied().unwrap_or(0.0);
                        srgb::encode_byte(value)
                    })
                }),
            )
        }
    }
}

fn painted<T>(map: &Raster<T>, color: impl Fn(&T) -> Rgb) -> RgbImage {
    picture(map.width, map.height, map.data.iter().map(color))
}

fn picture(width: usize, height: usize, colors: impl Iterator<Item = Rgb>) -> RgbImage {
    let samples = colors.flatten().collect();
    RgbImage::from_raw(width as u32, height as u32, samples).unwrap_or_default()
}

/// The 1st and 99th percentile of the depths that are there.
fn depth_range(map: &DepthMap) -> (f32, f32) {
    let mut depths: Vec<f32> = map
        .data
        .iter()
        .copied()
        .filter(|&depth| depth > 0.0 && depth.is_finite())
        .collect();
    if depths.is_empty() {
        return (0.0, 1.0);
    }
    let last = depths.len() - 1;
    let near = *depths.select_nth_unstable_by(last / 100, f32::total_cmp).1;
    let far = *depths
        .select_nth_unstable_by(last - last / 100, f32::total_cmp)
        .1;
    (near, far)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Samples;

    fn decoded(preview: Preview<'_>, max_side: usize) -> (usize, usize, Vec<u8>) {
        let bytes = encode_preview_png(preview, max_side);
        let photo = crate::photo::decode_photo_bytes(Path::new("p.png"), &bytes).unwrap();
        match photo.samples {
            Samples::U8(samples) => (photo.width, photo.height, samples),
            other => panic!("{} bits", other.bits()),
        }
    }

    #[test]
    fn normals_towards_the_camera_are_blue_and_up_is_green() {
        let map = Raster {
            width: 3,
            height: 1,
            data: vec![[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [0.0; 3]],
        };
        let (_, _, pixels) = decoded(Preview::Normal(&map), 0);
        assert_eq!(pixels, [128, 128, 255, 128, 255, 128, 0, 0, 0]);
    }

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let map = Raster {
            width: 3,
            height: 1,
            data: vec![1.0, 2.0, 0.0],
        };
        let (_, _, pixels) = decoded(Preview::Depth(&map), 0);
        assert_eq!(pixels[..3], [253, 231, 37]);
        assert_eq!(pixels[3..6], [68, 1, 84]);
        assert_eq!(pixels[6..], [0, 0, 0]);
    }

    #[test]
    fn errors_have_a_fixed_scale_and_a_colour_for_none() {
        let map = Raster {
            width: 4,
            height: 1,
            data: vec![0.0, 10.0, 20.0, f32::NAN],
        };
        let (_, _, pixels) = decoded(
            Preview::Error {
                map: &map,
                max: 10.0,
            },
            0,
        );
        assert_eq!(pixels[..3], [0, 0, 4]);
        assert_eq!(pixels[3..6], [252, 255, 164]);
        assert_eq!(pixels[6..9], [252, 255, 164]);
        assert_eq!(pixels[9..], NO_ERROR_VALUE);
    }

    #[test]
    fn a_jpeg_stays_below_its_bytes_whatever_it_shows() {
        let mut random = 1u32;
        let noise = Raster::from_fn(700, 300, |_, _| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1 << 24) as f32
        });
        let preview = Preview::Error {
            map: &noise,
            max: 1.0,
        };
        for most in [3_000, 20_000, 80_000] {
            let bytes = encode_preview_jpeg(preview, 600, most);
            assert!(bytes.len() <= most, "{} of {most}", bytes.len());
            // Noise that is averaged takes fewer bytes than its pixels suggest.
            assert!(3 * bytes.len() > most, "{} of {most}", bytes.len());
            let picture = image::load_from_memory(&bytes).unwrap();
            let aspect = f64::from(picture.width()) / f64::from(picture.height());
            assert!((aspect / (7.0 / 3.0) - 1.0).abs() < 0.05, "{aspect}");
        }
        let empty = Raster::from_fn(0, 0, |_, _| 0.0f32);
        let one = encode_preview_jpeg(Preview::Depth(&empty), 600, 1_000);
        assert_eq!(image::load_from_memory(&one).unwrap().width(), 1);
    }

    #[test]
    fn pictures_fit_and_grey_images_have_three_channels() {
        let image = LinearImage::filled(100, 37, 1, 0.214_041_14);
        let (width, height, pixels) = decoded(Preview::Linear(&image), 40);
        assert_eq!((width, height), (40, 15));
        assert!(
            pixels.iter().all(|&v| (127..=128).contains(&v)),
            "{pixels:?}"
        );
        let empty = Raster::from_fn(0, 0, |_, _| 0.0f32);
        assert_eq!(decoded(Preview::Depth(&empty), 0).0, 1);
    }
}
