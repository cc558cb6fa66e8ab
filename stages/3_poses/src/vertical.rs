//! The vertical of the scene, where ground or cameras show it.
//!
//! A flat ground (a printed mat, a table): the plane `n · X = d` that most points off the object lie
//! on, by random triples and a least-squares fit (`n` = the eigenvector of the smallest eigenvalue
//! of the scatter); its standard deviation is `σ_n = √(λ₀ / (N λ₁))`. A plane that stands rather
//! than lies, seen from the cameras' own upright, is a wall and does not count. Else the mean of
//! the cameras' upright directions, with EXIF's orientation, for cameras that were held level.

use nalgebra::{Point3, Vector3};
use rilievo_numerics::plane::Plane;
use rilievo_scene::{PhotoSet, PosedViews, SparsePoint};
use serde::{Deserialize, Serialize};

/// What the vertical follows from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VerticalSource {
    /// A flat ground off the object.
    Ground,
    /// How the cameras were held.
    Cameras,
}

/// The vertical of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vertical {
    /// Unit vector upwards in the world frame.
    pub up_in_world: [f64; 3],
    /// What it follows from.
    pub source: VerticalSource,
    /// Standard deviation, degrees.
    pub sigma_deg: f64,
    /// Share of the points off the object that lie on the ground.
    pub ground_share: Option<f64>,
}

/// Fewest points off the object that can make a ground.
const MIN_NUM_POINTS: usize = 30;
/// Least share of them on the ground.
const MIN_GROUND_SHARE: f64 = 0.5;
/// Distance from the plane of a point on it, as a share of the cameras' distance: paper that is not
/// quite flat, a tenth of a millimetre to a millimetre at arm's length.
const MAX_OFF_PLANE: f64 = 0.002;
const NUM_TRIPLES: usize = 300;
/// A ground's normal is nearer to the cameras' upright than this; a wall's is not.
const MAX_LEAN_DEG: f64 = 60.0;
/// Cameras whose upright directions differ more were turned at will.
const MAX_SPREAD_DEG: f64 = 25.0;

/// The vertical, and the ground with its normal upwards, among the points off the object; `None` when neither ground nor
/// cameras show it.
pub(crate) fn find(
    photos: &PhotoSet,
    posed: &PosedViews,
    off_object: &[Point3<f64>],
) -> Option<(Vertical, Option<Plane>)> {
    let (up, spread_deg) = upright(photos, posed)?;
    if let Some((vertical, ground)) = ground(posed, off_object, &up) {
        return Some((vertical, Some(ground)));
    }
    let vertical = Vertical {
        up_in_world: up.into(),
        source: VerticalSource::Cameras,
        sigma_deg: spread_deg,
        ground_share: None,
    };
    (spread_deg <= MAX_SPREAD_DEG).then_some((vertical, None))
}

/// The points that a mask shows to be the object's, and all others.
pub(crate) fn object_and_rest(
    photos: &PhotoSet,
    posed: &PosedViews,
) -> (Vec<Point3<f64>>, Vec<Point3<f64>>) {
    let on_object = |view: usize, pixel: &[f64; 2]| {
        let mask = photos.photos[posed.views[view].photo.0].mask.as_ref();
        mask.is_some_and(|m| m.contains(pixel[0].round() as isize, pixel[1].round() as isize))
    };
    let is_object = |p: &SparsePoint| p.track.iter().any(|t| on_object(t.view.0, &t.pixel));
    let (object, rest): (Vec<&SparsePoint>, Vec<&SparsePoint>) =
        posed.points.iter().partition(|p| is_object(p));
    let places = |points: Vec<&SparsePoint>| {
        let points = points.into_iter();
        points.map(|p| Point3::from(p.position)).collect()
    };
    (places(object), places(rest))
}

/// Mean upright direction of the cameras, and the RMS angle of the cameras to it, degrees.
fn upright(photos: &PhotoSet, posed: &PosedViews) -> Option<(Vector3<f64>, f64)> {
    let each: Vec<Vector3<f64>> = posed
        .views
        .iter()
        .map(|view| {
            let [x, y] = photos.photos[view.photo.0].orientation.up_in_stored();
            view.cam_from_world.rotation.inverse() * Vector3::new(x, y, 0.0)
        })
        .collect();
    let mean = each.iter().sum::<Vector3<f64>>().try_normalize(1e-6)?;
    let squares: f64 = each.iter().map(|up| up.angle(&mean).powi(2)).sum();
    let spread = (squares / each.len().max(1) as f64).sqrt();
    Some((mean, spread.to_degrees()))
}

/// The plane that most points off the object lie on.
fn ground(
    posed: &PosedViews,
    points: &[Point3<f64>],
    upright: &Vector3<f64>,
) -> Option<(Vertical, Plane)> {
    if points.len() < MIN_NUM_POINTS {
        return None;
    }
    let centers: Vec<Point3<f64>> = posed
        .views
        .iter()
        .map(|v| v.cam_from_world.center_in_source())
        .collect();
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    let middle = Point3::from(sum / points.len() as f64);
    let reach = centers.iter().map(|c| (c - middle).norm()).sum::<f64>() / centers.len() as f64;
    // The ground is seen from above.
    let ground = Plane::of_most(points, MAX_OFF_PLANE * reach, NUM_TRIPLES, |_, _| true)?;
    let ground = ground.facing(&centers);
    let share = ground.num_points as f64 / points.len() as f64;
    let leans = ground.normal.angle(upright).to_degrees() > MAX_LEAN_DEG;
    let vertical = Vertical {
        up_in_world: ground.normal.into(),
        source: VerticalSource::Ground,
        sigma_deg: ground.sigma.to_degrees(),
        ground_share: Some(share),
    };
    let is_sure = share >= MIN_GROUND_SHARE && ground.num_points >= MIN_NUM_POINTS && !leans;
    is_sure.then_some((vertical, ground))
}
