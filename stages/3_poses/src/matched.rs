//! The matched photos: cameras, keypoint positions and tracks, which stay the same while poses are
//! found.

use crate::options::{PosesOptions, RefineIntrinsics};
use crate::projection::{FOCAL, K1, K2, NUM_INTRINSICS, PRINCIPAL_POINT};
use crate::tracks::{self, TrackSighting};
use nalgebra::Point2;
use rilievo_scene::{FeatureMatches, FocalSource, Intrinsics, Keypoint, PhotoSet};

/// Standard deviation of `ln f` where it comes from EXIF: a nominal length, rounded to whole
/// millimetres or thereabouts, at a focus nearer than infinity.
pub(crate) const EXIF_FOCAL_SIGMA: f64 = 0.02;
/// Standard deviation of `ln f` where nothing is known.
pub(crate) const GUESS_FOCAL_SIGMA: f64 = 0.4;
/// Standard deviation of the principal point, as a share of the image's longer side.
const PRINCIPAL_POINT_SIGMA: f64 = 0.02;
/// Standard deviation of the distortion coefficients `k1, k2, p1, p2, k3`.
pub(crate) const DISTORTION_SIGMA: [f64; 5] = [0.3, 0.3, 0.01, 0.01, 0.1];

/// Standard deviation of a small keypoint's coordinate, pixels: the distances of matches from the
/// true epipolar lines of three calibrated photo sets.
const KEYPOINT_SIGMA_PX: f64 = 0.15;
/// Its growth with the keypoint's size, from the same sets: large blobs are poorly placed.
const KEYPOINT_SIGMA_PER_SIZE: f64 = 0.05;

/// A camera shared by photos.
#[derive(Clone)]
pub(crate) struct CameraPrior {
    /// Its group in the photo set.
    pub group: usize,
    /// Intrinsics before any adjustment.
    pub initial: Intrinsics,
    /// Standard deviations of what may be refined.
    pub prior_sigma: [Option<f64>; NUM_INTRINSICS],
    /// Logarithm of the focal length to start from, over the initial one.
    pub start_ln_focal: f64,
    /// Whether it was made for photos that were zoomed or cropped, see [`crate::own_focal`].
    pub is_own: bool,
    /// Whether its principal point is not where the photos' middle is, see [`crate::own_center`].
    pub is_cropped: bool,
    /// The camera that it shares its lens with: all but the principal point.
    pub lens_of: Option<usize>,
}

/// Photos with their cameras, keypoints and tracks.
pub(crate) struct MatchedPhotos<'a> {
    pub photos: &'a PhotoSet,
    pub matches: &'a FeatureMatches,
    pub cameras: Vec<CameraPrior>,
    /// Camera of each photo.
    pub camera_of: Vec<usize>,
    /// Keypoint positions per photo, pixels.
    pub pixels: Vec<Vec<Point2<f64>>>,
    /// Standard deviation of each coordinate of a keypoint's position, pixels.
    pub sigmas_px: Vec<Vec<f64>>,
    /// Tracks, each ordered by photo.
    pub tracks: Vec<Vec<TrackSighting>>,
    /// Per photo: its tracks and the sighting's place in each.
    pub tracks_of: Vec<Vec<(usize, usize)>>,
}

impl<'a> MatchedPhotos<'a> {
    pub fn new(photos: &'a PhotoSet, matches: &'a FeatureMatches, options: &PosesOptions) -> Self {
        let mut cameras: Vec<CameraPrior> = Vec::new();
        let camera_of = photos
            .photos
            .iter()
            .map(|photo| {
                let same = |c: &CameraPrior| {
                    c.group == photo.camera_group && c.initial == photo.intrinsics
                };
                cameras.iter().position(same).unwrap_or_else(|| {
                    cameras.push(CameraPrior {
                        group: photo.camera_group,
                        initial: photo.intrinsics,
                        prior_sigma: prior_sigma(
                            &photo.intrinsics,
                            photo.focal_source,
                            options.refine_intrinsics,
                        ),
                        start_ln_focal: 0.0,
                        is_own: false,
                        is_cropped: false,
                        lens_of: None,
                    });
                    cameras.len() - 1
                })
            })
            .collect();
        let pixel = |k: &Keypoint| Point2::new(f64::from(k.x), f64::from(k.y));
        let sigma_px =
            |k: &Keypoint| KEYPOINT_SIGMA_PX.hypot(KEYPOINT_SIGMA_PER_SIZE * f64::from(k.size_px));
        let tracks = tracks::build(matches);
        let mut tracks_of = vec![Vec::new(); photos.photos.len()];
        for (t, track) in tracks.iter().enumerate() {
            for (s, sighting) in track.iter().enumerate() {
                tracks_of[sighting.photo].push((t, s));
            }
        }
        Self {
            photos,
            matches,
            cameras,
            camera_of,
            pixels: each_keypoint(matches, pixel),
            sigmas_px: each_keypoint(matches, sigma_px),
            tracks,
            tracks_of,
        }
    }

    pub fn pixel(&self, sighting: &TrackSighting) -> Point2<f64> {
        self.pixels[sighting.photo][sighting.keypoint as usize]
    }

    /// Standard deviation of a sighting, pixels.
    pub fn sigma_px(&self, sighting: &TrackSighting) -> f64 {
        self.sigmas_px[sighting.photo][sighting.keypoint as usize]
    }

    /// The tracks of any of some photos, ascending.
    pub fn tracks_of_any(&self, photos: &[usize]) -> Vec<usize> {
        let tracks = photos.iter().flat_map(|&p| &self.tracks_of[p]);
        let mut tracks: Vec<usize> = tracks.map(|&(track, _)| track).collect();
        tracks.sort_unstable();
        tracks.dedup();
        tracks
    }

    /// The camera whose lens a photo was taken with.
    pub fn lens_of(&self, photo: usize) -> usize {
        let camera = self.camera_of[photo];
        self.cameras[camera].lens_of.unwrap_or(camera)
    }

    pub fn num_photos(&self) -> usize {
        self.photos.photos.len()
    }
}

/// A value of every keypoint, per photo.
fn each_keypoint<T>(matches: &FeatureMatches, value: impl Fn(&Keypoint) -> T) -> Vec<Vec<T>> {
    let photos = matches.photos.iter();
    photos
        .map(|list| list.keypoints.iter().map(&value).collect())
        .collect()
}

/// Which intrinsics may change, and how far the start may be trusted.
fn prior_sigma(
    camera: &Intrinsics,
    source: FocalSource,
    refine: RefineIntrinsics,
) -> [Option<f64>; NUM_INTRINSICS] {
    let mut sigma = [None; NUM_INTRINSICS];
    let focal_sigma = match source {
        FocalSource::Guess => GUESS_FOCAL_SIGMA,
        _ => EXIF_FOCAL_SIGMA,
    };
    match refine {
        RefineIntrinsics::None => {}
        RefineIntrinsics::Auto if source == FocalSource::CameraFile => {}
        RefineIntrinsics::Auto => {
            sigma[FOCAL] = Some(focal_sigma);
            sigma[K1] = Some(DISTORTION_SIGMA[0]);
            sigma[K2] = Some(DISTORTION_SIGMA[1]);
        }
        RefineIntrinsics::Focal => sigma[FOCAL] = Some(focal_sigma),
        RefineIntrinsics::All => {
            let longer = camera.longer_side();
            sigma[FOCAL] = Some(focal_sigma);
            sigma[PRINCIPAL_POINT].fill(Some(PRINCIPAL_POINT_SIGMA * longer));
            sigma[K1..].copy_from_slice(&DISTORTION_SIGMA.map(Some));
        }
    }
    sigma
}
