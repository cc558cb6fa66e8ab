//! Whole runs of the program on one synthetic object that is photographed `N` times: CPU seconds,
//! peak resident memory and disk space of every stage, and the exponents `e` of `cost ~ N^e` fitted
//! through them.

use crate::Failure;
use crate::growth::exponent;
use rilievo_scene::StageId;
use std::path::{Path, PathBuf};
use std::process::Command;

const PROGRAM: &str = env!("CARGO_BIN_EXE_rilievo");
/// Arc over which photos are taken, degrees a photo and at most: more photos go farther around,
/// then closer together.
const ARC_PER_PHOTO_DEG: f64 = 15.0;
const MAX_ARC_DEG: f64 = 340.0;

#[derive(clap::Args)]
pub struct Arguments {
    /// Numbers of photos
    #[arg(default_values_t = [8, 16, 32, 64])]
    numbers: Vec<usize>,
    /// Size of the photos
    #[arg(long, default_value = "1152x864")]
    size: String,
    /// Keeps sets and runs in this folder
    #[arg(long)]
    keep: Option<PathBuf>,
}

/// What a stage cost: CPU seconds, and MB of memory and disk.
#[derive(Clone, Copy, Default)]
struct Cost {
    cpu_seconds: f64,
    peak_mb: f64,
    disk_mb: f64,
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let temporary = tempfile::tempdir()?;
    let folder = arguments.keep.as_deref().unwrap_or(temporary.path());
    std::fs::create_dir_all(folder)?;
    let mut costs = Vec::new();
    for &n in &arguments.numbers {
        let of_set = run(folder, n, &arguments.size)?;
        print_set(n, &of_set);
        costs.push(of_set);
    }
    if costs.len() < 2 {
        return Ok(());
    }
    println!("exponents        CPU     peak     disk");
    for (k, stage) in StageId::ALL.iter().enumerate() {
        let fitted = |value: fn(&Cost) -> f64| {
            let values = costs.iter().map(|of_set| value(&of_set[k]));
            exponent(arguments.numbers.iter().copied().zip(values))
        };
        println!(
            "{:12} {:8.2} {:8.2} {:8.2}",
            stage.name(),
            fitted(|c| c.cpu_seconds),
            fitted(|c| c.peak_mb),
            fitted(|c| c.disk_mb)
        );
    }
    Ok(())
}

/// Photographs and reconstructs a set; the cost of every stage.
fn run(folder: &Path, n: usize, size: &str) -> Result<Vec<Cost>, Failure> {
    let set = folder.join(format!("set{n}"));
    let run = folder.join(format!("run{n}"));
    let config = folder.join(format!("set{n}.toml"));
    let arc = (ARC_PER_PHOTO_DEG * n as f64).min(MAX_ARC_DEG);
    std::fs::write(
        &config,
        format!("[scene]\nsubject = \"stone\"\nspeckle = 0.02\n[photographs]\narc_deg = {arc}\n"),
    )?;
    if !set.exists() {
        let mut synth = Command::new(PROGRAM);
        synth.arg("synth").arg(&set).arg("--config").arg(&config);
        synth.args(["--seed", "77", "--size", size, "--views", &n.to_string()]);
        succeed(&mut synth)?;
    }
    let mut reconstruct = Command::new(PROGRAM);
    reconstruct
        .arg("reconstruct")
        .arg(set.join("photos"))
        .arg("-o")
        .arg(&run);
    reconstruct.arg("--masks").arg(set.join("masks"));
    reconstruct.arg("--sphere").arg(set.join("sphere.json"));
    succeed(&mut reconstruct)?;
    let stages = StageId::ALL.iter();
    stages.map(|stage| cost(&run.join(stage.name()))).collect()
}

fn succeed(command: &mut Command) -> Result<(), Failure> {
    let ended = command.stderr(std::process::Stdio::null()).status()?;
    ended
        .success()
        .then_some(())
        .ok_or_else(|| format!("{command:?} ended with {ended}").into())
}

/// What a stage's manifest says of its cost.
fn cost(stage: &Path) -> Result<Cost, Failure> {
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
    let stages = StageId::ALL.iter().map(|stage| stage.name());
    for (stage, cost) in stages.chain(["all"]).zip(costs.iter().chain([&total])) {
        let Cost {
            cpu_seconds,
            peak_mb,
            disk_mb,
        } = cost;
        let each = cpu_seconds / n as f64;
        println!("{stage:12} {cpu_seconds:9.1} {each:16.2} {peak_mb:10.0} {disk_mb:10.0}");
    }
}
