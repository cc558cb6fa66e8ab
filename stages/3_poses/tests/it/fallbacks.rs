//! Input that deceives: copies, repeated texture, wrong intrinsics; and what fixes scale and vertical.

use crate::common;

use common::{World, WorldOptions, arc, camera, from_truth, options, pose_errors, world};
use nalgebra::{Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rilievo_poses::{
    KnownDistance, MarkedPoints, PosesError, PosesOptions, PosesReport, VerticalSource, run,
};
use rilievo_scene::{FocalSource, PosedViews, Recorder, ScaleSource, Silent, Unit, WorldFrame};

fn solve_with(world: &World, options: &PosesOptions) -> (PosedViews, PosesReport) {
    let (posed, report, _) = solve_and_tell(world, options);
    (posed, report)
}

/// The result, its report, and what was warned of.
fn solve_and_tell(world: &World, options: &PosesOptions) -> (PosedViews, PosesReport, Vec<String>) {
    let told = Recorder::default();
    let (posed, report) = run(&world.photos, &world.matches, None, options, &told).unwrap();
    (posed, report, told.warnings())
}

#[test]
fn copies_of_a_photo_get_the_same_pose() {
    let (poses, points) = arc(&[0.0, 15.0, 30.0, 30.0, 30.0, 45.0, 60.0], 300);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let set = from_truth(&WorldOptions::default(), poses, &points, &mut rng);
    let (posed, _) = solve_with(&set, &options());
    assert_eq!(posed.views.len(), 7);
    let center = |k: usize| posed.views[k].cam_from_world.center_in_source();
    let apart = (center(2) - center(3))
        .norm()
        .max((center(2) - center(4)).norm());
    let baseline = (center(0) - center(6)).norm();
    assert!(apart < 1e-5 * baseline, "{apart} of {baseline}");
    let (error, _) = pose_errors(&posed, &set.cam_from_world);
    assert!(error < 1e-5, "{error}");
}

#[test]
fn only_copies_of_one_photo_have_no_parallax() {
    let (poses, points) = arc(&[10.0, 10.0, 10.0], 200);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let set = from_truth(&WorldOptions::default(), poses, &points, &mut rng);
    let result = run(&set.photos, &set.matches, None, &options(), &Silent);
    assert!(
        matches!(result, Err(PosesError::StandsStill { .. })),
        "{result:?}"
    );
}

#[test]
fn repeated_texture_on_a_symmetric_object_does_not_deceive() {
    // Point k + n/2 is point k turned half around the vertical, and looks the same.
    let (poses, half) = arc(
        &[0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0],
        150,
    );
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    let mut points = half.clone();
    points.extend(half.iter().map(|p| turn * p));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let settings = WorldOptions {
        noise_px: 0.2,
        ..WorldOptions::default()
    };
    let mut set = from_truth(&settings, poses, &points, &mut rng);
    let n = half.len() as u32;
    for pair in &mut set.matches.pairs {
        let apart = pair.second.0 - pair.first.0;
        if apart >= 7 {
            // From opposite sides most matches are with the twin, and agree with each other.
            for m in pair.matches.iter_mut().filter(|m| m[0] % 5 < 3) {
                m[1] = (m[1] + n) % (2 * n);
            }
        }
    }
    let (posed, _) = solve_with(&set, &options());
    // The photos between the deceived ones tell: none is lost, and no pose is wrong.
    assert_eq!(posed.views.len(), 9, "{:?}", posed.unregistered);
    let (center, rotation) = pose_errors(&posed, &set.cam_from_world);
    assert!(center < 2e-3 && rotation < 0.1, "{center} {rotation}");
}

#[test]
fn a_wrong_focal_length_in_exif_is_found_and_told() {
    // Another sensor than assumed, or a cropped photo: factors between most formats.
    for factor in [1.5, 1.25, 0.67] {
        let mut set = world(&WorldOptions {
            noise_px: 0.2,
            span_deg: 120.0,
            num_views: 8,
            ..WorldOptions::default()
        });
        for photo in &mut set.photos.photos {
            photo.intrinsics.fx *= factor;
            photo.intrinsics.fy *= factor;
            photo.focal_source = FocalSource::Exif35mm;
        }
        let (posed, _, warnings) = solve_and_tell(&set, &options());
        assert_eq!(posed.views.len(), 8, "{factor}");
        let focal = posed.views[0].intrinsics.fx;
        assert!((focal / 1300.0 - 1.0).abs() < 0.01, "{factor}: {focal}");
        assert!(
            warnings.iter().any(|w| w.contains("EXIF")),
            "{factor}: {:?}",
            warnings
        );
    }
}

/// Keypoints of a photo as after a zoom by a factor, or a crop beside the middle that was enlarged to the
/// photo's size.
fn zoom(set: &mut World, photo: usize, factor: f64, offset_px: [f64; 2]) {
    let camera = camera();
    for keypoint in &mut set.matches.photos[photo].keypoints {
        let [x, y] = [
            f64::from(keypoint.x) - camera.cx,
            f64::from(keypoint.y) - camera.cy,
        ];
        keypoint.x = (camera.cx + offset_px[0] + factor * x) as f32;
        keypoint.y = (camera.cy + offset_px[1] + factor * y) as f32;
    }
}

#[test]
fn zoomed_and_cropped_photos_get_a_focal_length_of_their_own() {
    let settings = WorldOptions {
        num_views: 8,
        ..WorldOptions::default()
    };
    // Room for zooms.
    let wide = |noise_px, outlier_share| {
        let mut set = world(&WorldOptions {
            noise_px: noise_px / 0.6,
            outlier_share,
            ..settings.clone()
        });
        for photo in 0..8 {
            zoom(&mut set, photo, 0.6, [0.0; 2]);
        }
        for photo in &mut set.photos.photos {
            photo.focal_source = FocalSource::Exif35mm;
            photo.intrinsics.fx *= 0.6;
            photo.intrinsics.fy *= 0.6;
        }
        set
    };
    for (outlier_share, zooms) in [
        (0.0, vec![(2, 1.4, [0.0; 2])]),
        (0.0, vec![(1, 1.5, [0.0; 2]), (5, 1.5, [0.0; 2])]),
        (0.1, vec![(6, 0.7, [0.0; 2])]),
        (0.0, vec![(3, 1.4, [50.0, -40.0]), (4, 0.8, [0.0; 2])]),
    ] {
        let mut set = wide(0.2, outlier_share);
        for &(photo, factor, offset) in &zooms {
            zoom(&mut set, photo, factor, offset);
        }
        let (posed, _, warnings) = solve_and_tell(&set, &options());
        assert_eq!(posed.views.len(), 8, "{zooms:?}");
        for view in &posed.views {
            let zoom = zooms.iter().find(|(photo, ..)| *photo == view.photo.0);
            let factor = zoom.map_or(1.0, |(_, factor, _)| *factor);
            let error = view.intrinsics.fx / (factor * 780.0) - 1.0;
            assert!(error.abs() < 0.015, "{zooms:?} {}: {error}", view.name);
        }
        let (center, rotation) = pose_errors(&posed, &set.cam_from_world);
        let tolerance = if zooms[0].2 == [0.0; 2] { 0.005 } else { 0.03 };
        assert!(center < tolerance, "{zooms:?}: {center} {rotation}");
        let told = warnings.iter().filter(|w| w.contains("zoomed or cropped"));
        assert!(told.count() >= 1, "{zooms:?}: {warnings:?}");
    }
    // Neither noise nor wrong matches, nor a zoom that is stated, make one.
    for (noise_px, outlier_share) in [(0.2, 0.0), (1.0, 0.0), (0.3, 0.3)] {
        let mut set = wide(noise_px, outlier_share);
        zoom(&mut set, 2, 1.4, [0.0; 2]);
        let zoomed = &mut set.photos.photos[2];
        zoomed.camera_group = 1;
        zoomed.intrinsics.fx *= 1.4;
        zoomed.intrinsics.fy *= 1.4;
        let (_, _, warnings) = solve_and_tell(&set, &options());
        let told = warnings.iter().any(|w| w.contains("zoomed or cropped"));
        assert!(!told, "{noise_px} {outlier_share}: {warnings:?}");
    }
}

/// A photo cut at its left (positive) or right side and at its top (positive) or bottom, pixels, without a word of it.
fn crop(set: &mut World, photo: usize, [x, y]: [f64; 2]) {
    for keypoint in &mut set.matches.photos[photo].keypoints {
        keypoint.x -= x.max(0.0) as f32;
        keypoint.y -= y.max(0.0) as f32;
    }
    let camera = &mut set.photos.photos[photo].intrinsics;
    camera.width -= x.abs() as usize;
    camera.height -= y.abs() as usize;
    camera.cx = (camera.width as f64 - 1.0) / 2.0;
    camera.cy = (camera.height as f64 - 1.0) / 2.0;
}

#[test]
fn photos_cropped_beside_the_middle_keep_their_optical_axis() {
    let [left, right] = [[200.0, 0.0], [-200.0, 0.0]];
    let uncropped = [0.0; 2];
    for (num_views, noise_px, outlier_share, crops) in [
        (4, 0.0, 0.0, vec![left, left, right, right]),
        (4, 0.2, 0.0, vec![left; 4]),
        (6, 0.2, 0.1, vec![left, right, left, right, left, right]),
        (6, 0.2, 0.0, vec![[0.0, 150.0]; 6]),
        (
            8,
            0.2,
            0.1,
            [vec![uncropped; 6], vec![[200.0, 150.0]; 2]].concat(),
        ),
        // As large a frame, with nothing cut, is left as it is: so are noise and wrong matches.
        (4, 0.2, 0.0, vec![uncropped; 4]),
        (8, 0.5, 0.2, vec![uncropped; 8]),
    ] {
        let mut set = world(&WorldOptions {
            num_views,
            noise_px: noise_px / 0.6,
            outlier_share,
            ..WorldOptions::default()
        });
        for (photo, crop_of) in crops.iter().enumerate() {
            // Room for crops.
            zoom(&mut set, photo, 0.6, [0.0; 2]);
            set.photos.photos[photo].intrinsics.fx *= 0.6;
            set.photos.photos[photo].intrinsics.fy *= 0.6;
            set.photos.photos[photo].focal_source = FocalSource::Exif35mm;
            crop(&mut set, photo, *crop_of);
        }
        let (posed, _, warnings) = solve_and_tell(&set, &options());
        let case = format!("{num_views} views, {noise_px} px, {crops:?}");
        assert_eq!(posed.views.len(), num_views, "{case}");
        let (center, rotation) = pose_errors(&posed, &set.cam_from_world);
        assert!(center < 0.01, "{case}: {center} {rotation}");
        assert!(rotation < 0.3, "{case}: {center} {rotation}");
        for view in &posed.views {
            let [x, y] = crops[view.photo.0];
            let camera = &view.intrinsics;
            let focal = camera.fx / 780.0 - 1.0;
            assert!(focal.abs() < 0.01, "{case}: {focal}");
            let (cx, cy) = (599.5 - x.max(0.0), 449.5 - y.max(0.0));
            let offset = (camera.cx - cx).hypot(camera.cy - cy);
            assert!(offset < 8.0, "{case}: {offset} px");
        }
        let is_told = warnings.iter().any(|w| w.contains("optical axis"));
        assert_eq!(
            is_told,
            crops.iter().any(|c| *c != uncropped),
            "{case}: {warnings:?}"
        );
    }
}

#[test]
fn neither_a_lens_that_bends_nor_few_matches_make_a_crop() {
    for (num_views, span_deg, num_points, k1) in [
        (3, 45.0, 400, -0.1),
        (3, 45.0, 400, 0.15),
        (6, 90.0, 400, -0.1),
        (16, 120.0, 60, 0.0),
        (5, 12.0, 200, 0.0),
    ] {
        let mut set = world(&WorldOptions {
            num_views,
            span_deg,
            num_points,
            noise_px: 0.4,
            ..WorldOptions::default()
        });
        for photo in &mut set.photos.photos {
            photo.focal_source = FocalSource::Exif35mm;
        }
        distort(&mut set, k1);
        let (_, _, warnings) = solve_and_tell(&set, &options());
        let is_told = warnings.iter().any(|w| w.contains("optical axis"));
        assert!(!is_told, "{num_views}, {num_points}, {k1}: {warnings:?}");
    }
}

#[test]
fn few_narrow_views_keep_to_the_focal_length_of_exif() {
    // Three photos over ten degrees hardly tell the focal length: EXIF, two per cent off, does.
    let mut set = world(&WorldOptions {
        noise_px: 0.3,
        span_deg: 10.0,
        num_views: 3,
        num_points: 120,
        ..WorldOptions::default()
    });
    for photo in &mut set.photos.photos {
        photo.intrinsics.fx *= 1.02;
        photo.intrinsics.fy *= 1.02;
        photo.focal_source = FocalSource::Exif35mm;
    }
    let (posed, _, warnings) = solve_and_tell(&set, &options());
    assert_eq!(posed.views.len(), 3);
    let focal = posed.views[0].intrinsics.fx;
    assert!((focal / 1300.0 - 1.0).abs() < 0.05, "{focal}");
    assert!(!warnings.iter().any(|w| w.contains("EXIF")));
}

/// Keypoints moved by radial distortion that no camera states.
fn distort(set: &mut World, k1: f64) {
    let camera = camera();
    for list in &mut set.matches.photos {
        for keypoint in &mut list.keypoints {
            let at = Point2::new(f64::from(keypoint.x), f64::from(keypoint.y));
            let ray = camera.ray(&at);
            let factor = 1.0 + k1 * ray.xy().norm_squared();
            keypoint.x = (camera.cx + camera.fx * ray.x * factor) as f32;
            keypoint.y = (camera.cy + camera.fy * ray.y * factor) as f32;
        }
    }
}

#[test]
fn poses_allow_for_distortion_that_the_given_camera_does_not_state() {
    let settings = WorldOptions {
        noise_px: 0.1,
        num_views: 5,
        span_deg: 50.0,
        ..WorldOptions::default()
    };
    let mut set = world(&settings);
    distort(&mut set, 0.1);
    let (posed, report, warnings) = solve_and_tell(&set, &options());
    let lens = report.lens.unwrap();
    assert!((lens.k1[0] - 0.1).abs() < 0.003, "{lens:?}");
    assert!(lens.largest_px > 0.5 && lens.cost_drop > 0.1, "{lens:?}");
    assert!(warnings.iter().any(|w| w.contains("distortion")));
    assert!(report.contradicted_focal.is_none());
    // The camera stays as given, to the bit, and the poses are nearer to the truth.
    assert_eq!(posed.views[0].intrinsics, camera());
    let exact = PosesOptions {
        refine_intrinsics: rilievo_poses::RefineIntrinsics::None,
        ..options()
    };
    let (bent, report) = solve_with(&set, &exact);
    assert!(report.lens.is_none());
    let (with, _) = pose_errors(&posed, &set.cam_from_world);
    let (without, _) = pose_errors(&bent, &set.cam_from_world);
    assert!(with < 0.5 * without && with < 1e-3, "{with} {without}");
}

#[test]
fn an_exact_camera_is_not_doubted() {
    for noise_px in [0.05, 0.5] {
        let set = world(&WorldOptions {
            noise_px,
            ..WorldOptions::default()
        });
        let (_, report) = solve_with(&set, &options());
        assert!(report.lens.is_none(), "{:?}", report.lens);
        let focal = report.contradicted_focal;
        assert!(focal.is_none(), "{focal:?}");
    }
}

#[test]
fn a_given_focal_length_that_the_photos_contradict_is_told() {
    for factor in [0.94, 1.25] {
        let mut set = world(&WorldOptions {
            noise_px: 0.1,
            span_deg: 60.0,
            ..WorldOptions::default()
        });
        for photo in &mut set.photos.photos {
            photo.intrinsics.fx *= factor;
            photo.intrinsics.fy *= factor;
        }
        let (posed, report, warnings) = solve_and_tell(&set, &options());
        let focal = report.contradicted_focal.unwrap();
        assert!((focal.found_px / 1300.0 - 1.0).abs() < 0.01, "{focal:?}");
        assert!(warnings.contains(&focal.finding().sentence()));
        assert!(report.lens.is_none(), "{:?}", report.lens);
        // It stays as given, to the bit.
        let given = &set.photos.photos[0].intrinsics;
        assert_eq!(&posed.views[0].intrinsics, given);
    }
}

#[test]
fn a_distance_between_cameras_makes_the_world_metric() {
    let set = world(&WorldOptions {
        noise_px: 0.1,
        ..WorldOptions::default()
    });
    let center = |k: usize| set.cam_from_world[k].center_in_source();
    let metres = (center(0) - center(4)).norm();
    let known = KnownDistance {
        metres,
        sigma_metres: 0.001 * metres,
        cameras: Some(["v000".to_owned(), "v004.png".to_owned()]),
        marks: Vec::new(),
    };
    let with = |known| PosesOptions {
        known_distance: Some(known),
        ..options()
    };
    let (posed, report) = solve_with(&set, &with(known.clone()));
    assert_eq!(posed.scale.unit, Unit::Metre);
    assert_eq!(posed.scale.source, ScaleSource::KnownDistance);
    let sigma = report.scale.relative_sigma.unwrap();
    assert!((0.001..0.002).contains(&sigma), "{sigma}");
    let found = |a: usize, b: usize| {
        let at = |k: usize| posed.views[k].cam_from_world.center_in_source();
        (at(a) - at(b)).norm()
    };
    let expected = (center(1) - center(5)).norm();
    assert!(
        (found(1, 5) / expected - 1.0).abs() < 1e-3,
        "{}",
        found(1, 5)
    );
    let stranger = KnownDistance {
        cameras: Some(["v000".to_owned(), "v099".to_owned()]),
        ..known
    };
    let result = run(&set.photos, &set.matches, None, &with(stranger), &Silent);
    match result {
        Err(PosesError::KnownDistance { reason }) => assert!(reason.contains("v099"), "{reason}"),
        other => panic!("{:?}", other.map(|(posed, _)| posed.scale)),
    }
}

#[test]
fn two_marked_points_make_the_world_metric() {
    let set = world(&WorldOptions {
        noise_px: 0.1,
        ..WorldOptions::default()
    });
    let (first, second) = (Point3::new(-0.3, 0.2, 0.1), Point3::new(0.4, -0.1, -0.2));
    let mark = |k: usize, shift: f64| {
        let pixel = |p: &Point3<f64>| {
            let at = camera().project(&set.cam_from_world[k].apply(p)).unwrap();
            [at.x, at.y + shift]
        };
        MarkedPoints {
            image: format!("v{k:03}.png"),
            first: pixel(&first),
            second: pixel(&second),
        }
    };
    let known = |marks| KnownDistance {
        metres: (first - second).norm(),
        sigma_metres: 0.0,
        cameras: None,
        marks,
    };
    let with = |marks| PosesOptions {
        known_distance: Some(known(marks)),
        ..options()
    };
    let (posed, _) = solve_with(&set, &with(vec![mark(0, 0.3), mark(2, -0.2), mark(4, 0.1)]));
    let sigma = posed.scale.relative_sigma.unwrap();
    // A pixel of 1300 at 3 m, over 0.8 m, from three photos.
    assert!((0.001..0.01).contains(&sigma), "{sigma}");
    let center = |k: usize| set.cam_from_world[k].center_in_source();
    let at = |k: usize| posed.views[k].cam_from_world.center_in_source();
    let ratio = (at(0) - at(5)).norm() / (center(0) - center(5)).norm();
    assert!((ratio - 1.0).abs() < 3.0 * sigma, "{ratio} {sigma}");
    let result = run(
        &set.photos,
        &set.matches,
        None,
        &with(vec![mark(0, 0.0), mark(2, 60.0)]),
        &Silent,
    );
    assert!(
        matches!(result, Err(PosesError::KnownDistance { .. })),
        "{:?}",
        result.map(|(posed, _)| posed.scale)
    );
    assert!(known(Vec::new()).validate().is_err());
}

#[test]
fn the_vertical_follows_from_the_ground_or_from_the_cameras() {
    // Two thirds of the points on a table 10° off the cameras' vertical.
    let tilt = UnitQuaternion::from_euler_angles(10_f64.to_radians(), 0.0, 0.0);
    let (poses, mut points) = arc(&[0.0, 15.0, 30.0, 45.0, 60.0], 300);
    for (k, p) in points.iter_mut().enumerate() {
        if k % 3 > 0 {
            p.z = -0.6;
            *p = tilt * *p;
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let settings = WorldOptions {
        noise_px: 0.1,
        ..WorldOptions::default()
    };
    let set = from_truth(&settings, poses, &points, &mut rng);
    let (posed, report) = solve_with(&set, &options());
    let vertical = report.vertical.unwrap();
    assert_eq!(vertical.source, VerticalSource::Ground);
    // In the frame of the first camera both worlds agree.
    let up = posed.views[0].cam_from_world.rotation * Vector3::from(vertical.up_in_world);
    let truth = set.cam_from_world[0].rotation * (tilt * Vector3::z());
    let angle = up.angle(&truth).to_degrees();
    assert!(angle < 0.05, "{angle}");
    assert!(vertical.sigma_deg < 0.05, "{}", vertical.sigma_deg);
    // The world is level: z upwards from the table, on which the origin lies, cameras in front.
    assert_eq!(posed.frame, WorldFrame::Level);
    assert!((Vector3::from(vertical.up_in_world) - Vector3::z()).norm() < 1e-9);
    let reach = posed.views[0].cam_from_world.translation.norm();
    let heights = posed.points.iter().map(|p| p.position[2].abs());
    let num_on_table = heights.filter(|&z| z < 0.002 * reach).count();
    assert!(2 * num_on_table > posed.points.len(), "{num_on_table}");
    let centers = posed.views.iter();
    let centers = centers.map(|v| v.cam_from_world.center_in_source());
    let mean = centers.map(|c| c.coords).sum::<Vector3<f64>>() / posed.views.len() as f64;
    assert!(
        mean.z > 0.0 && mean.y < 0.0 && mean.x.abs() < 1e-2 * reach,
        "{mean}"
    );

    let (poses, points) = arc(&[0.0, 15.0, 30.0, 45.0, 60.0], 300);
    let set = from_truth(&settings, poses, &points, &mut rng);
    let (posed, report) = solve_with(&set, &options());
    let vertical = report.vertical.unwrap();
    assert_eq!(vertical.source, VerticalSource::Cameras);
    let up = posed.views[0].cam_from_world.rotation * Vector3::from(vertical.up_in_world);
    let truth = set.cam_from_world[0].rotation * Vector3::z();
    assert_eq!(posed.frame, WorldFrame::FirstCamera);
    let first = posed.views[0].cam_from_world;
    assert!(first.rotation.angle() < 1e-9 && first.translation.norm() < 1e-9);
    // All cameras look down by 17°, around an arc of 60°: the mean leans as they do.
    let angle = up.angle(&truth).to_degrees();
    assert!(angle < 20.0, "{angle}");
}
