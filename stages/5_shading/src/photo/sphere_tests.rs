//! Reference spheres in the photo model: one that sees another light, lamps nearby, and a light fixed to the camera.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::environment::{self, LightScene};
use super::known_light::KnownLight;
use super::light::Light;
use super::rendered_tests::{World, depths, known_light, loaded, miss, options, photographed};
use super::views::Scene;
use super::{distant, surround};
use nalgebra::Point3;
use rilievo_scene::{Alone, LightKind};
use rilievo_synthetic::{BallOptions, LightModel, Subject};

/// The light at the true shape, by 128 rays.
fn light(scene: &Scene, truth: &[Vec<f64>], known: &KnownLight) -> Light {
    let level = &scene.pyramid[0];
    let light_scene = LightScene {
        known,
        ground: None,
        num_rays: 128,
        team: &Alone,
    };
    environment::visible(level, truth, &scene.pyramid[1], &light_scene)
        .unwrap()
        .unwrap()
}

/// An ellipsoid with two spheres, the second one lit as by a lamp of its own.
fn lamp_on_the_second() -> (World, World) {
    let (mut scene, render) = options(Subject::Ellipsoid, LightModel::Bounce, (200, 150));
    scene.mesh_spacing_m = 0.005;
    // To the left and before the object, near enough to hide a part of its environment.
    scene.more_spheres = vec![BallOptions {
        at_m: [-0.13, -0.10],
        radius_m: 0.04,
    }];
    let as_seen = photographed(scene.clone(), &render, None);
    let mut lamp = photographed(scene, &render, None);
    for (view, photo) in lamp.views.iter_mut().zip(&mut lamp.photos.photos) {
        for y in 0..view.image.height {
            for x in 0..view.image.width {
                if *view.sphere_masks[1].at(x, y) {
                    // Bright where the others are dark.
                    for value in view.image.pixel_mut(x, y) {
                        *value = 0.1 + 0.8 * (0.6 - *value).max(0.0);
                    }
                }
            }
        }
        photo.pixels = std::sync::Arc::new(rilievo_scene::InMemoryPixels(std::sync::Arc::new(
            view.image.clone(),
        )));
    }
    (as_seen, lamp)
}

#[test]
fn a_sphere_of_another_light_hides_and_tells_nothing() {
    let (as_seen, lamp) = lamp_on_the_second();
    let scene = loaded(&as_seen);
    let truth = depths(&as_seen, &scene);
    let level = &scene.pyramid[0];
    assert_eq!(as_seen.posed.spheres.len(), 2);
    let of = |world: &World, rejected: &[usize]| {
        known_light(&world.photos, &world.posed, LightKind::World, rejected)
    };
    let known = miss(level, &truth, &light(&scene, &truth, &of(&as_seen, &[])));

    let scene = loaded(&lamp);
    let tells = of(&lamp, &[1]);
    assert_eq!((tells.groups.len(), tells.spheres.len()), (1, 2));
    let left_out = light(&scene, &truth, &tells);
    let believed = light(&scene, &truth, &of(&lamp, &[]));
    let level = &scene.pyramid[0];
    let (left_out_miss, believed_miss) = (
        miss(level, &truth, &left_out),
        miss(level, &truth, &believed),
    );
    println!(
        "light misses {known:.4} with the sphere in one light, {left_out_miss:.4} left out, {believed_miss:.4} believed"
    );
    assert!(
        left_out_miss < 1.15 * known,
        "left out {left_out_miss}, in one light {known}"
    );
    assert!(
        left_out_miss < 0.9 * believed_miss,
        "left out {left_out_miss}, believed {believed_miss}"
    );

    // It still hides: without it the pixels next to it get another light than with it, others do not.
    let mut alone = tells;
    alone.spheres.truncate(1);
    let absent = light(&scene, &truth, &alone);
    let mut changes: Vec<f64> = (0..level.views.len())
        .flat_map(|i| {
            let pairs = left_out.harmonics[i].iter().zip(&absent.harmonics[i]);
            pairs.map(|(a, b)| f64::from((a[1][3] / b[1][3] - 1.0).abs()))
        })
        .collect();
    let median = rilievo_numerics::robust::median(&mut changes).unwrap();
    let most = rilievo_numerics::robust::quantile(&mut changes, 0.99).unwrap();
    println!("without it the light changes by {median:.4}, at most {most:.4}");
    assert!(most > 0.03 && most > 3.0 * median, "{most}, {median}");
}

#[test]
fn a_light_fixed_to_the_camera_is_found_with_its_shadows() {
    let (mut scene, mut render) = options(Subject::Bust, LightModel::Bounce, (240, 180));
    scene.mesh_spacing_m = 0.004;
    render.num_views = 3;
    render.turntable = true;
    let turned = photographed(scene, &render, None);
    let scene = loaded(&turned);
    let truth = depths(&turned, &scene);
    let level = &scene.pyramid[0];
    let nine = distant::fit(level, &truth, LightKind::Camera).unwrap();
    let nine = miss(level, &truth, &nine);
    let [camera, world] = [LightKind::Camera, LightKind::World].map(|kind| {
        let known = known_light(&turned.photos, &turned.posed, kind, &[]);
        miss(level, &truth, &light(&scene, &truth, &known))
    });
    println!(
        "nine harmonics a view {nine:.4}; rays {camera:.4}, with a light fixed in the world {world:.4}"
    );
    assert!(
        camera < 0.75 * nine && camera < 0.045,
        "{camera}, nine {nine}"
    );
    assert!(world > 1.5 * camera, "world {world}, camera {camera}");
}

/// The light of a stone on its mat under lamps at a distance, at the true shape, and what it misses.
fn lit_from(distance_m: Option<f64>, turntable: bool) -> (Option<f64>, f64) {
    let (mut scene, mut render) = options(Subject::Stone, LightModel::Bounce, (200, 150));
    scene.mesh_spacing_m = 0.006;
    render.num_views = 3;
    scene.lamps_at_m = distance_m;
    render.turntable = turntable;
    let kind = if turntable {
        LightKind::Camera
    } else {
        LightKind::World
    };
    let world = photographed(scene, &render, None);
    let scene = loaded(&world);
    let truth = depths(&world, &scene);
    let level = &scene.pyramid[0];
    let mat = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30)].map(|c| 0.02 * (c - 14.5)));
    let mat: Vec<Point3<f64>> = mat.map(|[x, y]| Point3::new(x, y, 0.0)).collect();
    let object = surround::object_points(level, &truth);
    let ground = surround::find_ground(&mat, &object, &scene.small);
    let known = known_light(&world.photos, &world.posed, kind, &[]);
    let light_scene = LightScene {
        known: &known,
        ground: ground.as_ref(),
        num_rays: 256,
        team: &Alone,
    };
    let light = environment::visible(level, &truth, &scene.pyramid[1], &light_scene);
    let light = light.unwrap().unwrap();
    (light.distance, miss(level, &truth, &light))
}

#[test]
fn lamps_nearby_light_the_object_as_well_as_far_ones() {
    let (far, usual) = lit_from(None, false);
    println!("far: {far:?}, misses {usual:.4}");
    assert_eq!(far, None);
    for turntable in [false, true] {
        let (found, misses) = lit_from(Some(0.9), turntable);
        println!(".9 m: {found:.3?}, misses {misses:.4}");
        let found = found.unwrap_or(f64::INFINITY);
        assert!((0.6..1.2).contains(&found), "{found}");
        assert!(misses < 1.25 * usual, "{misses}, far away {usual}");
    }
}
