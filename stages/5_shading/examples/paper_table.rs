//! The paper's table on `data/shading_table`: `paper_table DATA_DIR [CASE...]`, a case being
//! `L3-rough`, `L3-flat`, … or `L3-two`.
//!
//! Prints mean and median angle of the normals over the whole mask, median relative depth error,
//! RMS of the re-rendered image, and CPU seconds.

use nalgebra::{Matrix3, Point3, Rotation3};
use rilievo_scene::{Intrinsics, Lighting, NormalMap, RigidTransform, Silent, SphericalHarmonics};
use rilievo_shading::{
    ShadingOptions, ShadingProblem, ShadingSolution, ShadingView, ViewLight, ViewMatches, solve,
};
use std::path::Path;
use std::sync::Arc;

type Failure = Box<dyn std::error::Error>;

/// Seconds of processor time of this process.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split(' ').collect();
    let ticks = |k: usize| {
        fields
            .get(k)
            .and_then(|v| v.parse::<f64>().ok())
            .unwrap_or(0.0)
    };
    (ticks(12) + ticks(13)) / 100.0
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(values) => values.iter().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

fn read_view(data: &Path, name: &str, light: &str, start: &str) -> Result<ShadingView, Failure> {
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

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values
        .get(((values.len() as f64 - 1.0) * share) as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// Mean and median angle in degrees, and median relative depth error in per cent.
fn errors(data: &Path, solution: &ShadingSolution, at: usize) -> Result<[f64; 4], Failure> {
    let solved = &solution.views[at];
    let folder = data.join(&solved.name);
    let normals: NormalMap = rilievo_io::read_normal(&folder.join("normal_true.exr"))?;
    let depths = rilievo_io::read_depth(&folder.join("depth_true.exr"))?;
    let (mut angles, mut ratios) = (Vec::new(), Vec::new());
    if let Ok(folder) = std::env::var("OUTPUT") {
        let folder = Path::new(&folder);
        rilievo_io::write_depth(
            &folder.join(format!("{}_depth.exr", solved.name)),
            &solved.depth,
        )?;
        rilievo_io::write_normal(
            &folder.join(format!("{}_normal.exr", solved.name)),
            &solved.normal,
        )?;
    }
    for y in 0..normals.height {
        for x in 0..normals.width {
            if let Some(truth) = normals.normal(x, y) {
                let angle = solved.normal.normal(x, y).map_or(90.0, |n| {
                    n.normalize()
                        .dot(&truth.normalize())
                        .clamp(-1.0, 1.0)
                        .acos()
                        .to_degrees()
                });
                angles.push(angle);
                ratios.push(f64::from(solved.depth.at(x, y) / depths.at(x, y)));
            }
        }
    }
    if std::env::var_os("VERBOSE").is_some()
        && let Some(map) = &solved.confidence
    {
        // Mean error of the fifths of the mask, from the surest to the least sure.
        let mut pairs: Vec<(f32, f64)> = map
            .data
            .iter()
            .zip(&normals.data)
            .filter(|(_, n)| n[2] != 0.0)
            .map(|(&c, _)| c)
            .zip(angles.iter().copied())
            .collect();
        pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
        for fifth in pairs.chunks(pairs.len().div_ceil(5)) {
            let mean = fifth.iter().map(|pair| pair.1).sum::<f64>() / fifth.len() as f64;
            print!("[{:.3}: {mean:.2} deg] ", fifth[0].0);
        }
        println!();
    }
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    let scale = quantile(&mut ratios, 0.5);
    let mut raw: Vec<f64> = ratios.iter().map(|r| (r - 1.0).abs() * 100.0).collect();
    let mut scaled: Vec<f64> = ratios
        .iter()
        .map(|r| (r / scale - 1.0).abs() * 100.0)
        .collect();
    Ok([
        mean,
        quantile(&mut angles, 0.5),
        quantile(&mut raw, 0.5),
        quantile(&mut scaled, 0.5),
    ])
}

/// `-noise`: half a pixel of noise on every coordinate; `-false`: that, and every twentieth match
/// replaced by a false one.
fn disturbed(mut pixels: Vec<[f64; 4]>, kind: &str) -> Vec<[f64; 4]> {
    let mut state = 12345_u64;
    let mut uniform = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    if kind == "-noise" || kind == "-false" {
        for value in pixels.iter_mut().flatten() {
            let normal = (-2.0 * uniform().max(1e-12).ln()).sqrt()
                * (std::f64::consts::TAU * uniform()).cos();
            *value += 0.5 * normal;
        }
    }
    if kind == "-false" {
        let num = pixels.len();
        for k in (7..num).step_by(20) {
            let other = pixels[((uniform() * num as f64) as usize).min(num - 1)];
            pixels[k][2] = other[2];
            pixels[k][3] = other[3];
        }
    }
    pixels
}

fn case_problem(data: &Path, case: &str) -> Result<ShadingProblem, Failure> {
    let (light, start) = case.split_once('-').ok_or("a case is LIGHT-START")?;
    let mut problem = ShadingProblem::default();
    if let Some(kind) = start.strip_prefix("two") {
        for name in ["view1", "view2"] {
            problem.views.push(read_view(data, name, light, "flat")?);
        }
        let pixels: Vec<[f64; 4]> = std::fs::read_to_string(data.join("matches.csv"))?
            .lines()
            .skip(1)
            .filter_map(|line| {
                let v: Vec<f64> = line.split(',').filter_map(|v| v.parse().ok()).collect();
                <[f64; 4]>::try_from(v).ok()
            })
            .collect();
        problem.matches.push(ViewMatches {
            views: [0, 1],
            pixels: disturbed(pixels, kind),
        });
    } else {
        problem.views.push(read_view(data, "view1", light, start)?);
    }
    Ok(problem)
}

fn main() -> Result<(), Failure> {
    let mut args = std::env::args().skip(1);
    let data = args.next().ok_or("usage: paper_table DATA_DIR [CASE...]")?;
    let mut cases: Vec<String> = args.collect();
    if cases.is_empty() {
        cases = ["rough", "flat", "two"]
            .iter()
            .flat_map(|start| ["L3", "L1", "L2"].map(|light| format!("{light}-{start}")))
            .collect();
    }
    let options: ShadingOptions = match std::env::var("OPTIONS") {
        Ok(json) => serde_json::from_str(&json)?,
        Err(_) => ShadingOptions::default(),
    };
    println!("case       view    MAE deg  median  depth %  scaled %  RMS image  CPU s  theta  z");
    for case in cases {
        let problem = case_problem(Path::new(&data), &case)?;
        let begun = cpu_seconds();
        let solution = solve(&problem, &options, &Silent)?;
        let cpu = cpu_seconds() - begun;
        for at in 0..solution.views.len() {
            let [mean, median, depth, scaled] = errors(Path::new(&data), &solution, at)?;
            let facts = &solution.report.views[at];
            if std::env::var_os("VERBOSE").is_some() {
                println!(
                    "{} anchors, {} rejected; matches {:?} px, {} rejected",
                    facts.num_anchors,
                    facts.num_anchors_rejected,
                    solution.report.match_sigma_px,
                    solution.report.num_matches_rejected
                );
            }
            println!(
                "{case:10} {:7} {mean:7.3} {median:7.3} {depth:8.4} {scaled:8.4}  {:9.5} {cpu:6.2} {:6.2} {:6.2}",
                facts.name, facts.rms_rendered, facts.seconds.theta, facts.seconds.z
            );
        }
    }
    Ok(())
}
