//! Where the photographer stands: on an arc around the object, by hand rather than by machine.

use crate::noise::unit;
use crate::options::RenderOptions;
use crate::scene::Scene;
use nalgebra::{Matrix3, Point2, Point3, Rotation3, Vector3};
use rilievo_scene::{Distortion, Intrinsics, RigidTransform};

/// Focal length in widths of the image: that of a standard lens.
const FOCAL_IN_WIDTHS: f64 = 1.35;
/// Mean height of the cameras over the horizon, degrees: front and top of the object are seen, and
/// the mat.
const ELEVATION_DEG: f64 = 24.0;

/// Pose of a camera at `center` that looks at `target`, the horizon turned by `roll`.
pub(crate) fn look_at(center: &Point3<f64>, target: &Point3<f64>, roll: f64) -> RigidTransform {
    let forward = (target - center).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let (sin, cos) = roll.sin_cos();
    let axes = [right * cos + down * sin, down * cos - right * sin, forward];
    RigidTransform::from_world_pose(
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes)),
        *center,
    )
}

pub(crate) fn intrinsics(options: &RenderOptions) -> Intrinsics {
    Intrinsics {
        distortion: Distortion::plain(options.distortion),
        ..Intrinsics::pinhole(
            options.width,
            options.height,
            FOCAL_IN_WIDTHS * options.width as f64,
            0.5 * (options.width as f64 - 1.0),
            0.5 * (options.height as f64 - 1.0),
        )
    }
}

/// Poses on the arc, near enough that object and sphere fill the frame of every view.
pub(crate) fn place(scene: &Scene, options: &RenderOptions) -> Vec<RigidTransform> {
    let outline = scene.outline();
    let camera = intrinsics(options);
    let step = if options.arc_deg >= 360.0 {
        options.arc_deg / options.num_views as f64
    } else {
        options.arc_deg / (options.num_views.max(2) - 1) as f64
    };
    let poses = |distance: f64| -> Vec<RigidTransform> {
        (0..options.num_views)
            .map(|i| {
                let jitter = |item: u32| {
                    if options.turntable {
                        return 0.0;
                    }
                    2.0 * unit([scene.options.seed as u32, i as u32, item, 11]) - 1.0
                };
                let first = -0.5 * step * (options.num_views - 1) as f64;
                let azimuth = (first + step * i as f64 + 0.12 * step * jitter(0)).to_radians();
                let elevation = (ELEVATION_DEG + 4.0 * jitter(1)).to_radians();
                let direction = Vector3::new(
                    azimuth.sin() * elevation.cos(),
                    -azimuth.cos() * elevation.cos(),
                    elevation.sin(),
                );
                let mut standing = middle(outline.iter().copied());
                if options.turntable {
                    (standing.x, standing.y) = (0.0, 0.0);
                }
                let center = standing + direction * (distance * (1.0 + 0.03 * jitter(2)));
                let roll = 0.02 * jitter(6);
                if options.turntable {
                    return look_at(&center, &standing, roll);
                }
                // The middle of what the camera sees comes to the middle of the frame.
                let first_look = look_at(&center, &standing, roll);
                let rays = outline.iter().map(|p| {
                    let q = first_look.apply(p);
                    Point3::new(q.x / q.z, q.y / q.z, 1.0)
                });
                let aim = first_look.inverse().apply(&middle(rays));
                let wobble = Vector3::new(jitter(3), jitter(4), jitter(5)) * 0.008;
                look_at(&center, &(aim + wobble), roll)
            })
            .collect()
    };
    let fits = |poses: &[RigidTransform]| {
        poses.iter().all(|pose| {
            outline.iter().all(|point| {
                camera
                    .project(&pose.apply(point))
                    .is_some_and(|p: Point2<f64>| {
                        (p.x - camera.cx).abs() < 0.5 * options.fill * camera.width as f64
                            && (p.y - camera.cy).abs() < 0.5 * options.fill * camera.height as f64
                    })
            })
        })
    };
    let mut distance = 1.2 * scene.options.height_m;
    let mut placed = poses(distance);
    // The bound ends the search for lenses that cannot hold the object at any distance.
    while !fits(&placed) && distance < 1000.0 * scene.options.height_m {
        distance *= 1.02;
        placed = poses(distance);
    }
    placed
}

/// Centre of the box around points.
fn middle(points: impl Iterator<Item = Point3<f64>>) -> Point3<f64> {
    let start = (
        Vector3::repeat(f64::INFINITY),
        Vector3::repeat(f64::NEG_INFINITY),
    );
    let (low, high) = points.fold(start, |(low, high), p| {
        (low.inf(&p.coords), high.sup(&p.coords))
    });
    Point3::from(0.5 * (low + high))
}
