//! The paper's table on `data/shading_table`: `paper_table DATA_DIR [--methods] [--pictures DIR] [CASE...]`,
//! a case being `L3-rough`, `L3-flat`, `L3-two`, `L3-two-noise`, `L3-two-false`, …
//!
//! Prints mean and median angle of the normals over the whole mask, median relative depth error
//! without and with one free scale, RMS of the re-rendered image, and CPU seconds; `--methods` adds the
//! paper's splitting and the fixed point, `--pictures` writes image, normals and depth.

mod table;

use rilievo_io::Preview;
use rilievo_scene::{NormalMap, Silent};
use rilievo_shading::{
    ShadingOptions, ShadingProblem, ShadingSolution, Splitting, ViewMatches, solve,
};
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

/// What the paper reports for its own object (mean angle, degrees): lighting, start, its splitting.
const PAPER: [(&str, &str, f64); 8] = [
    ("L1", "rough", 8.74),
    ("L2", "rough", 9.93),
    ("L3", "rough", 3.61),
    ("L1", "flat", 27.91),
    ("L2", "flat", 37.46),
    ("L3", "flat", 13.80),
    ("L1", "two", 18.34),
    ("L3", "two", 8.13),
];

fn write_pictures(folder: &Path, case: &str, solution: &ShadingSolution) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)?;
    for view in &solution.views {
        let path = |kind: &str| folder.join(format!("{case}_{}_{kind}.png", view.name));
        rilievo_io::write_preview_png(&path("image"), Preview::Linear(&view.rendered), 0)?;
        rilievo_io::write_preview_png(&path("normal"), Preview::Normal(&view.normal), 0)?;
        rilievo_io::write_preview_png(&path("depth"), Preview::Depth(&view.depth), 0)?;
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let mut data = None;
    let mut pictures = None;
    let mut methods = vec![Splitting::Full];
    let mut cases: Vec<String> = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--pictures" => pictures = args.next(),
            "--methods" => methods = vec![Splitting::Full, Splitting::Paper, Splitting::FixedPoint],
            _ if data.is_none() => data = Some(arg),
            _ => cases.push(arg),
        }
    }
    let data = data.ok_or("usage: paper_table DATA_DIR [--methods] [--pictures DIR] [CASE...]")?;
    let data = Path::new(&data);
    if cases.is_empty() {
        cases = ["rough", "flat", "two"]
            .iter()
            .flat_map(|start| ["L3", "L1", "L2"].map(|light| format!("{light}-{start}")))
            .collect();
    }
    println!(
        "case           view   method MAE deg  median  depth %  scaled %  RMS image  CPU s  (paper, its object)"
    );
    for case in cases {
        let problem = case_problem(data, &case)?;
        let paper = PAPER
            .iter()
            .find(|(light, start, _)| case == format!("{light}-{start}"))
            .map_or_else(String::new, |(_, _, angle)| format!("{angle:.2}"));
        for &splitting in &methods {
            let options = ShadingOptions {
                splitting,
                ..ShadingOptions::default()
            };
            let begun = cpu_seconds();
            let solution = solve(&problem, &options, &Silent)?;
            let cpu = cpu_seconds() - begun;
            for at in 0..solution.views.len() {
                let [mean, median, depth, scaled] = errors(data, &solution, at)?;
                let facts = &solution.report.views[at];
                println!(
                    "{case:14} {:6} {:6} {mean:7.3} {median:7.3} {depth:8.4} {scaled:8.4}  {:9.5} {cpu:6.2}  {paper}",
                    facts.name,
                    format!("{splitting:?}"),
                    facts.rms_rendered
                );
            }
            if let (Some(folder), Splitting::Full) = (&pictures, splitting) {
                write_pictures(Path::new(folder), &case, &solution)?;
            }
        }
    }
    Ok(())
}
