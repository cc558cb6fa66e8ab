//! What relief is resolved where there is no truth: two halves of the photos, each shaped alone.
//!
//! What both halves find alike is the surface, as far as they share no error; what they find
//! differently is noise. The wavelength at which the correlation of their normals falls to one half
//! is called resolved (van Heel and Schatz 2005). Errors that both share, of the light or of
//! pigment that is taken for relief, count as relief: the correlation with the truth is lower. So
//! no estimate of that is made of it, as for halves with independent errors alone.

use super::relief::{BandSums, relief_bands, relief_sums};
use nalgebra::{Point2, Vector3};
use rayon::prelude::*;
use rilievo_scene::{NormalMap, PosedView, PosedViews, Raster, ShadedView, ShadedViews};
use serde::Serialize;

/// Correlation of the halves at which relief counts as resolved.
pub const RESOLVED_CORRELATION: f64 = 0.5;
/// Distance of both halves' surfaces along the line of sight, pixel footprints, up to which they
/// show the same place.
const MAX_APART_PX: f64 = 8.0;
/// Difference of depth between neighbours, pixel footprints, beyond which they belong to different
/// surfaces.
const MAX_STEP_PX: f64 = 8.0;

/// One half: its views, and what was found of them.
#[derive(Clone, Copy, Debug)]
pub struct Half<'a> {
    /// Cameras.
    pub posed: &'a PosedViews,
    /// Maps, in any order.
    pub shaded: &'a ShadedViews,
}

impl Half<'_> {
    fn views(&self) -> impl Iterator<Item = (&PosedView, &ShadedView)> {
        let maps = self.shaded.views.iter();
        maps.filter_map(|maps| Some((self.posed.views.get(maps.view.0)?, maps)))
    }
}

/// One band of wavelengths.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalvesBand {
    /// Wavelength that passes best, pixels.
    pub wavelength_px: f64,
    /// The same on the surface, the poses' unit.
    pub wavelength: Option<f64>,
    /// Root mean square of the relief that the halves found, degrees.
    pub rms_deg: f64,
    /// Correlation of the halves; `None` where one of them is flat.
    pub correlation: Option<f64>,
    /// Pixels that were compared.
    pub num_px: usize,
}

/// The shortest wavelength down to which the halves agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Resolved {
    /// All bands that were compared, the shortest of this wavelength, are resolved.
    AllBands {
        /// Pixels.
        wavelength_px: f64,
        /// The poses' unit.
        wavelength: Option<f64>,
    },
    /// Down to this wavelength.
    DownTo {
        /// Pixels.
        wavelength_px: f64,
        /// The poses' unit.
        wavelength: Option<f64>,
    },
    /// Not even the longest one, or nothing could be compared.
    None,
}

/// The agreement of two halves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalvesComparison {
    /// From short to long wavelengths; those with too few pixels are left out.
    pub relief: Vec<HalvesBand>,
    /// Down to where the halves agree.
    pub resolved: Resolved,
}

/// Compares the normals of two halves in every view of either, where both show the same place.
pub fn compare_halves(first: &Half<'_>, second: &Half<'_>) -> HalvesComparison {
    let mut all: Vec<BandSums> = Vec::new();
    for (own, other) in [(first, second), (second, first)] {
        for (view, maps) in own.views() {
            let seen = seen_from(view, maps, other);
            let focal_px = view.intrinsics.focal_px();
            // Both fields know the same pixels, so that means beside a border are over the same
            // ones.
            let own = Raster::from_fn(seen.width, seen.height, |x, y| {
                let is_seen = *seen.at(x, y) != [0.0; 3];
                if is_seen {
                    *maps.normal.at(x, y)
                } else {
                    [0.0; 3]
                }
            });
            let sums = relief_sums(&seen, &own, Some(&maps.depth), focal_px);
            if all.is_empty() {
                all = sums;
            } else {
                all.iter_mut().zip(&sums).for_each(|(all, of)| all.add(of));
            }
        }
    }
    let relief: Vec<HalvesBand> = relief_bands(&all)
        .into_iter()
        .map(|band| HalvesBand {
            wavelength_px: band.wavelength_px,
            wavelength: band.wavelength,
            rms_deg: band.true_rms_deg,
            correlation: band.correlation,
            num_px: band.num_px,
        })
        .collect();
    HalvesComparison {
        resolved: resolved(&relief),
        relief,
    }
}

/// From long to short wavelengths, where the correlation first falls to [`RESOLVED_CORRELATION`]:
/// linear in the logarithm of the wavelength.
fn resolved(bands: &[HalvesBand]) -> Resolved {
    let mut longer: Option<(&HalvesBand, f64)> = None;
    for band in bands.iter().rev() {
        // A band in which one half is flat is none that both resolve.
        let correlation = band.correlation.unwrap_or(0.0);
        if correlation < RESOLVED_CORRELATION {
            let Some((longer, above)) = longer else {
                return Resolved::None;
            };
            let share = (above - RESOLVED_CORRELATION) / (above - correlation);
            let between = |from: f64, to: f64| from * (to / from).powf(share);
            return Resolved::DownTo {
                wavelength_px: between(longer.wavelength_px, band.wavelength_px),
                wavelength: longer
                    .wavelength
                    .zip(band.wavelength)
                    .map(|(from, to)| between(from, to)),
            };
        }
        longer = Some((band, correlation));
    }
    longer.map_or(Resolved::None, |(band, _)| Resolved::AllBands {
        wavelength_px: band.wavelength_px,
        wavelength: band.wavelength,
    })
}

/// The other half's normals in the frame and at the pixels of a view: the mean over those of its
/// views that show the same place, each weighed with the squared cosine at which it sees it. Zero
/// where none does.
fn seen_from(view: &PosedView, maps: &ShadedView, other: &Half<'_>) -> NormalMap {
    let (width, height) = (maps.depth.width, maps.depth.height);
    let world_from_cam = view.cam_from_world.inverse();
    let rotation = view.cam_from_world.rotation_matrix();
    let others: Vec<_> = other
        .views()
        .map(|(posed, maps)| {
            (
                posed,
                maps,
                rotation * posed.cam_from_world.rotation_matrix().transpose(),
            )
        })
        .collect();
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|y| {
            (0..width)
                .map(|x| {
                    let depth = f64::from(*maps.depth.at(x, y));
                    if depth.is_nan() || depth <= 0.0 {
                        return [0.0; 3];
                    }
                    let pixel = Point2::new(x as f64, y as f64);
                    let point = world_from_cam.apply(&view.intrinsics.unproject(&pixel, depth));
                    let mut sum = Vector3::zeros();
                    for (posed, maps, here_from_there) in &others {
                        let there = posed.cam_from_world.apply(&point);
                        let Some(place) = posed.intrinsics.project(&there) else {
                            continue;
                        };
                        let footprint = 1.0 / posed.intrinsics.focal_px();
                        let Some((zeta, normal)) = at(maps, place, MAX_STEP_PX * footprint) else {
                            continue;
                        };
                        if (there.z.ln() - zeta).abs() > MAX_APART_PX * footprint {
                            continue;
                        }
                        let cosine = -there.coords.normalize().dot(&normal);
                        if cosine > 0.0 {
                            sum += here_from_there * normal * (cosine * cosine);
                        }
                    }
                    let length = sum.norm();
                    if length > 0.0 {
                        [0, 1, 2].map(|k| (sum[k] / length) as f32)
                    } else {
                        [0.0; 3]
                    }
                })
                .collect()
        })
        .collect();
    Raster {
        width,
        height,
        data: rows.concat(),
    }
}

/// Log depth and unit normal between four pixels of one surface.
fn at(maps: &ShadedView, place: Point2<f64>, max_step: f64) -> Option<(f64, Vector3<f64>)> {
    let (width, height) = (maps.depth.width, maps.depth.height);
    let is_inside = |v: f64, count: usize| v >= 0.0 && v < count.saturating_sub(1) as f64;
    if !is_inside(place.x, width) || !is_inside(place.y, height) {
        return None;
    }
    let (x, y) = (place.x as usize, place.y as usize);
    let (a, b) = (place.x - x as f64, place.y - y as f64);
    let (mut zeta, mut normal) = (0.0, Vector3::zeros());
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (dx, dy, weight) in [
        (0, 0, (1.0 - a) * (1.0 - b)),
        (1, 0, a * (1.0 - b)),
        (0, 1, (1.0 - a) * b),
        (1, 1, a * b),
    ] {
        let depth = f64::from(*maps.depth.at(x + dx, y + dy));
        let n = maps.normal.normal(x + dx, y + dy)?;
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let log = depth.ln();
        (low, high) = (f64::min(low, log), f64::max(high, log));
        zeta += weight * log;
        normal += weight * n;
    }
    (high - low <= max_step).then_some(())?;
    Some((zeta, normal.try_normalize(1e-6)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;
    use rilievo_scene::{Intrinsics, PhotoIdx, RigidTransform, ViewIdx};

    const SIZE: usize = 200;
    const FOCAL: f64 = 400.0;

    fn posed(offsets: &[f64]) -> PosedViews {
        let view = |(k, x): (usize, &f64)| {
            let mut pose = RigidTransform::identity();
            pose.translation.x = -x;
            let middle = 0.5 * (SIZE as f64 - 1.0);
            PosedView {
                photo: PhotoIdx(k),
                name: format!("v{k}"),
                file_name: format!("v{k}.png"),
                intrinsics: Intrinsics::pinhole(SIZE, SIZE, FOCAL, middle, middle),
                cam_from_world: pose,
            }
        };
        PosedViews {
            views: offsets.iter().enumerate().map(view).collect(),
            ..PosedViews::default()
        }
    }

    /// A plane at depth 1 with waves of 20, 75 and 150 pixels, and noise of the normals.
    fn shaded(offsets: &[f64], noise: f64, seed: u64) -> ShadedViews {
        let mut random = Random(seed);
        let view = |(k, offset): (usize, &f64)| {
            let normal = Raster::from_fn(SIZE, SIZE, |x, _| {
                let place = x as f64 + offset * FOCAL;
                let wave = |length: f64| 0.05 * (std::f64::consts::TAU * place / length).sin();
                let slope = wave(20.0) + wave(75.0) + wave(150.0);
                let n = Vector3::new(
                    slope + noise * random.normal(),
                    noise * random.normal(),
                    -1.0,
                )
                .normalize();
                [n.x as f32, n.y as f32, n.z as f32]
            });
            ShadedView {
                view: ViewIdx(k),
                name: format!("v{k}"),
                depth: Raster::filled(SIZE, SIZE, 1.0),
                normal,
                confidence: None,
                rendered: None,
                albedo: None,
            }
        };
        ShadedViews {
            views: offsets.iter().enumerate().map(view).collect(),
        }
    }

    fn compared(noise: f64) -> HalvesComparison {
        // Baselines of whole pixels, so that nothing is interpolated.
        let (left, right) = ([0.0, 4.0 / FOCAL], [2.0 / FOCAL]);
        compare_halves(
            &Half {
                posed: &posed(&left),
                shaded: &shaded(&left, noise, 3),
            },
            &Half {
                posed: &posed(&right),
                shaded: &shaded(&right, noise, 4),
            },
        )
    }

    #[test]
    fn halves_that_find_the_same_agree_at_every_wavelength() {
        let found = compared(0.0);
        for band in &found.relief {
            assert!(band.correlation.unwrap() > 0.9999, "{band:?}");
        }
        let Resolved::AllBands {
            wavelength_px,
            wavelength,
        } = found.resolved
        else {
            panic!("{:?}", found.resolved)
        };
        assert!((wavelength_px - 4.7).abs() < 0.1);
        assert!((wavelength.unwrap() - wavelength_px / FOCAL).abs() < 1e-6);
    }

    #[test]
    fn noise_is_no_relief_and_waves_are_resolved() {
        let found = compared(0.02);
        assert!(found.relief[0].correlation.unwrap() < 0.3, "{found:?}");
        assert!(found.relief[2].correlation.unwrap() > 0.9, "{found:?}");
        let Resolved::DownTo { wavelength_px, .. } = found.resolved else {
            panic!("{found:?}")
        };
        assert!((4.7..19.0).contains(&wavelength_px), "{wavelength_px}");
    }

    #[test]
    fn the_wavelength_is_interpolated_where_the_correlation_falls_to_a_half() {
        let band = |k: i32, correlation: Option<f64>| HalvesBand {
            wavelength_px: 4.0 * 2.0_f64.powi(k),
            wavelength: None,
            rms_deg: 1.0,
            correlation,
            num_px: 1000,
        };
        let bands = [band(0, Some(0.1)), band(1, Some(0.3)), band(2, Some(0.7))];
        let Resolved::DownTo { wavelength_px, .. } = resolved(&bands) else {
            panic!("{:?}", resolved(&bands))
        };
        assert!((wavelength_px - 8.0 * 2.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(resolved(&bands[..2]), Resolved::None);
        assert_eq!(resolved(&[]), Resolved::None);
        assert_eq!(resolved(&[band(0, None)]), Resolved::None);
    }

    #[test]
    fn surfaces_that_lie_apart_are_not_compared() {
        let offsets = [0.0];
        let (posed, near) = (posed(&offsets), shaded(&offsets, 0.0, 1));
        let mut far = near.clone();
        far.views[0].depth = Raster::filled(SIZE, SIZE, 1.1);
        let halves = [&near, &far].map(|shaded| Half {
            posed: &posed,
            shaded,
        });
        let found = compare_halves(&halves[0], &halves[1]);
        assert_eq!(found.resolved, Resolved::None);
        assert!(found.relief.is_empty(), "{found:?}");
    }
}
