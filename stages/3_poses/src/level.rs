//! The world's axes, where no given poses fix them.
//!
//! Where the object stands on a flat ground (a printed mat, a table): z upwards from the ground, the origin on it
//! under the object's middle, and the cameras on the side of -y, which is the front. Else the axes of the first
//! posed camera.

use crate::vertical::Vertical;
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rilievo_numerics::plane::Plane;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{PosedViews, RigidTransform, WorldFrame};

/// Fewest points inside the masks that place the object.
pub(crate) const MIN_OBJECT_POINTS: usize = 30;
/// Share of the object's points beyond its middle's box on either side: single wrong ones.
const BEYOND: f64 = 0.02;
/// Length of the mean of the directions to the cameras below which they go all round and have no side: the first one is
/// in front then.
const MIN_ONE_SIDED: f64 = 0.3;
/// Least slope at which a camera looks down on the ground, as a sine: others look past the object into the distance.
const MIN_DOWN: f64 = 0.05;

/// Turns and moves the world so that it lies as the module says; the vertical with it. `object` are the points that
/// masks show to be the object's.
pub(crate) fn apply(
    object: &[Point3<f64>],
    ground: Option<&Plane>,
    posed: &mut PosedViews,
    vertical: Option<&mut Vertical>,
) {
    let level = ground.and_then(|ground| level_from_world(object, posed, ground));
    posed.frame = match level {
        Some(_) => WorldFrame::Level,
        None => WorldFrame::FirstCamera,
    };
    let first = posed.views.first().map(|view| view.cam_from_world);
    let Some(new_from_old) = level.or(first) else {
        return;
    };
    move_world(&new_from_old, posed, vertical);
}

/// Turns and moves the world, the vertical with it.
pub(crate) fn move_world(
    new_from_old: &RigidTransform,
    posed: &mut PosedViews,
    vertical: Option<&mut Vertical>,
) {
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
        // Along the new axes, of errors that are independent along the old ones.
        let squares = Vector3::from(sphere.center_sigma).map(|s| s * s);
        let turned = new_from_old.rotation_matrix().map(|r| r * r) * squares;
        sphere.center_sigma = turned.map(f64::sqrt).into();
    }
    if let Some(vertical) = vertical {
        let up = Vector3::from(vertical.up_in_world);
        let up = match posed.frame {
            WorldFrame::Level => Vector3::z(),
            _ => new_from_old.rotation * up,
        };
        vertical.up_in_world = up.into();
    }
}

/// The way to axes on a ground whose normal points upwards; `None` where the object's place is not known.
fn level_from_world(
    object: &[Point3<f64>],
    posed: &PosedViews,
    ground: &Plane,
) -> Option<RigidTransform> {
    let up = ground.normal;
    let cameras: Vec<_> = posed.views.iter().map(|v| v.cam_from_world).collect();
    // Horizontal axes of any direction, to measure the object's sides along.
    let oblique = if up.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = oblique.cross(&up).normalize();
    let frame = Matrix3::from_rows(&[x.transpose(), up.cross(&x).transpose(), up.transpose()]);
    let middle = middle_of(object, &frame, (MIN_OBJECT_POINTS, BEYOND)).or_else(|| {
        // What most cameras look at on the ground.
        let looked_at = cameras.iter().filter_map(|pose| {
            let axis = pose.rotation.inverse() * Vector3::z();
            let (center, down) = (pose.center_in_source(), -axis.dot(&up));
            (down > MIN_DOWN).then(|| center + axis * (ground.distance(&center) / down))
        });
        let looked_at: Vec<_> = looked_at.collect();
        middle_of(&looked_at, &frame, (cameras.len().div_ceil(2), 0.5))
    })?;
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
    // Cameras right above the object have no side.
    let y = -front.try_normalize(f64::EPSILON).unwrap_or(x);
    let rows = Matrix3::from_rows(&[y.cross(&up).transpose(), y.transpose(), up.transpose()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    Some(RigidTransform {
        rotation,
        translation: -(rotation * origin.coords),
    })
}

/// Middle of the box around points along the rows of `frame`, but for a share `beyond` on each side; `None` of fewer
/// than `least`.
fn middle_of(
    points: &[Point3<f64>],
    frame: &Matrix3<f64>,
    (least, beyond): (usize, f64),
) -> Option<Point3<f64>> {
    if points.len() < least.max(1) {
        return None;
    }
    let mut middle = Vector3::zeros();
    for k in 0..3 {
        let along = frame.row(k).transpose();
        let mut places: Vec<f64> = points.iter().map(|p| along.dot(&p.coords)).collect();
        let [low, high] = [beyond, 1.0 - beyond].map(|share| quantile(&mut places, share));
        middle += along * (0.5 * (low? + high?));
    }
    Some(Point3::from(middle))
}
