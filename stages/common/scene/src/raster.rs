//! Row-major images: the one container behind photos, masks and maps.

use serde::{Deserialize, Serialize};

/// A row-major raster with one value per pixel; `(x, y)` are column and row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Raster<T> {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// `height * width` values, row by row.
    pub data: Vec<T>,
}

impl<T: Clone> Raster<T> {
    /// A raster filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }
}

impl<T> Raster<T> {
    /// Wraps existing values; `None` unless there are exactly `width * height` of them.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Option<Self> {
        (data.len() == width * height).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// A raster computed pixel by pixel from `(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut value: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                data.push(value(x, y));
            }
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// Position of pixel `(x, y)` in `data`.
    #[inline]
    pub fn index(&self, x: usize, y: usize) -> usize {
        y * self.width + x
    }

    /// Value at `(x, y)`.
    ///
    /// # Panics
    /// Outside the raster.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> &T {
        &self.data[y * self.width + x]
    }

    /// Mutable value at `(x, y)`.
    ///
    /// # Panics
    /// Outside the raster.
    #[inline]
    pub fn at_mut(&mut self, x: usize, y: usize) -> &mut T {
        &mut self.data[y * self.width + x]
    }

    /// Value at `(x, y)`, `None` outside the raster.
    #[inline]
    pub fn get(&self, x: isize, y: isize) -> Option<&T> {
        (x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height)
            .then(|| &self.data[y as usize * self.width + x as usize])
    }

    /// First and last column, then first and last row, of the values that fulfil a condition;
    /// `None` where none does.
    pub fn bounds(&self, fulfils: impl Fn(&T) -> bool) -> Option<[[usize; 2]; 2]> {
        let mut rows = self.data.chunks(self.width.max(1)).enumerate();
        let within = |(y, row): (usize, &[T])| {
            let first = row.iter().position(&fulfils)?;
            Some((y, [first, row.iter().rposition(&fulfils)?]))
        };
        let (top, columns) = rows.by_ref().find_map(within)?;
        let start = (columns, top);
        let ([x0, x1], bottom) = rows.filter_map(within).fold(start, |(x, _), (y, row)| {
            ([x[0].min(row[0]), x[1].max(row[1])], y)
        });
        Some([[x0, x1], [top, bottom]])
    }

    /// The part in a rectangle that starts at `(x0, y0)`.
    ///
    /// # Panics
    /// Where the rectangle reaches beyond the raster.
    #[must_use]
    pub fn cropped(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self
    where
        T: Copy,
    {
        Self::from_fn(width, height, |x, y| *self.at(x0 + x, y0 + y))
    }

    /// Whether another raster has the same size.
    pub fn same_size<U>(&self, other: &Raster<U>) -> bool {
        self.width == other.width && self.height == other.height
    }
}

/// Which pixels belong to the object.
pub type Mask = Raster<bool>;

impl Mask {
    /// Number of pixels that are set.
    pub fn count(&self) -> usize {
        self.data.iter().filter(|&&inside| inside).count()
    }

    /// Share of pixels that are set, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.count() as f64 / self.data.len().max(1) as f64
    }

    /// Places of the pixels along the four sides, each once.
    pub fn frame(&self) -> impl Iterator<Item = (usize, usize)> {
        let (width, height) = (self.width, self.height);
        (0..height).flat_map(move |y| {
            let is_side = y == 0 || y + 1 == height;
            let step = if is_side { 1 } else { width.max(2) - 1 };
            (0..width).step_by(step).map(move |x| (x, y))
        })
    }

    /// Share of those pixels that are set, 0 to 1.
    pub fn frame_share(&self) -> f64 {
        let marked = self.frame().filter(|&(x, y)| *self.at(x, y)).count();
        marked as f64 / self.frame().count().max(1) as f64
    }

    /// The pixels that it leaves out.
    #[must_use]
    pub fn inverted(mut self) -> Self {
        self.data.iter_mut().for_each(|is| *is = !*is);
        self
    }

    /// Value at `(x, y)`, `false` outside the raster.
    #[inline]
    pub fn contains(&self, x: isize, y: isize) -> bool {
        self.get(x, y).copied().unwrap_or(false)
    }
}

/// Linear intensities, 1 or 3 interleaved channels; 1 is the photo's white.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearImage {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// 1 (grey) or 3 (red, green, blue).
    pub channels: usize,
    /// `height * width * channels` values, row by row, channels together.
    pub data: Vec<f32>,
}

impl LinearImage {
    /// An image filled with one value.
    pub fn filled(width: usize, height: usize, channels: usize, value: f32) -> Self {
        Self {
            width,
            height,
            channels,
            data: vec![value; width * height * channels],
        }
    }

    /// The channels of pixel `(x, y)`.
    ///
    /// # Panics
    /// Outside the image.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let start = (y * self.width + x) * self.channels;
        &self.data[start..start + self.channels]
    }

    /// Mutable channels of pixel `(x, y)`.
    ///
    /// # Panics
    /// Outside the image.
    #[inline]
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let start = (y * self.width + x) * self.channels;
        &mut self.data[start..start + self.channels]
    }

    /// The part in a rectangle that starts at `(x0, y0)`.
    ///
    /// # Panics
    /// Where the rectangle reaches beyond the image.
    #[must_use]
    pub fn cropped(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        let mut data = Vec::with_capacity(width * height * self.channels);
        for y in y0..y0 + height {
            let start = (y * self.width + x0) * self.channels;
            data.extend_from_slice(&self.data[start..start + width * self.channels]);
        }
        Self {
            width,
            height,
            channels: self.channels,
            data,
        }
    }

    /// Mean of the channels, one value per pixel.
    pub fn to_grey(&self) -> Raster<f32> {
        let scale = 1.0 / self.channels as f32;
        Raster {
            width: self.width,
            height: self.height,
            data: self
                .data
                .chunks_exact(self.channels)
                .map(|pixel| pixel.iter().sum::<f32>() * scale)
                .collect(),
        }
    }

    /// Bilinear interpolation of one channel at a sub-pixel position; `None` where one of the
    /// four neighbours lies outside the image.
    #[inline]
    pub fn sample(&self, x: f64, y: f64, channel: usize) -> Option<f32> {
        bilinear((self.width, self.height), x, y, |i| {
            self.data[i * self.channels + channel]
        })
    }
}

/// Bilinear interpolation at a sub-pixel position between pixels whose values `value` returns by
/// their index, row by row; `None` where one of the four neighbours lies outside.
#[inline]
pub fn bilinear(
    (width, height): (usize, usize),
    x: f64,
    y: f64,
    value: impl Fn(usize) -> f32,
) -> Option<f32> {
    let (x0, y0) = (x.floor(), y.floor());
    if x0.is_nan() || y0.is_nan() || x0 < 0.0 || y0 < 0.0 {
        return None;
    }
    let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
    let (x0, y0) = (x0 as usize, y0 as usize);
    // The far neighbour is not needed where its weight is zero.
    let x1 = if fx > 0.0 { x0 + 1 } else { x0 };
    let y1 = if fy > 0.0 { y0 + 1 } else { y0 };
    if x1 >= width || y1 >= height {
        return None;
    }
    let at = |x: usize, y: usize| value(y * width + x);
    let top = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
    let bottom = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
    Some(top * (1.0 - fy) + bottom * fy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_is_exact_on_a_plane_and_refuses_the_outside() {
        let mut image = LinearImage::filled(5, 4, 1, 0.0);
        for y in 0..4 {
            for x in 0..5 {
                image.pixel_mut(x, y)[0] = 2.0 * x as f32 - 3.0 * y as f32 + 1.0;
            }
        }
        let value = image.sample(2.25, 1.5, 0);
        assert!(value.is_some_and(|v| (v - (4.5 - 4.5 + 1.0)).abs() < 1e-6));
        assert_eq!(image.sample(4.0, 3.0, 0), Some(0.0));
        assert_eq!(image.sample(4.1, 3.0, 0), None);
        assert_eq!(image.sample(-0.1, 0.0, 0), None);
        assert_eq!(image.sample(f64::NAN, 0.0, 0), None);
    }
}
