//! How far a mask's border lies from the object's outline in its photo.
//!
//! Over the pixels `B` of a patch of the border, with outward normals `n`, the derivative along the normal is averaged
//! with its sign, `d(t) = mean_B ∂√L/∂n (x + t n)`: the outline, which the patch follows, adds up, and texture on either
//! side cancels. Where `|d|` peaks and stands out from its median over `t` the outline is; the patch's border lies
//! `−t` beyond it.

use crate::edges::{reduced_mask, reduced_root};
use rilievo_numerics::robust::median;
use rilievo_scene::{LinearImage, Mask, Raster};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longer side of the reduced photo.
const SIDE_PX: usize = 1280;
/// How far the outline is looked for, pixels of the reduced photo: an outline's own relief lies farther in.
const REACH_PX: i32 = 14;
/// Side of a patch, pixels, and the fewest of the border in it.
const PATCH_PX: usize = 48;
const MIN_PATCH_BORDER_PX: usize = 24;
/// Peak over median from which a patch has an outline.
const CLEAR_PEAK: f64 = 3.0;
/// Fewest such patches that tell of the whole border.
const MIN_CLEAR_PATCHES: usize = 6;
/// Distance up to which a border lies on the outline, pixels of the reduced photo: what hands and JPEG miss.
const ON_OUTLINE_PX: f64 = 2.0;
/// Share of the patches that must lie alike for the mask as a whole to be larger or smaller than the object.
const ALIKE_SHARE: f64 = 0.6;
/// Radius of the disc whose masked pixels give a border pixel's normal.
const NORMAL_RADIUS_PX: i32 = 5;

/// A mask's border against the outline in its photo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaskOutline {
    /// How far most of the border lies beyond the outline, pixels of the photo, negative inside it; absent where its
    /// parts lie differently.
    pub beyond_px: Option<f64>,
    /// Share of the border that lies on the outline.
    pub share_on_outline: f64,
    /// What counts as on it, pixels of the photo.
    pub tolerance_px: f64,
}

impl MaskOutline {
    /// How far the mask reaches beyond the object all around, where it does.
    pub fn too_large_px(&self) -> Option<f64> {
        self.beyond_px.filter(|&beyond| beyond > self.tolerance_px)
    }

    /// How far it ends inside the object all around, where it does.
    pub fn too_small_px(&self) -> Option<f64> {
        let inside = self.beyond_px.map(|beyond| -beyond);
        inside.filter(|&inside| inside > self.tolerance_px)
    }
}

/// Measures it; `None` where the border is short or the photo has no edges along it.
pub(crate) fn measure(image: &LinearImage, mask: &Mask) -> Option<MaskOutline> {
    let factor = image.width.max(image.height).div_ceil(SIDE_PX).max(1);
    let mask = reduced_mask(mask, factor);
    let root = reduced_root(image, factor);
    let patches = patches(&mask);
    let distances: Vec<Option<f64>> = patches
        .values()
        .filter(|border| border.len() >= MIN_PATCH_BORDER_PX)
        .map(|border| distance_beyond(&root, &mask, border))
        .collect();
    let mut clear: Vec<f64> = distances.iter().flatten().copied().collect();
    if clear.len() < MIN_CLEAR_PATCHES || 2 * clear.len() < distances.len() {
        return None;
    }
    let middle = median(&mut clear)?;
    let share_near = |center: f64| {
        let near = clear
            .iter()
            .filter(|d| (*d - center).abs() <= ON_OUTLINE_PX);
        near.count() as f64 / clear.len() as f64
    };
    let scale = factor as f64;
    Some(MaskOutline {
        beyond_px: (share_near(middle) >= ALIKE_SHARE).then_some(scale * middle),
        share_on_outline: share_near(0.0),
        tolerance_px: scale * ON_OUTLINE_PX,
    })
}

/// The last masked pixels of every patch's border, away from the frame.
fn patches(mask: &Mask) -> BTreeMap<(usize, usize), Vec<(usize, usize)>> {
    let margin = (REACH_PX + 2) as usize;
    let mut patches: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for y in margin..mask.height.saturating_sub(margin) {
        for x in margin..mask.width.saturating_sub(margin) {
            let is_border = *mask.at(x, y)
                && [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
                    .iter()
                    .any(|&(x, y)| !*mask.at(x, y));
            if is_border {
                let patch = patches.entry((y / PATCH_PX, x / PATCH_PX));
                patch.or_default().push((x, y));
            }
        }
    }
    patches
}

/// How far a patch's border lies beyond the outline, pixels of the reduced photo; none where no outline stands out.
fn distance_beyond(root: &Raster<f32>, mask: &Mask, border: &[(usize, usize)]) -> Option<f64> {
    let mut sums = vec![0.0; 2 * REACH_PX as usize + 1];
    for &(x, y) in border {
        let Some([nx, ny]) = outward_normal(mask, x, y) else {
            continue;
        };
        let at = |t: i32| {
            let t = f64::from(t);
            bilinear(root, x as f64 + t * nx, y as f64 + t * ny)
        };
        for (sum, t) in sums.iter_mut().zip(-REACH_PX..) {
            *sum += at(t + 1) - at(t - 1);
        }
    }
    let sizes: Vec<f64> = sums.iter().map(|sum| sum.abs()).collect();
    let (peak, largest) = sizes
        .iter()
        .copied()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    if largest <= CLEAR_PEAK * median(&mut sizes.clone())? {
        return None;
    }
    // The vertex of the parabola through the peak and its neighbours.
    let fraction = match (peak.checked_sub(1).map(|k| sizes[k]), sizes.get(peak + 1)) {
        (Some(before), Some(&behind)) => {
            0.5 * (behind - before) / (2.0 * largest - before - behind).max(f64::MIN_POSITIVE)
        }
        _ => 0.0,
    };
    // The border runs half a pixel outside of its last pixels.
    Some(0.5 - (peak as f64 + fraction - f64::from(REACH_PX)))
}

/// Direction in which the mask ends; none in the middle of a thin line.
fn outward_normal(mask: &Mask, x: usize, y: usize) -> Option<[f64; 2]> {
    let (mut nx, mut ny) = (0.0, 0.0);
    let radius = NORMAL_RADIUS_PX;
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            let (u, v) = (x as i32 + dx, y as i32 + dy);
            if dx * dx + dy * dy <= radius * radius && *mask.at(u as usize, v as usize) {
                nx -= f64::from(dx);
                ny -= f64::from(dy);
            }
        }
    }
    let length = nx.hypot(ny);
    (length > 1e-9).then(|| [nx / length, ny / length])
}

fn bilinear(root: &Raster<f32>, x: f64, y: f64) -> f64 {
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let (left, top) = (left as usize, top as usize);
    let row = |y: usize| {
        (1.0 - fx) * f64::from(*root.at(left, y)) + fx * f64::from(*root.at(left + 1, y))
    };
    (1.0 - fy) * row(top) + fy * row(top + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of radius 200 on a textured ground of nearly its brightness, shaded towards its rim; the mask is a disc too.
    fn measured(radius: f64, shift: f64) -> Option<MaskOutline> {
        let (width, height) = (640, 520);
        let mut image = LinearImage::filled(width, height, 1, 0.0);
        let distance =
            |x: usize, y: usize, shift: f64| (x as f64 - 320.0 - shift).hypot(y as f64 - 260.0);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f64, y as f64);
                let texture =
                    0.06 * ((0.9 * u).sin() * (0.7 * v).cos() + (0.31 * u + 0.4 * v).sin());
                let from_center = distance(x, y, 0.0) / 200.0;
                let value = if from_center < 1.0 {
                    0.5 * (1.0 - 0.6 * from_center.powi(6)) + 0.2 * texture
                } else {
                    0.4 + texture
                };
                image.pixel_mut(x, y).fill(value as f32);
            }
        }
        let mask = Raster::from_fn(width, height, |x, y| distance(x, y, shift) < radius);
        measure(&image, &mask)
    }

    #[test]
    fn a_mask_that_is_larger_or_smaller_than_the_object_is_told_by_how_much() {
        for off in [-8.0, -4.0, 0.0, 1.0, 4.0, 8.0] {
            let found = measured(200.0 + off, 0.0).expect("an outline");
            let beyond = found.beyond_px.expect("alike all around");
            assert!((beyond - off).abs() < 0.7, "{off}: {found:?}");
            assert_eq!(found.too_large_px().is_some(), off > 2.0, "{found:?}");
            assert_eq!(found.too_small_px().is_some(), off < -2.0, "{found:?}");
            assert_eq!(found.share_on_outline > 0.9, off.abs() < 2.0, "{found:?}");
        }
    }

    #[test]
    fn a_shifted_mask_is_neither_larger_nor_smaller() {
        let found = measured(200.0, 10.0).expect("an outline");
        assert_eq!(found.beyond_px, None, "{found:?}");
        assert!(found.share_on_outline < 0.5, "{found:?}");
    }

    #[test]
    fn without_edges_or_border_nothing_is_said() {
        let flat = LinearImage::filled(160, 120, 1, 0.5);
        let disc = Raster::from_fn(160, 120, |x, y| {
            (x as f64 - 80.0).hypot(y as f64 - 60.0) < 30.0
        });
        assert_eq!(measure(&flat, &disc), None);
        assert_eq!(measure(&flat, &Raster::filled(160, 120, true)), None);
        assert_eq!(measure(&flat, &Raster::filled(20, 12, true)), None);
    }
}
