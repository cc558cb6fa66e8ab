//! The mask of an object whose surroundings another program has made exactly black or white.
//!
//! What is flat (all channels within [`FLAT`] of black or white) and connected to the frame is background. JPEG leaves
//! noise around the object: pixels within [`NOISE`] of that colour are background too, [`REACH_PX`] deep. Of the pixels
//! in front of it, those that differ from it less than half as much as the object behind them are mixed with less than
//! half of the object. A region inside the object is background where its border is as sharp.
//!
//! Measured on two cut-out photos (320 x 240 and 1296 x 968 pixels), black and white, stored as PNG and as JPEG of quality
//! 50 to 95, colours halved or not: the outline lies 0 to .25 pixels outside the true one and .1 inside at most.

use crate::error::SegmentationError;
use crate::raster::regions;
use rilievo_scene::{DecodedPhoto, Mask, Samples};

/// Distance from black or white of a flat pixel, of 255: JPEG's steps leave flat areas off by one or two.
const FLAT: u8 = 2;

/// Brightness beside the object that is JPEG's noise, of 255. At quality 50 noise of 12 and more reaches 1 pixel.
const NOISE: u8 = 12;

/// How far from flat pixels noise is sought: to 4 pixels it is found whole at quality 50; an object that is as dark as
/// noise itself loses less than a pixel, at 8 it loses two.
const REACH_PX: usize = 4;

/// Pixels around one in which the object's own brightness is looked for.
const BEHIND_PX: usize = 2;

/// Share of the frame's border that must be flat.
const MIN_BORDER_SHARE: f64 = 0.5;

/// Share of the background that may stand out from it in specks; a dark room's noise has more.
const MAX_SPECKS: f64 = 0.002;

/// Area of a piece of the object over the largest one's; smaller ones are specks.
const PIECE_SHARE: f64 = 0.01;

/// Share of the outline along which the object may be hardly brighter than its noise. Cut-out photos have .02 at most; one
/// whose object is as black as its surroundings along a third of it .25 to .45.
const MAX_UNSURE_SHARE: f64 = 0.15;

/// Shares of the frame between which an object can lie.
const OBJECT_SHARES: std::ops::RangeInclusive<f64> = 0.002..=0.98;

/// Fewest pixels of a hole.
const MIN_HOLE_PX: usize = 64;

/// What the surroundings of an object are.
#[derive(Clone, Debug, PartialEq)]
pub enum Surroundings {
    /// Those of a photo.
    Photographed,
    /// Exactly black, or white: the object's mask.
    Flat {
        /// The object.
        mask: Mask,
        /// Whether they are white.
        white: bool,
    },
    /// The same, but the object is as black or white itself along this share of its outline.
    Unsure {
        /// The share.
        share: f64,
    },
}

/// Looks for flat surroundings in a photo as decoded.
///
/// # Errors
/// When the library fails.
pub fn surroundings(photo: &DecodedPhoto) -> Result<Surroundings, SegmentationError> {
    for white in [false, true] {
        // Floating-point pictures have no white.
        if white && matches!(photo.samples, Samples::F32(_)) {
            continue;
        }
        let (width, height) = (photo.width, photo.height);
        let away = away_from(photo, white);
        // Most photos have no flat border: of those no more is looked at.
        let mut border = Mask::filled(width, height, false);
        let frame: Vec<(usize, usize)> = border.frame().collect();
        for (x, y) in frame {
            *border.at_mut(x, y) = away(x, y)[0] <= FLAT;
        }
        if border.frame_share() >= MIN_BORDER_SHARE {
            let away = Away::from_fn(width, height, away);
            let flat = Mask::from_fn(width, height, |x, y| away.at(x, y)[0] <= FLAT);
            return Ok(cut(&away, &flat, white)?);
        }
    }
    Ok(Surroundings::Photographed)
}

type Away = rilievo_scene::Raster<[u8; 2]>;

/// How far a pixel is from black or white, of 255: the channel that is farthest, and the brightness.
fn away_from(photo: &DecodedPhoto, white: bool) -> impl Fn(usize, usize) -> [u8; 2] {
    // Linear values are compared as they look, by their square root.
    let shown = |value: f32| {
        let value = if photo.linear_by_metadata {
            value.max(0.0).sqrt()
        } else {
            value
        };
        (255.0 * value).round().clamp(0.0, 255.0) as u8
    };
    let level = move |index: usize| match &photo.samples {
        Samples::U8(v) if !photo.linear_by_metadata => v[index],
        Samples::U8(v) => shown(f32::from(v[index]) / 255.0),
        Samples::U16(v) => shown(f32::from(v[index]) / 65535.0),
        Samples::F32(v) => shown(v[index]),
    };
    let channels = photo.channels;
    move |x, y| {
        let first = (y * photo.width + x) * channels;
        let of = |channel: usize| {
            let level = level(first + channel.min(channels - 1));
            if white { 255 - level } else { level }
        };
        let [r, g, b] = [of(0), of(1), of(2)];
        // Weights of JPEG's brightness.
        let luma = (299 * u32::from(r) + 587 * u32::from(g) + 114 * u32::from(b)) / 1000;
        [r.max(g).max(b), luma as u8]
    }
}

fn cut(away: &Away, flat: &Mask, white: bool) -> opencv::Result<Surroundings> {
    let (width, height) = (away.width, away.height);
    let luma = |x: usize, y: usize| away.at(x, y)[1];
    // Flat regions at the frame, with the noise before the object.
    let (number, num_regions) = regions(flat)?;
    let mut is_outside = vec![false; num_regions];
    for (x, y) in flat.frame() {
        is_outside[*number.at(x, y) as usize] = true;
    }
    is_outside[0] = false;
    let outside = Mask::from_fn(width, height, |x, y| is_outside[*number.at(x, y) as usize]);
    let noise = |x: usize, y: usize| luma(x, y) <= NOISE && away.at(x, y)[0] <= 2 * NOISE;
    let behind_noise = grown(&outside, REACH_PX, &noise);
    // The object: the largest piece and those that are no specks.
    let (number, num_pieces) = regions(&behind_noise.inverted())?;
    let mut areas = vec![0usize; num_pieces];
    number
        .data
        .iter()
        .for_each(|&piece| areas[piece as usize] += 1);
    areas[0] = 0;
    let largest = areas.iter().copied().max().unwrap_or(0) as f64;
    let is_piece = |area: usize| area > 0 && area as f64 >= PIECE_SHARE * largest;
    let specks: usize = areas.iter().filter(|&&area| !is_piece(area)).sum();
    let object = Mask::from_fn(width, height, |x, y| {
        is_piece(areas[*number.at(x, y) as usize])
    });
    let num_outside = width * height - object.count();
    if !OBJECT_SHARES.contains(&object.coverage())
        || specks as f64 > MAX_SPECKS * num_outside as f64
    {
        return Ok(Surroundings::Photographed);
    }
    let behind = |x: usize, y: usize| {
        let near =
            |at: usize, end: usize| at.saturating_sub(BEHIND_PX)..(at + BEHIND_PX + 1).min(end);
        let pixels = near(y, height).flat_map(|y| near(x, width).map(move |x| (x, y)));
        let of_object = pixels.filter(|&(x, y)| *object.at(x, y));
        of_object.map(|(x, y)| luma(x, y)).max().unwrap_or(0)
    };
    // Holes through the object, whose border is sharp as well.
    let holes = Mask::from_fn(width, height, |x, y| *object.at(x, y) && *flat.at(x, y));
    let (number, num_holes) = regions(&holes)?;
    let mut tally = vec![[0usize; 3]; num_holes];
    for y in 0..height {
        for x in 0..width {
            let hole = *number.at(x, y) as usize;
            tally[hole][0] += 1;
            if hole > 0 && is_border(&holes, x, y) {
                tally[hole][1] += 1;
                tally[hole][2] += usize::from(behind(x, y) > 2 * NOISE);
            }
        }
    }
    let is_hole = |[area, border, sharp]: [usize; 3]| {
        area >= MIN_HOLE_PX && sharp as f64 >= (1.0 - MAX_UNSURE_SHARE) * border as f64
    };
    let through = Mask::from_fn(width, height, |x, y| {
        let hole = *number.at(x, y) as usize;
        hole > 0 && is_hole(tally[hole])
    });
    let through = grown(&through, REACH_PX, &noise);
    let background = Mask::from_fn(width, height, |x, y| !*object.at(x, y) || *through.at(x, y));
    let mixed = |x: usize, y: usize| 2 * u16::from(luma(x, y)) < u16::from(behind(x, y));
    let mask = grown(&background, 1, &mixed).inverted();
    let (mut num_border, mut unsure) = (0usize, 0usize);
    for y in 0..height {
        for x in 0..width {
            if *mask.at(x, y) && is_border(&mask, x, y) {
                num_border += 1;
                unsure += usize::from(behind(x, y) < 2 * NOISE);
            }
        }
    }
    let share = unsure as f64 / num_border.max(1) as f64;
    Ok(if share > MAX_UNSURE_SHARE {
        Surroundings::Unsure { share }
    } else {
        Surroundings::Flat { mask, white }
    })
}

/// Whether a pixel of a mask has one beside it that is not; the frame ends none.
fn is_border(mask: &Mask, x: usize, y: usize) -> bool {
    let (x, y) = (x as isize, y as isize);
    let beside = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
    beside.iter().any(|&(x, y)| mask.get(x, y) == Some(&false))
}

/// A mask with what fits and is connected to it through such pixels within some steps, along rows, columns and diagonals.
fn grown(mask: &Mask, steps: usize, fits: &dyn Fn(usize, usize) -> bool) -> Mask {
    let mut grown = mask.clone();
    let is_set = |(x, y): &(usize, usize)| *mask.at(*x, *y);
    let all = (0..mask.height).flat_map(|y| (0..mask.width).map(move |x| (x, y)));
    let mut front: Vec<(usize, usize)> = all.filter(is_set).collect();
    for _ in 0..steps {
        let mut next = Vec::new();
        for (x, y) in front {
            for ny in y.saturating_sub(1)..(y + 2).min(mask.height) {
                for nx in x.saturating_sub(1)..(x + 2).min(mask.width) {
                    if !*grown.at(nx, ny) && fits(nx, ny) {
                        *grown.at_mut(nx, ny) = true;
                        next.push((nx, ny));
                    }
                }
            }
        }
        front = next;
    }
    grown
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::ExifFacts;
    use rilievo_synthetic::testing::overlap;

    const SIZE: (usize, usize) = (200, 150);

    /// A shaded ring, cut out, its outline mixed with the surroundings by the pixels' share; `own` is its own brightness.
    fn ring(level: f32, noise: u8, own: impl Fn(f32, f32) -> f32) -> (DecodedPhoto, Mask) {
        let at = |x: usize, y: usize| (x as f32 - 100.3).hypot(y as f32 - 74.6);
        // Share of the object, by the distance from both outlines.
        let share = |r: f32| (50.5 - r).clamp(0.0, 1.0) * (r - 14.5).clamp(0.0, 1.0);
        let truth = Mask::from_fn(SIZE.0, SIZE.1, |x, y| share(at(x, y)) >= 0.5);
        let mut data = Vec::new();
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let r = at(x, y);
                let value = share(r) * own(x as f32, y as f32) + (1.0 - share(r)) * level;
                let index = y * SIZE.0 + x;
                // As JPEG has it: near the outline alone.
                let ripple = if (48.0..54.0).contains(&r) { noise } else { 0 };
                let ripple = (index * 7919 % 17) as f32 / 16.0
                    * f32::from(ripple)
                    * if level > 0.0 { -1.0 } else { 1.0 };
                for tint in [0.0, 1.0, -1.0] {
                    let value = value + ripple + if share(r) == 1.0 { tint } else { 0.0 };
                    data.push(value.round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        let photo = DecodedPhoto {
            file_name: "a.jpg".to_owned(),
            width: SIZE.0,
            height: SIZE.1,
            channels: 3,
            samples: Samples::U8(data),
            linear_by_metadata: false,
            saturates_at_white: true,
            encoding_reason: String::new(),
            profile_curve: None,
            alpha: None,
            exif: ExifFacts::default(),
        };
        (photo, truth)
    }

    fn shaded(x: f32, _: f32) -> f32 {
        70.0 + 0.6 * x
    }

    #[test]
    fn objects_cut_out_to_black_and_white_have_their_masks() {
        for (level, is_white) in [(0.0, false), (255.0, true)] {
            for noise in [0, 10] {
                let (photo, truth) = ring(level, noise, shaded);
                let Surroundings::Flat { mask, white } = surroundings(&photo).unwrap() else {
                    panic!("level {level}, noise {noise}");
                };
                assert_eq!(white, is_white);
                let overlap = overlap(&mask, &truth);
                assert!(overlap > 0.99, "level {level}, noise {noise}: {overlap}");
                assert!(!mask.at(100, 75), "the hole of the ring");
            }
        }
    }

    #[test]
    fn black_places_inside_the_object_are_the_objects() {
        // A shadow that ends softly, crushed to black.
        let shadow = |x: f32, y: f32| (3.0 * ((x - 70.0).hypot(y - 75.0) - 6.0)).clamp(0.0, 130.0);
        let (photo, truth) = ring(0.0, 0, shadow);
        let Surroundings::Flat { mask, .. } = surroundings(&photo).unwrap() else {
            panic!("not found");
        };
        assert!(*mask.at(70, 75));
        assert!(overlap(&mask, &truth) > 0.98);
    }

    #[test]
    fn an_object_as_black_as_its_surroundings_is_unsure() {
        let half_black = |x: f32, _: f32| (2.0 * (x - 100.0)).clamp(4.0, 120.0);
        let (photo, _) = ring(0.0, 0, half_black);
        let found = surroundings(&photo).unwrap();
        assert!(
            matches!(found, Surroundings::Unsure { share } if share > 0.3),
            "{found:?}"
        );
    }

    #[test]
    fn photographed_backdrops_are_no_cut_outs() {
        // Dark, and near black with a sensor's noise.
        for level in [9.0, 0.0] {
            let (mut photo, _) = ring(level, 0, shaded);
            if let Samples::U8(data) = &mut photo.samples {
                for (i, value) in data.iter_mut().enumerate() {
                    *value = value.saturating_add((i * 7919 % 1009 % 7) as u8);
                }
            }
            assert_eq!(surroundings(&photo).unwrap(), Surroundings::Photographed);
        }
        let (mut blank, _) = ring(0.0, 0, |_, _| 0.0);
        assert_eq!(surroundings(&blank).unwrap(), Surroundings::Photographed);
        blank.samples = Samples::U8(vec![255; SIZE.0 * SIZE.1 * 3]);
        assert_eq!(surroundings(&blank).unwrap(), Surroundings::Photographed);
    }
}
