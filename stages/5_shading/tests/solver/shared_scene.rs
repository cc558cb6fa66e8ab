//! The cells of the paper's table on the shared scene, where it lies beside the repository.

use crate::solved;
use crate::table;
use rilievo_scene::Silent;
use rilievo_shading::paper::{Coupling, PaperOptions, solve};
use rilievo_synthetic::testing::shared_data;

#[test]
fn the_literal_coupling_of_two_views_agrees_with_anchors() {
    // Two views of one plane-like relief from cameras side by side, matched by projection.
    let Some(data) = shared_data("shading_table") else {
        return;
    };
    let problem = table::two_views(&data, "L3");
    for coupling in [Coupling::Anchors, Coupling::Literal] {
        let options = PaperOptions {
            coupling,
            ..PaperOptions::default()
        };
        let solution = solve(&problem, &options, &Silent).expect("a valid problem");
        for view in &solution.views {
            let angle = table::mean_angle(&data, view);
            println!("{coupling:?} {}: {angle}", view.name);
            assert!(angle < 2.2, "{coupling:?} {}: {angle}", view.name);
        }
    }
}

#[test]
fn the_papers_cells_are_reached_on_the_shared_scene() {
    let Some(data) = shared_data("shading_table") else {
        return;
    };
    for (light, start, limit) in [
        ("L3", "rough", 1.1),
        ("L1", "rough", 5.3),
        ("L2", "rough", 5.9),
        ("L3", "flat", 1.1),
        ("L1", "flat", 29.5),
    ] {
        let view = table::view(&data, "view1", light, start);
        let solution = solved(view, &PaperOptions::default());
        let angle = table::mean_angle(&data, &solution.views[0]);
        assert!(angle < limit, "{light} {start}: {angle} over {limit}");
    }
}

#[test]
fn confidence_ranks_the_true_errors() {
    let Some(data) = shared_data("shading_table") else {
        return;
    };
    for light in ["L3", "L1", "L2"] {
        let view = table::view(&data, "view1", light, "rough");
        let solution = solved(view, &PaperOptions::default());
        let solved = &solution.views[0];
        let confidence = solved.confidence.as_ref().expect("asked for");
        let mut pairs: Vec<(f32, f64)> = table::angles(&data, solved)
            .into_iter()
            .map(|(x, y, angle)| (*confidence.at(x, y), angle))
            .collect();
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        let fifths: Vec<f64> = pairs
            .chunks(pairs.len().div_ceil(5))
            .map(|fifth| fifth.iter().map(|pair| pair.1).sum::<f64>() / fifth.len() as f64)
            .collect();
        println!("{light}: {fifths:?}");
        assert!(
            fifths.windows(2).all(|pair| pair[0] < pair[1]),
            "{light}: {fifths:?}"
        );
    }
}
