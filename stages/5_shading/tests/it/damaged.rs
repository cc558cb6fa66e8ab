//! Poses, anchors and light that were damaged between the stages: an error that says so, or a result,
//! never a panic.

use rilievo_scene::{Silent, StageId};
use rilievo_shading::photo::Effort;
use rilievo_shading::{ShadingError, ShadingModel, ShadingOptions, Surroundings, run};
use rilievo_synthetic::testing::{Random, mutated, sphere_world};

/// Both models with the least work.
fn models() -> [ShadingOptions; 2] {
    [ShadingModel::Photo, ShadingModel::Paper].map(|model| {
        let mut options = ShadingOptions {
            model,
            ..ShadingOptions::default()
        };
        options.photo.num_outer_iterations = 1;
        options.photo.effort = Effort {
            num_sweeps: 1,
            num_half_iterations: 0,
            max_more_iterations: 0,
            max_num_rounds: 1,
            num_rays: 16,
            ..Effort::default()
        };
        options
    })
}

#[test]
fn the_undamaged_world_has_a_shape() {
    let world = sphere_world();
    for options in models() {
        let (shaded, _) = run(
            &world.photos,
            &world.posed,
            &world.lighting,
            &options,
            Surroundings::in_memory(&Silent),
        )
        .unwrap();
        assert_eq!(shaded.num_views(), 3);
    }
}

#[test]
fn an_anchor_in_no_view_is_named() {
    let world = sphere_world();
    let mut posed = world.posed.clone();
    posed.anchors[4].observations[1].view.0 = 3;
    for options in models() {
        match run(
            &world.photos,
            &posed,
            &world.lighting,
            &options,
            Surroundings::in_memory(&Silent),
        ) {
            Err(ShadingError::Inconsistent(error)) => {
                assert_eq!(error.made_by, StageId::Poses);
                assert_eq!(error.reason, "anchor 4 is seen in view 3 of 3");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn poses_and_light_changed_at_random_never_end_in_a_panic() {
    let world = sphere_world();
    let mut random = Random(5);
    let (mut tried, mut refused) = (0, 0);
    while tried < 12 {
        let (Some((posed, of_poses)), Some((lighting, of_light))) = (
            mutated(&world.posed, &mut random),
            mutated(&world.lighting, &mut random),
        ) else {
            continue;
        };
        tried += 1;
        println!("{of_poses}, {of_light}");
        for options in models() {
            for (posed, lighting) in [(&posed, &world.lighting), (&world.posed, &lighting)] {
                let found = run(
                    &world.photos,
                    posed,
                    lighting,
                    &options,
                    Surroundings::in_memory(&Silent),
                );
                refused += usize::from(matches!(found, Err(ShadingError::Inconsistent(_))));
            }
        }
    }
    assert!(refused > 2, "{refused} of {}", 4 * tried);
}
