//! Grey photo for alignment: `√I`, which evens out photon noise, in 16 bits, as a pyramid.

use rilievo_scene::LinearImage;

/// Levels: full size, half, quarter.
pub(crate) const NUM_LEVELS: usize = 3;
/// Code of `√I = 1`; leaves headroom above white.
const WHITE: f32 = 32_768.0;

struct Level {
    width: usize,
    height: usize,
    data: Vec<u16>,
}

pub(crate) struct Pyramid {
    levels: Vec<Level>,
}

impl Pyramid {
    /// Builds all levels; each halves the one before by the mean of 2×2 pixels.
    pub fn new(image: &LinearImage) -> Self {
        let grey = image.to_grey();
        let mut levels = vec![Level {
            width: grey.width,
            height: grey.height,
            data: grey
                .data
                .iter()
                .map(|v| (WHITE * v.max(0.0).sqrt()).min(65_535.0) as u16)
                .collect(),
        }];
        for k in 1..NUM_LEVELS {
            let fine = &levels[k - 1];
            let (width, height) = (fine.width / 2, fine.height / 2);
            let mut data = Vec::with_capacity(width * height);
            for y in 0..height {
                let (above, below) = (
                    &fine.data[2 * y * fine.width..][..fine.width],
                    &fine.data[(2 * y + 1) * fine.width..][..fine.width],
                );
                data.extend((0..width).map(|x| {
                    let sum = u32::from(above[2 * x])
                        + u32::from(above[2 * x + 1])
                        + u32::from(below[2 * x])
                        + u32::from(below[2 * x + 1]);
                    ((sum + 2) / 4) as u16
                }));
            }
            levels.push(Level {
                width,
                height,
                data,
            });
        }
        Self { levels }
    }

    /// Value at a full-size pixel position by cubic convolution (Keys 1981, a = −½) on a level;
    /// `None` within two pixels of its border.
    #[inline]
    pub fn sample(&self, x: f32, y: f32, level: usize) -> Option<f32> {
        let scale = 1.0 / (1_u32 << level) as f32;
        // Pixel x of a halved level covers 2x and 2x + 1.
        let (x, y) = ((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5);
        let image = &self.levels[level];
        let inside =
            x >= 1.0 && y >= 1.0 && x + 2.0 < image.width as f32 && y + 2.0 < image.height as f32;
        if !inside {
            return None;
        }
        // Of positive numbers truncation is the floor, without a call.
        let (column, row) = (x as i32, y as i32);
        let (wx, wy) = (weights(x - column as f32), weights(y - row as f32));
        let start = (row as usize - 1) * image.width + column as usize - 1;
        if start + 3 * image.width + 4 > image.data.len() {
            return None;
        }
        let mut sum = 0.0;
        for (row, w) in wy.iter().enumerate() {
            let line = &image.data[start + row * image.width..][..4];
            sum += w
                * (wx[0] * f32::from(line[0])
                    + wx[1] * f32::from(line[1])
                    + wx[2] * f32::from(line[2])
                    + wx[3] * f32::from(line[3]));
        }
        Some(sum)
    }
}

#[inline]
fn weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (-t2 + t3),
    ]
}
