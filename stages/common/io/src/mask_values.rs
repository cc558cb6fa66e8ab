//! Whether a picture is a mask by its values: two of them, whatever they are, and a thin band of
//! greys where they meet.
//!
//! The two values are the most frequent dark and the most frequent bright one; a pixel is grey when
//! it is near neither. Smoothed edges, soft brushes and JPEG give greys along the border alone, so
//! greys are counted over the whole frame and, more strictly, over the tiles away from any border.
//! A photo has them everywhere.

use crate::error::IoError;
use std::path::Path;

/// Pixels on a side of a tile: two blocks of JPEG, whose ringing does not reach beyond one.
const TILE_PX: usize = 16;

/// Steps of 255 within which a pixel is near a value: what JPEG leaves of a flat one.
const NEAR: u8 = 16;

/// Share of the frame that may be grey. Borders smoothed over a thirtieth of the frame's width stay
/// below a fifth, photos begin at a third.
const MAX_GREY_SHARE: f64 = 0.25;

/// Greys away from borders that may be, over themselves and the pixels of the rarer value: an
/// object photographed before black or white is grey for the most part of what is not backdrop.
const MAX_AWAY_SHARE: f64 = 0.25;

/// Share of the frame below which greys away from borders are specks and labels.
const MIN_AWAY_OF_FRAME: f64 = 0.01;

/// Level from which a pixel is object.
pub(crate) const BRIGHT: u8 = 128;

/// Refuses a picture of levels 0 to 255 that has more than two values. One without any dark or any
/// bright pixel passes: whoever uses it refuses a mask of nothing or everything.
///
/// # Shapes
/// `levels`: `height * width`.
pub(crate) fn check(path: &Path, levels: &[u8], width: usize) -> Result<(), IoError> {
    let mut histogram = [0usize; 256];
    for &level in levels {
        histogram[usize::from(level)] += 1;
    }
    let most_frequent = |range: std::ops::RangeInclusive<u8>| {
        range.fold((0, 0), |best: (u8, usize), level| {
            let count = histogram[usize::from(level)];
            if count > best.1 { (level, count) } else { best }
        })
    };
    let (dark, num_dark) = most_frequent(0..=BRIGHT - 1);
    let (bright, num_bright) = most_frequent(BRIGHT..=u8::MAX);
    if num_dark == 0 || num_bright == 0 {
        return Ok(());
    }
    let of_frame = |count: usize| count as f64 / levels.len() as f64;
    let near = |value: u8| -> usize {
        let range = value.saturating_sub(NEAR)..=value.saturating_add(NEAR);
        range.map(|level| histogram[usize::from(level)]).sum()
    };
    let is_grey = |level: u8| level.abs_diff(dark) > NEAR && level.abs_diff(bright) > NEAR;
    let grey: usize = (0..=u8::MAX)
        .filter(|&level| is_grey(level))
        .map(|level| histogram[usize::from(level)])
        .sum();

    if of_frame(grey) <= MIN_AWAY_OF_FRAME {
        return Ok(());
    }

    let away = grey_away_from_borders(levels, width, is_grey);
    let rarer = near(dark).min(near(bright));
    let away_share = away as f64 / (away + rarer) as f64;
    let away_too_many = away_share > MAX_AWAY_SHARE && of_frame(away) > MIN_AWAY_OF_FRAME;
    if of_frame(grey) <= MAX_GREY_SHARE && !away_too_many {
        return Ok(());
    }
    Err(IoError::input(
        path,
        format!(
            "is no mask but a photo or a drawing: a mask has two values and greys only where they \
             meet; here {:.0} % of the pixels are far from both {dark} and {bright}, the most \
             frequent dark and bright value of 255, and {:.0} % are so away from every border",
            100.0 * of_frame(grey),
            100.0 * of_frame(away)
        ),
    )
    .with_hint("give a picture that is white on the object and black elsewhere, from a folder of masks alone"))
}

/// Grey pixels in the tiles that hold no border between dark and bright, nor touch one that does.
fn grey_away_from_borders(levels: &[u8], width: usize, is_grey: impl Fn(u8) -> bool) -> usize {
    let columns = width.div_ceil(TILE_PX);
    // Of each tile: whether it has dark pixels, bright ones, and how many grey ones.
    let tiles: Vec<(bool, bool, usize)> = levels
        .chunks(width * TILE_PX)
        .flat_map(|rows| {
            let mut tiles = vec![(false, false, 0); columns];
            for row in rows.chunks(width) {
                for (tile, part) in tiles.iter_mut().zip(row.chunks(TILE_PX)) {
                    let num_bright = part.iter().filter(|&&level| level >= BRIGHT).count();
                    tile.0 |= num_bright < part.len();
                    tile.1 |= num_bright > 0;
                    tile.2 += part.iter().filter(|&&level| is_grey(level)).count();
                }
            }
            tiles
        })
        .collect();
    let rows = tiles.len() / columns;
    let near_border = |index: usize| {
        let (x, y) = (index % columns, index / columns);
        let beside = |k: usize, end: usize| k.saturating_sub(1)..(k + 2).min(end);
        beside(y, rows).any(|y| {
            beside(x, columns).any(|x| {
                let (dark, bright, _) = tiles[y * columns + x];
                dark && bright
            })
        })
    };
    (0..tiles.len())
        .filter(|&index| tiles[index].2 > 0 && !near_border(index))
        .map(|index| tiles[index].2)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, codecs::jpeg::JpegEncoder};

    const SIZE: (usize, usize) = (640, 480);

    fn picture(level: impl Fn(f64, f64) -> f64) -> Vec<u8> {
        (0..SIZE.0 * SIZE.1)
            .map(|i| level((i % SIZE.0) as f64, (i / SIZE.0) as f64) as u8)
            .collect()
    }

    fn passes(levels: &[u8]) -> Result<(), IoError> {
        check(Path::new("masks/a.png"), levels, SIZE.0)
    }

    /// The same after JPEG, at a quality out of 100.
    fn after_jpeg(levels: &[u8], quality: u8) -> Vec<u8> {
        let image = GrayImage::from_raw(SIZE.0 as u32, SIZE.1 as u32, levels.to_vec()).unwrap();
        let mut bytes = Vec::new();
        image
            .write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality))
            .unwrap();
        image::load_from_memory(&bytes)
            .unwrap()
            .into_luma8()
            .into_raw()
    }

    /// A disc whose border is spread over some pixels.
    fn disc(band_px: f64) -> Vec<u8> {
        picture(|x, y| {
            let inside = 0.5 + (150.0 - (x - 300.0).hypot(y - 250.0)) / band_px;
            255.0 * inside.clamp(0.0, 1.0)
        })
    }

    /// Bars of three pixels, nine apart, smoothed by a pixel.
    fn lattice() -> Vec<u8> {
        let bar = |t: f64| (2.0 - (t % 12.0 - 4.0).abs()).clamp(0.0, 1.0);
        picture(|x, y| {
            if (x - 300.0).hypot(y - 250.0) < 180.0 {
                255.0 * bar(x + 0.3 * y).max(bar(y - 0.3 * x + 480.0))
            } else {
                0.0
            }
        })
    }

    #[test]
    fn masks_with_smoothed_borders_pass() {
        for levels in [disc(0.01), disc(1.0), disc(5.0), disc(20.0), lattice()] {
            assert_eq!(passes(&levels), Ok(()));
            for quality in [95, 50, 10] {
                assert_eq!(passes(&after_jpeg(&levels, quality)), Ok(()), "{quality}");
            }
        }
    }

    #[test]
    fn any_two_values_make_a_mask_and_a_narrow_band_in_doubt_too() {
        let two = |dark: u8, bright: u8| -> Vec<u8> {
            let value = |level: u8| if level >= BRIGHT { bright } else { dark };
            disc(1.0).into_iter().map(value).collect()
        };
        assert_eq!(passes(&two(0, 170)), Ok(()));
        assert_eq!(passes(&two(60, 255)), Ok(()));
        let in_doubt = picture(|x, y| match (x - 300.0).hypot(y - 250.0) {
            r if r < 130.0 => 255.0,
            r if r < 160.0 => 128.0,
            _ => 0.0,
        });
        assert_eq!(passes(&in_doubt), Ok(()));
        // What marks nothing or everything is told with that reason.
        assert_eq!(passes(&picture(|x, _| x / 8.0)), Ok(()));
    }

    #[test]
    fn photos_are_refused_with_their_figures() {
        // A shaded ball, before something in between, before black and before white.
        let ball = |backdrop: f64| {
            picture(|x, y| {
                let (u, v) = ((x - 300.0) / 180.0, (y - 250.0) / 180.0);
                let texture = 15.0 * (x / 3.0).sin() * (y / 5.0).cos();
                if u.hypot(v) < 1.0 {
                    130.0 + 90.0 * (0.7 * u - 0.7 * v) + texture
                } else {
                    backdrop
                        + if backdrop == 100.0 {
                            0.1 * x + texture
                        } else {
                            0.0
                        }
                }
            })
        };
        for backdrop in [100.0, 0.0, 255.0] {
            for levels in [ball(backdrop), after_jpeg(&ball(backdrop), 75)] {
                let error = passes(&levels).unwrap_err().to_string();
                for part in [
                    "masks/a.png",
                    "is no mask",
                    "% of the pixels",
                    "white on the",
                ] {
                    assert!(error.contains(part), "{backdrop}: {error}");
                }
            }
        }
    }
}
