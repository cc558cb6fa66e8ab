//! Photographs against the laws they are made by.

// Helpers outside the test functions may fail as these may.
#![allow(clippy::expect_used)]

use nalgebra::{Point2, Vector3};
use rilievo_synthetic::{
    LightModel, RenderOptions, RenderedView, Scene, SceneOptions, Subject, SyntheticError, render,
    true_tracks,
};

fn scene(subject: Subject) -> Scene {
    Scene::new(SceneOptions {
        seed: 3,
        subject,
        speckle: 0.0,
        mesh_spacing_m: 0.006,
        ..SceneOptions::default()
    })
    .expect("a usable scene")
}

fn small(light: LightModel) -> RenderOptions {
    RenderOptions {
        num_views: 3,
        width: 128,
        height: 96,
        light,
        noise: 0.0,
        shadow_rays: 32,
        ..RenderOptions::default()
    }
}

/// Object pixels whose eight neighbours lie on the object too, on one side of any depth edge.
fn inner_pixels(view: &RenderedView) -> Vec<(usize, usize)> {
    let depth = &view.depth;
    (0..depth.width * depth.height)
        .map(|i| (i % depth.width, i / depth.width))
        .filter(|&(x, y)| {
            let here = *depth.at(x, y);
            (-1..=1).all(|dy| {
                (-1..=1).all(|dx| {
                    depth
                        .get(x as isize + dx, y as isize + dy)
                        .is_some_and(|&z| z > 0.0 && (z / here - 1.0).abs() < 0.004)
                })
            })
        })
        .collect()
}

#[test]
fn harmonic_photos_obey_the_image_formation_exactly() {
    let views = render(&scene(Subject::Bust), &small(LightModel::Harmonics)).expect("photos");
    for view in &views {
        let pixels = inner_pixels(view);
        assert!(pixels.len() > 100, "{}", pixels.len());
        for (x, y) in pixels {
            let n = view.normal.normal(x, y).expect("a normal on the object");
            for (c, row) in view.lighting.channels.iter().enumerate() {
                let (seen, model) = (f64::from(view.image.pixel(x, y)[c]), row.evaluate(&n));
                assert!((seen - model).abs() < 2e-6, "({x}, {y}) {seen} {model}");
            }
        }
    }
}

#[test]
fn depth_and_normals_describe_one_surface_in_all_views() {
    let views = render(&scene(Subject::Ellipsoid), &small(LightModel::Harmonics)).expect("photos");
    let mut compared = 0;
    for (a, b) in [(0, 1), (1, 2)] {
        let (a, b) = (&views[a], &views[b]);
        for (x, y) in inner_pixels(a) {
            let n = a.normal.normal(x, y).expect("a normal");
            let pixel = Point2::new(x as f64, y as f64);
            assert!(
                n.dot(&a.intrinsics.ray(&pixel)) < 0.0,
                "({x}, {y}) faces away"
            );
            let p = a.intrinsics.unproject(&pixel, (*a.depth.at(x, y)).into());
            let world = a.cam_from_world.inverse().apply(&p);
            let in_b = b.cam_from_world.apply(&world);
            let Some(q) = b.intrinsics.project(&in_b) else {
                continue;
            };
            let (i, j) = (q.x.round(), q.y.round());
            if b.depth
                .get(i as isize, j as isize)
                .is_none_or(|&z| z == 0.0)
            {
                continue;
            }
            // The tangent plane of b's pixel must contain the point to second order.
            let m = b.normal.normal(i as usize, j as usize).expect("a normal");
            let foot = Point2::new(i, j);
            let base = b
                .intrinsics
                .unproject(&foot, (*b.depth.at(i as usize, j as usize)).into());
            if m.dot(&b.intrinsics.ray(&foot).normalize()) > -0.3 {
                continue;
            }
            let distance = m.dot(&(in_b - base)).abs();
            assert!(distance < 1.5e-3, "({x}, {y}): {distance} m");
            let in_world =
                |v: &RenderedView, n: Vector3<f64>| v.cam_from_world.rotation.inverse() * n;
            assert!(in_world(a, n).dot(&in_world(b, m)) > 0.8);
            compared += 1;
        }
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn shadows_darken_and_bounce_brightens() {
    let scene = scene(Subject::Bust);
    let mean = |light| {
        let views = render(&scene, &small(light)).expect("photos");
        let (mut sum, mut count) = (0.0, 0.0);
        for view in &views {
            for (x, y) in inner_pixels(view) {
                sum += f64::from(view.image.pixel(x, y)[1]) / view.lighting.channels[1].0[3];
                count += 1.0;
            }
        }
        sum / count
    };
    let (open, shadowed, bounced) = (
        mean(LightModel::Harmonics),
        mean(LightModel::Shadowed),
        mean(LightModel::Bounce),
    );
    assert!(
        shadowed < bounced && bounced < open && shadowed > 0.4 * open,
        "{shadowed} {bounced} {open}"
    );
}

#[test]
fn one_thread_and_three_take_the_same_photos_and_seeds_differ() {
    let photos = |threads: usize, seed: u64| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads")
            .install(|| {
                let scene = Scene::new(SceneOptions {
                    seed,
                    mesh_spacing_m: 0.01,
                    ..SceneOptions::default()
                })
                .expect("a scene");
                let options = RenderOptions {
                    num_views: 2,
                    noise: 0.01,
                    exposure_drift_ev: 0.2,
                    ..small(LightModel::Bounce)
                };
                render(&scene, &options).expect("photos")
            })
    };
    let one = photos(1, 5);
    assert_eq!(one, photos(3, 5));
    let other = photos(2, 6);
    assert!(one[0].depth != other[0].depth && one[0].gain != other[0].gain);
}

#[test]
fn true_tracks_project_where_they_say() {
    let scene = scene(Subject::Stone);
    let views = render(&scene, &small(LightModel::Harmonics)).expect("photos");
    let tracks = true_tracks(&scene.mesh, &views, 100, 1);
    assert!(tracks.len() > 50, "{}", tracks.len());
    for track in &tracks {
        for (view, pixel, depth) in &track.observations {
            let view = &views[*view];
            let p = view.cam_from_world.apply(&track.position.into());
            let q = view.intrinsics.project(&p).expect("in front");
            assert!((q.x - pixel[0]).hypot(q.y - pixel[1]) < 1e-9 && (p.z - depth).abs() < 1e-12);
        }
    }
}

#[test]
fn unusable_options_and_views_are_named() {
    let options = SceneOptions {
        height_m: f64::NAN,
        ..SceneOptions::default()
    };
    let error = Scene::new(options).err();
    assert!(
        matches!(
            &error,
            Some(SyntheticError::InvalidOption {
                option: "height_m",
                ..
            })
        ),
        "{error:?}"
    );
    let scene = scene(Subject::Ellipsoid);
    let mut options = small(LightModel::Harmonics);
    options.num_views = 0;
    let error = render(&scene, &options).err();
    assert!(
        matches!(
            &error,
            Some(SyntheticError::InvalidOption {
                option: "num_views",
                ..
            })
        ),
        "{error:?}"
    );
}
