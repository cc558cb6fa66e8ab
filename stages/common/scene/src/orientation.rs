//! How a stored picture is turned to stand upright.
//!
//! Everything in this program is in the frame of the pixels as stored: photos, masks, marks,
//! cameras, maps and exports. What people draw on top of a photo is often upright, because the
//! programs that show photos turn them; it is brought back to the stored frame where it is read.
//!
//! Source: EXIF 2.32 (CIPA DC-008), tag Orientation.

use crate::raster::{Mask, Raster};
use crate::sphere::SphereMark;
use serde::{Deserialize, Serialize};

/// EXIF's orientation, 1 to 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct Orientation(u8);

impl Orientation {
    /// The stored picture stands upright.
    pub const UPRIGHT: Self = Self(1);

    /// The orientation of EXIF's number; `None` unless it is 1 to 8.
    pub fn of_exif(number: u8) -> Option<Self> {
        (1..=8).contains(&number).then_some(Self(number))
    }

    /// EXIF's number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// Whether the upright picture is as wide as the stored one is high.
    fn swaps_sides(self) -> bool {
        self.0 >= 5
    }

    /// Whether the stored picture is the scene's mirror image.
    pub fn is_mirrored(self) -> bool {
        matches!(self.0, 2 | 4 | 5 | 7)
    }

    /// Columns and rows of the upright picture.
    pub fn upright_size(self, (width, height): (usize, usize)) -> (usize, usize) {
        if self.swaps_sides() {
            (height, width)
        } else {
            (width, height)
        }
    }

    /// Direction in the stored picture, x right and y down, that is up in the upright one.
    pub fn up_in_stored(self) -> [f64; 2] {
        match self.0 {
            3 | 4 => [0.0, 1.0],
            5 | 6 => [-1.0, 0.0],
            7 | 8 => [1.0, 0.0],
            _ => [0.0, -1.0],
        }
    }

    /// Place in the stored picture, of `stored` columns and rows, of a place in the upright one.
    /// Centres of pixels have whole coordinates.
    pub fn to_stored(self, [x, y]: [f64; 2], stored: (usize, usize)) -> [f64; 2] {
        let (right, bottom) = (stored.0 as f64 - 1.0, stored.1 as f64 - 1.0);
        match self.0 {
            2 => [right - x, y],
            3 => [right - x, bottom - y],
            4 => [x, bottom - y],
            5 => [y, x],
            6 => [y, bottom - x],
            7 => [right - y, bottom - x],
            8 => [right - y, x],
            _ => [x, y],
        }
    }

    /// A raster drawn over the upright picture, in the stored picture's frame.
    pub fn raster_to_stored<T: Copy>(self, upright: &Raster<T>) -> Raster<T> {
        let (width, height) = self.upright_size((upright.width, upright.height));
        // Turns by a quarter undo each other, all others themselves.
        let to_upright = match self.0 {
            6 => Self(8),
            8 => Self(6),
            _ => self,
        };
        Raster::from_fn(width, height, |x, y| {
            let at = [x as f64, y as f64];
            let [x, y] = to_upright.to_stored(at, (upright.width, upright.height));
            *upright.at(x as usize, y as usize)
        })
    }

    /// A mask in the stored frame, of `stored` columns and rows, and whether its size shows that it
    /// was drawn over the upright picture.
    pub fn mask_by_size(self, mask: Mask, stored: (usize, usize)) -> (Mask, bool) {
        let given = (mask.width, mask.height);
        if given != stored && given == self.upright_size(stored) {
            (self.raster_to_stored(&mask), true)
        } else {
            (mask, false)
        }
    }

    /// A mark drawn over the upright picture, in the frame of the stored one, of `stored` columns
    /// and rows.
    pub fn mark_to_stored(self, upright: &SphereMark, stored: (usize, usize)) -> SphereMark {
        let place = |at: [f64; 2]| self.to_stored(at, stored);
        match upright {
            SphereMark::Mask(mask) => SphereMark::Mask(self.raster_to_stored(mask)),
            SphereMark::Circle {
                center_px,
                radius_px,
            } => SphereMark::Circle {
                center_px: place(*center_px),
                radius_px: *radius_px,
            },
            SphereMark::Ellipse {
                center_px,
                semi_axes_px,
                angle_rad,
            } => {
                let center = place(*center_px);
                let (sin, cos) = angle_rad.sin_cos();
                let tip = place([center_px[0] + cos, center_px[1] + sin]);
                SphereMark::Ellipse {
                    center_px: center,
                    semi_axes_px: *semi_axes_px,
                    angle_rad: (tip[1] - center[1]).atan2(tip[0] - center[0]),
                }
            }
            SphereMark::Points(points) => {
                SphereMark::Points(points.iter().copied().map(place).collect())
            }
        }
    }
}

impl Default for Orientation {
    fn default() -> Self {
        Self::UPRIGHT
    }
}

impl TryFrom<u8> for Orientation {
    type Error = String;

    fn try_from(number: u8) -> Result<Self, String> {
        Self::of_exif(number).ok_or_else(|| format!("{number} is none of the orientations 1 to 8"))
    }
}

impl From<Orientation> for u8 {
    fn from(orientation: Orientation) -> Self {
        orientation.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EXIF's definition: where the stored picture's first row and first column lie in the upright
    /// one.
    const FIRST_ROW_AND_COLUMN: [(&str, &str); 8] = [
        ("top", "left"),
        ("top", "right"),
        ("bottom", "right"),
        ("bottom", "left"),
        ("left", "top"),
        ("right", "top"),
        ("right", "bottom"),
        ("left", "bottom"),
    ];

    fn all() -> impl Iterator<Item = Orientation> {
        (1..=8).filter_map(Orientation::of_exif)
    }

    #[test]
    fn the_first_row_and_column_lie_where_exif_says() {
        let stored = (5, 3);
        for (orientation, (row, column)) in all().zip(FIRST_ROW_AND_COLUMN) {
            let (width, height) = orientation.upright_size(stored);
            let middle_of = |side: &str| match side {
                "top" => [(width - 1) as f64 / 2.0, 0.0],
                "bottom" => [(width - 1) as f64 / 2.0, (height - 1) as f64],
                "left" => [0.0, (height - 1) as f64 / 2.0],
                _ => [(width - 1) as f64, (height - 1) as f64 / 2.0],
            };
            let to_stored = |side| orientation.to_stored(middle_of(side), stored);
            assert_eq!(to_stored(row), [2.0, 0.0], "{orientation:?}");
            assert_eq!(to_stored(column), [0.0, 1.0], "{orientation:?}");
        }
    }

    #[test]
    fn rasters_and_places_turn_alike_and_up_is_up() {
        let stored = (5, 3);
        for orientation in all() {
            let (width, height) = orientation.upright_size(stored);
            let upright = Raster::from_fn(width, height, |x, y| (x, y));
            let back = orientation.raster_to_stored(&upright);
            assert_eq!((back.width, back.height), stored);
            for (x, y) in upright.data.iter().copied() {
                let [sx, sy] = orientation.to_stored([x as f64, y as f64], stored);
                assert_eq!(
                    *back.at(sx as usize, sy as usize),
                    (x, y),
                    "{orientation:?}"
                );
            }
            let lower = orientation.to_stored([1.0, 1.0], stored);
            let upper = orientation.to_stored([1.0, 0.0], stored);
            let up = [upper[0] - lower[0], upper[1] - lower[1]];
            assert_eq!(up, orientation.up_in_stored(), "{orientation:?}");
            let right = orientation.to_stored([2.0, 1.0], stored);
            let right = [right[0] - lower[0], right[1] - lower[1]];
            let handed = right[0] * up[1] - right[1] * up[0];
            assert_eq!(orientation.is_mirrored(), handed > 0.0, "{orientation:?}");
        }
        assert_eq!(Orientation::of_exif(0), None);
        assert_eq!(Orientation::of_exif(9), None);
    }

    #[test]
    fn ellipses_turn_with_their_outlines() {
        let stored = (40, 30);
        let (center, [a, b], angle) = ([14.0, 11.0], [6.0, 3.0], 0.4f64);
        let rim = |center: [f64; 2], angle: f64, t: f64| {
            let (x, y) = (a * t.cos(), b * t.sin());
            [
                center[0] + angle.cos() * x - angle.sin() * y,
                center[1] + angle.sin() * x + angle.cos() * y,
            ]
        };
        let mark = SphereMark::Ellipse {
            center_px: center,
            semi_axes_px: [a, b],
            angle_rad: angle,
        };
        for orientation in all() {
            let SphereMark::Ellipse {
                center_px,
                angle_rad,
                ..
            } = orientation.mark_to_stored(&mark, stored)
            else {
                panic!("an ellipse stays one");
            };
            for t in [0.0, 0.7, 2.0] {
                let [x, y] = orientation.to_stored(rim(center, angle, t), stored);
                let (dx, dy) = (x - center_px[0], y - center_px[1]);
                let along = (angle_rad.cos() * dx + angle_rad.sin() * dy) / a;
                let across = (angle_rad.cos() * dy - angle_rad.sin() * dx) / b;
                assert!((along.hypot(across) - 1.0).abs() < 1e-12, "{orientation:?}");
            }
        }
    }
}
