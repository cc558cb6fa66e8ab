//! Depth and normal maps of one view against the truth, pixel by pixel.
//!
//! * Depth: `|s z_e − z_t| / z_t` wherever both have a value, `s` the one scale of the scene.
//! * Normals: the angle between estimate and truth in the camera frame. A truth without normals
//!   (a fused stereo surface) is too coarse for single pixels; there both sides are replaced by
//!   planes fitted to 21×21 pixels (`planes`).
//! * Completeness: the share of the truth's pixels that have a depth; pixels without one enter
//!   nothing else. The truth's pixels are those with a depth, or with a normal where no depth is
//!   known.

use super::planes::{PLANE_HALF_WINDOW_PX, plane_normals};
use super::regions::{Region, RegionError, RegionSums, region_errors, regions};
use super::relief::{BandSums, ReliefBand, relief_bands, relief_sums};
use super::truth::{TruthMaps, TruthView, is_depth};
use crate::error::SyntheticError;
use nalgebra::Vector3;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{DepthMap, NormalMap, Raster};
use serde::Serialize;
use std::collections::BTreeMap;

/// Where compared normals come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NormalSource {
    /// The normal maps of both sides.
    Maps,
    /// Planes fitted to the depths of both sides.
    Planes,
}

/// Errors of one view's pixels, in the order of the pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelErrors {
    /// Pixels whose truth is known.
    pub num_truth: usize,
    /// Those of them with an estimated depth.
    pub num_estimated: usize,
    /// Angles between normals, degrees.
    pub normal_deg: Vec<f64>,
    /// Relative errors of depth, absolute values.
    pub depth_rel: Vec<f64>,
    /// Depths of both sides, `[estimate times scale, truth]`, truth's unit.
    pub depths: Vec<[f32; 2]>,
    /// Where the normals come from.
    pub normal_source: NormalSource,
    /// The errors of normals by region, where both sides have normal maps.
    pub regions: [RegionSums; Region::ALL.len()],
    /// The relief by wavelength, where both sides have normal maps.
    pub relief: Vec<BandSums>,
}

/// Summary of pixel errors; what there is no pixel for is `None`, and `reasons` says why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapComparison {
    /// Share of the truth's pixels with a depth, 0 to 1.
    pub complete: Option<f64>,
    /// Mean angle between normals, degrees.
    pub normal_mae_deg: Option<f64>,
    /// Median angle between normals, degrees.
    pub normal_median_deg: Option<f64>,
    /// Median relative depth error.
    pub depth_median_rel: Option<f64>,
    /// 90 % quantile of the relative depth error.
    pub depth_p90_rel: Option<f64>,
    /// Root mean square of the relative depth error.
    pub depth_rms_rel: Option<f64>,
    /// Mean absolute error of depth, truth's unit.
    pub depth_mae: Option<f64>,
    /// Root mean square error of depth, truth's unit.
    pub depth_rmse: Option<f64>,
    /// The same after the scale and offset of depth that fit best, which stand beside it: what
    /// is left of a shape whose distance and size are free.
    pub depth_rmse_scale_offset: Option<[f64; 3]>,
    /// Share of compared normals within 11.25, 22.5 and 30 degrees.
    pub normal_within_11_22_30_deg: Option<[f64; 3]>,
    /// Where the normals come from.
    pub normals_from: NormalSource,
    /// The errors of normals by region, from the outline inwards; empty without normal maps.
    pub regions: Vec<RegionError>,
    /// The relief by wavelength, the finest first; empty without normal maps.
    pub relief: Vec<ReliefBand>,
    /// Pixels of the truth.
    pub num_truth_px: usize,
    /// Key of a null value: why it could not be computed.
    pub reasons: BTreeMap<String, String>,
}

/// Values that need depths of both sides, and those that need normals.
const DEPTH_KEYS: [&str; 6] = [
    "depth_median_rel",
    "depth_p90_rel",
    "depth_rms_rel",
    "depth_mae",
    "depth_rmse",
    "depth_rmse_scale_offset",
];
const NORMAL_KEYS: [&str; 3] = [
    "normal_mae_deg",
    "normal_median_deg",
    "normal_within_11_22_30_deg",
];

impl PixelErrors {
    fn depth_errors(&self, of: impl Fn(f64) -> f64) -> Vec<f64> {
        let difference = |[z, truth]: &[f32; 2]| f64::from(*z) - f64::from(*truth);
        self.depths
            .iter()
            .map(|pair| of(difference(pair)))
            .collect()
    }

    /// Root mean square of `a z + b − truth` over the best `a` and `b`; `[rms, a, b]`.
    fn fitted_depth(&self) -> Option<[f64; 3]> {
        if self.depths.is_empty() {
            return None;
        }
        let num = self.depths.len() as f64;
        let pairs = || {
            self.depths
                .iter()
                .map(|[z, t]| (f64::from(*z), f64::from(*t)))
        };
        let (z_mean, t_mean) =
            pairs().fold((0.0, 0.0), |(a, b), (z, t)| (a + z / num, b + t / num));
        let (mut zz, mut zt) = (0.0, 0.0);
        for (z, t) in pairs() {
            zz += (z - z_mean).powi(2);
            zt += (z - z_mean) * (t - t_mean);
        }
        let scale = if zz > 0.0 { zt / zz } else { 1.0 };
        let offset = t_mean - scale * z_mean;
        let square = pairs()
            .map(|(z, t)| (scale * z + offset - t).powi(2))
            .sum::<f64>();
        Some([(square / num).sqrt(), scale, offset])
    }

    /// Means and quantiles.
    pub fn summary(&self) -> MapComparison {
        let (regions, relief) = (region_errors(&self.regions), relief_bands(&self.relief));
        let absent: [(bool, &[&str], &str); 5] = [
            (
                self.num_truth == 0,
                &["complete"],
                "the truth knows no pixel here",
            ),
            (
                self.depth_rel.is_empty(),
                &DEPTH_KEYS,
                "no pixel has both an estimated and a true depth",
            ),
            (
                self.normal_deg.is_empty(),
                &NORMAL_KEYS,
                "no pixel has both an estimated and a true normal",
            ),
            (
                regions.is_empty(),
                &["regions"],
                "result and truth do not both have normal maps",
            ),
            (
                relief.is_empty(),
                &["relief"],
                "result and truth do not both have normals of enough pixels away from edges",
            ),
        ];
        let reasons = (absent.into_iter().filter(|(is_absent, ..)| *is_absent))
            .flat_map(|(_, keys, reason)| keys.iter().map(move |key| (*key, reason)))
            .map(|(key, reason)| (key.to_owned(), reason.to_owned()))
            .collect();
        let mean = |values: &[f64]| {
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let share_within = |limit: f64| {
            self.normal_deg.iter().filter(|&&a| a < limit).count() as f64
                / self.normal_deg.len() as f64
        };
        let mut depth = self.depth_rel.clone();
        let mut normal = self.normal_deg.clone();
        MapComparison {
            complete: (self.num_truth > 0)
                .then(|| self.num_estimated as f64 / self.num_truth as f64),
            normal_mae_deg: mean(&self.normal_deg),
            normal_median_deg: quantile(&mut normal, 0.5),
            depth_median_rel: quantile(&mut depth, 0.5),
            depth_p90_rel: quantile(&mut depth, 0.9),
            depth_rms_rel: mean(&self.depth_rel.iter().map(|d| d * d).collect::<Vec<_>>())
                .map(f64::sqrt),
            depth_mae: mean(&self.depth_errors(|e| e.abs())),
            depth_rmse: mean(&self.depth_errors(|e| e * e)).map(f64::sqrt),
            depth_rmse_scale_offset: self.fitted_depth(),
            normal_within_11_22_30_deg: (!normal.is_empty())
                .then(|| [share_within(11.25), share_within(22.5), share_within(30.0)]),
            normals_from: self.normal_source,
            regions,
            relief,
            num_truth_px: self.num_truth,
            reasons,
        }
    }
}

/// The pixels of several views as one; `None` without a view.
pub fn aggregate<'a>(views: impl Iterator<Item = &'a PixelErrors>) -> Option<MapComparison> {
    views
        .fold(None, |all: Option<PixelErrors>, view| {
            let Some(mut all) = all else {
                return Some(view.clone());
            };
            all.num_truth += view.num_truth;
            all.num_estimated += view.num_estimated;
            all.normal_deg.extend_from_slice(&view.normal_deg);
            all.depth_rel.extend_from_slice(&view.depth_rel);
            all.depths.extend_from_slice(&view.depths);
            for (sums, more) in all.regions.iter_mut().zip(&view.regions) {
                sums.num_px += more.num_px;
                sums.sum_deg += more.sum_deg;
            }
            all.relief
                .resize(all.relief.len().max(view.relief.len()), BandSums::default());
            for (sums, more) in all.relief.iter_mut().zip(&view.relief) {
                sums.add(more);
            }
            Some(all)
        })
        .map(|all| all.summary())
}

/// Compares one view; `depth` in the estimate's unit is multiplied by `scale`. A view without a
/// result (`depth` is `None`) counts as missing everywhere.
///
/// # Errors
/// Maps of another size than the truth's.
pub fn compare_maps(
    truth: &TruthView,
    depth: Option<&DepthMap>,
    normal: Option<&NormalMap>,
    scale: f64,
) -> Result<PixelErrors, SyntheticError> {
    let expected = truth.maps.size();
    let sizes = [
        ("depth map", depth.map(|m| (m.width, m.height))),
        ("normal map", normal.map(|m| (m.width, m.height))),
        (
            "true normal map",
            truth.maps.normal().map(|m| (m.width, m.height)),
        ),
    ];
    for (what, size) in sizes {
        if let Some(got) = size.filter(|&size| size != expected) {
            return Err(SyntheticError::SizeMismatch {
                view: truth.name.clone(),
                what,
                got,
                expected,
            });
        }
    }
    let known: Vec<(usize, usize)> = (0..expected.1)
        .flat_map(|y| (0..expected.0).map(move |x| (x, y)))
        .filter(|&(x, y)| truth.maps.is_known(x, y))
        .collect();
    let normal_source = match truth.maps.normal() {
        Some(_) => NormalSource::Maps,
        None => NormalSource::Planes,
    };
    let mut errors = PixelErrors {
        num_truth: known.len(),
        num_estimated: 0,
        normal_deg: Vec::new(),
        depth_rel: Vec::new(),
        depths: Vec::new(),
        normal_source,
        regions: Default::default(),
        relief: Vec::new(),
    };
    let Some(depth) = depth else {
        return Ok(errors);
    };
    for &(x, y) in &known {
        let z = *depth.at(x, y);
        if !is_depth(z) {
            continue;
        }
        errors.num_estimated += 1;
        if let Some(true_depth) = truth.maps.depth() {
            let z_true = f64::from(*true_depth.at(x, y));
            errors
                .depth_rel
                .push(((scale * f64::from(z) - z_true) / z_true).abs());
            errors
                .depths
                .push([(scale * f64::from(z)) as f32, z_true as f32]);
        }
    }
    let planes;
    let (estimated, true_normals) = match (&truth.maps, normal) {
        (TruthMaps::Normal(true_normals) | TruthMaps::Both(_, true_normals), Some(normal)) => {
            let true_depth = truth.maps.depth();
            let focal_px = truth.intrinsics.focal_px();
            errors.relief = relief_sums(normal, true_normals, true_depth, focal_px);
            (normal, true_normals)
        }
        (TruthMaps::Normal(_) | TruthMaps::Both(..), None) => return Ok(errors),
        (TruthMaps::Depth(true_depth), _) => {
            let both = Raster::from_fn(expected.0, expected.1, |x, y| {
                is_depth(*depth.at(x, y)) && is_depth(*true_depth.at(x, y))
            });
            planes = [depth, true_depth]
                .map(|map| plane_normals(map, &both, &truth.intrinsics, PLANE_HALF_WINDOW_PX));
            (&planes[0], &planes[1])
        }
    };
    // Planes of many pixels belong to no single one.
    let regions = (normal_source == NormalSource::Maps).then(|| regions(truth));
    for (x, y) in known {
        if let (Some(e), Some(t)) = (estimated.normal(x, y), true_normals.normal(x, y)) {
            let angle = angle_deg(&e, &t);
            if angle.is_finite() {
                errors.normal_deg.push(angle);
                if let Some(regions) = &regions {
                    let sums = &mut errors.regions[*regions.at(x, y) as usize];
                    sums.num_px += 1;
                    sums.sum_deg += angle;
                }
            }
        }
    }
    Ok(errors)
}

/// Angle between two directions, accurate at small angles where the arc cosine is not.
pub(crate) fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use rilievo_scene::Intrinsics;

    fn camera() -> Intrinsics {
        Intrinsics::pinhole(60, 50, 80.0, 29.5, 24.5)
    }

    /// Depth of the plane `n · X = d` in every pixel.
    fn plane(n: Vector3<f64>, d: f64) -> DepthMap {
        DepthMap::from_fn(60, 50, |x, y| {
            (d / n.dot(&camera().ray(&Point2::new(x as f64, y as f64)))) as f32
        })
    }

    fn truth(with_normals: bool) -> TruthView {
        let n = Vector3::new(0.3, -0.2, -1.0).normalize();
        let normal = n.map(|c| c as f32);
        TruthView {
            name: "IMG_0001".into(),
            intrinsics: camera(),
            maps: match with_normals {
                true => TruthMaps::Both(plane(n, -1.0), NormalMap::filled(60, 50, normal.into())),
                false => TruthMaps::Depth(plane(n, -1.0)),
            },
        }
    }

    #[test]
    fn planes_are_recovered_up_to_the_border() {
        let truth = truth(true);
        let all = Raster::filled(60, 50, true);
        let TruthMaps::Both(depth, normal) = truth.maps else {
            panic!("both were given");
        };
        let planes = plane_normals(&depth, &all, &camera(), PLANE_HALF_WINDOW_PX);
        // Half windows at the frame's sides still hold a third of the pixels, corners do not.
        let (mut worst, mut count) = (0.0_f64, 0);
        for (p, t) in planes.data.iter().zip(&normal.data) {
            let to = |v: &[f32; 3]| Vector3::new(v[0].into(), v[1].into(), v[2].into());
            if p != &[0.0; 3] {
                worst = worst.max(angle_deg(&to(p), &to(t)));
                count += 1;
            }
        }
        assert!(worst < 1e-2, "{worst} degrees");
        assert!(count > 2500, "{count}");
    }

    #[test]
    fn the_scale_and_missing_pixels_are_counted() {
        for with_normals in [true, false] {
            let truth = truth(with_normals);
            let mut depth = truth.maps.depth().expect("given").clone();
            for z in &mut depth.data {
                *z *= 0.5;
            }
            for x in 0..30 {
                for y in 0..50 {
                    *depth.at_mut(x, y) = 0.0;
                }
            }
            let errors = compare_maps(&truth, Some(&depth), truth.maps.normal(), 2.02);
            let summary = errors.expect("sizes agree").summary();
            assert_eq!(summary.complete, Some(0.5));
            let median = summary.depth_median_rel.expect("pixels in common");
            assert!((median - 0.01).abs() < 1e-6, "{median}");
            let [rms, scale, offset] = summary.depth_rmse_scale_offset.expect("pixels in common");
            assert!(
                rms < 1e-6 && (scale * 1.01 - 1.0).abs() < 1e-5,
                "{rms} {scale} {offset}"
            );
            let (mae, rmse) = (summary.depth_mae, summary.depth_rmse);
            assert!(
                mae > Some(0.005) && mae < Some(0.05) && mae <= rmse,
                "{mae:?} {rmse:?}"
            );
            let mae = summary.normal_mae_deg.expect("pixels in common");
            assert!(mae < 1e-2, "{mae}");
        }
    }

    #[test]
    fn a_tilt_shows_as_its_angle() {
        let truth = truth(false);
        let tilted = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), 5_f64.to_radians())
            * Vector3::new(0.3, -0.2, -1.0).normalize();
        let errors = compare_maps(&truth, Some(&plane(tilted, -1.0)), None, 1.0);
        let summary = errors.expect("sizes agree").summary();
        let expected = angle_deg(&tilted, &Vector3::new(0.3, -0.2, -1.0));
        let median = summary.normal_median_deg.expect("planes");
        assert!((median - expected).abs() < 1e-2, "{median} {expected}");
    }

    #[test]
    fn normals_are_compared_without_a_true_depth() {
        let both = truth(true);
        let mut normal = both.maps.normal().expect("given").clone();
        // Background on the left half.
        for y in 0..50 {
            for x in 0..30 {
                *normal.at_mut(x, y) = [0.0; 3];
            }
        }
        let tilted = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), 3_f64.to_radians())
            * Vector3::new(0.3, -0.2, -1.0).normalize();
        let estimate = NormalMap::filled(60, 50, tilted.map(|c| c as f32).into());
        let depth = DepthMap::filled(60, 50, 2.0);
        let known = TruthView {
            maps: TruthMaps::new(None, Some(normal)).expect("normals"),
            ..both
        };
        let errors = compare_maps(&known, Some(&depth), Some(&estimate), 1.0);
        let summary = errors.expect("sizes agree").summary();
        let expected = angle_deg(&tilted, &Vector3::new(0.3, -0.2, -1.0));
        let mean = summary.normal_mae_deg.expect("pixels in common");
        assert!((mean - expected).abs() < 1e-4, "{mean} {expected}");
        assert_eq!((summary.num_truth_px, summary.complete), (1500, Some(1.0)));
        assert_eq!(summary.normals_from, NormalSource::Maps);
        assert!(summary.depth_median_rel.is_none());
        assert!(summary.reasons.contains_key("depth_median_rel"));
    }

    #[test]
    fn nothing_estimated_is_null_with_a_reason_and_another_size_an_error() {
        let truth = truth(true);
        let none = compare_maps(&truth, None, None, 1.0).expect("no map, no conflict");
        let summary = none.summary();
        assert_eq!(
            (summary.complete, summary.normal_mae_deg),
            (Some(0.0), None)
        );
        assert!(summary.reasons.contains_key("normal_mae_deg"));
        let small = DepthMap::filled(10, 10, 1.0);
        let error = compare_maps(&truth, Some(&small), None, 1.0);
        assert!(
            matches!(
                error,
                Err(SyntheticError::SizeMismatch { got: (10, 10), .. })
            ),
            "{error:?}"
        );
    }
}
