//! The measurements behind `benches/EXPERIMENTS.md`, ARCHITECTURE and CHANGELOG:
//! `cargo bench --bench measure -- help` lists them.
//!
//! Data sets hold `photos`, `masks` and `truth` as `rilievo synth` writes them.

#[allow(dead_code, reason = "shared with a test")]
mod data_set;
mod head;
#[path = "../../stages/3_poses/tests/it/common/mod.rs"]
#[allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]
mod rings;
#[path = "../../src/system.rs"]
#[allow(dead_code, reason = "the program uses more of it")]
mod system;
#[allow(dead_code, reason = "shared with a test")]
mod table;

mod anchors;
mod growth;
mod large;
mod many_views;
mod paper_table;
mod photo_model;
mod scale;
mod sphere;
mod steps;
mod truth_maps;

use clap::Parser;

type Failure = Box<dyn std::error::Error + Send + Sync>;

#[derive(Parser)]
#[command(about = "Measures accuracy, time and memory of the stages")]
enum Measure {
    /// Depth anchors against true depth
    Anchors(anchors::Arguments),
    /// Time and memory of the paper's model on large colour views
    Large(large::Arguments),
    /// Time and memory of pose estimation by the number of photos, on simulated tracks
    ManyViews(many_views::Arguments),
    /// The paper's table
    PaperTable(paper_table::Arguments),
    /// Accuracy of the photo model on true cameras, after every step
    PhotoModel(photo_model::Arguments),
    /// CPU time, memory and disk space of whole runs by the number of photos
    Scale(scale::Arguments),
    /// Sphere, scale, gains and light on true cameras
    Sphere(sphere::Arguments),
    /// The paper's theta-step and z-step against the machine's copy bandwidth
    Steps,
    /// Cloud and mesh that fusion makes of true maps
    TruthMaps(truth_maps::Arguments),
}

fn main() -> Result<(), Failure> {
    // `cargo bench` adds a flag of its own.
    let words = std::env::args_os().filter(|word| word != "--bench");
    match Measure::parse_from(words) {
        Measure::Anchors(arguments) => anchors::measure(&arguments),
        Measure::Large(arguments) => large::measure(&arguments),
        Measure::ManyViews(arguments) => many_views::measure(&arguments),
        Measure::PaperTable(arguments) => paper_table::measure(&arguments),
        Measure::PhotoModel(arguments) => photo_model::measure(&arguments),
        Measure::Scale(arguments) => scale::measure(&arguments),
        Measure::Sphere(arguments) => sphere::measure(&arguments),
        Measure::Steps => steps::measure(),
        Measure::TruthMaps(arguments) => truth_maps::measure(&arguments),
    }
}
