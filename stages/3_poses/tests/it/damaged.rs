//! Matches that were damaged between the stages: an error that says so, or a result, never a panic.

use crate::common;

use common::{WorldOptions, options, world};
use rilievo_poses::{PosesError, run};
use rilievo_scene::{FeatureMatches, PhotoIdx, Silent, StageId};
use rilievo_synthetic::testing::{Random, mutated};

#[test]
fn matches_that_contradict_the_keypoints_are_named() {
    let world = world(&WorldOptions::default());
    let told = |change: &dyn Fn(&mut FeatureMatches)| {
        let mut matches = world.matches.clone();
        change(&mut matches);
        match run(&world.photos, &matches, None, &options(), &Silent) {
            Err(PosesError::Inconsistent(error)) => {
                assert_eq!(error.made_by, StageId::Features);
                error.reason
            }
            other => panic!("{other:?}"),
        }
    };
    for (reason, parts) in [
        (
            told(&|m| m.pairs[2].matches[7] = [5, 4000]),
            vec!["pair 2", "keypoint 4000 of 400"],
        ),
        (
            told(&|m| m.photos[1].keypoints.clear()),
            vec!["v001.png", "of 0"],
        ),
        (
            told(&|m| m.pairs[0].second = PhotoIdx(9)),
            vec!["pair 0 has photo 9 of 6"],
        ),
        (
            told(&|m| m.pairs[1].first = m.pairs[1].second),
            vec!["pair 1 joins photo 2 with photo 2"],
        ),
        (
            told(&|m| m.photos[3].keypoints[8].x = f32::NAN),
            vec!["keypoint 8 lies outside v003.png"],
        ),
        (
            told(&|m| m.photos[3].keypoints[8].y = 4000.0),
            vec!["keypoint 8 lies outside v003.png"],
        ),
        (
            told(&|m| drop(m.photos.pop())),
            vec!["5 lists of keypoints for 6 photos"],
        ),
    ] {
        assert!(parts.iter().all(|part| reason.contains(part)), "{reason}");
    }
}

#[test]
fn matches_changed_at_random_never_end_in_a_panic() {
    let world = world(&WorldOptions {
        num_views: 4,
        num_points: 60,
        noise_px: 0.3,
        ..WorldOptions::default()
    });
    let mut random = Random(3);
    let (mut tried, mut refused) = (0, 0);
    while tried < 300 {
        let Some((matches, place)) = mutated(&world.matches, &mut random) else {
            continue;
        };
        tried += 1;
        println!("{place}");
        let result = run(&world.photos, &matches, None, &options(), &Silent);
        match result {
            Ok((posed, _)) => posed.check_with(&world.photos).unwrap(),
            Err(PosesError::Inconsistent(_)) => refused += 1,
            Err(_) => {}
        }
    }
    assert!(refused > 50 && refused < tried, "{refused} of {tried}");
}
