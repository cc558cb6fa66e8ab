//! How the cost of a run grows with the number of photos.
//!
//! `cargo bench --bench scale -- [--size WxH] [--keep DIR] [N ...]` photographs one synthetic object `N` times (8, 16, 32
//! and 64 without it) at about a megapixel, reconstructs it, and prints for every stage CPU seconds, peak resident memory
//! and disk space, and the exponents `e` of `cost ~ N^e` fitted through them.

use rilievo_scene::StageId;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;

const PROGRAM: &str = env!("CARGO_BIN_EXE_rilievo");
/// Arc over which photos are taken, degrees a photo and at most: more photos go farther around, then closer together.
const ARC_PER_PHOTO_DEG: f64 = 15.0;
const MAX_ARC_DEG: f64 = 340.0;

/// What a stage cost.
#[derive(Clone, Copy, Default)]
struct Cost {
    cpu_seconds: f64,
    peak_mb: f64,
    disk_mb: f64,
}

struct Arguments {
    numbers: Vec<usize>,
    size: String,
    keep: Option<PathBuf>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = arguments()?;
    let folder = arguments.keep.clone().unwrap_or_else(|| {
        std::env::temp_dir().join(format!("rilievo-scale-{}", std::process::id()))
    });
    std::fs::create_dir_all(&folder)?;
    let mut costs = Vec::new();
    for &n in &arguments.numbers {
        let of_set = measured(&folder, n, &arguments.size)?;
        print_set(n, &of_set);
        costs.push(of_set);
    }
    print_growth(&arguments.numbers, &costs);
    if arguments.keep.is_none() {
        std::fs::remove_dir_all(&folder)?;
    }
    Ok(())
}

fn arguments() -> Result<Arguments, Box<dyn Error>> {
    let mut found = Arguments {
        numbers: Vec::new(),
        size: "1152x864".to_owned(),
        keep: None,
    };
    // `cargo bench` adds a flag of its own.
    let mut given = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = given.next() {
        match word.as_str() {
            "--size" => found.size = given.next().ok_or("--size takes WxH")?,
            "--keep" => found.keep = Some(given.next().ok_or("--keep takes a folder")?.into()),
            number => found.numbers.push(number.parse()?),
        }
    }
    if found.numbers.is_empty() {
        found.numbers = vec![8, 16, 32, 64];
    }
    Ok(found)
}

/// Photographs and reconstructs a set; the cost of every stage.
fn measured(folder: &Path, n: usize, size: &str) -> Result<Vec<Cost>, Box<dyn Error>> {
    let set = folder.join(format!("set{n}"));
    let run = folder.join(format!("run{n}"));
    let config = folder.join(format!("set{n}.toml"));
    let arc = (ARC_PER_PHOTO_DEG * n as f64).min(MAX_ARC_DEG);
    std::fs::write(
        &config,
        format!("[scene]\nsubject = \"stone\"\nspeckle = 0.02\n[photographs]\narc_deg = {arc}\n"),
    )?;
    if !set.exists() {
        program(
            &[
                "synth",
                &text(&set),
                "--views",
                &n.to_string(),
                "--size",
                size,
                "--seed",
                "77",
            ],
            &config,
        )?;
    }
    let (photos, masks) = (text(&set.join("photos")), text(&set.join("masks")));
    let sphere = text(&set.join("sphere.json"));
    let shading = folder.join("run.toml");
    std::fs::write(&shading, "")?;
    let out = text(&run);
    program(
        &[
            "reconstruct",
            &photos,
            "--masks",
            &masks,
            "--sphere",
            &sphere,
            "-o",
            &out,
        ],
        &shading,
    )?;
    let stages = StageId::ALL.iter();
    stages.map(|stage| cost(&run.join(stage.name()))).collect()
}

fn program(arguments: &[&str], config: &Path) -> Result<(), Box<dyn Error>> {
    let ended = Command::new(PROGRAM)
        .args(arguments)
        .arg("--config")
        .arg(config)
        .stderr(std::process::Stdio::null())
        .status()?;
    if ended.success() {
        return Ok(());
    }
    Err(format!("rilievo {} ended with {ended}", arguments.join(" ")).into())
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// What a stage's manifest tells of its cost.
fn cost(stage: &Path) -> Result<Cost, Box<dyn Error>> {
    let manifest: serde_json::Value =
        serde_json::from_slice(&std::fs::read(stage.join("manifest.json"))?)?;
    let files = manifest["files"]
        .as_object()
        .ok_or("a manifest names its files")?;
    let bytes: f64 = files
        .values()
        .filter_map(|file| file["bytes"].as_f64())
        .sum();
    Ok(Cost {
        cpu_seconds: manifest["cpu_seconds"].as_f64().ok_or("no CPU time")?,
        peak_mb: manifest["peak_memory_bytes"].as_f64().unwrap_or(f64::NAN) / 1e6,
        disk_mb: bytes / 1e6,
    })
}

fn print_set(n: usize, costs: &[Cost]) {
    println!("{n} photos        CPU s    CPU s a photo    peak MB    disk MB");
    let total = costs.iter().fold(Cost::default(), |sum, cost| Cost {
        cpu_seconds: sum.cpu_seconds + cost.cpu_seconds,
        peak_mb: sum.peak_mb.max(cost.peak_mb),
        disk_mb: sum.disk_mb + cost.disk_mb,
    });
    let stages = StageId::ALL.map(StageId::name);
    for (stage, cost) in stages
        .iter()
        .chain(&["all"])
        .zip(costs.iter().chain([&total]))
    {
        println!(
            "{stage:12} {:9.1} {:16.2} {:10.0} {:10.0}",
            cost.cpu_seconds,
            cost.cpu_seconds / n as f64,
            cost.peak_mb,
            cost.disk_mb
        );
    }
}

fn print_growth(numbers: &[usize], costs: &[Vec<Cost>]) {
    if numbers.len() < 2 {
        return;
    }
    println!("exponents        CPU     peak     disk");
    for (k, stage) in StageId::ALL.map(StageId::name).iter().enumerate() {
        let fitted = |value: fn(&Cost) -> f64| {
            let values: Vec<f64> = costs.iter().map(|of_set| value(&of_set[k])).collect();
            exponent(numbers, &values)
        };
        let (cpu, peak) = (fitted(|c| c.cpu_seconds), fitted(|c| c.peak_mb));
        println!(
            "{stage:12} {cpu:8.2} {peak:8.2} {:8.2}",
            fitted(|c| c.disk_mb)
        );
    }
}

/// Slope of the logarithm of cost over that of the number, by least squares.
fn exponent(numbers: &[usize], values: &[f64]) -> f64 {
    let points: Vec<[f64; 2]> = numbers
        .iter()
        .zip(values)
        .filter(|(_, value)| **value > 0.0)
        .map(|(&n, value)| [(n as f64).ln(), value.ln()])
        .collect();
    let count = points.len().max(1) as f64;
    let mean = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
    let (mut xy, mut xx) = (0.0, 0.0);
    for [x, y] in points {
        xy += (x - mean[0]) * (y - mean[1]);
        xx += (x - mean[0]).powi(2);
    }
    xy / xx
}
