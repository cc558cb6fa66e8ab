//! Photos whose principal point is not in their middle: cropped or straightened beside it.
//!
//! A crop beside the middle looks like a turn of the camera. What the turn leaves over bends focal length, poses and shape,
//! so that every figure looks well and the size is per cents off. Where no camera file says better, the principal points
//! are tried free in an adjustment of the whole model, one of each photo, with the lens shared as before. Where the cost falls
//! clearly, the fewest parameters that explain nearly as much are taken (along one side, of a camera, of photos with like
//! offsets), unless all points lie as near the middle as a lens puts them.

use crate::adjustment::{AdjustedCamera, BundleOptions};
use crate::error::PosesError;
use crate::incremental::{MIN_NUM_VIEWS_FOR_INTRINSICS, intrinsics_scope, limits};
use crate::lens::{MIN_CHI_SQUARE_DROP, chi_square_drop, clear_drop};
use crate::matched::{CameraPrior, MatchedPhotos};
use crate::model::{AdjustmentScope, IntrinsicsScope, Model};
use crate::options::{PosesOptions, RefineIntrinsics};
use crate::projection::{FOCAL, PRINCIPAL_POINT};
use crate::report::AdjustmentReport;
use rilievo_scene::{Observer, StageId, first_and_more};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviation of the principal point of a cropped photo, as a share of its longer side.
pub(crate) const CROP_OFFSET: f64 = 0.05;
/// Least offset that counts as a crop, as a share of the longer side: lenses stay below.
const MIN_OFFSET: f64 = 0.02;
/// Largest difference between offsets of one crop, as a share of the longer side: those found photo by photo scatter by
/// half as much.
const SAME_CROP: f64 = 0.02;

/// Share of what a point a photo explains that fewer points must explain, too.
const EXPLAINED: f64 = 0.9;
/// Times that points are found anew with free principal points.
const NUM_ROUNDS: usize = 2;

/// Cameras, some with principal points of their own, which photo has which, and a model with them.
pub(crate) struct OwnCenters {
    pub cameras: Vec<CameraPrior>,
    pub camera_of: Vec<usize>,
    pub model: Model,
}

impl AdjustedCamera {
    /// Offset of the principal point from the middle, as a share of the longer side.
    fn offset(&self) -> [f64; 2] {
        let longer = self.initial.longer_side();
        [0, 1].map(|k| self.deviation[PRINCIPAL_POINT][k] / longer)
    }
}

impl OwnCenters {
    /// Offset of each photo's principal point from the middle, as a share of the longer side.
    fn offsets(&self) -> Vec<[f64; 2]> {
        let cameras = self.camera_of.iter().map(|&k| &self.model.cameras[k]);
        cameras.map(AdjustedCamera::offset).collect()
    }

    /// Does something with the photos as if they had these cameras.
    fn with<T>(
        &mut self,
        matched: &mut MatchedPhotos<'_>,
        act: impl FnOnce(&MatchedPhotos<'_>, &mut Model) -> T,
    ) -> T {
        self.swap(matched);
        let done = act(matched, &mut self.model);
        self.swap(matched);
        done
    }

    /// Exchanges the cameras of the photos for these.
    pub fn swap(&mut self, matched: &mut MatchedPhotos<'_>) {
        std::mem::swap(&mut matched.cameras, &mut self.cameras);
        std::mem::swap(&mut matched.camera_of, &mut self.camera_of);
    }
}

/// A guess at how photos were cropped.
struct Crops {
    /// Along which sides.
    axes: [bool; 2],
    /// Per photo: which it shares its principal point with, and `None` for one that has it in the middle.
    crop_of: Vec<Option<usize>>,
}

impl Crops {
    fn num_parameters(&self) -> usize {
        let crops: BTreeSet<usize> = self.crop_of.iter().flatten().copied().collect();
        crops.len() * self.axes.iter().filter(|&&is_free| is_free).count()
    }
}

/// Principal points that explain the photos clearly better than their middles; `None` where none do.
///
/// # Errors
/// When an adjustment breaks down or the observer asked to stop.
pub(crate) fn find(
    matched: &mut MatchedPhotos<'_>,
    model: &Model,
    options: &PosesOptions,
    observer: &dyn Observer,
) -> Result<Option<OwnCenters>, PosesError> {
    let is_free = |&camera: &usize| matched.cameras[camera].prior_sigma[FOCAL].is_some();
    if options.refine_intrinsics != RefineIntrinsics::Auto
        || model.num_views() < MIN_NUM_VIEWS_FOR_INTRINSICS
        || !matched.camera_of.iter().all(is_free)
    {
        return Ok(None);
    }
    let proceed = || {
        let num_views = model.num_views();
        let flow = observer.progress(StageId::Poses, "registering photos", (num_views, num_views));
        flow.ok_or(PosesError::Interrupted)
    };
    proceed()?;
    // A lens that bends is no crop: the middles may have all distortion that explains the photos.
    let in_the_middle = |matched: &MatchedPhotos<'_>, model: &Model| {
        let scope = AdjustmentScope::all("principal points in the middle", IntrinsicsScope::All);
        model
            .clone()
            .adjust(matched, &scope, &BundleOptions::complete(1e-6))
    };
    let plain = in_the_middle(matched, model)?;
    let is_posed: Vec<bool> = model.poses.iter().map(Option::is_some).collect();
    let each = Crops {
        axes: [true; 2],
        crop_of: (0..matched.num_photos()).map(Some).collect(),
    };
    let start = vec![[0.0; 2]; matched.num_photos()];
    let (mut most, mut own) = tried(matched, model, &each, &start)?;
    if !is_clear(&plain, &most, 2 * model.num_views()) {
        return Ok(None);
    }
    // Matches that contradicted the turned cameras tell the offsets, too.
    let limits = limits(options);
    for _ in 0..NUM_ROUNDS {
        proceed()?;
        most = own.with(matched, |matched, model| {
            model.triangulate_all(matched, &limits);
            adjust(matched, model)
        })?;
    }
    let mut base = own.model.clone();
    base.cameras.truncate(matched.cameras.len());
    let plain = in_the_middle(matched, &base)?;
    // The fewest parameters that explain as much of the photos.
    let (cameras, offsets) = (matched.camera_of.clone(), own.offsets());
    let shared = |axes| Crops {
        axes,
        crop_of: cameras.iter().copied().map(Some).collect(),
    };
    let alike = |axes| same_crops(&cameras, &offsets, &is_posed, axes);
    let sides = [[true, false], [false, true], [true, true]];
    for crops in sides.map(shared).into_iter().chain(sides.map(alike)) {
        proceed()?;
        let (cost, fewer) = tried(matched, &base, &crops, &offsets)?;
        let [all, these] =
            [&most, &cost].map(|after| plain.solve.final_cost - after.solve.final_cost);
        if these >= EXPLAINED * all && is_clear(&plain, &cost, crops.num_parameters()) {
            let is_far = |[x, y]: &[f64; 2]| x.hypot(*y) >= MIN_OFFSET;
            return Ok(fewer.offsets().iter().any(is_far).then_some(fewer));
        }
    }
    Ok(None)
}

/// Whether so many more parameters explain the photos clearly better.
fn is_clear(before: &AdjustmentReport, after: &AdjustmentReport, num_added: usize) -> bool {
    let least = num_added as f64 * MIN_CHI_SQUARE_DROP;
    clear_drop(before, after).is_some() && chi_square_drop(before, after) >= least
}

/// Photos of one camera whose offsets are equal along the sides; those in the middle share it.
fn same_crops(
    cameras: &[usize],
    offsets: &[[f64; 2]],
    is_posed: &[bool],
    axes: [bool; 2],
) -> Crops {
    let along = |offset: &[f64; 2]| [0, 1].map(|k| if axes[k] { offset[k] } else { 0.0 });
    let mut crop_of = vec![None; cameras.len()];
    for photo in 0..cameras.len() {
        let [x, y] = along(&offsets[photo]);
        if !is_posed[photo] || x.hypot(y) < MIN_OFFSET {
            continue;
        }
        let is_same = |&first: &usize| {
            let [u, v] = along(&offsets[first]);
            crop_of[first] == Some(first)
                && cameras[first] == cameras[photo]
                && (x - u).hypot(y - v) < SAME_CROP
        };
        crop_of[photo] = (0..photo).find(is_same).or(Some(photo));
    }
    // Nothing is known of the others: as the rest of their camera's photos, where these are alike.
    for photo in (0..cameras.len()).filter(|&photo| !is_posed[photo]) {
        let mut rest = (0..cameras.len()).filter(|&p| is_posed[p] && cameras[p] == cameras[photo]);
        let first = rest.next().and_then(|p| crop_of[p]);
        let is_alike = rest.all(|p| crop_of[p] == first);
        crop_of[photo] = if is_alike { first } else { Some(photo) };
    }
    Crops { axes, crop_of }
}

/// The model after an adjustment of all with the principal points of the crops free, which start at the mean of their
/// photos' `offsets` (shares of the longer side).
fn tried(
    matched: &mut MatchedPhotos<'_>,
    model: &Model,
    crops: &Crops,
    offsets: &[[f64; 2]],
) -> Result<(AdjustmentReport, OwnCenters), PosesError> {
    let mut photos_of: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (photo, crop) in crops.crop_of.iter().enumerate() {
        if let Some(crop) = crop {
            photos_of.entry(*crop).or_default().push(photo);
        }
    }
    let mut own = OwnCenters {
        cameras: matched.cameras.clone(),
        camera_of: matched.camera_of.clone(),
        model: model.clone(),
    };
    for photos in photos_of.values() {
        let lens = own.camera_of[photos[0]];
        let mut prior = own.cameras[lens].clone();
        let mut camera = model.cameras[lens].clone();
        prior.lens_of = Some(lens);
        prior.is_cropped = true;
        let posed: Vec<usize> = photos
            .iter()
            .copied()
            .filter(|&p| model.poses[p].is_some())
            .collect();
        let sigma = CROP_OFFSET * prior.initial.longer_side();
        for (k, is_free) in crops.axes.into_iter().enumerate() {
            let sum: f64 = posed.iter().map(|&p| offsets[p][k]).sum();
            let mean = if is_free {
                sum / posed.len().max(1) as f64
            } else {
                0.0
            };
            camera.deviation[PRINCIPAL_POINT][k] = mean * prior.initial.longer_side();
            prior.prior_sigma[PRINCIPAL_POINT][k] = is_free.then_some(sigma);
        }
        for &photo in photos {
            own.camera_of[photo] = own.cameras.len();
        }
        own.cameras.push(prior);
        own.model.cameras.push(camera);
    }
    let report = own.with(matched, adjust)?;
    Ok((report, own))
}

/// Adjusts all of a model.
fn adjust(matched: &MatchedPhotos<'_>, model: &mut Model) -> Result<AdjustmentReport, PosesError> {
    let scope = AdjustmentScope::all("principal points free", intrinsics_scope(model));
    model.adjust(matched, &scope, &BundleOptions::complete(1e-6))
}

/// A sentence for the photos that have a principal point of their own.
pub(crate) fn warning(matched: &MatchedPhotos<'_>, model: &Model) -> Option<String> {
    let posed = (0..matched.num_photos()).filter(|&p| model.poses[p].is_some());
    let offset = |photo: usize| {
        let [x, y] = model.cameras[matched.camera_of[photo]].offset();
        x.hypot(y)
    };
    let is_cropped =
        |&p: &usize| matched.cameras[matched.camera_of[p]].is_cropped && offset(p) >= MIN_OFFSET;
    let cropped: Vec<usize> = posed.filter(is_cropped).collect();
    let largest = cropped.iter().map(|&p| offset(p)).fold(0.0, f64::max);
    let names = cropped
        .iter()
        .map(|&p| matched.photos.photos[p].file_name.as_str());
    Some(format!(
        "{}: the matches say that the optical axis meets the photo up to {:.0} % of its longer side beside the middle, \
         as where they were cropped or straightened; the matches were believed",
        first_and_more(names)?,
        100.0 * largest,
    ))
}
