//! The solver on analytic surfaces and on the shared scene.

mod analytic;
mod breaks;
mod convergence;
mod invariances;
mod recovery;
mod robustness;
mod shared_scene;
mod special_cases;
mod surface;
mod table;

use rilievo_scene::Silent;
use rilievo_shading::ShadingError;
use rilievo_shading::paper::{PaperOptions, ShadingProblem, ShadingSolution, ShadingView, solve};

fn problem(view: ShadingView) -> ShadingProblem {
    ShadingProblem {
        views: vec![view],
        matches: Vec::new(),
    }
}

fn solved(view: ShadingView, options: &PaperOptions) -> ShadingSolution {
    solve(&problem(view), options, &Silent).expect("a valid problem")
}

fn refused(view: ShadingView) -> ShadingError {
    match solve(&problem(view), &PaperOptions::default(), &Silent) {
        Ok(_) => panic!("accepted"),
        Err(error) => error,
    }
}
