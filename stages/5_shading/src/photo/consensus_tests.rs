//! Weights of the views against each other, on rendered views of known angles.

#![allow(clippy::unwrap_used)]

use super::rendered_tests::{depths, loaded, options, photographed};
use nalgebra::{Point2, Vector3};
use rilievo_numerics::robust::median;
use rilievo_stereo::consensus::{MAX_RELATIVE_WEIGHT, add_terms};
use rilievo_stereo::level::Level;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_synthetic::{LightModel, Subject};

#[test]
fn the_view_that_faces_the_surface_counts_for_more() {
    let (scene, mut render) = options(Subject::Ellipsoid, LightModel::Harmonics, (240, 180));
    render.num_views = 2;
    render.arc_deg = 60.0;
    let world = photographed(scene, &render, None);
    let scene = loaded(&world);
    let truth = depths(&world, &scene);
    let level = Level::new(scene.pyramid[0].views.clone(), &[vec![1], vec![0]]);
    let surfaces = Surfaces::new(&level, &truth, Reading::Cubic);
    let n = truth[0].len();
    let (mut hessian, mut rhs) = (vec![0.0; n], vec![0.0; n]);
    let terms = (hessian.as_mut_slice(), rhs.as_mut_slice());
    add_terms(&surfaces, 0, &truth[0], 1.0, 0.1, terms);

    // What is a quarter as certain is held a quarter as strongly.
    let uncertain = vec![vec![0.25; n]; 2];
    let surfaces = surfaces.with_certainty(Some(&uncertain));
    let (mut weaker, mut pulls) = (vec![0.0; n], vec![0.0; n]);
    let terms = (weaker.as_mut_slice(), pulls.as_mut_slice());
    add_terms(&surfaces, 0, &truth[0], 1.0, 0.1, terms);
    let pairs = hessian.iter().chain(&rhs).zip(weaker.iter().chain(&pulls));
    for (sure, unsure) in pairs {
        assert!(
            (0.25 * sure - unsure).abs() <= 1e-12 * sure.abs(),
            "{sure} {unsure}"
        );
    }

    let (here, other) = (&world.views[0], &world.views[1]);
    let world_from_here = here.cam_from_world.inverse();
    let corner = scene.frames[0].corner;
    let (mut bounded, mut better, mut worse) = (Vec::new(), Vec::new(), Vec::new());
    for p in 0..n {
        let Some(proposal) = surfaces.propose(0, 0, p, truth[0][p], 0.1) else {
            continue;
        };
        let pixels = &level.views[0].pixels;
        let (x, y) = (
            pixels.xs[p] as usize + corner.0,
            pixels.ys[p] as usize + corner.1,
        );
        let normal: Vector3<f64> = here.normal.normal(x, y).unwrap();
        let at = Point2::new(x as f64, y as f64);
        let point = here.intrinsics.unproject(&at, truth[0][p].exp());
        let facing = -normal.dot(&point.coords.normalize());
        let seen = other.cam_from_world.apply(&world_from_here.apply(&point));
        let turned = other.cam_from_world.rotation * (world_from_here.rotation * normal);
        let facing_other = -turned.dot(&seen.coords.normalize());
        // At a grazing angle a facet tells little.
        if facing.min(facing_other) < 0.5 {
            continue;
        }
        let expected = (facing_other / facing).powi(2);
        let found = hessian[p] / proposal.slope.powi(2);
        let deviation = |expected: f64| (found / expected - 1.0).abs();
        if expected > 1.4 * MAX_RELATIVE_WEIGHT {
            bounded.push(deviation(MAX_RELATIVE_WEIGHT));
        } else if (1.2..0.95 * MAX_RELATIVE_WEIGHT).contains(&expected) {
            better.push(deviation(expected));
        } else if expected < 0.67 {
            worse.push(deviation(expected));
        }
    }
    // The mesh's facets turn their normals by a degree or two.
    for mut deviations in [bounded, better, worse] {
        let count = deviations.len();
        let middle = median(&mut deviations).unwrap();
        assert!(count > 100 && middle < 0.1, "{count} pixels: {middle}");
    }
}
