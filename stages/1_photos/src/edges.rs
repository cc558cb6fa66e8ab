//! Whether a mask's border lies on edges of its photo, as an object's outline does.
//!
//! With the gradient's magnitude `g = |∇√L|` of a reduced photo (the square root is near what the eye
//! sees) and the border `B` of the reduced mask, the mean of `g` along `B` is compared with its means
//! along `B` shifted by 3 and 6 per cent of the diagonal in eight directions:
//! `ratio = mean_B g / max_s mean_{B + s} g`. An outline has about 2 to 3; the border of another
//! photo's mask, or of one that is shifted, is one border among many and has mostly less than 1.

use rilievo_scene::{LinearImage, Mask, Raster};

/// Longer side of the reduced photo: outlines that are drawn a few pixels off still lie on their edge.
const SIDE_PX: usize = 512;

/// Lengths of the shifts, share of the diagonal: the smaller is more than a hand's error, the larger
/// less than an object's size.
const SHIFT_SHARES: [f64; 2] = [0.03, 0.06];

/// Directions of the shifts.
const DIRECTIONS: [(isize, isize); 8] = [
    (1, 0),
    (1, 1),
    (0, 1),
    (-1, 1),
    (-1, 0),
    (-1, -1),
    (0, -1),
    (1, -1),
];

/// Fewest border pixels that make a mean.
const MIN_BORDER_PX: usize = 32;

/// How much stronger the photo's edges are along the mask's border than along the same border shifted,
/// at the strongest shift; `None` where there is no border or no edge at all.
pub(crate) fn mask_edge_ratio(image: &LinearImage, mask: &Mask) -> Option<f64> {
    let factor = image.width.max(image.height).div_ceil(SIDE_PX).max(1);
    let border = border(&reduced_mask(mask, factor));
    if border.len() < MIN_BORDER_PX {
        return None;
    }
    let gradient = gradient(&reduced_root(image, factor));
    let along = |shift: (isize, isize)| {
        let found: Vec<f64> = border
            .iter()
            .filter_map(|&(x, y)| gradient.get(x + shift.0, y + shift.1))
            .map(|&value| f64::from(value))
            .collect();
        // What is left of a border that was pushed out of the frame is no comparison.
        (2 * found.len() >= border.len()).then(|| found.iter().sum::<f64>() / found.len() as f64)
    };
    let diagonal = (gradient.width as f64).hypot(gradient.height as f64);
    let strongest = SHIFT_SHARES
        .iter()
        .flat_map(|share| {
            DIRECTIONS.map(|(x, y)| {
                let length = share * diagonal / f64::from((x * x + y * y) as i32).sqrt();
                let step = length.round().max(1.0) as isize;
                (x * step, y * step)
            })
        })
        .filter_map(along)
        .fold(0.0, f64::max);
    (strongest > 0.0).then_some(along((0, 0))? / strongest)
}

/// Blocks of `factor * factor` pixels, those beyond the last whole block left out.
fn blocks(width: usize, height: usize, factor: usize) -> (usize, usize) {
    (width / factor, height / factor)
}

/// Blocks of which at least half is object.
pub(crate) fn reduced_mask(mask: &Mask, factor: usize) -> Mask {
    let (width, height) = blocks(mask.width, mask.height, factor);
    Raster::from_fn(width, height, |x, y| {
        let rows = (y * factor..(y + 1) * factor).map(|y| y * mask.width + x * factor);
        let marked: usize = rows
            .map(|start| {
                let row = &mask.data[start..start + factor];
                row.iter().filter(|&&inside| inside).count()
            })
            .sum();
        2 * marked >= factor * factor
    })
}

/// Square root of each block's mean.
pub(crate) fn reduced_root(image: &LinearImage, factor: usize) -> Raster<f32> {
    let (width, height) = blocks(image.width, image.height, factor);
    let channels = image.channels;
    let scale = 1.0 / (factor * factor * channels) as f32;
    Raster::from_fn(width, height, |x, y| {
        let rows = (y * factor..(y + 1) * factor).map(|y| y * image.width + x * factor);
        let sum: f32 = rows
            .map(|start| {
                let row = &image.data[start * channels..(start + factor) * channels];
                row.iter().sum::<f32>()
            })
            .sum();
        (sum * scale).max(0.0).sqrt()
    })
}

/// Pixels of which the one to the right or below is of the other kind.
fn border(mask: &Mask) -> Vec<(isize, isize)> {
    let mut found = Vec::new();
    for y in 0..mask.height.saturating_sub(1) {
        for x in 0..mask.width.saturating_sub(1) {
            let inside = mask.at(x, y);
            if inside != mask.at(x + 1, y) || inside != mask.at(x, y + 1) {
                found.push((x as isize, y as isize));
            }
        }
    }
    found
}

/// Magnitude of the gradient by Sobel's differences, which smooth across; zero along the frame.
fn gradient(root: &Raster<f32>) -> Raster<f32> {
    let (width, height) = (root.width, root.height);
    Raster::from_fn(width, height, |x, y| {
        if x == 0 || y == 0 || x + 1 >= width || y + 1 >= height {
            return 0.0;
        }
        let across = |y: usize| root.at(x + 1, y) - root.at(x - 1, y);
        let down = |x: usize| root.at(x, y + 1) - root.at(x, y - 1);
        let dx = across(y - 1) + 2.0 * across(y) + across(y + 1);
        let dy = down(x - 1) + 2.0 * down(x) + down(x + 1);
        dx.hypot(dy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc brighter than a textured backdrop.
    fn photo(width: usize, height: usize) -> LinearImage {
        let mut image = LinearImage::filled(width, height, 3, 0.0);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f64 / width as f64, y as f64 / width as f64);
                let texture =
                    0.04 * ((60.0 * u).sin() * (47.0 * v).cos() + (23.0 * u + 31.0 * v).sin());
                let level = if disc(u, v) { 0.5 + 0.3 * u } else { 0.25 } + texture;
                image.pixel_mut(x, y).fill(level as f32);
            }
        }
        image
    }

    fn disc(u: f64, v: f64) -> bool {
        (u - 0.5).hypot(v - 0.35) < 0.2
    }

    fn ratio(width: usize, shift: (f64, f64), factor: f64) -> Option<f64> {
        let height = width * 3 / 4;
        let mask = Raster::from_fn(width, height, |x, y| {
            let (u, v) = (x as f64 / width as f64, y as f64 / width as f64);
            disc(
                0.5 + (u - 0.5 - shift.0) / factor,
                0.35 + (v - 0.35 - shift.1) / factor,
            )
        });
        mask_edge_ratio(&photo(width, height), &mask)
    }

    #[test]
    fn an_outline_lies_on_edges_and_a_shifted_one_does_not() {
        for width in [160, 640, 1500] {
            // A pixel or two beside the edge, as hands draw.
            for shift in [(0.0, 0.0), (1.0 / 512.0, -1.0 / 512.0)] {
                let own = ratio(width, shift, 1.0);
                assert!(own.is_some_and(|own| own > 1.5), "{width}: {own:?}");
            }
            for shift in [(0.25, 0.0), (0.0, -0.15), (0.05, 0.05)] {
                let shifted = ratio(width, shift, 1.0);
                assert!(
                    shifted.is_some_and(|r| r < 1.0),
                    "{width} {shift:?}: {shifted:?}"
                );
            }
            let larger = ratio(width, (0.0, 0.0), 1.3);
            assert!(larger.is_some_and(|r| r < 1.0), "{width}: {larger:?}");
        }
    }

    #[test]
    fn without_edges_or_border_nothing_is_said() {
        let flat = LinearImage::filled(160, 120, 1, 0.5);
        let mask = Raster::from_fn(160, 120, |x, _| x < 80);
        assert_eq!(mask_edge_ratio(&flat, &mask), None);
        let nothing = Raster::filled(160, 120, false);
        assert_eq!(mask_edge_ratio(&photo(160, 120), &nothing), None);
    }
}
