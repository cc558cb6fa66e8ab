//! Poses from synthetic correspondences, in rungs of difficulty.

use crate::common;

use common::{
    RingsOptions, World, WorldOptions, arc, from_truth, look_at, options, pose_errors, rings, world,
};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rilievo_poses::{GivenPoses, PosesError, ReferenceFrame, RefineIntrinsics, run};
use rilievo_scene::{
    FocalSource, MarkedSphere, PhotoIdx, PosedViews, Recorder, RigidTransform, ScaleSource, Silent,
    SphereMark, SphereRequest, Unit, WorldCoordinates, WorldFrame,
};
use rilievo_synthetic::testing::Impatient;

/// Keypoints are stored in single precision: 3e-5 px at 1000 px.
const EXACT: f64 = 1e-6;

fn solve(world: &World) -> (rilievo_scene::PosedViews, rilievo_poses::PosesReport) {
    run(&world.photos, &world.matches, None, &options(), &Silent).unwrap()
}

#[test]
fn exact_correspondences_give_exact_poses() {
    let world = world(&WorldOptions::default());
    let (posed, report) = solve(&world);
    assert_eq!(posed.views.len(), 6);
    assert_eq!(posed.points.len(), 400);
    let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
    assert!(center < EXACT && rotation < 1e-4, "{center} {rotation}");
    assert!(report.mean_reprojection_error_px < 1e-3, "{report:?}");
    for view in &posed.views {
        assert_eq!(view.intrinsics, common::camera());
    }
    assert_eq!(posed.scale.source, ScaleSource::Gauge);
}

#[test]
fn noise_bends_the_poses_no_more_than_it_must() {
    let world = world(&WorldOptions {
        noise_px: 0.5,
        ..WorldOptions::default()
    });
    let (posed, report) = solve(&world);
    let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
    // 400 points, 0.5 px, f = 1300: some 0.5/1300/√400 radians, times a factor of geometry.
    assert!(center < 5e-4 && rotation < 0.03, "{center} {rotation}");
    let sigma = report.keypoint_sigma_px;
    assert!((sigma - 0.5).abs() < 0.05, "{sigma}");
    let claimed = report.views[3].rotation_sigma_deg.unwrap();
    assert!(
        claimed > rotation / 10.0 && claimed < 0.05,
        "{claimed} {rotation}"
    );
}

#[test]
fn a_fifth_of_wrong_matches_does_no_harm() {
    let world = world(&WorldOptions {
        noise_px: 0.3,
        outlier_share: 0.2,
        ..WorldOptions::default()
    });
    let (posed, _) = solve(&world);
    assert_eq!(posed.views.len(), 6);
    let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
    assert!(center < 1e-3 && rotation < 0.05, "{center} {rotation}");
}

#[test]
fn a_wrong_focal_length_is_refined_and_a_stated_one_is_not() {
    let mut world = world(&WorldOptions {
        noise_px: 0.2,
        span_deg: 120.0,
        num_views: 8,
        ..WorldOptions::default()
    });
    for photo in &mut world.photos.photos {
        photo.intrinsics.fx *= 1.06;
        photo.intrinsics.fy *= 1.06;
        photo.focal_source = FocalSource::Exif35mm;
    }
    let (posed, report) = solve(&world);
    let focal = posed.views[0].intrinsics.fx;
    assert!((focal / 1300.0 - 1.0).abs() < 0.003, "{focal}");
    assert_eq!(report.refined_focals_px.len(), 1);
    assert!(posed.views[0].intrinsics.distortion.is_none());
    let (center, _) = pose_errors(&posed, &world.cam_from_world);
    assert!(center < 2e-3, "{center}");
    let fixed = rilievo_poses::PosesOptions {
        refine_intrinsics: RefineIntrinsics::None,
        ..options()
    };
    let (posed, _) = run(&world.photos, &world.matches, None, &fixed, &Silent).unwrap();
    assert_eq!(posed.views[0].intrinsics, world.photos.photos[0].intrinsics);
}

#[test]
fn permuted_photos_give_the_same_model() {
    let setup = WorldOptions {
        noise_px: 0.3,
        ..WorldOptions::default()
    };
    let straight = world(&setup);
    let order = [3, 0, 5, 1, 4, 2];
    let mut permuted = world(&setup);
    let mut place = [0; 6];
    for (new, &old) in order.iter().enumerate() {
        permuted.photos.photos[new] = straight.photos.photos[old].clone();
        permuted.matches.photos[new] = straight.matches.photos[old].clone();
        place[old] = new;
    }
    for pair in &mut permuted.matches.pairs {
        let (a, b) = (place[pair.first.0], place[pair.second.0]);
        (pair.first, pair.second) = (PhotoIdx(a), PhotoIdx(b));
        if a > b {
            std::mem::swap(&mut pair.first, &mut pair.second);
            pair.essential = pair.essential.map(|e| e.transpose());
            pair.matches.iter_mut().for_each(|m| m.reverse());
        }
    }
    permuted.matches.pairs.sort_by_key(|p| (p.first, p.second));
    let (a, _) = solve(&straight);
    let (b, _) = solve(&permuted);
    let poses_of_a: Vec<RigidTransform> = a.views.iter().map(|v| v.cam_from_world).collect();
    let renamed: Vec<RigidTransform> = order.iter().map(|&old| poses_of_a[old]).collect();
    let (center, rotation) = pose_errors(&b, &renamed);
    // Outlier limits cut differently in another order; the noise of 0.3 px gives 2e-4.
    assert!(center < 1e-4 && rotation < 0.01, "{center} {rotation}");
}

fn assert_same_with_any_threads(world: &World) {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| solve(world))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let world = world(&WorldOptions {
        noise_px: 0.4,
        outlier_share: 0.1,
        ..WorldOptions::default()
    });
    assert_same_with_any_threads(&world);
}

#[test]
fn a_ring_of_64_photos_closes() {
    let world = world(&WorldOptions {
        num_views: 64,
        span_deg: 360.0,
        num_points: 300,
        noise_px: 0.3,
        reach: 4,
        ..WorldOptions::default()
    });
    let (posed, _) = solve(&world);
    assert_eq!(posed.views.len(), 64);
    let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
    assert!(center < 1e-3 && rotation < 0.05, "{center} {rotation}");
}

/// Largest errors of centres and rotations, and those of an adjustment that starts from the truth: what the
/// observations allow.
fn errors_and_least(setup: &RingsOptions) -> ((f64, f64), (f64, f64)) {
    let mut world = rings(setup);
    let (posed, _) = solve(&world);
    assert_eq!(posed.views.len(), setup.num_views);
    let found = pose_errors(&posed, &world.cam_from_world);
    give(&mut world, |pose| *pose);
    let refine = rilievo_poses::PosesOptions {
        given_poses: GivenPoses::Refine,
        ..options()
    };
    let (posed, _) = run(&world.photos, &world.matches, None, &refine, &Silent).unwrap();
    (found, pose_errors(&posed, &world.cam_from_world))
}

#[test]
fn photos_adjusted_with_their_neighbours_are_as_exact_as_the_observations_allow() {
    let exact = rings(&RingsOptions {
        num_views: 80,
        num_keypoints: 200,
        noise_px: 0.0,
        outlier_share: 0.0,
        ..RingsOptions::default()
    });
    let (posed, _) = solve(&exact);
    assert_eq!(posed.views.len(), 80);
    let (center, rotation) = pose_errors(&posed, &exact.cam_from_world);
    assert!(center < 1e-5 && rotation < 1e-3, "{center} {rotation}");
    for outlier_share in [0.0, 0.1] {
        let ((center, rotation), least) = errors_and_least(&RingsOptions {
            num_views: 120,
            num_keypoints: 250,
            outlier_share,
            ..RingsOptions::default()
        });
        assert!(center < 1.1 * least.0, "{center} {least:?}");
        assert!(rotation < 1.1 * least.1, "{rotation} {least:?}");
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit_of_many_views() {
    let world = rings(&RingsOptions {
        num_views: 64,
        num_keypoints: 150,
        ..RingsOptions::default()
    });
    assert_same_with_any_threads(&world);
}

#[test]
#[ignore = "minutes"]
fn a_thousand_photos_are_posed() {
    let ((center, rotation), least) = errors_and_least(&RingsOptions {
        num_views: 1000,
        ..RingsOptions::default()
    });
    assert!(center < 1.1 * least.0, "{center} {least:?}");
    assert!(rotation < 1.1 * least.1, "{rotation} {least:?}");
}

#[test]
fn two_photos_are_enough_and_one_is_not() {
    let two = world(&WorldOptions {
        num_views: 2,
        span_deg: 20.0,
        ..WorldOptions::default()
    });
    let (posed, _) = solve(&two);
    assert_eq!(posed.views.len(), 2);
    let one = world(&WorldOptions {
        num_views: 1,
        ..WorldOptions::default()
    });
    let error = run(&one.photos, &one.matches, None, &options(), &Silent);
    assert!(matches!(
        error,
        Err(PosesError::TooFewPhotos { num_photos: 1 })
    ));
}

#[test]
fn what_cannot_be_reconstructed_has_a_name() {
    let flat = world(&WorldOptions {
        planar: true,
        ..WorldOptions::default()
    });
    let error = run(&flat.photos, &flat.matches, None, &options(), &Silent);
    assert!(
        matches!(error, Err(PosesError::OnlyHomographies { .. })),
        "{error:?}"
    );
    let mut strangers = world(&WorldOptions::default());
    strangers.matches.pairs.clear();
    let error = run(
        &strangers.photos,
        &strangers.matches,
        None,
        &options(),
        &Silent,
    );
    assert!(
        matches!(error, Err(PosesError::NoMatches { .. })),
        "{error:?}"
    );
    // Cameras a hair's breadth apart: rays too nearly parallel.
    let (poses, points) = arc(&[0.0, 1.0, 2.0], 400);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let near = from_truth(&WorldOptions::default(), poses, &points, &mut rng);
    let error = run(&near.photos, &near.matches, None, &options(), &Silent);
    assert!(
        matches!(error, Err(PosesError::NoInitialPair { .. })),
        "{error:?}"
    );
}

#[test]
fn photos_within_a_few_degrees_are_posed_and_what_it_costs_is_told() {
    let near = world(&WorldOptions {
        span_deg: 6.0,
        num_views: 3,
        ..WorldOptions::default()
    });
    let told = Recorder::default();
    let (posed, _) = run(&near.photos, &near.matches, None, &options(), &told).unwrap();
    assert_eq!(posed.views.len(), 3);
    assert!(
        told.warnings().iter().any(|w| w.contains("from within")),
        "{:?}",
        told.warnings()
    );
    let wide = world(&WorldOptions {
        span_deg: 30.0,
        num_views: 3,
        ..WorldOptions::default()
    });
    let told = Recorder::default();
    run(&wide.photos, &wide.matches, None, &options(), &told).unwrap();
    assert!(
        !told.warnings().iter().any(|w| w.contains("from within")),
        "{:?}",
        told.warnings()
    );
}

#[test]
fn photos_of_something_else_stay_out_with_a_reason() {
    let mut world = world(&WorldOptions {
        num_views: 8,
        ..WorldOptions::default()
    });
    // The last three photos know only each other, the last of all no one.
    world
        .matches
        .pairs
        .retain(|p| p.second.0 != 7 && (p.first.0 < 5) == (p.second.0 < 5));
    let (posed, report) = solve(&world);
    let names: Vec<&str> = posed.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["v000", "v001", "v002", "v003", "v004"]);
    assert_eq!(report.other_model_sizes, [2]);
    assert_eq!(posed.unregistered.len(), 3);
    assert!(posed.unregistered[0].reason.contains("separate model"));
    assert!(
        posed.unregistered[2]
            .reason
            .contains("matches no other photo")
    );
}

fn give(world: &mut World, change: impl Fn(&RigidTransform) -> RigidTransform) {
    for (photo, pose) in world.photos.photos.iter_mut().zip(&world.cam_from_world) {
        photo.given_cam_from_world = Some(change(pose));
    }
}

#[test]
fn given_poses_are_kept_to_the_bit_or_refined() {
    let mut world = world(&WorldOptions {
        noise_px: 0.3,
        ..WorldOptions::default()
    });
    give(&mut world, |p| *p);
    let (posed, report) = solve(&world);
    for (view, pose) in posed.views.iter().zip(&world.cam_from_world) {
        assert_eq!(view.cam_from_world, *pose);
    }
    assert!(posed.points.len() > 390, "{}", posed.points.len());
    assert_eq!(posed.scale.source, ScaleSource::GivenPoses);
    // Nothing said that they are metres.
    assert_eq!(posed.scale.unit, Unit::Arbitrary);
    assert!(report.initial_pair.is_none());
    // Disturbed, they are pulled back.
    let nudge = UnitQuaternion::from_euler_angles(0.001, -0.002, 0.001);
    give(&mut world, |p| RigidTransform {
        rotation: nudge * p.rotation,
        translation: p.translation + Vector3::new(0.002, 0.001, -0.003),
    });
    let refine = rilievo_poses::PosesOptions {
        given_poses: GivenPoses::Refine,
        ..options()
    };
    let (posed, _) = run(&world.photos, &world.matches, None, &refine, &Silent).unwrap();
    let (center, rotation) = pose_errors(&posed, &world.cam_from_world);
    assert!(center < 1e-3 && rotation < 0.03, "{center} {rotation}");
}

#[test]
fn photos_without_a_given_pose_are_posed_in_the_frame_of_the_others() {
    let mut world = world(&WorldOptions {
        noise_px: 0.3,
        ..WorldOptions::default()
    });
    let num = world.cam_from_world.len();
    for given in [num - 1, 2, 1] {
        give(&mut world, |p| *p);
        for photo in &mut world.photos.photos[given..] {
            photo.given_cam_from_world = None;
        }
        let told = Recorder::default();
        let (posed, _) = run(&world.photos, &world.matches, None, &options(), &told).unwrap();
        let told = told.warnings().join("\n");
        assert_eq!(posed.views.len(), num, "{told}");
        assert!(
            told.contains(&world.photos.photos[given].file_name) || given == 1,
            "{told}"
        );
        if given == 1 {
            assert_ne!(posed.frame, WorldFrame::Given);
            assert!(told.contains("alone and not used"), "{told}");
            continue;
        }
        assert_eq!(posed.frame, WorldFrame::Given);
        for (k, (view, pose)) in posed.views.iter().zip(&world.cam_from_world).enumerate() {
            if k < given {
                assert_eq!(view.cam_from_world, *pose);
            }
            let apart = (view.cam_from_world.center_in_source() - pose.center_in_source()).norm();
            let turned = (view.cam_from_world.rotation.angle_to(&pose.rotation)).to_degrees();
            // As far as .3 px of noise move a photo among exact ones.
            assert!(
                apart < 3e-3 && turned < 0.1,
                "{k} of {given}: {apart} m, {turned} degrees"
            );
        }
    }
}

#[test]
fn the_frame_of_earlier_cameras_is_kept_where_those_in_common_agree() {
    let world = world(&WorldOptions {
        noise_px: 0.3,
        ..WorldOptions::default()
    });
    let (own, _) = solve(&world);
    let turn = UnitQuaternion::from_euler_angles(0.3, 0.8, -0.4);
    let moved = |view: &rilievo_scene::PosedView| {
        let center = turn * (view.cam_from_world.center_in_source() * 2.5);
        let rotation = view.cam_from_world.rotation * turn.inverse();
        let center = center.coords + Vector3::new(5.0, -3.0, 1.0);
        RigidTransform {
            rotation,
            translation: -(rotation * center),
        }
    };
    let told_with = |change: &dyn Fn(usize, RigidTransform) -> RigidTransform, is_asked: bool| {
        let cameras = own.views.iter().enumerate();
        let cameras = cameras.map(|(k, view)| (view.file_name.clone(), change(k, moved(view))));
        let reference = ReferenceFrame {
            cameras: cameras.collect(),
            world: WorldCoordinates {
                unit: Unit::Metre,
                frame: WorldFrame::Level,
                offset: [0.0; 3],
            },
            knows_object: true,
            is_asked,
        };
        let options = rilievo_poses::PosesOptions {
            reference: Some(reference),
            ..options()
        };
        let told = Recorder::default();
        let (posed, report) = run(&world.photos, &world.matches, None, &options, &told).unwrap();
        (posed, report, told.warnings().join("\n"))
    };
    // One photo was replaced by one from elsewhere.
    let replaced = |k: usize, pose: RigidTransform| match k {
        2 => look_at(Point3::new(9.0, 9.0, 9.0), Point3::origin()),
        _ => pose,
    };
    // A size that nothing states any more is not kept, that of cameras which were asked for is.
    let (posed, _, _) = told_with(&replaced, false);
    assert_eq!(posed.scale.unit, Unit::Arbitrary);
    let (posed, report, told) = told_with(&replaced, true);
    assert!(told.contains("5 cameras in common agree"), "{told}");
    assert_eq!(report.num_frame_cameras, Some(5));
    assert_eq!(
        (posed.frame, posed.scale.unit),
        (WorldFrame::Level, Unit::Metre)
    );
    for (view, before) in posed.views.iter().zip(&own.views) {
        let (now, before) = (
            view.cam_from_world.center_in_source(),
            moved(before).center_in_source(),
        );
        assert!((now - before).norm() < 1e-9, "{now} {before}");
    }
    let scrambled = |k: usize, pose: RigidTransform| RigidTransform {
        rotation: UnitQuaternion::from_euler_angles(0.0, 0.5 * k as f64, 0.0) * pose.rotation,
        ..pose
    };
    let (posed, report, told) = told_with(&scrambled, false);
    assert!(told.contains("not taken over"), "{told}");
    assert_eq!((posed.frame, report.num_frame_cameras), (own.frame, None));
}

#[test]
fn given_poses_in_another_convention_are_named() {
    let mut world = world(&WorldOptions::default());
    let opengl = RigidTransform {
        rotation: UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        translation: Vector3::zeros(),
    };
    let mirror = |p: &RigidTransform| {
        let m = nalgebra::Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        let r = m * p.rotation_matrix() * m;
        RigidTransform {
            rotation: UnitQuaternion::from_matrix(&r),
            translation: m * p.translation,
        }
    };
    type Change = Box<dyn Fn(&RigidTransform) -> RigidTransform>;
    let cases: [(&str, Change); 3] = [
        ("invert", Box::new(|p| p.inverse())),
        ("OpenGL", Box::new(move |p| opengl.compose(p))),
        ("mirrored", Box::new(mirror)),
    ];
    for (word, change) in cases {
        give(&mut world, change);
        let error = run(&world.photos, &world.matches, None, &options(), &Silent);
        match error {
            Err(PosesError::GivenPosesInconsistent { hint, .. }) => {
                assert!(hint.contains(word), "{word}: {hint}");
            }
            other => panic!("{word}: {other:?}"),
        }
    }
}

/// Marks of a ball in every other photo; the generator's unit is a metre when its true radius is
/// stated.
fn ball(world: &World, name: &str, center: [f64; 3], stated_radius: f64) -> MarkedSphere {
    let marks = [0, 2, 4].map(|k| {
        let sphere = rilievo_photometry::sphere::SphereInCamera {
            center: world.cam_from_world[k].apply(&Point3::from(center)),
            radius: 0.25,
        };
        let ellipse = sphere.ellipse(&common::camera()).unwrap();
        let mark = SphereMark::Ellipse {
            center_px: ellipse.center,
            semi_axes_px: ellipse.semi_axes,
            angle_rad: ellipse.angle_rad,
        };
        (PhotoIdx(k), mark)
    });
    MarkedSphere {
        name: name.to_owned(),
        ..MarkedSphere::only(stated_radius, marks.to_vec())
    }
}

/// The model under spheres, what was warned of, and the length between two of its cameras over the true one.
fn with_spheres(world: &World, spheres: Vec<MarkedSphere>) -> (PosedViews, Vec<String>, f64) {
    let request = SphereRequest {
        spheres,
        ..SphereRequest::default()
    };
    let told = Recorder::default();
    let (posed, _) = run(
        &world.photos,
        &world.matches,
        Some(&request),
        &options(),
        &told,
    )
    .unwrap();
    let distance = |a: &RigidTransform, b: &RigidTransform| {
        (a.center_in_source() - b.center_in_source()).norm()
    };
    let found = distance(
        &posed.views[0].cam_from_world,
        &posed.views[5].cam_from_world,
    );
    let truth = distance(&world.cam_from_world[0], &world.cam_from_world[5]);
    (posed, told.warnings(), found / truth)
}

#[test]
fn the_sphere_makes_the_world_metric() {
    let world = world(&WorldOptions::default());
    let only = ball(&world, MarkedSphere::ONLY, [0.3, 0.2, 0.1], 0.25);
    let (posed, warnings, scale) = with_spheres(&world, vec![only]);
    assert_eq!(posed.scale.source, ScaleSource::Sphere, "{:?}", warnings);
    assert_eq!(posed.scale.unit, Unit::Metre);
    assert!((scale - 1.0).abs() < 2e-3, "{scale}");
    let radius = posed.spheres[0].radius;
    assert!((radius - 0.25).abs() < 1e-9, "{radius}");
}

#[test]
fn two_spheres_share_a_scale_and_a_wrong_radius_is_told() {
    let world = world(&WorldOptions::default());
    let a = ball(&world, "a", [0.3, 0.2, 0.1], 0.25);
    let told = |warnings: &[String], parts: &[&str]| {
        let told = |w: &String| parts.iter().all(|part| w.contains(part));
        assert!(warnings.iter().any(told), "{parts:?} not in {warnings:?}");
    };
    let b = ball(&world, "b", [-0.4, 0.3, 0.0], 0.25);
    let (posed, warnings, scale) = with_spheres(&world, vec![a.clone(), b]);
    assert!((scale - 1.0).abs() < 2e-3, "{scale}");
    let names: Vec<&str> = posed.spheres.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["a", "b"], "{:?}", warnings);
    for sphere in &posed.spheres {
        let (radius, sigma) = (sphere.radius, sphere.center_sigma);
        assert!((radius - 0.25).abs() < 1e-3, "{radius}");
        assert!(sigma.iter().all(|s| *s > 0.0 && *s < 0.01), "{sigma:?}");
    }
    assert!(
        !warnings.iter().any(|w| w.contains("scale")),
        "{:?}",
        warnings
    );

    let wrong = ball(&world, "b", [-0.4, 0.3, 0.0], 0.2625);
    let (posed, warnings, scale) = with_spheres(&world, vec![a.clone(), wrong.clone()]);
    told(
        &warnings,
        &[
            "% of that of the other sphere",
            "one of the two radii is wrong",
        ],
    );
    assert!((scale - 1.025).abs() < 5e-3, "{scale}");
    let sigma = posed.scale.relative_sigma.unwrap();
    assert!((0.02..0.03).contains(&sigma), "{sigma}");

    let c = ball(&world, "c", [0.0, -0.5, 0.0], 0.25);
    let (_, warnings, scale) = with_spheres(&world, vec![a.clone(), wrong, c]);
    told(
        &warnings,
        &[
            "the scale that b gives is 10",
            "it is left out of the scale",
        ],
    );
    assert!((scale - 1.0).abs() < 2e-3, "{scale}");

    // One in a unit of its own, and one that is marked nowhere.
    let centimetres = ball(&world, "b", [-0.4, 0.3, 0.0], 25.0);
    let (posed, warnings, _) = with_spheres(&world, vec![a.clone(), centimetres]);
    told(
        &warnings,
        &[
            "the scale that b gives is 100",
            "in another unit, the scale stays arbitrary",
        ],
    );
    assert_eq!(posed.scale.unit, Unit::Arbitrary);
    let names: Vec<&str> = posed.spheres.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["a", "b"], "both still tell the light");
    let nowhere = MarkedSphere {
        name: "b".to_owned(),
        ..MarkedSphere::only(0.25, Vec::new())
    };
    let (posed, warnings, scale) = with_spheres(&world, vec![nowhere, a]);
    told(
        &warnings,
        &["b was not located, the others go on: the sphere is marked in no photo"],
    );
    assert!(
        posed.spheres.len() == 1 && (scale - 1.0).abs() < 2e-3,
        "{scale}"
    );
}

#[test]
fn an_observer_can_stop_the_stage() {
    let world = world(&WorldOptions::default());
    let result = run(&world.photos, &world.matches, None, &options(), &Impatient);
    assert!(matches!(result, Err(PosesError::Interrupted)));
}

#[test]
fn a_camera_that_only_turns_has_no_parallax() {
    let at = Point3::new(3.0, 0.0, 0.8);
    let poses = [-0.1, 0.0, 0.1]
        .map(|y| look_at(at, Point3::new(0.0, y, 0.0)))
        .to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let points: Vec<Point3<f64>> = (0..200)
        .map(|k| {
            let k = f64::from(k);
            Point3::new(
                (k * 1.3).sin() * 0.6,
                (k * 0.7).cos() * 0.6,
                (k * 2.1).sin() * 0.4,
            )
        })
        .collect();
    let turned = from_truth(&WorldOptions::default(), poses, &points, &mut rng);
    let error = run(&turned.photos, &turned.matches, None, &options(), &Silent);
    assert!(
        matches!(error, Err(PosesError::OnlyHomographies { .. })),
        "{error:?}"
    );
}
