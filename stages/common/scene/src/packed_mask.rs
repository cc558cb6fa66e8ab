//! Masks, a bit a pixel.

use crate::raster::Mask;

/// Which pixels of a photo belong to the object, a bit a pixel: the masks of all photos are in memory throughout a
/// run, and at a byte a pixel hundreds of large ones would outweigh everything else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PackedMask {
    width: usize,
    height: usize,
    /// Pixels row by row, the first in the lowest bit.
    words: Vec<u64>,
}

impl PackedMask {
    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Value at `(x, y)`, `false` outside the mask.
    #[inline]
    pub fn contains(&self, x: isize, y: isize) -> bool {
        if x < 0 || y < 0 || x as usize >= self.width || y as usize >= self.height {
            return false;
        }
        let index = y as usize * self.width + x as usize;
        self.words[index / 64] >> (index % 64) & 1 == 1
    }

    /// Number of pixels that are set.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// The same, a value a pixel.
    pub fn unpacked(&self) -> Mask {
        Mask::from_fn(self.width, self.height, |x, y| {
            self.contains(x as isize, y as isize)
        })
    }
}

impl Mask {
    /// The same, a bit a pixel.
    pub fn packed(&self) -> PackedMask {
        let words = self.data.chunks(64).map(|pixels| {
            let set = pixels.iter().enumerate().filter(|(_, is)| **is);
            set.fold(0, |word, (k, _)| word | 1 << k)
        });
        PackedMask {
            width: self.width,
            height: self.height,
            words: words.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_comes_out_as_it_went_in() {
        for (width, height) in [(0, 0), (1, 1), (64, 1), (65, 3), (13, 29)] {
            let mask = Mask::from_fn(width, height, |x, y| (x * x + 3 * y) % 7 < 3);
            let packed = mask.packed();
            assert_eq!(packed.unpacked(), mask);
            assert_eq!(packed.count(), mask.count());
            for y in -1..=height as isize {
                for x in -1..=width as isize {
                    assert_eq!(packed.contains(x, y), mask.contains(x, y), "{x} {y}");
                }
            }
        }
    }
}
