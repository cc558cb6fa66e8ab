//! Whether the spheres in several views agree with the stated kind of light.
//!
//! With the gains of the photos free, the scatter of `ln I` between views is compared at equal
//! normals in the world (a resting light leaves none) and at equal normals in the camera (a light
//! fixed to the camera leaves none). Views that look in nearly the same direction cannot tell.

use crate::cells::{CellMean, NUM_CELLS, cell_means, two_way};
use crate::report::KindCheck;
use crate::side::Side;
use nalgebra::Vector3;
use rilievo_scene::LightKind;

/// The better kind must leave this many times less scatter.
const CLEAR: f64 = 1.5;
/// Scatter that any kind may leave: noise, compression, cells of finite size.
const UNAVOIDABLE: f64 = 0.01;
/// Directions of view must differ by this much, radians (6°).
const MIN_TURN: f64 = 0.1;

/// Compares both kinds; `None` with fewer than two views of the sphere.
pub(crate) fn check(side: &Side, stated: LightKind) -> Option<KindCheck> {
    let num_views = side.views.len();
    if num_views < 2 {
        return None;
    }
    let scatter = |in_world: bool| {
        let mut means: Vec<CellMean> = Vec::new();
        for patch in &side.patches {
            let (sample, rotation) = (&patch.samples, &side.world_from_cam[patch.view]);
            let values = (0..sample.normals.len())
                .filter(|&k| !sample.usable[k].contains(&false))
                .map(|k| {
                    let normal: Vector3<f64> = sample.normals[k];
                    let normal = if in_world { rotation * normal } else { normal };
                    (normal, sample.values[k].iter().sum::<f64>())
                });
            let first_cell = patch.sphere * NUM_CELLS;
            means.extend(cell_means(patch.view, first_cell, values));
        }
        let fit = two_way(num_views, &means);
        (fit.num_shared >= 10).then_some(fit.scatter)
    };
    let turn = side
        .world_from_cam
        .iter()
        .skip(1)
        .map(|r| r.angle_to(&side.world_from_cam[0]))
        .fold(0.0, f64::max);
    let (world, camera) = (scatter(true)?, scatter(false)?);
    let fits = if turn < MIN_TURN {
        None
    } else if camera > CLEAR * world.max(UNAVOIDABLE) {
        Some(LightKind::World)
    } else if world > CLEAR * camera.max(UNAVOIDABLE) {
        Some(LightKind::Camera)
    } else {
        None
    };
    Some(KindCheck {
        stated,
        scatter_world: world,
        scatter_camera: camera,
        fits,
        contradicts: fits.is_some_and(|kind| kind != stated),
    })
}
