//! Poses and light that were damaged between the stages: an error that says so, or a result, never a
//! panic.

use rilievo_lighting::{LightingError, LightingOptions, LightingRequest, overlays, run};
use rilievo_photometry::surface_check::check;
use rilievo_scene::{Silent, SphereRequest, StageId};
use rilievo_synthetic::testing::{Random, mutated, sphere_world};

fn options() -> LightingOptions {
    LightingOptions {
        min_num_pixels: 30,
        ..LightingOptions::default()
    }
}

#[test]
fn the_undamaged_world_has_a_light() {
    let world = sphere_world();
    let request = LightingRequest::Sphere(SphereRequest::default());
    let found = run(&world.photos, &world.posed, &request, &options(), &Silent);
    assert_eq!(found.unwrap().0.views.len(), 3);
}

#[test]
fn a_pose_that_belongs_to_no_photo_is_named() {
    let world = sphere_world();
    let mut posed = world.posed.clone();
    posed.views[1].photo.0 = 7;
    let request = LightingRequest::OwnShape;
    match run(&world.photos, &posed, &request, &options(), &Silent) {
        Err(LightingError::Inconsistent(error)) => {
            assert_eq!(error.made_by, StageId::Poses);
            assert_eq!(error.reason, "v1.png is photo 7 of 3");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn poses_and_light_changed_at_random_never_end_in_a_panic() {
    let world = sphere_world();
    let mut random = Random(4);
    let (mut tried, mut refused) = (0, 0);
    while tried < 50 {
        let (Some((posed, place)), Some((light, where_light))) = (
            mutated(&world.posed, &mut random),
            mutated(&world.lighting, &mut random),
        ) else {
            continue;
        };
        tried += 1;
        println!("{place}, {where_light}");
        let (photos, options) = (&world.photos, options());
        let sphere = LightingRequest::Sphere(SphereRequest::default());
        for request in [sphere, LightingRequest::OwnShape] {
            match run(photos, &posed, &request, &options, &Silent) {
                Ok((found, _)) => found.check(&posed).unwrap(),
                Err(LightingError::Inconsistent(_)) => refused += 1,
                Err(_) => {}
            }
        }
        let (posed, shaded) = (&world.posed, &world.shaded);
        let used = (light.source, light.views.as_slice());
        let _ = check(photos, posed, used, shaded, &Silent);
        let _ = overlays(photos, posed, &light);
    }
    assert!(refused > 10 && refused < 2 * tried, "{refused} of {tried}");
}
