//! Outlines of a rendered object on a mat beside a sphere, from true points, against true masks.

// Helpers outside the test functions may fail as these may.
#![allow(clippy::expect_used)]

use nalgebra::Point3;
use rilievo_scene::{PhotoIdx, PosedViews, SparsePoint, TrackElement, ViewIdx};
use rilievo_segmentation::{
    Consensus, Outline, SeenPoints, SegmentationError, Sketch, outline, sketch,
};
use rilievo_synthetic::testing::{Random, overlap, posed_view};
use rilievo_synthetic::{
    RenderOptions, RenderedView, Scene, SceneOptions, Subject, render, true_tracks,
};

const NUM_OBJECT_POINTS: usize = 500;
const NUM_MAT_POINTS: usize = 1500;

struct World {
    views: Vec<RenderedView>,
    posed: PosedViews,
}

fn world(subject: Subject) -> World {
    let scene = Scene::new(SceneOptions {
        seed: 11,
        subject,
        mesh_spacing_m: 0.004,
        ..SceneOptions::default()
    })
    .expect("a usable scene");
    let options = RenderOptions {
        num_views: 5,
        width: 480,
        height: 360,
        shadow_rays: 24,
        ..RenderOptions::default()
    };
    let views = render(&scene, &options).expect("photos");
    let mut posed = PosedViews::default();
    for (k, view) in views.iter().enumerate() {
        let name = format!("{}.jpg", view.name);
        posed
            .views
            .push(posed_view(k, &name, view.intrinsics, view.cam_from_world));
    }
    for track in true_tracks(&scene.mesh, &views, NUM_OBJECT_POINTS, 5) {
        let seen = track
            .observations
            .iter()
            .map(|&(view, pixel, _)| (view, pixel));
        posed.points.push(sparse(track.position, seen.collect()));
    }
    let mut random = Random(3);
    for _ in 0..NUM_MAT_POINTS {
        let position = [random.unit() - 0.5, random.unit() - 0.5, 0.0];
        let seen: Vec<_> = (views.iter().enumerate())
            .filter_map(|(k, view)| Some((k, uncovered(view, position)?)))
            .collect();
        if seen.len() > 1 {
            posed.points.push(sparse(position, seen));
        }
    }
    World { views, posed }
}

fn sparse(position: [f64; 3], seen: Vec<(usize, [f64; 2])>) -> SparsePoint {
    SparsePoint {
        position,
        color: [0; 3],
        error_px: 0.0,
        track: seen
            .into_iter()
            .map(|(view, pixel)| TrackElement {
                view: ViewIdx(view),
                keypoint_idx: 0,
                pixel,
            })
            .collect(),
    }
}

/// Where a view sees a place of the mat, unless object or sphere stand before it.
fn uncovered(view: &RenderedView, position: [f64; 3]) -> Option<[f64; 2]> {
    let in_cam = view.cam_from_world.apply(&Point3::from(position));
    let pixel = view.intrinsics.project(&in_cam)?;
    let (x, y) = (pixel.x.round() as isize, pixel.y.round() as isize);
    let covered =
        view.object_mask.contains(x, y) || view.sphere_masks.iter().any(|mask| mask.contains(x, y));
    let inside = view.object_mask.get(x, y).is_some();
    (inside && !covered).then_some(pixel.into())
}

fn outlines(world: &World) -> Vec<Outline> {
    let points = parted(world);
    let views = || world.posed.views.iter().zip(&world.views).enumerate();
    let sketches: Vec<Option<Sketch>> = views()
        .map(|(k, (view, rendered))| sketch(&points, k, view, &rendered.image).ok())
        .collect();
    let consensus = Consensus::of(&points, &world.posed.views, &sketches).expect("votes");
    views()
        .map(|(k, (view, rendered))| {
            let own = sketches[k].as_ref().expect("a sketch");
            let known = (own, consensus.as_ref());
            outline(&points, k, view, &rendered.image, known).expect("a mask")
        })
        .collect()
}

/// Of every view, the share of its mask inside the others'.
fn agreements(world: &World, sketches: &[Option<Sketch>]) -> Option<Vec<f64>> {
    let views = &world.posed.views[..sketches.len()];
    let consensus = Consensus::of(&parted(world), views, sketches).expect("votes")?;
    let all = views.iter().zip(sketches.iter().flatten());
    Some(
        all.map(|(view, own)| {
            consensus
                .agreement(view, own)
                .expect("votes")
                .expect("others")
        })
        .collect(),
    )
}

#[test]
fn an_object_on_a_mat_is_cut_out_without_the_sphere_beside_it() {
    for subject in [Subject::Stone, Subject::Bust] {
        let world = world(subject);
        let found = outlines(&world);
        for (outline, rendered) in found.iter().zip(&world.views) {
            let share = overlap(&outline.mask, &rendered.object_mask);
            assert!(share > 0.95, "{subject:?} {}: {share}", rendered.name);
            assert!(outline.inside > 0.98, "{subject:?} {}", outline.inside);
            for sphere in &rendered.sphere_masks {
                let on_sphere = sphere.data.iter().zip(&outline.mask.data);
                let taken = on_sphere
                    .filter(|(sphere, mask)| **sphere && **mask)
                    .count();
                assert!(taken < sphere.count() / 50, "{subject:?}: {taken}");
            }
        }
        let last: Vec<Option<Sketch>> = found.into_iter().map(|o| Some(o.sketch)).collect();
        for share in agreements(&world, &last).expect("five photos") {
            assert!(share > 0.97, "{subject:?}: {share}");
        }
    }
}

fn parted(world: &World) -> rilievo_segmentation::ObjectPoints {
    SeenPoints::new(&world.posed)
        .part(&world.posed.views)
        .expect("an object")
}

#[test]
fn a_mask_that_takes_in_something_else_disagrees_with_the_others() {
    let world = world(Subject::Stone);
    let found = outlines(&world);
    let mut last: Vec<Option<Sketch>> = found.into_iter().map(|o| Some(o.sketch)).collect();
    let small = &mut last[2].as_mut().expect("a sketch").mask;
    for y in 0..small.height {
        for x in small.width * 3 / 4..small.width {
            *small.at_mut(x, y) = true;
        }
    }
    let shares = agreements(&world, &last).expect("five photos");
    assert!(shares[2] < 0.7, "{shares:?}");
    assert!(shares[0] > 0.95, "{shares:?}");
    // Two photos cannot tell which of them is wrong.
    assert_eq!(agreements(&world, &last[..2]), None);
}

#[test]
fn what_cannot_be_told_is_refused() {
    let world = world(Subject::Stone);
    let on_mat = |p: &&SparsePoint| p.position[2] == 0.0;
    let mat_only = PosedViews {
        points: world.posed.points.iter().filter(on_mat).cloned().collect(),
        ..world.posed.clone()
    };
    let refused = SeenPoints::new(&mat_only)
        .part(&mat_only.views)
        .unwrap_err();
    assert!(
        matches!(refused, SegmentationError::FewPoints { .. }),
        "{refused}"
    );
    let nothing = PosedViews::default();
    let refused = SeenPoints::new(&nothing).part(&nothing.views).unwrap_err();
    assert!(
        matches!(refused, SegmentationError::FewPoints { found: 0, .. }),
        "{refused}"
    );
    // A camera that looks the other way.
    let mut away = world.posed.views[0].clone();
    away.photo = PhotoIdx(0);
    away.cam_from_world.translation.z -= 100.0;
    let refused = sketch(&parted(&world), 0, &away, &world.views[0].image).unwrap_err();
    assert!(
        matches!(refused, SegmentationError::NotInPhoto { .. }),
        "{refused}"
    );
}
