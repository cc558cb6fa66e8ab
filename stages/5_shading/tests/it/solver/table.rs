//! The views of `shading_table`, for tests.

#[path = "../../../../../benches/measure/table.rs"]
mod files;

use rilievo_shading::paper::{ShadingProblem, ShadingView, SolvedView};
use std::path::Path;

/// One view under one lighting, with the flat or rough start.
pub fn view(data: &Path, name: &str, light: &str, start: &str) -> ShadingView {
    files::view(data, name, light, start).expect("readable data")
}

/// Both views from planes, with all matches.
pub fn two_views(data: &Path, light: &str) -> ShadingProblem {
    files::two_views(data, light).expect("readable data")
}

/// Angle in degrees at every pixel `(x, y)` of the mask; a missing normal counts 90.
pub fn angles(data: &Path, solved: &SolvedView) -> Vec<(usize, usize, f64)> {
    let truth = files::true_normals(data, &solved.name).expect("readable truth");
    files::angles(&truth, solved)
}

/// Mean of [`angles`].
pub fn mean_angle(data: &Path, solved: &SolvedView) -> f64 {
    let angles = angles(data, solved);
    angles.iter().map(|a| a.2).sum::<f64>() / angles.len() as f64
}
