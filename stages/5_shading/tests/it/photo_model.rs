//! The photo model on photographs of a stained ball that the test renders itself.

use nalgebra::{Point3, Rotation3, Vector3};
use rilievo_scene::{
    Intrinsics, LightKind, LightSource, LightingCalibration, Photo, PhotoSet, PosedViews,
    RigidTransform, Silent,
};
use rilievo_shading::photo::{self, Effort, PhotoOptions};
use rilievo_shading::{ShadingError, Surroundings};
use rilievo_synthetic::testing::{Maps, PosedPhotos, on_sphere, painted, photo};
use std::sync::Arc;

const SIDE: usize = 120;
const FOCAL_PX: f64 = 260.0;

struct Rendered {
    photos: PhotoSet,
    posed: PosedViews,
    truth: Vec<Maps>,
}

/// Albedo of a surface point: smooth stains of several sizes.
fn albedo(n: &Vector3<f64>) -> f64 {
    0.6 + 0.08 * (9.0 * n.x + 4.0 * n.y).sin() * (11.0 * n.y - 3.0 * n.z).cos()
        + 0.08 * (23.0 * n.y + 5.0 * n.x).sin() * (19.0 * n.z + 7.0 * n.x).sin()
}

/// Views of a ball of radius 0.5 from a circle of radius 2, exposures as given.
fn ball(exposures: &[f64]) -> Rendered {
    let light = Vector3::new(0.3, -0.8, -0.5).normalize();
    let (mut made, mut truth) = (PosedPhotos::default(), Vec::new());
    let middle = (SIDE as f64 - 1.0) / 2.0;
    let camera = Intrinsics::pinhole(SIDE, SIDE, FOCAL_PX * 0.75, middle, middle);
    for (i, exposure) in exposures.iter().enumerate() {
        let angle = 0.3 * (i as f64 - 0.5 * (exposures.len() as f64 - 1.0));
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), angle);
        let center = Point3::from(turn * Vector3::new(0.0, 0.0, -2.0));
        let pose = RigidTransform::from_world_pose(turn, center);
        let surface = |pixel| on_sphere(&pose.translation, 0.5, &camera, pixel);
        let image = painted(&camera, 0.0, |pixel| {
            let (_, normal) = surface(pixel)?;
            let n = turn * normal;
            let shade = 0.3 + 0.6 * (0.5 + 0.5 * n.dot(&light));
            Some([exposure * shade * albedo(&n)])
        });
        let maps = Maps::of(&camera, surface);
        let photo = Photo {
            mask: Some(Arc::new(maps.mask.packed())),
            ..photo(&format!("view{i}.png"), image, camera)
        };
        made.push(photo, pose);
        truth.push(maps);
    }
    Rendered {
        photos: made.photos,
        posed: made.posed,
        truth,
    }
}

fn no_light() -> LightingCalibration {
    LightingCalibration {
        source: LightSource::OwnShape,
        kind: LightKind::World,
        environment_in_world: None,
        views: Vec::new(),
        spheres: Vec::new(),
        samples: Vec::new(),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    rilievo_numerics::robust::median(&mut values).unwrap_or(f64::NAN)
}

fn small() -> PhotoOptions {
    PhotoOptions {
        num_outer_iterations: 1,
        effort: Effort {
            coarse_pixels: 4000,
            num_rays: 32,
            ..Effort::default()
        },
        ..PhotoOptions::default()
    }
}

fn shaped(
    photos: &PhotoSet,
    posed: &PosedViews,
) -> Result<(photo::ShapedViews, photo::PhotoReport), ShadingError> {
    photo::run(
        photos,
        posed,
        &no_light(),
        &small(),
        Surroundings::in_memory(&Silent),
    )
}

#[test]
fn a_stained_ball_is_found_with_its_exposures() {
    let scene = ball(&[1.0, 0.8, 0.9]);
    let result = shaped(&scene.photos, &scene.posed);
    let Ok((shaded, report)) = result else {
        panic!("{:?}", result.err())
    };
    let (mut ratios, mut angles) = (Vec::new(), Vec::new());
    for (view, Maps { depth, normal, .. }) in shaded.views().unwrap().views.iter().zip(&scene.truth)
    {
        for p in 0..depth.data.len() {
            if depth.data[p] > 0.0 {
                assert!(view.depth.data[p] > 0.0, "{} has a hole at {p}", view.name);
                ratios.push(f64::from((view.depth.data[p] / depth.data[p]).ln().abs()));
                let (a, b) = (normal.data[p], view.normal.data[p]);
                let dot: f64 = (0..3).map(|c| f64::from(a[c] * b[c])).sum();
                angles.push(dot.clamp(-1.0, 1.0).acos().to_degrees());
            }
        }
    }
    let (depth_error, angle) = (median(ratios), median(angles));
    // A fifth of a pixel of disparity at these angles is 0.3 % of depth.
    assert!(depth_error < 0.003, "depth {depth_error}, normals {angle}");
    assert!(angle < 10.0, "normals {angle}, depth {depth_error}");
    for (view, gain) in report.views.iter().zip([1.0, 0.8, 0.9]) {
        assert!(
            (view.gain[0] - gain).abs() < 0.02,
            "{}: {:?}",
            view.name,
            view.gain
        );
    }
}

#[test]
fn threads_do_not_change_a_byte() {
    let scene = ball(&[1.0, 1.0]);
    let solve = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let Ok(pool) = pool else { panic!("no pool") };
        pool.install(|| shaped(&scene.photos, &scene.posed))
    };
    match (solve(1), solve(2)) {
        (Ok((one, _)), Ok((two, _))) => assert!(
            one.views().unwrap() == two.views().unwrap(),
            "results differ"
        ),
        (one, two) => panic!("{:?} {:?}", one.err(), two.err()),
    }
}

#[test]
fn one_view_is_refused_by_name() {
    let scene = ball(&[1.0]);
    let result = shaped(&scene.photos, &scene.posed);
    assert!(
        matches!(&result, Err(ShadingError::NoDepth { view }) if view == "view0"),
        "{:?}",
        result.err()
    );
    let empty = shaped(&scene.photos, &PosedViews::default());
    assert!(
        matches!(empty, Err(ShadingError::NoViews)),
        "{:?}",
        empty.err()
    );
}
