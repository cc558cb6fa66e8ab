//! Track positions by patch alignment.
//!
//! SIFT places each keypoint on its own, with an error of 0.1 to 0.6 px that grows with its size.
//! Here one sighting of a track, the one with the largest image of it, becomes the reference, at
//! the pixel nearest to its keypoint, and every other sighting is moved to where the photo looks
//! most like the reference's patch (an affine map, gain and offset free: [`align`]). The map
//! starts from the plane through the neighbouring points. Poses enter only into this start, so
//! that an adjustment on the refined positions may correct them.

mod align;
mod image;

use crate::error::PosesError;
use crate::matched::MatchedPhotos;
use crate::model::{Model, RefinedPixel, RefinedPixels};
use crate::projection::CenteredPose;
use align::{AffineMap, Template};
use image::Pyramid;
use nalgebra::{Matrix2, Matrix3, Point2, Point3, Vector2, Vector3};
use rayon::prelude::*;
use rilievo_scene::loading::map_few_at_once;
use rilievo_scene::{Flow, Intrinsics, Observer};

/// Least correlation of an aligned patch.
const MIN_CORRELATION: f32 = 0.8;
/// Largest correction of a position, in units of its standard deviation before, with a floor.
const MAX_SHIFT_SIGMAS: f64 = 5.0;
const MIN_MAX_SHIFT_PX: f64 = 1.5;
/// Samples of a patch per keypoint size: the patch spans four sizes, within limits.
const STEP_PER_SIZE: f64 = 0.25;
const MAX_STEP_PX: f64 = 4.0;
/// Error of an aligned position that its residuals do not show (relief, interpolation), pixels.
const FLOOR_SIGMA_PX: f64 = 0.04;
/// Factor of the standard deviation for the correlation of neighbouring residuals.
const CORRELATED_RESIDUALS: f64 = 3.0;
/// Neighbouring points that give the plane, and how far they may lie away in the reference.
const NUM_PLANE_POINTS: usize = 8;
const MAX_PLANE_DISTANCE_PX: f64 = 60.0;

/// Points of one reference photo by cells of its image.
struct Neighborhood {
    cells: Vec<Vec<(Point2<f64>, Point3<f64>)>>,
    num_columns: usize,
    num_rows: usize,
}

impl Neighborhood {
    fn new(matched: &MatchedPhotos<'_>, model: &Model, photo: usize) -> Self {
        let camera = &matched.photos.photos[photo].intrinsics;
        let num_columns = (camera.width as f64 / MAX_PLANE_DISTANCE_PX).ceil() as usize + 1;
        let num_rows = (camera.height as f64 / MAX_PLANE_DISTANCE_PX).ceil() as usize + 1;
        let mut cells = vec![Vec::new(); num_columns * num_rows];
        for &(track, place) in &matched.tracks_of[photo] {
            if let Some(point) = &model.points[track]
                && point.support.contains(&place)
            {
                let pixel = matched.pixel(&matched.tracks[track][place]);
                let column =
                    ((pixel.x / MAX_PLANE_DISTANCE_PX).max(0.0) as usize).min(num_columns - 1);
                let row = ((pixel.y / MAX_PLANE_DISTANCE_PX).max(0.0) as usize).min(num_rows - 1);
                cells[row * num_columns + column].push((pixel, point.position));
            }
        }
        Self {
            cells,
            num_columns,
            num_rows,
        }
    }

    /// Normal of the plane through the nearest points; `None` when they are few or on a line.
    fn normal(&self, pixel: &Point2<f64>, at: &Point3<f64>) -> Option<Vector3<f64>> {
        let column = (pixel.x / MAX_PLANE_DISTANCE_PX).max(0.0) as usize;
        let row = (pixel.y / MAX_PLANE_DISTANCE_PX).max(0.0) as usize;
        let mut near: Vec<(f64, Point3<f64>)> = Vec::new();
        for r in row.saturating_sub(1)..(row + 2).min(self.num_rows) {
            for c in column.saturating_sub(1)..(column + 2).min(self.num_columns) {
                for (p, x) in &self.cells[r * self.num_columns + c] {
                    let distance = (p - pixel).norm();
                    if distance > 1.0 && distance <= MAX_PLANE_DISTANCE_PX {
                        near.push((distance, *x));
                    }
                }
            }
        }
        if near.len() < NUM_PLANE_POINTS / 2 {
            return None;
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(NUM_PLANE_POINTS);
        let mut scatter = Matrix3::zeros();
        for (_, x) in &near {
            let d = x - at;
            scatter += d * d.transpose();
        }
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        // Two clearly longer directions make a plane.
        (eigen.eigenvalues[order[1]] > 4.0 * eigen.eigenvalues[order[0]].max(0.0))
            .then(|| eigen.eigenvectors.column(order[0]).into_owned())
    }
}

/// Affine map between two views of the plane through a point, from the reference's pixels.
fn plane_map(
    reference: (&Intrinsics, &CenteredPose),
    other: (&Intrinsics, &CenteredPose),
    pixel: &Point2<f64>,
    point: &Point3<f64>,
    normal: &Vector3<f64>,
) -> Option<AffineMap> {
    let through = |dx: f64, dy: f64| -> Option<Point2<f64>> {
        let ray = reference.1.rotation.inverse()
            * reference.0.ray(&Point2::new(pixel.x + dx, pixel.y + dy));
        let facing = ray.dot(normal);
        let depth = (point - reference.1.center).dot(normal) / facing;
        let on_plane = reference.1.center + ray * depth;
        (depth.is_finite() && depth > 0.0)
            .then(|| other.0.project(&other.1.apply(&on_plane)))
            .flatten()
    };
    const REACH_PX: f64 = 4.0;
    let (left, right) = (through(-REACH_PX, 0.0)?, through(REACH_PX, 0.0)?);
    let (above, below) = (through(0.0, -REACH_PX)?, through(0.0, REACH_PX)?);
    let center = through(0.0, 0.0)?;
    let (dx, dy) = (
        (right - left) / (2.0 * REACH_PX),
        (below - above) / (2.0 * REACH_PX),
    );
    let linear = Matrix2::new(dx.x as f32, dy.x as f32, dx.y as f32, dy.y as f32);
    // A patch seen from its edge cannot be compared.
    let area = linear.determinant();
    (area > 0.1 && area < 10.0).then(|| AffineMap {
        linear,
        center: Vector2::new(center.x as f32, center.y as f32),
    })
}

/// Templates that are held at once: 8 kB each.
const MAX_NUM_TEMPLATES: usize = 20_000;

/// The reference's patch of a track.
struct Patch {
    track: usize,
    /// Place of the reference in the track.
    reference: usize,
    /// Its pixel, whole.
    pixel: Point2<f64>,
    template: Template,
    /// Planes that the patch may lie on.
    normals: Vec<Vector3<f64>>,
}

/// Refined pixels of all tracks of a model; `None` where a sighting did not align.
///
/// Photos are looked at one after the other, `at_once` at a time, each once for the patches that it gives and once
/// for those that are sought in it.
///
/// # Errors
/// When a photo cannot be read or the observer asked to stop.
pub(crate) fn refine_tracks(
    matched: &MatchedPhotos<'_>,
    model: &Model,
    at_once: usize,
    observer: &dyn Observer,
) -> Result<RefinedPixels, PosesError> {
    let cameras = model.intrinsics();
    let mut refined: RefinedPixels = matched.tracks.iter().map(|t| vec![None; t.len()]).collect();
    // Track and place of its reference, by photo, so that photos near each other come together.
    let mut references: Vec<(usize, usize, usize)> = (0..matched.tracks.len())
        .filter_map(|track| {
            let place = reference(matched, model, track)?;
            Some((matched.tracks[track][place].photo, track, place))
        })
        .collect();
    references.sort_unstable();
    for batch in references.chunks(MAX_NUM_TEMPLATES) {
        let given: Vec<&[(usize, usize, usize)]> = batch.chunk_by(|a, b| a.0 == b.0).collect();
        let patches: Vec<Vec<Patch>> = map_few_at_once(&given, at_once, |list| {
            let photo = list[0].0;
            let pyramid = load(matched, photo, observer)?;
            let neighborhood = Neighborhood::new(matched, model, photo);
            let patch = |&(_, track, place): &(usize, usize, usize)| {
                Patch::new(matched, model, &pyramid, &neighborhood, (track, place))
            };
            Ok::<_, PosesError>(list.par_iter().filter_map(patch).collect())
        })?;
        let patches: Vec<Patch> = patches.into_iter().flatten().collect();
        // Photo, patch, and place in the track of what is sought there.
        let mut sought = Vec::new();
        for (k, patch) in patches.iter().enumerate() {
            refined[patch.track][patch.reference] = Some((patch.pixel, FLOOR_SIGMA_PX));
            for place in model.points[patch.track].iter().flat_map(|p| &p.support) {
                if *place != patch.reference {
                    sought.push((matched.tracks[patch.track][*place].photo, k, *place));
                }
            }
        }
        sought.sort_unstable();
        let sought: Vec<&[(usize, usize, usize)]> = sought.chunk_by(|a, b| a.0 == b.0).collect();
        let found = map_few_at_once(&sought, at_once, |list| {
            let pyramid = load(matched, list[0].0, observer)?;
            let find = |&(_, patch, place): &(usize, usize, usize)| {
                patches[patch].find(matched, model, &cameras, &pyramid, place)
            };
            Ok::<_, PosesError>(list.par_iter().map(find).collect::<Vec<_>>())
        })?;
        for (list, found) in sought.into_iter().zip(found) {
            for (&(_, patch, place), pixel) in list.iter().zip(found) {
                refined[patches[patch].track][place] = pixel;
            }
        }
    }
    Ok(refined)
}

fn load(
    matched: &MatchedPhotos<'_>,
    photo: usize,
    observer: &dyn Observer,
) -> Result<Pyramid, PosesError> {
    if observer.flow() == Flow::Stop {
        return Err(PosesError::Interrupted);
    }
    Ok(Pyramid::new(&*matched.photos.photos[photo].linear()?))
}

/// Size of a sighting's keypoint, pixels.
fn keypoint_size(matched: &MatchedPhotos<'_>, track: usize, place: usize) -> f64 {
    let s = &matched.tracks[track][place];
    f64::from(matched.matches.photos[s.photo].keypoints[s.keypoint as usize].size_px)
}

/// The sighting with the largest image of a track's point.
fn reference(matched: &MatchedPhotos<'_>, model: &Model, track: usize) -> Option<usize> {
    let support = &model.points[track].as_ref()?.support;
    let size = |place: usize| keypoint_size(matched, track, place);
    support
        .iter()
        .copied()
        .reduce(|a, b| if size(b) > size(a) { b } else { a })
}

impl Patch {
    fn new(
        matched: &MatchedPhotos<'_>,
        model: &Model,
        pyramid: &Pyramid,
        neighborhood: &Neighborhood,
        (track, reference): (usize, usize),
    ) -> Option<Self> {
        let sightings = &matched.tracks[track];
        let point = model.points[track].as_ref()?;
        let keypoint = matched.pixel(&sightings[reference]);
        let pixel = Point2::new(keypoint.x.round(), keypoint.y.round());
        let step = STEP_PER_SIZE * keypoint_size(matched, track, reference);
        let template = Template::new(
            pyramid,
            pixel.x as f32,
            pixel.y as f32,
            step.clamp(1.0, MAX_STEP_PX) as f32,
        )?;
        // Besides the plane of the neighbours, one that faces the cameras: at depth edges the
        // neighbours mislead.
        let mut facing = Vector3::zeros();
        for &place in &point.support {
            let center = model.poses[sightings[place].photo]?.center;
            facing += (center - point.position).normalize();
        }
        let mut normals = vec![facing.normalize()];
        normals.extend(neighborhood.normal(&keypoint, &point.position));
        Some(Self {
            track,
            reference,
            pixel,
            template,
            normals,
        })
    }

    /// Where another photo of the track shows the patch.
    fn find(
        &self,
        matched: &MatchedPhotos<'_>,
        model: &Model,
        cameras: &[Intrinsics],
        image: &Pyramid,
        place: usize,
    ) -> RefinedPixel {
        let sightings = &matched.tracks[self.track];
        let point = model.points[self.track].as_ref()?;
        let view = |place: usize| -> Option<(&Intrinsics, &CenteredPose)> {
            let photo = sightings[place].photo;
            Some((
                &cameras[matched.camera_of[photo]],
                model.poses[photo].as_ref()?,
            ))
        };
        let (own, other) = (view(self.reference)?, view(place)?);
        // Where the plane puts the centre, moved by the keypoints' own disagreement.
        let best = self
            .normals
            .iter()
            .filter_map(|normal| {
                let map = plane_map(own, other, &self.pixel, &point.position, normal)?;
                Some((self.template.correlate(image, &map)?, map))
            })
            .reduce(|a, b| if b.0 > a.0 { b } else { a });
        let (_, start) = best?;
        let sigma_px = |place: usize| matched.sigma_px(&sightings[place]);
        let reach = sigma_px(place).hypot(sigma_px(self.reference));
        let max_shift_px = (MAX_SHIFT_SIGMAS * reach).max(MIN_MAX_SHIFT_PX);
        let aligned = self.template.align(image, start, max_shift_px as f32)?;
        if aligned.correlation < MIN_CORRELATION {
            return None;
        }
        let sigma = (CORRELATED_RESIDUALS * f64::from(aligned.sigma_px)).hypot(FLOOR_SIGMA_PX);
        let at = Point2::new(f64::from(aligned.center.x), f64::from(aligned.center.y));
        Some((at, sigma))
    }
}
