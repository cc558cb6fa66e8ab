//! How far a mask's border lies from the object's outline in its photo.
//!
//! Over the pixels `B` of a patch of the border, with outward normals `n`, the derivative along the normal is averaged
//! with its sign, `d(t) = mean_B ∂√L/∂n (x + t n)`: the outline, which the patch follows, adds up, and texture on either
//! side cancels. Where `|d|` peaks and stands out from its median over `t` the outline is, at the peak nearest the border if
//! there is one beside it, else at the largest; the patch's border lies `−t` beyond it.

use crate::edges::{reduced_mask, reduced_root};
use rilievo_numerics::robust::median;
use rilievo_scene::{LinearImage, Mask, Raster, bilinear};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Least longer side of a reduced photo.
const SIDE_PX: usize = 1280;
/// How far the outline is looked for, pixels of the reduced photo.
const REACH_PX: i32 = 14;
/// Side of a patch, pixels, and the fewest of the border in it.
const PATCH_PX: usize = 48;
const MIN_PATCH_BORDER_PX: usize = 24;
/// Peak over median from which a patch has an outline.
const CLEAR_PEAK: f64 = 3.0;
/// Fewest such patches that stand for the whole border.
const MIN_CLEAR_PATCHES: usize = 6;
/// Distance up to which a border lies on the outline, pixels of the reduced photo: what hands and JPEG miss.
const ON_OUTLINE_PX: f64 = 2.5;
/// Share of the patches that must lie alike for the mask as a whole to be larger or smaller than the object.
const ALIKE_SHARE: f64 = 0.6;
/// Radius of the disc whose masked pixels give a border pixel's normal.
const NORMAL_RADIUS_PX: i32 = 5;

/// Times [`MaskOutline::tolerance_px`] from which background in the mask harms the surface well inside, too: normals
/// err there by a twentieth more at 6 pixels of a reduced photo, and by nothing up to 3 (`benches/EXPERIMENTS.md`).
const HARMFUL: f64 = 2.0;

/// Where a mask's border lies against the outline in its photo, if most of it lies alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaskOutline {
    /// How far most of the border lies beyond the outline, pixels of the photo, negative inside it.
    pub beyond_px: f64,
    /// Share of the border that lies on the outline.
    pub share_on_outline: f64,
    /// What counts as on it, pixels of the photo.
    pub tolerance_px: f64,
}

impl MaskOutline {
    /// Whether most of the border lies off the outline.
    pub fn is_apart(&self) -> bool {
        self.beyond_px.abs() > self.tolerance_px
    }

    /// Whether the mask takes in what stands behind the object.
    pub fn is_too_large(&self) -> bool {
        self.is_apart() && self.beyond_px > 0.0
    }

    /// Whether it takes in so much that the surface inside suffers.
    pub fn is_harmful(&self) -> bool {
        self.beyond_px > HARMFUL * self.tolerance_px
    }

    /// Whether it leaves out the object's rim.
    pub fn is_too_small(&self) -> bool {
        self.is_apart() && self.beyond_px < 0.0
    }
}

/// Measures it; `None` where the border is short, the photo has no edges along it, or its parts lie differently.
pub(crate) fn measure(image: &LinearImage, mask: &Mask) -> Option<MaskOutline> {
    let factor = (image.width.max(image.height) / SIDE_PX).max(1);
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
    (share_near(middle) >= ALIKE_SHARE).then(|| MaskOutline {
        beyond_px: scale * middle,
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
            let size = (root.width, root.height);
            bilinear(size, x as f64 + t * nx, y as f64 + t * ny, |k| root.data[k])
        };
        for (sum, t) in sums.iter_mut().zip(-REACH_PX..) {
            *sum += f64::from(at(t + 1)? - at(t - 1)?);
        }
    }
    let sizes: Vec<f64> = sums.iter().map(|sum| sum.abs()).collect();
    let least = CLEAR_PEAK * median(&mut sizes.clone())?;
    let peaks = (1..sizes.len() - 1)
        .filter(|&k| sizes[k] > least && sizes[k] >= sizes[k - 1] && sizes[k] > sizes[k + 1]);
    // At the vertex of the parabola through a peak and its neighbours; the border runs half a pixel outside of its last
    // pixels.
    let beyond = |k: usize| {
        let (before, peak, behind) = (sizes[k - 1], sizes[k], sizes[k + 1]);
        let fraction = 0.5 * (behind - before) / (2.0 * peak - before - behind);
        0.5 + f64::from(REACH_PX) - (k as f64 + fraction)
    };
    let found: Vec<(f64, f64)> = peaks.map(|k| (beyond(k), sizes[k])).collect();
    let nearest = found
        .iter()
        .min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
    if nearest.0.abs() <= ON_OUTLINE_PX {
        return Some(nearest.0);
    }
    // A flank that still rises where the search ends is no peak, and may hide a higher one.
    let largest = found.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let ends = sizes[0].max(sizes[sizes.len() - 1]);
    (largest.1 > ends).then_some(largest.0)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of radius 200 on a textured ground of nearly its brightness, shaded towards its rim, with a ring of a
    /// factor `ring` of the brightness up to `ring_px` beyond the outline, or inside it; the mask is a disc too.
    fn measured(radius: f64, shift: f64, ring_px: f64, ring: f64) -> Option<MaskOutline> {
        let (width, height) = (640, 520);
        let mut image = LinearImage::filled(width, height, 1, 0.0);
        let distance =
            |x: usize, y: usize, shift: f64| (x as f64 - 320.0 - shift).hypot(y as f64 - 260.0);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f64, y as f64);
                let texture =
                    0.06 * ((0.9 * u).sin() * (0.7 * v).cos() + (0.31 * u + 0.4 * v).sin());
                let from_center = distance(x, y, 0.0);
                let value = if from_center < 200.0 {
                    0.5 * (1.0 - 0.6 * (from_center / 200.0).powi(6)) + 0.2 * texture
                } else {
                    0.4 + texture
                };
                let beyond = from_center - 200.0;
                let is_ring = beyond * ring_px > 0.0 && beyond.abs() < ring_px.abs();
                let value = if is_ring { ring * value } else { value };
                image.pixel_mut(x, y).fill(value as f32);
            }
        }
        let mask = Raster::from_fn(width, height, |x, y| distance(x, y, shift) < radius);
        measure(&image, &mask)
    }

    #[test]
    fn a_mask_that_is_larger_or_smaller_than_the_object_is_told_by_how_much() {
        for off in [-8.0, -4.0, 0.0, 1.0, 4.0, 8.0] {
            let found = measured(200.0 + off, 0.0, 0.0, 1.0).expect("an outline");
            assert!((found.beyond_px - off).abs() < 0.7, "{off}: {found:?}");
            assert_eq!(found.is_too_large(), off > 3.0, "{found:?}");
            assert_eq!(found.is_harmful(), off > 5.0, "{found:?}");
            assert_eq!(found.is_too_small(), off < -3.0, "{found:?}");
            assert_eq!(found.share_on_outline > 0.9, off.abs() < 2.0, "{found:?}");
        }
    }

    #[test]
    fn an_exact_mask_is_right_beside_a_shadow_or_a_band_of_more_contrast() {
        for (ring_px, ring) in [(8.0, 0.4), (-8.0, 0.3), (-5.0, 2.6)] {
            let found = measured(200.0, 0.0, ring_px, ring).expect("an outline");
            assert!(found.beyond_px.abs() < 1.0, "{ring_px} {ring}: {found:?}");
        }
    }

    #[test]
    fn a_shifted_mask_is_neither_larger_nor_smaller_and_one_beyond_reach_is_not_measured() {
        assert_eq!(measured(200.0, 10.0, 0.0, 1.0), None);
        assert_eq!(measured(222.0, 0.0, 0.0, 1.0), None);
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
