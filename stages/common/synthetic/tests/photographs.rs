//! Photographs against the laws they are made by.

// Helpers outside the test functions may fail as these may.
#![allow(clippy::expect_used)]

use nalgebra::{Point2, Vector3};
use rilievo_synthetic::{
    BallOptions, LightModel, RenderOptions, RenderedView, Scene, SceneOptions, Subject,
    SyntheticError, render, true_tracks,
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
    let options = RenderOptions {
        width: 256,
        height: 192,
        ..small(LightModel::Harmonics)
    };
    let views = render(&scene(Subject::Bust), &options).expect("photos");
    for view in &views {
        let pixels = inner_pixels(view);
        assert!(pixels.len() > 500, "{}", pixels.len());
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
fn a_given_mesh_is_photographed_as_the_shape_that_it_was_made_of() {
    // Without relief, which a mesh of this spacing cannot hold.
    let options = SceneOptions {
        relief: 0.0,
        ..scene(Subject::Ellipsoid).options
    };
    let made = Scene::new(options).expect("a usable scene");
    let mut mesh = made.mesh.clone();
    // Of any size, anywhere, without normals: it is put onto the mat.
    for vertex in &mut mesh.vertices {
        *vertex = vertex.map(|c| 7.0 * c + 3.0);
    }
    mesh.normals.clear();
    let given = Scene::with_mesh(made.options.clone(), mesh).expect("a usable mesh");
    let options = small(LightModel::Harmonics);
    let (a, b) = (
        render(&made, &options).expect("photos"),
        render(&given, &options).expect("photos"),
    );
    let (mut worst_depth, mut angles) = (0.0f64, Vec::new());
    for (a, b) in a.iter().zip(&b) {
        for (x, y) in inner_pixels(a) {
            let (z, other) = (f64::from(*a.depth.at(x, y)), f64::from(*b.depth.at(x, y)));
            worst_depth = worst_depth.max((other / z - 1.0).abs());
            let n = a.normal.normal(x, y).expect("a normal");
            let other = b.normal.normal(x, y).expect("a normal");
            angles.push(n.angle(&other).to_degrees());
        }
    }
    angles.sort_by(f64::total_cmp);
    let median = angles[angles.len() / 2];
    // Chords of 6 mm on a body 24 cm high.
    assert!(worst_depth < 5e-3, "{worst_depth}");
    assert!(median < 1.0, "{median} degrees");

    for (broken, reason) in [
        (rilievo_scene::Mesh::default(), "no triangles"),
        (
            rilievo_scene::Mesh {
                vertices: vec![[0.0; 3]; 3],
                triangles: vec![[0, 1, 3]],
                ..Default::default()
            },
            "corner 3",
        ),
    ] {
        let error = Scene::with_mesh(made.options.clone(), broken).unwrap_err();
        assert!(error.to_string().contains(reason), "{error}");
    }
}

#[test]
fn stains_darken_a_part_and_gloss_adds_light_where_it_is_grazed() {
    let with = |stains: f64, gloss: f64| {
        let options = SceneOptions {
            stains,
            gloss,
            ..scene(Subject::Ellipsoid).options
        };
        let scene = Scene::new(options).expect("a usable scene");
        let mut options = small(LightModel::Harmonics);
        options.num_views = 1;
        render(&scene, &options).expect("photos").remove(0)
    };
    let (plain, stained, glossy) = (with(0.0, 0.0), with(0.4, 0.0), with(0.0, 1.0));
    let pixels = inner_pixels(&plain);
    let ratio = |view: &RenderedView, x, y, c| {
        f64::from(view.image.pixel(x, y)[c]) / f64::from(plain.image.pixel(x, y)[c])
    };
    let dark = pixels
        .iter()
        .filter(|&&(x, y)| ratio(&stained, x, y, 2) < 0.9)
        .count();
    let share = dark as f64 / pixels.len() as f64;
    assert!((0.05..0.7).contains(&share), "{share}");
    for &(x, y) in &pixels {
        let [red, blue] = [0, 2].map(|c| ratio(&stained, x, y, c));
        assert!(
            (0.59..=1.001).contains(&blue) && blue <= red + 1e-6,
            "{red} {blue}"
        );
        assert!(ratio(&glossy, x, y, 1) >= 0.999, "({x}, {y})");
    }
    let added: f64 = pixels
        .iter()
        .map(|&(x, y)| ratio(&glossy, x, y, 1) - 1.0)
        .sum();
    let mean = added / pixels.len() as f64;
    assert!((0.01..0.5).contains(&mean), "{mean}");
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
            Some(SyntheticError::InvalidOption(e)) if e.key == "height_m"
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
            Some(SyntheticError::InvalidOption(e)) if e.key == "num_views"
        ),
        "{error:?}"
    );
}

#[test]
fn spheres_in_the_object_or_in_each_other_are_refused() {
    let with = |at_m: [[f64; 2]; 2]| {
        Scene::new(SceneOptions {
            subject: Subject::Ellipsoid,
            mesh_spacing_m: 0.012,
            more_spheres: at_m
                .map(|at_m| BallOptions {
                    at_m,
                    radius_m: 0.02,
                })
                .to_vec(),
            ..SceneOptions::default()
        })
    };
    assert!(with([[-0.19, -0.05], [-0.19, -0.10]]).is_ok());
    let first = [0.62 * 0.24 + 0.03, -0.12 * 0.24];
    for (places, expected) in [
        ([[-0.19, -0.05], [-0.19, -0.08]], "beside the other spheres"),
        ([[-0.19, -0.05], first], "beside the other spheres"),
        ([[-0.19, -0.05], [0.0, 0.0]], "beside the object"),
    ] {
        let told = with(places).map(|_| ()).unwrap_err().to_string();
        assert!(
            told.contains("more_spheres.at_m") && told.contains(expected),
            "{told}"
        );
    }
}

#[test]
fn a_turntable_keeps_the_light_with_the_camera_and_fill_cuts_the_object() {
    let scene = scene(Subject::Ellipsoid);
    let photos = |turntable: bool, fill: f64| {
        let options = RenderOptions {
            turntable,
            fill,
            ..small(LightModel::Shadowed)
        };
        render(&scene, &options).expect("photos")
    };
    // Largest difference between the views' light in the camera's frame, over its mean.
    let spread = |views: &[RenderedView]| {
        let row = |v: &RenderedView| v.lighting.channels[1].0;
        let first = row(&views[0]);
        let others = views.iter().flat_map(|v| {
            let own = row(v);
            (0..9).map(move |k| ((own[k] - first[k]) / first[3]).abs())
        });
        others.fold(0.0, f64::max)
    };
    let (still, turned) = (photos(false, 0.9), photos(true, 0.9));
    let (moving, fixed) = (spread(&still), spread(&turned));
    assert!(fixed < 0.02 && moving > 0.2, "{fixed} {moving}");
    let touches = |view: &RenderedView| {
        let mask = &view.object_mask;
        (0..mask.height).any(|y| *mask.at(0, y) || *mask.at(mask.width - 1, y))
            || (0..mask.width).any(|x| *mask.at(x, 0) || *mask.at(x, mask.height - 1))
    };
    assert!(!still.iter().any(touches));
    assert!(photos(false, 2.5).iter().all(touches));
}
