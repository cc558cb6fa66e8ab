//! The paper's table, on a head that is made here or on a folder laid out as `shading_table`.
//!
//! A case is `L3-rough`, `L3-flat`, `L3-two`, `L3-two-noise`, `L3-two-false`, … or `L3-true`, which
//! starts from the truth: where that leaves a larger difference of the images than another start, the
//! image does not tell the two shapes apart.
//!
//! Prints mean and median angle of the normals over the whole mask, median relative depth error
//! without and with one free scale, RMS of the re-rendered image, and CPU seconds.

use crate::growth::{mean, quantile};
use crate::head::Source;
use crate::{Failure, system, table};
use rilievo_io::Preview;
use rilievo_scene::{Raster, Silent};
use rilievo_shading::paper::{
    PaperOptions, ShadingProblem, ShadingSolution, SolvedView, Splitting, ViewMatches, solve,
};
use rilievo_synthetic::testing::Random;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// Cases; without any the table
    cases: Vec<String>,
    /// A folder laid out as `shading_table`
    #[arg(long)]
    data: Option<PathBuf>,
    /// Adds the paper's splitting and the fixed point
    #[arg(long)]
    methods: bool,
    /// Writes image, normals, depth and error of each case, and the energy of the methods against
    /// the iterations (`CASE_methods.svg`)
    #[arg(long)]
    pictures: Option<PathBuf>,
}

/// Mean and median angle in degrees, and median relative depth error in per cent, as it is and
/// after one scale.
fn errors(source: &Source, solved: &SolvedView) -> Result<[f64; 4], Failure> {
    let (normals, depths) = source.truth(&solved.name)?;
    let found = table::angles(&normals, solved);
    let ratio =
        |&(x, y, _): &(usize, usize, f64)| f64::from(solved.depth.at(x, y) / depths.at(x, y));
    let mut ratios: Vec<f64> = found.iter().map(ratio).collect();
    let mut angles: Vec<f64> = found.iter().map(|found| found.2).collect();
    let scale = quantile(&mut ratios, 0.5);
    let off = |scale: f64| {
        let mut off: Vec<f64> = ratios
            .iter()
            .map(|r| 100.0 * (r / scale - 1.0).abs())
            .collect();
        quantile(&mut off, 0.5)
    };
    Ok([
        mean(&angles),
        quantile(&mut angles, 0.5),
        off(1.0),
        off(scale),
    ])
}

/// `-noise`: half a pixel of noise on every coordinate; `-false`: that, and every twentieth match
/// replaced by a false one.
fn disturbed(mut pixels: Vec<[f64; 4]>, kind: &str) -> Vec<[f64; 4]> {
    let mut random = Random(12345);
    if kind == "-noise" || kind == "-false" {
        for value in pixels.iter_mut().flatten() {
            *value += 0.5 * random.normal();
        }
    }
    if kind == "-false" {
        for k in (7..pixels.len()).step_by(20) {
            let other = pixels[random.below(pixels.len())];
            pixels[k][2..].copy_from_slice(&other[2..]);
        }
    }
    pixels
}

fn case_problem(source: &Source, case: &str) -> Result<ShadingProblem, Failure> {
    let (light, start) = case.split_once('-').ok_or("a case is LIGHT-START")?;
    let mut problem = ShadingProblem::default();
    if let Some(kind) = start.strip_prefix("two") {
        for name in ["view1", "view2"] {
            problem.views.push(source.view(name, light, "flat")?);
        }
        let pixels = source.matches()?;
        problem.matches.push(ViewMatches {
            views: [0, 1],
            pixels: disturbed(pixels, kind),
        });
    } else {
        problem.views.push(source.view("view1", light, start)?);
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

/// What the authors' code reaches on `shading_table`: lighting, start, mean angle in degrees.
const AUTHORS_CODE: [(&str, &str, f64); 6] = [
    ("L1", "rough", 8.27),
    ("L2", "rough", 7.20),
    ("L3", "rough", 1.90),
    ("L1", "flat", 31.6),
    ("L2", "flat", 29.9),
    ("L3", "flat", 17.4),
];

/// The angle that one of the lists above has for a case.
fn known(list: &[(&str, &str, f64)], case: &str) -> String {
    list.iter()
        .find(|(light, start, _)| case == format!("{light}-{start}"))
        .map_or_else(|| "-".to_owned(), |(_, _, angle)| format!("{angle:.2}"))
}

/// Angle that is white in pictures of the error, degrees.
const WHITE_DEG: f32 = 30.0;

fn write_pictures(
    folder: &Path,
    case: &str,
    source: &Source,
    solution: &ShadingSolution,
) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)?;
    for view in &solution.views {
        let path = |kind: &str| folder.join(format!("{case}_{}_{kind}.png", view.name));
        rilievo_io::write_preview_png(&path("image"), Preview::Linear(&view.rendered), 0)?;
        rilievo_io::write_preview_png(&path("normal"), Preview::Normal(&view.normal), 0)?;
        rilievo_io::write_preview_png(&path("depth"), Preview::Depth(&view.depth), 0)?;
        let (normals, _) = source.truth(&view.name)?;
        let mut map = Raster::filled(normals.width, normals.height, -1.0);
        for (x, y, angle) in table::angles(&normals, view) {
            *map.at_mut(x, y) = angle as f32;
        }
        let error = Preview::Error {
            map: &map,
            max: WHITE_DEG,
        };
        rilievo_io::write_preview_png(&path("error"), error, 0)?;
    }
    Ok(())
}

/// One curve of a figure: a name and values of the energy.
type Curve = (String, Vec<f64>);

/// Energy per pixel against the iteration, logarithmic, as SVG.
fn figure(title: &str, curves: &[Curve]) -> String {
    const COLOURS: [&str; 3] = ["#0060a0", "#c06000", "#808080"];
    let values = || curves.iter().flat_map(|(_, values)| values).copied();
    let log = |v: f64| v.max(1e-12).log10();
    let low = values().map(log).fold(f64::INFINITY, f64::min).floor();
    let high = values().map(log).fold(f64::NEG_INFINITY, f64::max).ceil();
    let longest = curves.iter().map(|(_, v)| v.len()).max().unwrap_or(1);
    let x = |k: usize| 60.0 + 500.0 * k as f64 / longest.max(2) as f64;
    let y = |v: f64| 40.0 + 280.0 * (high - log(v)) / (high - low).max(1.0);
    let mut svg = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' width='600' height='380' font-family='sans-serif' \
         font-size='12'><rect width='600' height='380' fill='white'/><text x='60' y='20'>{title}: \
         energy per pixel against iteration</text>"
    );
    for decade in low as i32..=high as i32 {
        let at = y(10.0_f64.powi(decade));
        svg += &format!(
            "<path d='M60 {at}H560' stroke='#ddd'/><text x='15' y='{at}'>1e{decade}</text>"
        );
    }
    for ((name, values), (k, colour)) in curves.iter().zip(COLOURS.iter().enumerate()) {
        let points: Vec<String> = values
            .iter()
            .enumerate()
            .map(|(k, &v)| format!("{:.1},{:.1}", x(k), y(v)))
            .collect();
        svg += &format!(
            "<polyline fill='none' stroke='{colour}' stroke-width='2' points='{}'/><text x='{}' \
             y='350' fill='{colour}'>{name}</text>",
            points.join(" "),
            80 + 160 * k
        );
    }
    svg + "</svg>"
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let source = arguments
        .data
        .clone()
        .map_or_else(Source::made, Source::Folder);
    let methods: &[Splitting] = match arguments.methods {
        true => &[Splitting::Full, Splitting::Paper, Splitting::FixedPoint],
        false => &[Splitting::Full],
    };
    let mut cases = arguments.cases.clone();
    if cases.is_empty() {
        let starts = ["rough", "flat", "true", "two"];
        let of_start = |start| ["L3", "L1", "L2"].map(|light| format!("{light}-{start}"));
        cases = starts.into_iter().flat_map(of_start).collect();
    }
    println!(
        "case           view   method     MAE deg  median  depth %  scaled %  RMS image  CPU s   paper  its code"
    );
    for case in cases {
        let problem = case_problem(&source, &case)?;
        let mut curves: Vec<Curve> = Vec::new();
        for &splitting in methods {
            let options = PaperOptions {
                splitting,
                ..PaperOptions::default()
            };
            let begun = system::cpu_seconds();
            let solution = solve(&problem, &options, &Silent)?;
            let cpu = system::cpu_seconds() - begun;
            for (solved, facts) in solution.views.iter().zip(&solution.report.views) {
                let [mean, median, depth, scaled] = errors(&source, solved)?;
                println!(
                    "{case:14} {:6} {:10} {mean:7.3} {median:7.3} {depth:8.4}  {scaled:8.4}  {:9.5} {cpu:6.2}  {:>6}  {:>8}",
                    facts.name,
                    format!("{splitting:?}"),
                    facts.rms_rendered,
                    known(&PAPER, &case),
                    known(&AUTHORS_CODE, &case),
                );
            }
            let facts = &solution.report.views[0];
            let energies = facts.iterations.iter().map(|i| i.energy);
            let per_pixel = energies.map(|e| e / facts.num_pixels as f64);
            curves.push((format!("{splitting:?}"), per_pixel.collect()));
            if let Some(folder) = &arguments.pictures {
                write_pictures(folder, &format!("{case}_{splitting:?}"), &source, &solution)?;
            }
        }
        if let (Some(folder), true) = (&arguments.pictures, curves.len() > 1) {
            std::fs::write(
                folder.join(format!("{case}_methods.svg")),
                figure(&case, &curves),
            )?;
        }
    }
    Ok(())
}
