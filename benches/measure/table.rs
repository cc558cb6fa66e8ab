//! `shading_table`: views, matches and truth.

use rilievo_io::{
    read_cameras, read_depth, read_lighting, read_linear, read_mask, read_matches_csv,
};
use rilievo_scene::NormalMap;
use rilievo_shading::paper::{ShadingProblem, ShadingView, SolvedView, ViewLight, ViewMatches};
use std::path::Path;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// One view under one lighting, with the flat or rough start.
pub fn view(data: &Path, name: &str, light: &str, start: &str) -> Result<ShadingView> {
    let folder = data.join(name);
    let cameras = read_cameras(&folder.join("camera.json"))?;
    let camera = cameras.cameras.first().ok_or("no camera")?;
    let lighting = read_lighting(&data.join("lighting.json"), Some(light))?;
    let mut view = ShadingView::new(
        name,
        Arc::new(read_linear(&folder.join(format!("image_{light}.exr")))?),
        read_mask(&folder.join("mask.png"))?,
        camera.intrinsics,
        ViewLight::Uniform(lighting.for_view(name).ok_or("no light")?.clone()),
    );
    view.initial_depth = Some(read_depth(&folder.join(format!("depth_{start}.exr")))?);
    view.cam_from_world = camera.cam_from_world;
    Ok(view)
}

/// The matches, `[x1, y1, x2, y2]` in pixels.
pub fn matches(data: &Path) -> Result<Vec<[f64; 4]>> {
    Ok(read_matches_csv(&data.join("matches.csv"))?)
}

/// Both views from planes, with all matches.
pub fn two_views(data: &Path, light: &str) -> Result<ShadingProblem> {
    let views = ["view1", "view2"].map(|name| view(data, name, light, "flat"));
    Ok(ShadingProblem {
        views: views.into_iter().collect::<Result<_>>()?,
        matches: vec![ViewMatches {
            views: [0, 1],
            pixels: matches(data)?,
        }],
    })
}

/// True normals of a view.
pub fn true_normals(data: &Path, name: &str) -> Result<NormalMap> {
    Ok(rilievo_io::read_normal(
        &data.join(name).join("normal_true.exr"),
    )?)
}

/// Angle in degrees at every pixel `(x, y)` of the truth's mask; a missing normal counts 90.
pub fn angles(truth: &NormalMap, solved: &SolvedView) -> Vec<(usize, usize, f64)> {
    let pixels = (0..truth.height).flat_map(|y| (0..truth.width).map(move |x| (x, y)));
    let angle = |(x, y)| {
        let truth = truth.normal(x, y)?;
        let found = solved.normal.normal(x, y);
        Some((x, y, found.map_or(90.0, |n| n.angle(&truth).to_degrees())))
    };
    pixels.filter_map(angle).collect()
}
