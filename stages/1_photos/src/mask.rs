//! Whether a mask can be the object's: right size, neither empty nor full, not inverted.
//!
//! A mask is taken for inverted when it marks most of the frame's border and a larger share of it
//! than of the whole frame: what it leaves out then lies inside, as an object does. An object that
//! fills the frame leaves out parts of the border instead.

use crate::error::PhotosError;
use crate::options::PhotosOptions;
use rilievo_scene::Mask;

/// Share of the frame that a mask which is not full must at least leave out.
const FULL_SHARE: f64 = 0.999;

/// Least share that an inverted mask leaves out; a smaller hole is a flaw of an object's mask.
const INVERTED_HOLE_SHARE: f64 = 0.01;

/// Share of the pixels along the four sides that a mask marks.
pub(crate) fn border_share(mask: &Mask) -> f64 {
    let (w, h) = (mask.width, mask.height);
    let mut marked = 0usize;
    let mut total = 0usize;
    for y in 0..h {
        let step = if y == 0 || y + 1 == h {
            1
        } else {
            w.max(2) - 1
        };
        for x in (0..w).step_by(step) {
            total += 1;
            marked += usize::from(*mask.at(x, y));
        }
    }
    marked as f64 / total.max(1) as f64
}

/// Checks a photo's mask.
pub(crate) fn check(
    photo: &str,
    (width, height): (usize, usize),
    mask: &Mask,
    options: &PhotosOptions,
) -> Result<(), PhotosError> {
    if (mask.width, mask.height) != (width, height) {
        return Err(PhotosError::MaskSize {
            photo: photo.to_owned(),
            mask_width: mask.width,
            mask_height: mask.height,
            width,
            height,
        });
    }
    let num_pixels = mask.count();
    if num_pixels < options.min_mask_px {
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
    let border = border_share(mask);
    if border >= options.inverted_border_share
        && border > coverage
        && 1.0 - coverage >= INVERTED_HOLE_SHARE
    {
        return Err(PhotosError::MaskInverted {
            photo: photo.to_owned(),
            border_percent: 100.0 * border,
        });
    }
    Ok(())
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
        check("a.jpg", SIZE, &mask, &PhotosOptions::default())
    }

    #[test]
    fn objects_pass_wherever_they_lie() {
        assert_eq!(checked(|x, y| x.hypot(y) < 20.0), Ok(()));
        // Cut by the lower side.
        assert_eq!(checked(|x, y| x.hypot(y - 20.0) < 25.0), Ok(()));
        // Fills the frame but for two corners.
        assert_eq!(checked(|x, y| x + y < 55.0), Ok(()));
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
        let mask = Raster::filled(60, 80, false);
        assert!(matches!(
            check("a.jpg", SIZE, &mask, &PhotosOptions::default()),
            Err(PhotosError::MaskSize { .. })
        ));
    }
}
