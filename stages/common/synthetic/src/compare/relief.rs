//! How much of the relief is there, by wavelength: bands of two normal fields beside each other.
//!
//! A band is the difference of two masked Gaussian means of a normal field, of standard deviations
//! `s` and `2s` pixels; wavelengths about `2πs` pass it best. Over the pixels whose disc of radius
//! `2s` lies on the object and off depth edges,
//!
//! `corr = ⟨t, e⟩ / (|t| |e|)`, `gain = ⟨t, e⟩ / |t|²`
//!
//! of the true band `t` and the found one `e`. An estimate that is best in the mean square has
//! `gain = corr²`: with less it is smoother than its data allow, with more it carries noise.
//! Between two independent estimates instead of truth and estimate, the correlation shows what both
//! resolve (van Heel and Schatz 2005).

use super::edges::{depth_edges, widened};
use super::truth::is_depth;
use rayon::prelude::*;
use rilievo_scene::{DepthMap, NormalMap, Raster};
use serde::Serialize;

/// Bands, an octave each; the first has `s` = 0.75 px.
const NUM_BANDS: usize = 6;
const FIRST_SIGMA_PX: f64 = 0.75;
/// Bands that are taken at full resolution; for each further one the fields are halved.
const NUM_FULL: usize = 3;
/// Pixels under which a band says nothing.
const MIN_PIXELS: usize = 100;

/// Sums over the pixels of one band.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BandSums {
    /// `|t|²`.
    pub reference: f64,
    /// `|e|²`.
    pub found: f64,
    /// `⟨t, e⟩`.
    pub both: f64,
    /// Pixels of the full resolution.
    pub num_px: usize,
    /// Sum of a pixel's size on the surface, the depth's unit, over those with a depth.
    pub footprints: f64,
    /// Pixels with a depth.
    pub num_footprints: usize,
}

impl BandSums {
    /// Adds another view's.
    pub fn add(&mut self, other: &Self) {
        self.reference += other.reference;
        self.found += other.found;
        self.both += other.both;
        self.num_px += other.num_px;
        self.footprints += other.footprints;
        self.num_footprints += other.num_footprints;
    }
}

/// One band of the relief.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReliefBand {
    /// Wavelength that passes best, pixels.
    pub wavelength_px: f64,
    /// The same on the surface, truth's unit; `None` without true depth.
    pub wavelength: Option<f64>,
    /// Root mean square of the true relief, degrees.
    pub true_rms_deg: f64,
    /// Correlation of true and found relief; `None` where one of them is flat.
    pub correlation: Option<f64>,
    /// Found over true relief, along the true one.
    pub gain: Option<f64>,
    /// Pixels that were compared.
    pub num_px: usize,
}

/// Bands from their sums; those with too few pixels are left out.
pub fn relief_bands(sums: &[BandSums]) -> Vec<ReliefBand> {
    sums.iter()
        .enumerate()
        .filter(|(_, sums)| sums.num_px >= MIN_PIXELS)
        .map(|(band, sums)| {
            let sigma_px = FIRST_SIGMA_PX * f64::from(1_u32 << band);
            let wavelength_px = std::f64::consts::TAU * sigma_px;
            let num = sums.num_px as f64;
            let size = (sums.reference * sums.found).sqrt();
            ReliefBand {
                wavelength_px,
                wavelength: (sums.num_footprints > 0)
                    .then(|| wavelength_px * sums.footprints / sums.num_footprints as f64),
                true_rms_deg: (sums.reference / num).sqrt().to_degrees(),
                correlation: (size > 0.0).then(|| sums.both / size),
                gain: (sums.reference > 0.0).then(|| sums.both / sums.reference),
                num_px: sums.num_px,
            }
        })
        .collect()
}

/// Sums of all bands of one view.
///
/// `depth` (the reference's, any unit; 0 is unknown) determines edges and, with `focal_px`, the
/// size of a pixel; without it only the border of the known normals is kept away from. All maps
/// have one size.
pub fn relief_sums(
    found: &NormalMap,
    reference: &NormalMap,
    depth: Option<&DepthMap>,
    focal_px: f64,
) -> Vec<BandSums> {
    let Some(window) = Window::around(reference) else {
        return vec![BandSums::default(); NUM_BANDS];
    };
    let mut fields = [
        window.field(reference, reference),
        window.field(found, reference),
    ];
    let mut blocked = window.blocked(&fields[1], depth);
    let footprints = depth.map(|depth| window.footprints(depth, focal_px));
    let mut step = 1;
    (0..NUM_BANDS)
        .map(|band| {
            if band >= NUM_FULL {
                fields = [fields[0].halved(), fields[1].halved()];
                blocked = halved(&blocked);
                step *= 2;
            }
            let sigma = (FIRST_SIGMA_PX * f64::from(1_u32 << band.min(NUM_FULL - 1))) as f32;
            let radius = (2.0 * sigma).max(1.5);
            let off = widened(&blocked, radius, true);
            let [reference, found] = [&fields[0], &fields[1]].map(|field| field.band(sigma));
            let mut sums = BandSums::default();
            for (i, (t, e)) in reference.iter().zip(&found).enumerate() {
                if off.data[i] {
                    continue;
                }
                let dot = |a: &[f32; 3], b: &[f32; 3]| -> f64 {
                    a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum()
                };
                let num = (step * step) as f64;
                sums.reference += num * dot(t, t);
                sums.found += num * dot(e, e);
                sums.both += num * dot(t, e);
                sums.num_px += step * step;
                let (x, y) = (i % off.width * step, i / off.width * step);
                let footprint = footprints.as_ref().map_or(0.0, |f| *f.at(x, y));
                if footprint > 0.0 {
                    sums.footprints += num * f64::from(footprint);
                    sums.num_footprints += step * step;
                }
            }
            sums
        })
        .collect()
}

/// The part of a map that holds normals.
struct Window {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl Window {
    fn around(normals: &NormalMap) -> Option<Self> {
        let [[left, right], [top, bottom]] = normals.bounds(is_known)?;
        Some(Self {
            x: left,
            y: top,
            width: right + 1 - left,
            height: bottom + 1 - top,
        })
    }

    /// Normals where both maps know them.
    fn field(&self, normals: &NormalMap, other: &NormalMap) -> Field {
        Field(Raster::from_fn(self.width, self.height, |x, y| {
            let (x, y) = (x + self.x, y + self.y);
            let n = normals.at(x, y);
            if is_known(n) && is_known(other.at(x, y)) {
                // Maps of 16-bit floats are of unit length to three digits only.
                let inverse = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
                [n[0] * inverse, n[1] * inverse, n[2] * inverse, 1.0]
            } else {
                [0.0; 4]
            }
        }))
    }

    /// Pixels that no disc may touch: without both normals, or beside a depth edge.
    fn blocked(&self, found: &Field, depth: Option<&DepthMap>) -> Raster<bool> {
        let mut blocked =
            Raster::from_fn(self.width, self.height, |x, y| found.0.at(x, y)[3] <= 0.0);
        let Some(depth) = depth else {
            return blocked;
        };
        let inside = DepthMap::from_fn(self.width, self.height, |x, y| {
            *depth.at(x + self.x, y + self.y)
        });
        for (blocked, edge) in blocked.data.iter_mut().zip(&depth_edges(&inside).data) {
            *blocked |= edge;
        }
        blocked
    }

    fn footprints(&self, depth: &DepthMap, focal_px: f64) -> Raster<f32> {
        Raster::from_fn(self.width, self.height, |x, y| {
            let z = *depth.at(x + self.x, y + self.y);
            if is_depth(z) {
                z / focal_px as f32
            } else {
                0.0
            }
        })
    }
}

fn is_known(n: &[f32; 3]) -> bool {
    n.iter().all(|v| v.is_finite()) && n.iter().any(|&v| v != 0.0)
}

/// Three components times a weight, and the weight.
struct Field(Raster<[f32; 4]>);

impl Field {
    /// Mean over a Gaussian less that over one of twice its width; zero where there is no weight
    /// near.
    fn band(&self, sigma: f32) -> Vec<[f32; 3]> {
        let (narrow, wide) = (self.mean(sigma), self.mean(2.0 * sigma));
        narrow
            .iter()
            .zip(&wide)
            .map(|(a, b)| std::array::from_fn(|k| a[k] - b[k]))
            .collect()
    }

    fn mean(&self, sigma: f32) -> Vec<[f32; 3]> {
        let Raster { width, height, .. } = self.0;
        let radius = (3.5 * sigma).ceil() as usize;
        let kernel: Vec<f32> = (0..=radius)
            .map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp())
            .collect();
        let taps = |at: usize, length: usize| {
            let low = at.saturating_sub(radius);
            (low..length.min(at + radius + 1)).map(move |k| (k, k.abs_diff(at)))
        };
        let mut rows = vec![[0.0_f32; 4]; width * height];
        rows.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let from = &self.0.data[y * width..(y + 1) * width];
            for (x, out) in row.iter_mut().enumerate() {
                for (k, distance) in taps(x, width) {
                    for (o, v) in out.iter_mut().zip(&from[k]) {
                        *o += kernel[distance] * v;
                    }
                }
            }
        });
        let mut means = vec![[0.0_f32; 3]; width * height];
        means
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(y, row)| {
                let mut sums = vec![[0.0_f32; 4]; width];
                for (k, distance) in taps(y, height) {
                    for (sum, from) in sums.iter_mut().zip(&rows[k * width..(k + 1) * width]) {
                        for (s, v) in sum.iter_mut().zip(from) {
                            *s += kernel[distance] * v;
                        }
                    }
                }
                for (out, sum) in row.iter_mut().zip(&sums) {
                    if sum[3] > 0.0 {
                        *out = std::array::from_fn(|k| sum[k] / sum[3]);
                    }
                }
            });
        means
    }

    /// Sums of blocks of 2×2 pixels.
    fn halved(&self) -> Self {
        let raster = &self.0;
        Self(Raster::from_fn(
            raster.width.div_ceil(2),
            raster.height.div_ceil(2),
            |x, y| {
                let mut sum = [0.0; 4];
                for v in block(raster, x, y) {
                    for (s, v) in sum.iter_mut().zip(v) {
                        *s += v;
                    }
                }
                sum
            },
        ))
    }
}

/// The pixels of a block of 2×2 that lie in the raster.
fn block<T>(raster: &Raster<T>, x: usize, y: usize) -> impl Iterator<Item = &T> {
    [(0, 0), (1, 0), (0, 1), (1, 1)]
        .into_iter()
        .map(move |(dx, dy)| (2 * x + dx, 2 * y + dy))
        .filter(|&(x, y)| x < raster.width && y < raster.height)
        .map(|(x, y)| raster.at(x, y))
}

fn halved(blocked: &Raster<bool>) -> Raster<bool> {
    Raster::from_fn(
        blocked.width.div_ceil(2),
        blocked.height.div_ceil(2),
        |x, y| block(blocked, x, y).any(|&b| b) || block(blocked, x, y).count() < 4,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;

    const SIZE: usize = 240;

    /// A frontal plane with waves of `amplitude` radians and `wavelength` pixels along `x`.
    fn waves(amplitude: f32, wavelength: f32) -> NormalMap {
        Raster::from_fn(SIZE, SIZE, |x, _| {
            let slope = amplitude * (std::f32::consts::TAU * x as f32 / wavelength).sin();
            let length = (1.0 + slope * slope).sqrt();
            [slope / length, 0.0, -1.0 / length]
        })
    }

    fn flat_depth() -> DepthMap {
        Raster::filled(SIZE, SIZE, 0.5)
    }

    fn bands(found: &NormalMap, truth: &NormalMap) -> Vec<ReliefBand> {
        relief_bands(&relief_sums(found, truth, Some(&flat_depth()), 1000.0))
    }

    #[test]
    fn the_truth_itself_has_all_relief_at_every_wavelength() {
        let truth = waves(0.05, 20.0);
        let bands = bands(&truth, &truth);
        assert_eq!(bands.len(), NUM_BANDS);
        for band in bands {
            assert!((band.correlation.unwrap() - 1.0).abs() < 1e-9, "{band:?}");
            assert!((band.gain.unwrap() - 1.0).abs() < 1e-9, "{band:?}");
            let footprint = 0.5 / 1000.0;
            let expected = band.wavelength_px * footprint;
            assert!(
                (band.wavelength.unwrap() / expected - 1.0).abs() < 1e-5,
                "{band:?}"
            );
        }
    }

    #[test]
    fn waves_stand_in_the_band_of_their_wavelength_and_their_height_is_the_gain() {
        for (wavelength, expected) in [(9.4, 1), (18.8, 2), (37.7, 3), (75.4, 4)] {
            let truth = waves(0.05, wavelength);
            let found = waves(0.02, wavelength);
            let bands = bands(&found, &truth);
            let strongest = bands
                .iter()
                .enumerate()
                .max_by(|a, b| a.1.true_rms_deg.total_cmp(&b.1.true_rms_deg))
                .unwrap();
            assert_eq!(strongest.0, expected, "{wavelength} px: {bands:?}");
            let band = strongest.1;
            assert!(band.correlation.unwrap() > 0.999, "{band:?}");
            assert!((band.gain.unwrap() - 0.4).abs() < 0.005, "{band:?}");
            // The difference of Gaussians passes exp(-1/2) - exp(-2) at its own wavelength.
            let passed = (-0.5_f64).exp() - (-2.0_f64).exp();
            let rms_deg = (0.05 * passed / 2.0_f64.sqrt()).to_degrees();
            assert!(
                (band.true_rms_deg / rms_deg - 1.0).abs() < 0.06,
                "{band:?} {rms_deg}"
            );
        }
    }

    #[test]
    fn noise_as_strong_as_the_relief_halves_the_correlation_squared() {
        let mut random = Random(5);
        let mut next = || random.normal() as f32;
        let truth = Raster::from_fn(SIZE, SIZE, |_, _| [0.03 * next(), 0.03 * next(), -1.0]);
        let found = truth.clone();
        let found = Raster::from_fn(SIZE, SIZE, |x, y| {
            let [a, b, c] = *found.at(x, y);
            [a + 0.03 * next(), b + 0.03 * next(), c]
        });
        for band in &bands(&found, &truth)[..3] {
            assert!(
                (band.correlation.unwrap() - 0.5_f64.sqrt()).abs() < 0.03,
                "{band:?}"
            );
            assert!((band.gain.unwrap() - 1.0).abs() < 0.05, "{band:?}");
        }
        let other = Raster::from_fn(SIZE, SIZE, |_, _| [0.03 * next(), 0.03 * next(), -1.0]);
        assert!(bands(&other, &truth)[0].correlation.unwrap().abs() < 0.03);
    }

    #[test]
    fn nothing_beside_edges_and_borders_is_counted() {
        let truth = waves(0.05, 20.0);
        let mut depth = flat_depth();
        let mut found = truth.clone();
        for y in 0..SIZE {
            for x in SIZE / 2..SIZE {
                *depth.at_mut(x, y) = 0.6;
            }
            // Wrong normals at the edge alone.
            for x in SIZE / 2 - 1..=SIZE / 2 {
                *found.at_mut(x, y) = [0.2, 0.0, -0.98];
            }
        }
        // A slope sets what a usual step of depth is.
        for (i, z) in depth.data.iter_mut().enumerate() {
            *z += 1e-5 * ((i % SIZE) + (i / SIZE)) as f32;
        }
        let with_edge = relief_bands(&relief_sums(&found, &truth, Some(&depth), 1000.0));
        let without = relief_bands(&relief_sums(&found, &truth, None, 1000.0));
        assert!(with_edge[0].correlation.unwrap() > 0.7, "{with_edge:?}");
        assert!(without[0].correlation.unwrap() < 0.5, "{without:?}");
        assert!(without[0].wavelength.is_none());
        let whole = SIZE * SIZE;
        assert!(with_edge[2].num_px < whole && with_edge[2].num_px > whole / 2);
    }

    #[test]
    fn maps_without_relief_or_without_pixels_say_nothing() {
        let flat = Raster::filled(SIZE, SIZE, [0.0, 0.0, -1.0]);
        let band = &bands(&flat, &flat)[0];
        assert_eq!((band.correlation, band.gain), (None, None), "{band:?}");
        let empty = Raster::filled(SIZE, SIZE, [0.0; 3]);
        assert!(bands(&flat, &empty).is_empty());
        assert!(bands(&empty, &flat).is_empty());
        let speck = Raster::from_fn(SIZE, SIZE, |x, y| {
            if x < 5 && y < 5 {
                [0.0, 0.0, -1.0]
            } else {
                [0.0; 3]
            }
        });
        assert!(bands(&speck, &speck).is_empty());
    }
}
