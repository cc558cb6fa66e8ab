//! Whether a mask can be the object's: right size, neither empty nor full, not inverted, no noise.
//!
//! A mask is taken for inverted when it marks most of the frame's border and a larger share of it
//! than of the whole frame: what it leaves out then lies inside, as an object does. An object that
//! fills the frame leaves out parts of the border instead.
//!
//! A mask is taken for noise when a pixel is independent of its neighbour:
//! `c(d) = (P(m, m') - p²) / (p - p²)` with the share `p` of object pixels and the share `P` of
//! pairs at a step `d` that both are, is 0 for independent pixels of any density, 1 far from
//! borders, and high along a hair or a wire however thin. The largest of the steps right, down and
//! along both diagonals counts.

use crate::edges;
use crate::error::PhotosError;
use rilievo_scene::{LinearImage, Mask, Orientation};

/// Fewest object pixels of a usable mask.
const MIN_MASK_PX: usize = 64;

/// Share of the frame's border that a mask must mark, besides missing the middle, to be taken for
/// inverted. Too small refuses objects that the frame cuts, too large misses inversions.
const INVERTED_BORDER_SHARE: f64 = 0.75;

/// Share of the frame that a mask which is not full must at least leave out.
const FULL_SHARE: f64 = 0.999;

/// Least share that an inverted mask leaves out; a smaller hole is a flaw of an object's mask.
const INVERTED_HOLE_SHARE: f64 = 0.01;

/// Correlation of neighbours below which a mask is noise. A disc with a tenth of its pixels flipped has
/// 0.55, lattices of bars a few pixels wide 0.7 and more, independent pixels 0.
const NOISE_CORRELATION: f64 = 0.3;

/// Pixels that are looked at for that: 0 is then known to a few thousandths.
const MAX_NUM_NOISE_SAMPLES: usize = 1_000_000;

/// What the border of a turned mask must have at least of the photo's edges, and how many times as much as the border of
/// the mask as given: an outline has 2 to 3, a border elsewhere less than 1.
const OUTLINE_EDGE_RATIO: f64 = 1.5;

/// A mask in the stored frame, and whether it was drawn over the photo as EXIF turns it, where sizes do not
/// decide (turned by half, mirrored, square): the object's outline is under one of both borders.
pub(crate) fn turned_by_content(
    mask: Mask,
    image: &LinearImage,
    orientation: Orientation,
) -> (Mask, bool) {
    let size = (image.width, image.height);
    if orientation == Orientation::UPRIGHT || orientation.upright_size(size) != size {
        return (mask, false);
    }
    let turned = orientation.raster_to_stored(&mask);
    let on_edges = [&mask, &turned].map(|mask| edges::mask_edge_ratio(image, mask));
    match on_edges {
        [Some(given), Some(upright)] if upright > OUTLINE_EDGE_RATIO * given.max(1.0) => {
            (turned, true)
        }
        _ => (mask, false),
    }
}

/// Checks a photo's mask.
pub(crate) fn check(photo: &str, size: (usize, usize), mask: &Mask) -> Result<(), PhotosError> {
    let mask_size = (mask.width, mask.height);
    if mask_size != size {
        return Err(PhotosError::MaskSize {
            photo: photo.to_owned(),
            mask_size,
            size,
        });
    }
    let num_pixels = mask.count();
    if num_pixels < MIN_MASK_PX {
        return Err(PhotosError::MaskEmpty {
            photo: photo.to_owned(),
            num_pixels,
        });
    }
    let coverage = mask.coverage();
    if coverage > FULL_SHARE {
        return Err(PhotosError::MaskFull {
            photo: photo.to_owned(),
        });
    }
    let border = mask.frame_share();
    if border >= INVERTED_BORDER_SHARE && border > coverage && 1.0 - coverage >= INVERTED_HOLE_SHARE
    {
        return Err(PhotosError::MaskInverted {
            photo: photo.to_owned(),
            border_percent: 100.0 * border,
        });
    }
    if let Some(correlation) = neighbour_correlation(mask)
        && correlation < NOISE_CORRELATION
    {
        return Err(PhotosError::MaskNoise {
            photo: photo.to_owned(),
            correlation,
        });
    }
    Ok(())
}

/// Correlation of a pixel with its neighbours; `None` where the sampled pixels are all alike.
fn neighbour_correlation(mask: &Mask) -> Option<f64> {
    let (width, height) = (mask.width, mask.height);
    if width < 3 || height < 2 {
        return None;
    }
    let row_step = (width * height).div_ceil(MAX_NUM_NOISE_SAMPLES).max(1);
    let (mut num, mut marked) = (0usize, 0usize);
    // Right, down, and along the diagonals.
    let mut pairs = [0usize; 4];
    for y in (0..height - 1).step_by(row_step) {
        let row = &mask.data[y * width..(y + 1) * width];
        let below = &mask.data[(y + 1) * width..(y + 2) * width];
        for x in 1..width - 1 {
            num += 1;
            if row[x] {
                marked += 1;
                let neighbours = [row[x + 1], below[x], below[x + 1], below[x - 1]];
                for (pairs, inside) in pairs.iter_mut().zip(neighbours) {
                    *pairs += usize::from(inside);
                }
            }
        }
    }
    if marked == 0 || marked == num {
        return None;
    }
    let share = marked as f64 / num as f64;
    let most = pairs.into_iter().max()? as f64 / num as f64;
    Some((most - share * share) / (share - share * share))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Raster;

    const SIZE: (usize, usize) = (80, 60);

    fn checked(inside: impl Fn(f64, f64) -> bool) -> Result<(), PhotosError> {
        let mask = Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
            inside(x as f64 - 40.0, y as f64 - 30.0)
        });
        check("a.jpg", SIZE, &mask)
    }

    #[test]
    fn objects_pass_wherever_they_lie() {
        assert_eq!(checked(|x, y| x.hypot(y) < 20.0), Ok(()));
        // Cut by the lower side.
        assert_eq!(checked(|x, y| x.hypot(y - 20.0) < 25.0), Ok(()));
        // Fills the frame but for two corners.
        assert_eq!(checked(|x, y| x + y < 55.0), Ok(()));
        // Wires with gaps, in many pieces.
        assert_eq!(
            checked(|x, y| x.abs() < 30.0 && y.rem_euclid(5.0) < 1.0),
            Ok(())
        );
        assert_eq!(
            checked(|x, y| (x + y).rem_euclid(6.0) < 1.0 && x.rem_euclid(9.0) < 7.0),
            Ok(())
        );
        // Leaves of three pixels.
        assert_eq!(
            checked(|x, y| x.rem_euclid(7.0) < 3.0 && y.rem_euclid(8.0) < 3.0),
            Ok(())
        );
        // Fills the frame but for a hole.
        assert_eq!(checked(|x, y| x.hypot(y) > 3.0), Ok(()));
    }

    #[test]
    fn what_cannot_be_an_object_is_refused() {
        assert!(matches!(
            checked(|_, _| false),
            Err(PhotosError::MaskEmpty { num_pixels: 0, .. })
        ));
        assert!(matches!(
            checked(|_, _| true),
            Err(PhotosError::MaskFull { .. })
        ));
        assert!(matches!(
            checked(|x, y| x.hypot(y) >= 20.0),
            Err(PhotosError::MaskInverted { .. })
        ));
        // Inverted, with the object standing on the lower side.
        assert!(matches!(
            checked(|x, y| x.abs() >= 10.0 || y < -10.0),
            Err(PhotosError::MaskInverted { .. })
        ));
        // A mixed hash of the place: independent pixels, many and few.
        let noise = |x: f64, y: f64| {
            let mut h = ((y * 80.0 + x) as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            h = (h ^ (h >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            (h >> 40) as f64 / (1u64 << 24) as f64
        };
        for density in [0.5, 0.15] {
            assert!(matches!(
                checked(|x, y| noise(x, y) < density),
                Err(PhotosError::MaskNoise { correlation, .. }) if correlation.abs() < 0.1
            ));
        }
        // The object with grain in it is ragged, and still the object.
        assert_eq!(
            checked(|x, y| (x.hypot(y) < 20.0) != (noise(x, y) < 0.05)),
            Ok(())
        );
        let mask = Raster::filled(60, 80, false);
        assert!(matches!(
            check("a.jpg", SIZE, &mask),
            Err(PhotosError::MaskSize { .. })
        ));
    }
}
