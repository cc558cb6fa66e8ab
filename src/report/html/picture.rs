//! Maps and photos as pictures inside the page, cut to the object so that detail shows.

use rilievo_io::{Preview, encode_preview_jpeg, picture_as_jpeg};
use rilievo_scene::{DepthMap, LinearImage, NormalMap, Raster};

/// Longer side of a picture, pixels: what the page shows is not wider.
const MAX_SIDE: usize = 900;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// Everything with a depth, and a margin; the whole frame where nothing has one.
    pub fn around(depth: &DepthMap) -> Self {
        let Some([[x0, x1], [y0, y1]]) = depth.bounds(|&z| z > 0.0) else {
            return Self::whole(depth.width, depth.height);
        };
        let margin = (x1 - x0).max(y1 - y0) / 20 + 2;
        let (x0, y0) = (x0.saturating_sub(margin), y0.saturating_sub(margin));
        Self {
            x: x0,
            y: y0,
            width: (x1 + margin + 1).min(depth.width) - x0,
            height: (y1 + margin + 1).min(depth.height) - y0,
        }
    }

    /// The whole frame.
    pub fn whole(width: usize, height: usize) -> Self {
        Self {
            x: 0,
            y: 0,
            width,
            height,
        }
    }

    fn cut<T: Copy>(&self, map: &Raster<T>) -> Raster<T> {
        map.cropped(self.x, self.y, self.width, self.height)
    }
}

/// Factor that brings the object's bright pixels to three quarters of white, so that dark photos
/// can be judged too.
pub fn exposure(image: &LinearImage, depth: &DepthMap) -> f32 {
    let grey = image.to_grey();
    let mut values: Vec<f32> = grey
        .data
        .iter()
        .zip(&depth.data)
        .filter(|&(value, &z)| z > 0.0 && value.is_finite())
        .map(|(&value, _)| value)
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let bright = values.len() * 98 / 100;
    let (_, value, _) = values.select_nth_unstable_by(bright, f32::total_cmp);
    if *value > 0.0 { 0.75 / *value } else { 1.0 }
}

/// Makes pictures that stay together below a number of bytes, each as data URL.
#[derive(Clone, Copy, Debug)]
pub struct Album {
    max_bytes: usize,
}

impl Album {
    /// For so many pictures that take so many bytes of the page at most.
    pub fn new(page_bytes: usize, num_pictures: usize) -> Self {
        // Base64 writes three bytes as four.
        let share = page_bytes / num_pictures.max(1) * 3 / 4;
        Self { max_bytes: share }
    }

    /// A photo.
    pub fn photo(&self, image: &LinearImage, window: Window, exposure: f32) -> String {
        let step = (window.width.max(window.height) / MAX_SIDE).max(1);
        let (width, height) = (window.width / step, window.height / step);
        let mut small = LinearImage::filled(width, height, image.channels, 0.0);
        let scale = exposure / (step * step) as f32;
        for y in 0..height {
            for x in 0..width {
                for dy in 0..step {
                    for dx in 0..step {
                        let from = image.pixel(window.x + x * step + dx, window.y + y * step + dy);
                        for (sum, value) in small.pixel_mut(x, y).iter_mut().zip(from) {
                            *sum += value * scale;
                        }
                    }
                }
            }
        }
        self.jpeg(Preview::Linear(&small))
    }

    /// A normal map.
    pub fn normals(&self, map: &NormalMap, window: Window) -> String {
        self.jpeg(Preview::Normal(&window.cut(map)))
    }

    /// A depth map.
    pub fn depth(&self, map: &DepthMap, window: Window) -> String {
        self.jpeg(Preview::Depth(&window.cut(map)))
    }

    /// A map of errors or shares, `max` and above bright.
    pub fn scalar(&self, map: &Raster<f32>, window: Window, max: f32) -> String {
        let map = &window.cut(map);
        self.jpeg(Preview::Error { map, max })
    }

    /// A picture file; `None` where its bytes are no picture.
    pub fn file(&self, bytes: &[u8]) -> Option<String> {
        picture_as_jpeg(bytes, MAX_SIDE, self.max_bytes).map(|bytes| data_url(&bytes))
    }

    fn jpeg(&self, preview: Preview<'_>) -> String {
        data_url(&encode_preview_jpeg(preview, MAX_SIDE, self.max_bytes))
    }
}

fn data_url(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", base64(jpeg))
}

/// Base64 of RFC 4648 with padding.
pub fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |index: usize| u32::from(chunk.get(index).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for position in 0..4 {
            if position <= chunk.len() {
                let sextet = (word >> (18 - 6 * position)) & 63;
                text.push(char::from(ALPHABET[sextet as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_agrees_with_the_rfc() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn the_window_holds_the_object_inside_the_frame() {
        let mut depth = DepthMap::filled(100, 80, 0.0);
        *depth.at_mut(0, 40) = 1.0;
        *depth.at_mut(60, 70) = 1.0;
        let window = Window::around(&depth);
        assert_eq!((window.x, window.y), (0, 35));
        assert_eq!((window.width, window.height), (66, 41));
        let empty = Window::around(&DepthMap::filled(10, 20, 0.0));
        assert_eq!(empty, Window::whole(10, 20));
    }
}
