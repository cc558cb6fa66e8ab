//! The reconstruction while it grows: poses of some photos, points of some tracks.

use crate::adjustment::{AdjustedCamera, AdjustedView, Bundle, BundleOptions, Observation};
use crate::error::PosesError;
use crate::matched::{CameraPrior, DISTORTION_SIGMA, GUESS_FOCAL_SIGMA, MatchedPhotos};
use crate::projection::{CenteredPose, FOCAL, K1, NUM_INTRINSICS, PRINCIPAL_POINT};
use crate::report::AdjustmentReport;
use crate::triangulation::{Sighting, TriangulationLimits, triangulate};
use nalgebra::{Matrix3, Point2, Point3};
use rayon::prelude::*;
use rilievo_numerics::robust::{RobustLoss, median};
use rilievo_scene::Intrinsics;

/// An observation is an outlier beyond this many median errors (3.4 standard deviations of a
/// two-dimensional normal distribution) …
const OUTLIER_MEDIANS: f64 = 4.0;
/// … but never below this, pixels.
const MIN_OUTLIER_PX: f64 = 0.3;

/// Sightings of a point from photos that a local adjustment holds still, evenly taken: more hold the point no better,
/// and where photos are dense there are dozens.
const MAX_NUM_HELD: usize = 8;

/// A triangulated track.
#[derive(Clone, Debug)]
pub(crate) struct ModelPoint {
    /// Position in the world frame.
    pub position: Point3<f64>,
    /// Which sightings of the track support it, ascending.
    pub support: Vec<usize>,
}

#[derive(Clone)]
pub(crate) struct Model {
    /// Cameras, as in the scene.
    pub cameras: Vec<AdjustedCamera>,
    pub poses: Vec<Option<CenteredPose>>,
    pub points: Vec<Option<ModelPoint>>,
    /// Positions by patch alignment, once there are any.
    pub refined: Option<RefinedPixels>,
}

/// What an adjustment covers.
pub(crate) struct AdjustmentScope<'a> {
    /// Name for the report.
    pub step: &'a str,
    /// Photos whose poses may change; `None`: all; empty: none, all points alone.
    pub photos: Option<&'a [usize]>,
    pub intrinsics: IntrinsicsScope,
}

/// Which of the intrinsics that have a prior may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum IntrinsicsScope {
    Fixed,
    /// What few views determine.
    Focal,
    All,
    /// Radial distortion of cameras that are otherwise as given; see [`crate::lens`].
    Nuisance,
    /// The same, and a focal length of which nothing is known.
    NuisanceAndFocal,
}

impl IntrinsicsScope {
    /// Standard deviations of the priors of a camera's parameters; `None` for what may not change.
    fn prior_sigma(self, camera: &CameraPrior) -> [Option<f64>; NUM_INTRINSICS] {
        let mut sigma = [None; NUM_INTRINSICS];
        match self {
            Self::Fixed => {}
            Self::Focal => {
                sigma[FOCAL] = camera.prior_sigma[FOCAL];
                if camera.is_cropped {
                    sigma[PRINCIPAL_POINT].copy_from_slice(&camera.prior_sigma[PRINCIPAL_POINT]);
                }
            }
            Self::All => sigma = camera.prior_sigma,
            Self::Nuisance => sigma[K1] = Some(DISTORTION_SIGMA[0]),
            Self::NuisanceAndFocal => {
                sigma[FOCAL] = Some(GUESS_FOCAL_SIGMA);
                sigma[K1] = Some(DISTORTION_SIGMA[0]);
            }
        }
        sigma
    }
}

impl<'a> AdjustmentScope<'a> {
    /// All poses and points.
    pub fn all(step: &'a str, intrinsics: IntrinsicsScope) -> Self {
        Self {
            step,
            photos: None,
            intrinsics,
        }
    }

    /// All points, cameras as they are.
    pub fn points(step: &'a str) -> Self {
        Self {
            step,
            photos: Some(&[]),
            intrinsics: IntrinsicsScope::Fixed,
        }
    }
}

/// A pixel that replaces a keypoint's own, with its standard deviation in pixels.
pub(crate) type RefinedPixel = Option<(Point2<f64>, f64)>;

/// Refined pixels per track and sighting.
pub(crate) type RefinedPixels = Vec<Vec<RefinedPixel>>;

impl Model {
    /// No poses, no points.
    pub fn empty(matched: &MatchedPhotos<'_>) -> Self {
        Self {
            cameras: matched
                .cameras
                .iter()
                .map(|c| {
                    let mut camera = AdjustedCamera::fixed(c.initial);
                    camera.deviation[FOCAL] = c.start_ln_focal;
                    camera
                })
                .collect(),
            poses: vec![None; matched.num_photos()],
            points: vec![None; matched.tracks.len()],
            refined: None,
        }
    }

    pub fn num_views(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    pub fn num_points(&self) -> usize {
        self.points.iter().flatten().count()
    }

    /// Number of points that a photo's sightings support.
    pub fn num_sightings(&self, matched: &MatchedPhotos<'_>, photo: usize) -> usize {
        let sightings = matched.tracks_of[photo].iter();
        let supports = |&(track, place): &(usize, usize)| {
            let point = self.points[track].as_ref();
            point.is_some_and(|point| point.support.binary_search(&place).is_ok())
        };
        sightings.filter(|sighting| supports(sighting)).count()
    }

    /// Current intrinsics, per camera.
    pub fn intrinsics(&self) -> Vec<Intrinsics> {
        self.cameras.iter().map(AdjustedCamera::current).collect()
    }

    /// Known points that a photo sees: keypoint pixel and position.
    pub fn visible_points(
        &self,
        matched: &MatchedPhotos<'_>,
        photo: usize,
    ) -> (Vec<Point2<f64>>, Vec<Point3<f64>>) {
        matched.tracks_of[photo]
            .iter()
            .filter_map(|&(track, place)| {
                let point = self.points[track].as_ref()?;
                Some((matched.pixel(&matched.tracks[track][place]), point.position))
            })
            .unzip()
    }

    /// What was seen of a point: place in the track, pixel, standard deviation in pixels.
    ///
    /// A track with two aligned sightings or more goes by them alone; others by their keypoints.
    pub fn observations(
        &self,
        matched: &MatchedPhotos<'_>,
        track: usize,
    ) -> Vec<(usize, Point2<f64>, f64)> {
        let Some(point) = &self.points[track] else {
            return Vec::new();
        };
        if let Some(refined) = &self.refined {
            let aligned: Vec<_> = point
                .support
                .iter()
                .filter_map(|&place| refined[track][place].map(|(pixel, s)| (place, pixel, s)))
                .collect();
            if aligned.len() >= 2 {
                return aligned;
            }
        }
        point
            .support
            .iter()
            .map(|&place| {
                let sighting = &matched.tracks[track][place];
                (place, matched.pixel(sighting), matched.sigma_px(sighting))
            })
            .collect()
    }

    /// A sighting of a track at a pixel; `None` without a pose.
    fn sighting<'m>(
        &'m self,
        matched: &MatchedPhotos<'_>,
        cameras: &'m [Intrinsics],
        photo: usize,
        pixel: Point2<f64>,
    ) -> Option<Sighting<'m>> {
        Some(Sighting {
            camera: &cameras[matched.camera_of[photo]],
            pose: self.poses[photo].as_ref()?,
            pixel,
        })
    }

    /// Triangulates every track that can be, and extends or trims the support of known points.
    pub fn triangulate_all(&mut self, matched: &MatchedPhotos<'_>, limits: &TriangulationLimits) {
        let all: Vec<usize> = (0..matched.tracks.len()).collect();
        self.triangulate(matched, &all, limits);
    }

    /// The same for some of the tracks; those that became a point or ceased to be one.
    pub fn triangulate(
        &mut self,
        matched: &MatchedPhotos<'_>,
        tracks: &[usize],
        limits: &TriangulationLimits,
    ) -> Vec<usize> {
        let cameras = self.intrinsics();
        let updated: Vec<Option<ModelPoint>> = tracks
            .par_iter()
            .map(|&t| {
                let posed = matched.tracks[t].iter().enumerate();
                let posed = posed.filter_map(|(place, s)| {
                    let pixel = matched.pixel(s);
                    Some((place, self.sighting(matched, &cameras, s.photo, pixel)?))
                });
                let (places, sightings): (Vec<usize>, Vec<Sighting<'_>>) = posed.unzip();
                if sightings.len() < 2 {
                    return None;
                }
                let supported = |(position, support): (Point3<f64>, Vec<usize>)| ModelPoint {
                    position,
                    support: support.into_iter().map(|k| places[k]).collect(),
                };
                if let Some(ModelPoint { position, .. }) = self.points[t] {
                    let support: Vec<usize> = (0..sightings.len())
                        .filter(|&k| sightings[k].error_px(&position) <= limits.max_error_px)
                        .collect();
                    let centers = support.iter().map(|&k| sightings[k].pose.center);
                    let centers: Vec<Point3<f64>> = centers.collect();
                    if support.len() * 2 > sightings.len() && limits.hold(&position, &centers) {
                        return Some(supported((position, support)));
                    }
                }
                triangulate(&sightings, limits).map(supported)
            })
            .collect();
        let mut changed = Vec::new();
        for (&track, point) in tracks.iter().zip(updated) {
            if point.is_some() != self.points[track].is_some() {
                changed.push(track);
            }
            self.points[track] = point;
        }
        changed
    }

    /// Drops sightings that err by more than four times the median, and points left with fewer
    /// than two or with rays too nearly parallel.
    pub fn drop_outliers(&mut self, matched: &MatchedPhotos<'_>, limits: &TriangulationLimits) {
        let cameras = self.intrinsics();
        let errors: Vec<Vec<(usize, f64)>> = (0..self.points.len())
            .into_par_iter()
            .map(|t| {
                let Some(point) = &self.points[t] else {
                    return Vec::new();
                };
                let seen = self.observations(matched, t).into_iter();
                let errors = seen.filter_map(|(place, pixel, _)| {
                    let photo = matched.tracks[t][place].photo;
                    let sighting = self.sighting(matched, &cameras, photo, pixel)?;
                    Some((place, sighting.error_px(&point.position)))
                });
                errors.collect()
            })
            .collect();
        let mut all: Vec<f64> = errors.iter().flatten().map(|e| e.1).collect();
        let typical = median(&mut all).unwrap_or(0.0);
        let limit = (OUTLIER_MEDIANS * typical).max(MIN_OUTLIER_PX);
        let limit = limit.min(limits.max_error_px);
        for (t, errors) in errors.into_iter().enumerate() {
            let Some(point) = &mut self.points[t] else {
                continue;
            };
            let close = errors.into_iter().filter(|&(_, error)| error <= limit);
            point.support = close.map(|(place, _)| place).collect();
            let poses = point.support.iter();
            let poses = poses.filter_map(|&place| self.poses[matched.tracks[t][place].photo]);
            let centers: Vec<Point3<f64>> = poses.map(|pose| pose.center).collect();
            if !limits.hold(&point.position, &centers) {
                self.points[t] = None;
            }
        }
    }

    /// The bundle of a scope, with the track of each of its points and the photo of each view.
    fn bundle(
        &self,
        matched: &MatchedPhotos<'_>,
        scope: &AdjustmentScope<'_>,
    ) -> (Bundle, Vec<usize>, Vec<usize>) {
        let mut free = vec![scope.photos.is_none(); self.poses.len()];
        scope
            .photos
            .into_iter()
            .flatten()
            .for_each(|&p| free[p] = true);
        let is_free = |photo: usize| free[photo];
        // With no pose free it is the points that are wanted, all of them.
        let wanted = match scope.photos {
            Some(photos) if !photos.is_empty() => matched.tracks_of_any(photos),
            _ => (0..self.points.len()).collect(),
        };
        let points_only = scope.photos.is_some_and(<[usize]>::is_empty);
        let mut view_of = vec![None; self.poses.len()];
        let mut photos = Vec::new();
        let mut views = Vec::new();
        let mut tracks = Vec::new();
        let (mut points, mut observations, mut offsets) = (Vec::new(), Vec::new(), vec![0]);
        for t in wanted {
            let Some(point) = &self.points[t] else {
                continue;
            };
            let sightings = &matched.tracks[t];
            let sees = |&place: &usize| is_free(sightings[place].photo);
            if !points_only && !point.support.iter().any(sees) {
                continue;
            }
            let mut seen = self.observations(matched, t);
            if scope.photos.is_some() && !points_only {
                let (held, moved): (Vec<_>, _) =
                    seen.into_iter().partition(|(place, ..)| !sees(place));
                let step = held.len().div_ceil(MAX_NUM_HELD).max(1);
                seen = moved;
                seen.extend(held.into_iter().step_by(step));
            }
            for (place, pixel, sigma) in seen {
                let sighting = &sightings[place];
                let Some(pose) = self.poses[sighting.photo] else {
                    continue;
                };
                let view = *view_of[sighting.photo].get_or_insert_with(|| {
                    photos.push(sighting.photo);
                    views.push(AdjustedView {
                        camera: matched.camera_of[sighting.photo],
                        pose,
                        free: [is_free(sighting.photo); 6],
                    });
                    views.len() - 1
                });
                observations.push(Observation {
                    view,
                    pixel,
                    weight: 1.0 / (sigma * sigma),
                });
            }
            if observations.len() < offsets[offsets.len() - 1] + 2 {
                observations.truncate(offsets[offsets.len() - 1]);
                continue;
            }
            offsets.push(observations.len());
            points.push(point.position);
            tracks.push(t);
        }
        let cameras = self.cameras.iter().zip(&matched.cameras);
        let cameras = cameras.map(|(camera, fixed)| AdjustedCamera {
            prior_sigma: scope.intrinsics.prior_sigma(fixed),
            lens_of: fixed.lens_of,
            ..camera.clone()
        });
        let mut bundle = Bundle {
            cameras: cameras.collect(),
            views,
            points,
            observations: observations.into(),
            offsets: offsets.into(),
        };
        bundle.fix_gauge();
        (bundle, tracks, photos)
    }

    /// Bundle adjustment over a scope.
    pub fn adjust(
        &mut self,
        matched: &MatchedPhotos<'_>,
        scope: &AdjustmentScope<'_>,
        options: &BundleOptions,
    ) -> Result<AdjustmentReport, PosesError> {
        let (mut bundle, tracks, photos) = self.bundle(matched, scope);
        let solve = bundle.adjust(options)?;
        for (view, &photo) in bundle.views.iter().zip(&photos) {
            self.poses[photo] = Some(view.pose);
        }
        for (camera, adjusted) in self.cameras.iter_mut().zip(&bundle.cameras) {
            camera.deviation = adjusted.deviation;
        }
        for (&track, position) in tracks.iter().zip(&bundle.points) {
            if let Some(point) = &mut self.points[track] {
                point.position = *position;
            }
        }
        let rms_px = bundle.residual_statistics().rms_px;
        Ok(AdjustmentReport {
            step: scope.step.to_owned(),
            num_views: bundle.views.len(),
            num_points: bundle.points.len(),
            num_observations: bundle.observations.len(),
            rms_px,
            solve,
        })
    }

    /// How well the observations of a scope determine poses and points.
    pub fn precision(
        &self,
        matched: &MatchedPhotos<'_>,
        scope: &AdjustmentScope<'_>,
        loss: RobustLoss,
    ) -> Precision {
        let (bundle, _, photos) = self.bundle(matched, scope);
        let statistics = bundle.residual_statistics();
        let mut precision = Precision {
            poses: vec![None; self.poses.len()],
            median_point_sigma: None,
            sigma_px: statistics.sigma_px,
        };
        if let Some(covariances) = bundle.covariances(loss) {
            let largest = |block: Matrix3<f64>| {
                statistics.unit_sigma * block.symmetric_eigenvalues().max().max(0.0).sqrt()
            };
            for (covariance, &photo) in covariances.poses.iter().zip(&photos) {
                let block = |from: usize| covariance.fixed_view::<3, 3>(from, from).into_owned();
                precision.poses[photo] = Some((largest(block(0)), largest(block(3))));
            }
            let mut points: Vec<f64> = covariances.points.into_iter().map(largest).collect();
            precision.median_point_sigma = median(&mut points);
        }
        precision
    }
}

/// Standard deviations in the adjustment's gauge.
pub(crate) struct Precision {
    /// Per photo: of the rotation (radians) and of the centre (world's unit), largest axis.
    pub poses: Vec<Option<(f64, f64)>>,
    /// Median over the points, largest axis, world's unit.
    pub median_point_sigma: Option<f64>,
    /// Of an observation coordinate, pixels.
    pub sigma_px: f64,
}
