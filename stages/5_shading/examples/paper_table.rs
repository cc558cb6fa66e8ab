//! The paper's table on `data/shading_table`: `paper_table DATA_DIR [CASE...]`, a case being
//! `L3-rough`, `L3-flat`, … or `L3-two`.
//!
//! Prints mean and median angle of the normals over the whole mask, median relative depth error,
//! RMS of the re-rendered image, and CPU seconds.

mod table;

use rilievo_scene::{NormalMap, Silent};
use rilievo_shading::{ShadingOptions, ShadingProblem, ShadingSolution, ViewMatches, solve};
use std::path::Path;
use table::{Failure, read_matches, read_view};

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
        let pixels = read_matches(data)?;
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
