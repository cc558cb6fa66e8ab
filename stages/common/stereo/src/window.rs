//! Rasters cropped to the object and reduced by whole factors.

use rilievo_scene::{LinearImage, Mask, Raster};

/// A rectangle of a raster's pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl Window {
    /// The box around a mask's set pixels, `margin_px` wider on every side as far as the raster reaches;
    /// `None` where none is set.
    pub fn around(mask: &Mask, margin_px: usize) -> Option<Self> {
        let [[left, right], [top, bottom]] = mask.bounds(|&inside| inside)?;
        let [x0, y0] = [left, top].map(|v| v.saturating_sub(margin_px));
        Some(Self {
            x0,
            y0,
            width: (right + 1 + margin_px).min(mask.width) - x0,
            height: (bottom + 1 + margin_px).min(mask.height) - y0,
        })
    }

    /// Its columns and rows.
    pub fn ranges(&self) -> [std::ops::Range<usize>; 2] {
        [
            self.x0..self.x0 + self.width,
            self.y0..self.y0 + self.height,
        ]
    }

    /// The part of a raster inside the window, which must lie in the raster.
    pub fn cut<T: Copy>(&self, raster: &Raster<T>) -> Raster<T> {
        raster.cropped(self.x0, self.y0, self.width, self.height)
    }
}

/// Means over blocks of `factor × factor` pixels; an incomplete last block is dropped.
pub fn block_mean(image: &LinearImage, factor: usize) -> LinearImage {
    let (width, height) = (image.width / factor, image.height / factor);
    let mut out = LinearImage::filled(width, height, image.channels, 0.0);
    let scale = 1.0 / (factor * factor) as f32;
    for y in 0..height {
        for x in 0..width {
            let mean = out.pixel_mut(x, y);
            for v in 0..factor {
                for u in 0..factor {
                    let pixel = image.pixel(x * factor + u, y * factor + v);
                    for (sum, value) in mean.iter_mut().zip(pixel) {
                        *sum += value;
                    }
                }
            }
            mean.iter_mut().for_each(|sum| *sum *= scale);
        }
    }
    out
}

/// Blocks of `factor × factor` pixels all of which pass; an incomplete last block is dropped.
pub fn blocks_where<T>(raster: &Raster<T>, factor: usize, passes: impl Fn(&T) -> bool) -> Mask {
    Raster::from_fn(raster.width / factor, raster.height / factor, |x, y| {
        (0..factor * factor)
            .all(|k| passes(raster.at(x * factor + k % factor, y * factor + k / factor)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_holds_the_set_pixels_and_its_margin_stays_inside() {
        let mask = Raster::from_fn(20, 10, |x, y| (2..5).contains(&x) && (3..9).contains(&y));
        let window = Window::around(&mask, 3);
        let expected = Window {
            x0: 0,
            y0: 0,
            width: 8,
            height: 10,
        };
        assert_eq!(window, Some(expected));
        assert_eq!(expected.cut(&mask).count(), mask.count());
        assert_eq!(Window::around(&Mask::filled(4, 4, false), 1), None);
    }

    #[test]
    fn blocks_hold_means_and_pass_whole() {
        let image = LinearImage {
            width: 5,
            height: 4,
            channels: 1,
            data: (0..20).map(|i| (i % 5 + 10 * (i / 5)) as f32).collect(),
        };
        let half = block_mean(&image, 2);
        assert_eq!((half.width, half.height), (2, 2));
        assert_eq!(half.data, [5.5, 7.5, 25.5, 27.5]);
        let mask = Raster::from_fn(5, 4, |x, y| x > 0 || y > 1);
        assert_eq!(
            blocks_where(&mask, 2, |&m| m).data,
            [false, true, true, true]
        );
    }
}
