//! Poses and maps that were damaged between the stages: an error that says so, or a result, never a
//! panic.

use rilievo_fusion::{FusionError, FusionOptions, Inputs, run};
use rilievo_scene::{MemoryScratch, PointCloud, PosedViews, ShadedViews, Silent, StageId};
use rilievo_synthetic::testing::{Random, SphereWorld, mutated, sphere_world};

/// The points of a world with other poses and maps.
fn fuse(
    world: &SphereWorld,
    posed: &PosedViews,
    shaded: &ShadedViews,
    options: &FusionOptions,
) -> Result<PointCloud, FusionError> {
    let inputs = Inputs {
        photos: &world.photos,
        posed,
        maps: shaded,
        scratch: &MemoryScratch,
    };
    let mut cloud = PointCloud::default();
    run(inputs, &mut cloud, options, &Silent)?;
    Ok(cloud)
}

#[test]
fn a_pose_that_is_no_number_is_named() {
    let mut world = sphere_world();
    world.posed.views[2].cam_from_world.translation.y = f64::NAN;
    let options = FusionOptions::default();
    match fuse(&world, &world.posed, &world.shaded, &options) {
        Err(FusionError::Inconsistent(error)) => {
            assert_eq!(error.made_by, StageId::Poses);
            assert_eq!(error.reason, "the pose of v2.png is not finite");
        }
        other => panic!("{other:?}"),
    }
}

/// Changes one map: its numbers, its size, or whose it is.
fn damage(shaded: &mut ShadedViews, random: &mut Random) -> String {
    const DEPTHS: [f32; 7] = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e30, 1e-30, 1e6];
    let which = random.below(shaded.views.len());
    let value = DEPTHS[random.below(DEPTHS.len())];
    let view = &mut shaded.views[which];
    let what = random.below(7);
    match what {
        0 => view.depth.data.fill(value),
        1 => {
            let pixels = view.depth.data.iter_mut();
            let every = 1 + random.below(50);
            pixels.step_by(every).for_each(|depth| *depth = value);
        }
        2 => view.normal.data.fill([value; 3]),
        3 => {
            let pixels = view.normal.data.iter_mut();
            let every = 1 + random.below(50);
            pixels.step_by(every).for_each(|normal| normal[2] = value);
        }
        4 => view.view.0 = random.below(5),
        5 => {
            view.depth.width = random.below(80);
            let size = view.depth.width * view.depth.height;
            view.depth.data.resize(size, 4.0);
        }
        _ => view.name.clear(),
    }
    format!("view {which}, change {what}, {value}")
}

#[test]
fn poses_and_maps_changed_at_random_never_end_in_a_panic() {
    let world = sphere_world();
    let options = FusionOptions {
        memory_mib: 64,
        ..FusionOptions::default()
    };
    let mut random = Random(6);
    let (mut tried, mut refused) = (0, 0);
    while tried < 60 {
        let Some((posed, place)) = mutated(&world.posed, &mut random) else {
            continue;
        };
        tried += 1;
        let mut shaded = world.shaded.clone();
        let change = damage(&mut shaded, &mut random);
        println!("{place}; {change}");
        for (posed, shaded) in [(&posed, &world.shaded), (&world.posed, &shaded)] {
            match fuse(&world, posed, shaded, &options) {
                Ok(cloud) => {
                    for point in &cloud.points {
                        assert!(point.position.iter().all(|x| x.is_finite()), "{point:?}");
                    }
                }
                Err(FusionError::Inconsistent(_)) => refused += 1,
                Err(_) => {}
            }
        }
    }
    assert!(refused > 8 && refused < 2 * tried, "{refused} of {tried}");
}
