//! Stage 5 on posed views: what the previous stages hand over becomes depth and normals.

use nalgebra::{Point2, UnitQuaternion, Vector3};
use rilievo_scene::{
    Anchor, AnchorObservation, AnchorOrigin, Intrinsics, LightKind, LightSource, Lighting,
    LightingCalibration, Photo, PhotoSet, PosedViews, Recorder, RigidTransform, Silent,
    SphericalHarmonics, ViewIdx, ViewLighting,
};
use rilievo_shading::{ShadingError, ShadingModel, ShadingOptions, Surroundings, run};
use rilievo_synthetic::testing::{Maps, PAPER_LIGHT, PosedPhotos, on_sphere, painted, photo};
use std::sync::Arc;

const SIZE: usize = 96;

/// A unit sphere at the origin, seen from two cameras at distance 4.
struct World {
    photos: PhotoSet,
    posed: PosedViews,
    lighting: LightingCalibration,
}

fn camera() -> Intrinsics {
    let centre = (SIZE as f64 - 1.0) / 2.0;
    Intrinsics::pinhole(SIZE, SIZE, 2.0 * SIZE as f64, centre, centre)
}

/// Depth and normal (camera frame) of the sphere at a pixel.
fn sphere(pose: &RigidTransform, pixel: [f64; 2]) -> Option<(f64, Vector3<f64>)> {
    on_sphere(&pose.translation, 1.0, &camera(), pixel)
}

fn world() -> World {
    let rows = PAPER_LIGHT.map(|row| SphericalHarmonics(row.map(|l| 0.5 * l)));
    let mut lighting = LightingCalibration {
        source: LightSource::Given,
        kind: LightKind::Camera,
        environment_in_world: None,
        views: Vec::new(),
        spheres: Vec::new(),
        samples: Vec::new(),
    };
    let mut made = PosedPhotos::default();
    for (index, angle) in [0.0, 0.35].into_iter().enumerate() {
        let pose = RigidTransform {
            rotation: UnitQuaternion::from_euler_angles(0.0, angle, 0.0),
            translation: Vector3::new(0.0, 0.0, 4.0),
        };
        // The rim, where slopes grow without bound, is left out of the mask.
        let maps = Maps::of(&camera(), |pixel| {
            sphere(&pose, pixel).filter(|(_, n)| n.z < -0.35)
        });
        let image = painted(&camera(), 0.0, |pixel| {
            sphere(&pose, pixel).map(|(_, n)| rows.map(|row| row.evaluate(&n)))
        });
        let photo = Photo {
            mask: Some(Arc::new(maps.mask.packed())),
            clip_level: 5.0,
            ..photo(&format!("view{index}.png"), image, camera())
        };
        made.push(photo, pose);
        lighting.views.push(ViewLighting {
            view: ViewIdx(index),
            lighting: Lighting {
                channels: rows.to_vec(),
            },
            residual: None,
            gain: vec![1.0; 3],
        });
        for k in 0..40_usize {
            let pixel = [30.0 + ((k * 17) % 36) as f64, 30.0 + ((k * 23) % 36) as f64];
            if let Some((depth, _)) = sphere(&pose, pixel) {
                let in_cam = camera().unproject(&Point2::new(pixel[0], pixel[1]), depth);
                made.posed.anchors.push(Anchor {
                    position: pose.inverse().apply(&in_cam).into(),
                    covariance: [1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8],
                    origin: AnchorOrigin::Guided,
                    observations: vec![AnchorObservation {
                        view: ViewIdx(index),
                        pixel,
                        depth,
                        sigma_ln_depth: 1e-4,
                    }],
                });
            }
        }
    }
    World {
        photos: made.photos,
        posed: made.posed,
        lighting,
    }
}

fn paper() -> ShadingOptions {
    ShadingOptions {
        model: ShadingModel::Paper,
        ..ShadingOptions::default()
    }
}

#[test]
fn anchored_views_of_a_sphere_are_recovered_in_place() {
    let world = world();
    let told = Recorder::default();
    let (shaded, _) = run(
        &world.photos,
        &world.posed,
        &world.lighting,
        &paper(),
        Surroundings::in_memory(&told),
    )
    .expect("solvable");
    let shaded = shaded.views().unwrap();
    assert_eq!(shaded.views.len(), 2);
    assert!(told.warnings().is_empty(), "{:?}", told.warnings());
    for view in &shaded.views {
        let pose = &world.posed.views[view.view.0].cam_from_world;
        let (mut angle, mut depth, mut count) = (0.0, 0.0, 0);
        for y in 0..SIZE {
            for x in 0..SIZE {
                let (Some(n), Some((z, truth))) =
                    (view.normal.normal(x, y), sphere(pose, [x as f64, y as f64]))
                else {
                    continue;
                };
                angle += n.dot(&truth).clamp(-1.0, 1.0).acos().to_degrees();
                depth += (f64::from(*view.depth.at(x, y)) / z - 1.0).abs();
                count += 1;
            }
        }
        let (angle, depth) = (angle / f64::from(count), depth / f64::from(count));
        assert!(count > 1500, "{count}");
        // Over a radius of 48 pixels the normal turns by one to three degrees per pixel.
        assert!(angle < 2.0 && depth < 1.5e-3, "{angle} deg, depth {depth}");
    }
}

#[test]
fn a_view_without_lighting_is_named() {
    let mut world = world();
    world.lighting.views.pop();
    let error = run(
        &world.photos,
        &world.posed,
        &world.lighting,
        &paper(),
        Surroundings::in_memory(&Silent),
    );
    assert!(
        matches!(&error, Err(ShadingError::MissingLighting { view }) if view == "view1"),
        "{error:?}"
    );
}

#[test]
fn a_view_that_nothing_places_is_left_out_with_a_warning() {
    let mut world = world();
    for anchor in &mut world.posed.anchors {
        anchor.observations.retain(|o| o.view != ViewIdx(1));
    }
    let told = Recorder::default();
    let (shaded, _) = run(
        &world.photos,
        &world.posed,
        &world.lighting,
        &paper(),
        Surroundings::in_memory(&told),
    )
    .expect("the other view is solvable");
    let shaded = shaded.views().unwrap();
    assert_eq!(shaded.views.len(), 1);
    let warnings = told.warnings();
    assert!(
        warnings.len() == 1 && warnings[0].contains("view1"),
        "{warnings:?}"
    );
}
