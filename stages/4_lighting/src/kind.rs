//! What the light is fixed to, decided from the spheres, a known shape or the anchors in several
//! views.
//!
//! With the gains of the photos free, the scatter of `ln I` between views is compared at equal
//! normals in the world (a resting light leaves none) and at equal normals in the camera (a light
//! fixed to the camera leaves none). Views that look in nearly the same direction cannot decide.

use crate::cells::{CellMean, cell_means, two_way};
use crate::report::KindCheck;
use crate::side::Side;
use nalgebra::{UnitQuaternion, Vector3};
use rilievo_photometry::samples::NUM_CELLS;
use rilievo_scene::{LightKind, PosedViews};

/// The better kind must leave this many times less scatter.
const CLEAR: f64 = 1.5;
/// Scatter that any kind may leave: noise, compression, cells of finite size.
const UNAVOIDABLE: f64 = 0.01;
/// Cells that two views must share.
const MIN_SHARED_CELLS: usize = 10;
/// Directions of view must differ by this much, radians (6°).
const MIN_TURN: f64 = 0.1;

/// Compares both kinds on the spheres; `None` with fewer than two views of them.
pub(crate) fn check(side: &Side, stated: Option<LightKind>) -> Option<KindCheck> {
    if side.views.len() < 2 {
        return None;
    }
    let means = |in_world: bool| {
        let of_patch = side.patches.iter().map(|patch| {
            let rotation = &side.world_from_cam[patch.view];
            let whole = patch.samples.readings.iter().filter(|r| r.is_whole());
            let values = whole.map(|reading| {
                let turned = rotation * reading.normal;
                let normal = if in_world { turned } else { reading.normal };
                (normal, reading.brightness())
            });
            cell_means(patch.view, patch.sphere * NUM_CELLS, values)
        });
        of_patch.flatten().collect()
    };
    compare(&side.world_from_cam, stated, CLEAR, means)
}

/// Compares both kinds on a known shape, of which nothing is stated: normals (camera frame) and
/// brightness of every view. The surface shades itself, which scatters both ways, so that the
/// smaller scatter decides; `None` where too few normals are seen twice.
pub(crate) fn check_on_shape(
    world_from_cam: &[UnitQuaternion<f64>],
    brightness: &[Vec<(Vector3<f64>, f64)>],
) -> Option<KindCheck> {
    let means = |in_world: bool| {
        let of_view = brightness.iter().enumerate().map(|(view, samples)| {
            let values = samples.iter().map(|&(normal, value)| {
                let turned = world_from_cam[view] * normal;
                (if in_world { turned } else { normal }, value)
            });
            cell_means(view, 0, values)
        });
        of_view.flatten().collect()
    };
    compare(world_from_cam, None, 1.0, means)
}

/// `means(true)` are the cells of normals in the world, `means(false)` those in the camera; the better
/// kind must leave `clear` times less scatter.
fn compare(
    world_from_cam: &[UnitQuaternion<f64>],
    stated: Option<LightKind>,
    clear: f64,
    means: impl Fn(bool) -> Vec<CellMean>,
) -> Option<KindCheck> {
    let scatter = |in_world: bool| {
        let fit = two_way(world_from_cam.len(), &means(in_world));
        (fit.num_shared >= MIN_SHARED_CELLS).then_some(fit.scatter)
    };
    let scatters = (scatter(true)?, scatter(false)?);
    Some(judge(world_from_cam, stated, clear, scatters))
}

/// The kind that leaves clearly less scatter, of that under a light at rest and that under one on the
/// camera.
pub(crate) fn judge(
    world_from_cam: &[UnitQuaternion<f64>],
    stated: Option<LightKind>,
    clear: f64,
    (world, camera): (f64, f64),
) -> KindCheck {
    let turn = world_from_cam
        .iter()
        .skip(1)
        .map(|r| r.angle_to(&world_from_cam[0]))
        .fold(0.0, f64::max);
    let fits = if turn < MIN_TURN {
        None
    } else if camera > clear * world.max(UNAVOIDABLE) {
        Some(LightKind::World)
    } else if world > clear * camera.max(UNAVOIDABLE) {
        Some(LightKind::Camera)
    } else {
        None
    };
    KindCheck {
        stated,
        scatter_world: world,
        scatter_camera: camera,
        fits,
        contradicts: stated.is_some() && fits.is_some() && fits != stated,
    }
}

/// The kind that is stated, else the one that the data decide, else a light at rest, as it is where a
/// camera is walked around an object.
pub(crate) fn settled(stated: Option<LightKind>, check: Option<&KindCheck>) -> LightKind {
    stated.or_else(|| check?.fits).unwrap_or(LightKind::World)
}

/// Rotations of all views.
pub(crate) fn world_from_cam(posed: &PosedViews) -> Vec<UnitQuaternion<f64>> {
    let views = posed.views.iter();
    views.map(|v| v.cam_from_world.rotation.inverse()).collect()
}
