//! Reads `shading_table`: views, matches and truth.
#![allow(dead_code)]

use nalgebra::{Matrix3, Point3, Rotation3};
use rilievo_scene::{Intrinsics, Lighting, RigidTransform, SphericalHarmonics};
use rilievo_shading::paper::{ShadingProblem, ShadingView, SolvedView, ViewLight, ViewMatches};
use std::path::Path;
use std::sync::Arc;

/// Anything that can go wrong with a file.
pub type Failure = Box<dyn std::error::Error>;

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(values) => values.iter().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

/// One view under one lighting, with the flat or rough start.
pub fn read_view(
    data: &Path,
    name: &str,
    light: &str,
    start: &str,
) -> Result<ShadingView, Failure> {
    let folder = data.join(name);
    let camera: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("camera.json"))?)?;
    let k = numbers(&camera["K"]);
    let image = rilievo_io::read_linear(&folder.join(format!("image_{light}.exr")))?;
    let lights: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(data.join("lighting.json"))?)?;
    let lighting = Lighting {
        channels: numbers(&lights[light])
            .chunks_exact(9)
            .map(|row| SphericalHarmonics(std::array::from_fn(|j| row[j])))
            .collect(),
    };
    let rotation = Matrix3::from_row_slice(&numbers(&camera["world_from_camera_rotation"]));
    let center = numbers(&camera["camera_center"]);
    let mut view = ShadingView::new(
        name,
        Arc::new(image.clone()),
        rilievo_io::read_mask(&folder.join("mask.png"))?,
        Intrinsics::pinhole(image.width, image.height, k[0], k[2], k[5]),
        ViewLight::Uniform(lighting),
    );
    view.initial_depth = Some(rilievo_io::read_depth(
        &folder.join(format!("depth_{start}.exr")),
    )?);
    view.cam_from_world = Some(RigidTransform::from_world_pose(
        Rotation3::from_matrix_unchecked(rotation),
        Point3::new(center[0], center[1], center[2]),
    ));
    Ok(view)
}

/// The matches, `[x1, y1, x2, y2]` in pixels.
pub fn read_matches(data: &Path) -> Result<Vec<[f64; 4]>, Failure> {
    Ok(std::fs::read_to_string(data.join("matches.csv"))?
        .lines()
        .skip(1)
        .filter_map(|line| {
            let v: Vec<f64> = line.split(',').filter_map(|v| v.parse().ok()).collect();
            <[f64; 4]>::try_from(v).ok()
        })
        .collect())
}

/// [`read_view`] for tests.
#[allow(clippy::expect_used)]
pub fn view(data: &Path, name: &str, light: &str, start: &str) -> ShadingView {
    read_view(data, name, light, start).expect("readable data")
}

/// Both views from planes, with all matches, for tests.
#[allow(clippy::expect_used)]
pub fn two_views(data: &Path, light: &str) -> ShadingProblem {
    ShadingProblem {
        views: ["view1", "view2"]
            .map(|name| view(data, name, light, "flat"))
            .into(),
        matches: vec![ViewMatches {
            views: [0, 1],
            pixels: read_matches(data).expect("readable matches"),
        }],
    }
}

/// Angle in degrees at every pixel `(x, y)` of the mask, for tests; a missing normal counts 90.
#[allow(clippy::expect_used)]
pub fn angles(data: &Path, solved: &SolvedView) -> Vec<(usize, usize, f64)> {
    let path = data.join(&solved.name).join("normal_true.exr");
    let truth = rilievo_io::read_normal(&path).expect("readable truth");
    let mut angles = Vec::new();
    for y in 0..truth.height {
        for x in 0..truth.width {
            if let Some(t) = truth.normal(x, y) {
                let angle = solved.normal.normal(x, y).map_or(90.0, |n| {
                    n.normalize()
                        .dot(&t.normalize())
                        .clamp(-1.0, 1.0)
                        .acos()
                        .to_degrees()
                });
                angles.push((x, y, angle));
            }
        }
    }
    angles
}

/// Mean of [`angles`].
pub fn mean_angle(data: &Path, solved: &SolvedView) -> f64 {
    let angles = angles(data, solved);
    angles.iter().map(|a| a.2).sum::<f64>() / angles.len() as f64
}
