//! What is known of the light point by point, for a solver whose light has shadows and bounce: nine
//! harmonics cannot be separated into what comes from the environment and what is hidden.

use crate::side::Side;
use nalgebra::Vector3;
use rilievo_photometry::samples::{SphereSamples, light_samples};
use rilievo_photometry::visibility::directions;
use rilievo_scene::{LightKind, LightSample, Lighting, PosedViews, ViewIdx, ViewLighting};

/// Normals at which given harmonics are read.
const NUM_DIRECTIONS: usize = 800;
/// Smallest cosine against the direction of view of those normals: harmonics fitted on what a photo shows
/// say nothing of what it does not.
const MIN_COSINE: f64 = 0.25;

/// Means of all spheres' pixels over cells of normals, view by view.
pub(crate) fn of_spheres(side: &Side) -> Vec<LightSample> {
    let patches = side.patches.iter();
    patches
        .flat_map(|patch| {
            let view = ViewIdx(side.views[patch.view]);
            let world_from_cam = &side.world_from_cam[patch.view];
            light_samples(
                &patch.samples,
                world_from_cam,
                view,
                (Some(patch.sphere), true),
            )
        })
        .collect()
}

/// Means over cells of a sphere that stood in the object's place before the camera of a view. A light
/// fixed to the camera falls on the object as every view sees it.
pub(crate) fn of_calibration(
    samples: &SphereSamples,
    camera: ViewIdx,
    kind: LightKind,
    posed: &PosedViews,
) -> Vec<LightSample> {
    let seen_by = match kind {
        LightKind::World => camera.0..camera.0 + 1,
        LightKind::Camera => 0..posed.views.len(),
    };
    seen_by
        .flat_map(|view| {
            let world_from_cam = posed.views[view].cam_from_world.rotation.inverse();
            light_samples(samples, &world_from_cam, ViewIdx(view), (None, false))
        })
        .collect()
}

/// Given harmonics, read at the normals that a view can show: of a light fixed in the world each normal in
/// one of the views that can, in turn; of one fixed to the camera in all of them.
pub(crate) fn of_harmonics(
    views: &[ViewLighting],
    kind: LightKind,
    posed: &PosedViews,
) -> Vec<LightSample> {
    let mut samples = Vec::new();
    for (k, direction) in directions(NUM_DIRECTIONS).iter().enumerate() {
        let normal = direction.map(f64::from).normalize();
        let facing: Vec<(&ViewLighting, Vector3<f64>)> = views
            .iter()
            .map(|entry| {
                (
                    entry,
                    posed.views[entry.view.0].cam_from_world.rotation * normal,
                )
            })
            .filter(|(_, in_camera)| -in_camera.z > MIN_COSINE)
            .collect();
        let read = match kind {
            LightKind::World if !facing.is_empty() => {
                let turn = k % facing.len();
                turn..turn + 1
            }
            _ => 0..facing.len(),
        };
        samples.extend(facing[read].iter().map(|(entry, in_camera)| LightSample {
            view: entry.view,
            sphere: None,
            normal_in_world: normal.map(|v| v as f32).into(),
            intensity: intensity(&entry.lighting, in_camera),
            has_gain: true,
        }));
    }
    samples
}

/// Harmonics of a light from one side undershoot zero on the other.
fn intensity(lighting: &Lighting, normal: &Vector3<f64>) -> [f32; 3] {
    let last = lighting.channels.len() - 1;
    std::array::from_fn(|c| lighting.channels[c.min(last)].evaluate(normal).max(0.0) as f32)
}
