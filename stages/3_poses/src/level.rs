//! The world's axes, where no given poses fix them.
//!
//! Where the object stands on a flat ground (a printed mat, a table): z upwards from the ground, the origin on it
//! under the object's middle, and the cameras on the side of -y, which is the front. Else the axes of the first
//! posed camera.

use crate::vertical::{Vertical, object_and_rest};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rilievo_numerics::lines::nearest_point;
use rilievo_numerics::plane::Plane;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{PhotoSet, PosedViews, RigidTransform, WorldFrame};

/// Fewest points inside the masks that tell where the object is.
const MIN_OBJECT_POINTS: usize = 30;
/// Share of the object's points beyond its middle's box on either side: single wrong ones.
const BEYOND: f64 = 0.02;
/// Cameras that stand nearer together around the object than this share of their distance, as a mean of directions,
/// go all round and have no side: the first one is in front then.
const MIN_ONE_SIDED: f64 = 0.3;

/// Turns and moves the world so that it lies as the module says; the vertical with it.
pub fn apply(
    photos: &PhotoSet,
    ground: Option<&Plane>,
    posed: &mut PosedViews,
    vertical: Option<&mut Vertical>,
) {
    let level = ground.and_then(|ground| level_from_world(photos, posed, ground));
    posed.frame = match level {
        Some(_) => WorldFrame::Level,
        None => WorldFrame::FirstCamera,
    };
    let first = posed.views.first().map(|view| view.cam_from_world);
    let Some(new_from_old) = level.or(first) else {
        return;
    };
    let old_from_new = new_from_old.inverse();
    for view in &mut posed.views {
        view.cam_from_world = view.cam_from_world.compose(&old_from_new);
    }
    let moved = |at: [f64; 3]| -> [f64; 3] { new_from_old.apply(&Point3::from(at)).into() };
    for point in &mut posed.points {
        point.position = moved(point.position);
    }
    for sphere in &mut posed.spheres {
        sphere.center_in_world = moved(sphere.center_in_world);
    }
    if let Some(vertical) = vertical {
        let up = Vector3::from(vertical.up_in_world);
        vertical.up_in_world = (new_from_old.rotation * up).into();
    }
}

/// The way to axes on a ground whose normal points upwards; `None` where the object's place is not known.
fn level_from_world(
    photos: &PhotoSet,
    posed: &PosedViews,
    ground: &Plane,
) -> Option<RigidTransform> {
    let up = ground.normal;
    let cameras: Vec<_> = posed.views.iter().map(|v| v.cam_from_world).collect();
    let axis = |pose: &RigidTransform| pose.rotation.inverse() * Vector3::z();
    let focus = nearest_point(cameras.iter().map(|c| (c.center_in_source(), axis(c))))?;
    // Horizontal axes of any direction, to measure the object's sides along.
    let any = focus - cameras.first()?.center_in_source();
    let x = up.cross(&any).try_normalize(1e-9 * any.norm())?;
    let frame = Matrix3::from_rows(&[x.transpose(), up.cross(&x).transpose(), up.transpose()]);
    let (object, _) = object_and_rest(photos, posed);
    let middle = middle_of(&object, &frame).unwrap_or(focus);
    let origin = middle - up * ground.distance(&middle);

    let across = |v: Vector3<f64>| v - up * up.dot(&v);
    let towards = |pose: &RigidTransform| across(pose.center_in_source() - origin);
    let mean = cameras
        .iter()
        .map(|c| towards(c).try_normalize(0.0).unwrap_or_default())
        .sum::<Vector3<f64>>()
        / cameras.len() as f64;
    let is_one_sided = mean.norm() > MIN_ONE_SIDED;
    let front = if is_one_sided {
        mean
    } else {
        towards(&cameras[0])
    };
    let y = -front.try_normalize(1e-9 * any.norm())?;
    let rows = Matrix3::from_rows(&[y.cross(&up).transpose(), y.transpose(), up.transpose()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    Some(RigidTransform {
        rotation,
        translation: -(rotation * origin.coords),
    })
}

/// Middle of the box around points along the rows of `frame`; `None` of few.
fn middle_of(points: &[Point3<f64>], frame: &Matrix3<f64>) -> Option<Point3<f64>> {
    if points.len() < MIN_OBJECT_POINTS {
        return None;
    }
    let mut middle = Vector3::zeros();
    for k in 0..3 {
        let along = frame.row(k).transpose();
        let mut places: Vec<f64> = points.iter().map(|p| along.dot(&p.coords)).collect();
        let [low, high] = [BEYOND, 1.0 - BEYOND].map(|share| quantile(&mut places, share));
        middle += along * (0.5 * (low? + high?));
    }
    Some(Point3::from(middle))
}
