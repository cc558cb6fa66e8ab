//! The command line, as other tools call it.

mod args;
mod formats;
mod parse;
mod words;

use crate::raw_child::DecodeRawArgs;
pub use args::*;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
pub use formats::{ExportFormat, ImportFormat};
use std::ffi::OsString;

/// Photographs of a plain, matte object to an accurate, finely detailed 3D model, by shading.
#[derive(Debug, Parser)]
#[command(
    version = env!("RILIEVO_VERSION"),
    long_version = env!("RILIEVO_LONG_VERSION"),
    max_term_width = 100,
    after_help = EXIT_CODES
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 unexpected error, 2 wrong usage, 3 input that cannot \
be used, 4 the data do not allow a result, 5 run directory in use, damaged or of another version, \
6 reading or writing failed, 130 interrupted (the same command goes on).";

/// The definition without hidden commands, as shells complete it and man pages describe it: generators of completions
/// take in all commands that there are, and none can be taken out of a definition.
pub fn visible() -> clap::Command {
    let whole = Cli::command();
    let shown = whole.get_subcommands().filter(|c| !c.is_hide_set());
    clap::Command::new(env!("CARGO_PKG_NAME"))
        .version(env!("RILIEVO_VERSION"))
        .long_version(env!("RILIEVO_LONG_VERSION"))
        .about(whole.get_about().cloned().unwrap_or_default())
        .after_help(EXIT_CODES)
        .max_term_width(100)
        .subcommand_required(true)
        .subcommands(shown.cloned())
}

/// The examples that the help of a command ends with.
macro_rules! examples {
    ($($line:literal),+) => { concat!("Examples:", $("\n  rilievo ", $line),+) };
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// A synthetic scene, photographed, reconstructed and measured: one to two minutes
    #[command(after_help = examples!("demo", "demo -o another --seed 7"))]
    Demo(DemoArgs),
    /// Looks at photos and masks before anything is computed: what is good, what is not, what to do
    #[command(after_help = examples!(
        "check photos",
        "check photos --masks masks --cameras intrinsics.json"
    ))]
    Check(CheckArgs),
    /// Proposes masks of an object, by a plain backdrop or by the photos' poses, to be looked at and corrected
    #[command(after_help = examples!("mask photos -o masks", "mask photos -o masks --run run"))]
    Mask(MaskArgs),
    /// Photographs to depth maps, a point cloud and a mesh
    #[command(after_help = examples!(
        "reconstruct photos --masks masks --sphere sphere.json -o run",
        "reconstruct photos --sphere auto --sphere-radius 0.02 -o run",
        "reconstruct photos --cameras colmap/sparse/0 --until 3_poses -o run"
    ))]
    Reconstruct(Box<ReconstructArgs>),
    /// One stage of a run again, with what the run directory says
    #[command(after_help = examples!("run 6_fusion run"))]
    Run(RunArgs),
    /// Which stages of a run are valid, stale (and why) or missing
    #[command(after_help = examples!("status run", "status run --verify"))]
    Status(StatusArgs),
    /// Why a stage would be redone or kept
    #[command(after_help = examples!("why run 5_shading"))]
    Why(StageArgs),
    /// Deletes the results of a stage
    #[command(after_help = examples!("clean run 6_fusion"))]
    Clean(StageArgs),
    /// Shape from shading alone: one view, or several coupled; refinement of a measured depth
    #[command(after_help = examples!(
        "shade --image photo.exr --mask mask.png --camera camera.json --lighting lighting.json -o shaded",
        "shade --image photo.png --mask mask.png --camera camera.json --prior depth.exr -o refined",
        "shade scene.json -o shaded"
    ))]
    Shade(Box<ShadeArgs>),
    /// Depth and normal maps of other programs (COLMAP, OpenMVS, OpenEXR) to one cloud and one mesh
    #[command(after_help = examples!(
        "fuse colmap/dense/0 --photos photos -o fused",
        "fuse run/5_shading --spacing 0.001 --watertight -o fused"
    ))]
    Fuse(Box<FuseArgs>),
    /// Accuracy of a run against ground truth
    #[command(after_help = examples!(
        "evaluate run --truth truth",
        "evaluate run --truth truth --align sim3 --json",
        "evaluate run --halves"
    ))]
    Evaluate(EvaluateArgs),
    /// A synthetic photo folder with ground truth
    #[command(after_help = examples!(
        "synth set --views 8 --size 1280x960 --seed 3",
        "synth set --mesh bust.ply --format tiff"
    ))]
    Synth(SynthArgs),
    /// Cameras of another program to cameras.json; an object of DiLiGenT or DiLiGenT-MV to a folder of
    /// photos, masks and truth
    #[command(after_help = examples!(
        "import transforms.json -o cameras.json",
        "import cameras.sfm -o cameras.json"
    ))]
    Import(ImportArgs),
    /// Cameras of a run, or of cameras.json, to another program's format
    #[command(after_help = examples!(
        "export run --format colmap -o colmap",
        "export run --format npz -o cameras.npz"
    ))]
    Export(ExportArgs),
    /// The completion script of a shell, on stdout
    #[command(after_help = examples!("completions bash", "completions zsh"))]
    Completions(CompletionsArgs),
    /// The man page of the program on stdout, or a page per command in a folder
    #[command(after_help = examples!("man", "man -o man1"))]
    Man(ManArgs),
    /// One camera RAW file, from stdin to stdout: how this program decodes them
    #[command(hide = true)]
    DecodeRaw(DecodeRawArgs),
}

impl Command {
    /// The number of threads that was asked for.
    pub fn threads(&self) -> Option<u16> {
        let work = match self {
            Self::Demo(args) => &args.work,
            Self::Check(args) => &args.work,
            Self::Mask(args) => &args.work,
            Self::Reconstruct(args) => &args.work,
            Self::Run(args) => &args.work,
            Self::Shade(args) => &args.work,
            Self::Fuse(args) => &args.work,
            _ => return None,
        };
        work.threads
    }
}

/// Flags that commands had once, with what replaces them.
const RETIRED_FLAGS: [(&str, &str); 3] = [
    (
        "--anchors",
        "depth anchors are grown over the surface, the one way that is left",
    ),
    (
        "--depth-order",
        "depth files whose values stand column by column are recognised",
    ),
    (
        "--color",
        "give --config a file with the lines [fusion] and color = \"albedo\"",
    ),
];

impl Cli {
    /// The command line of some words, the program's name first.
    ///
    /// # Errors
    /// What clap refuses; of a retired flag with what replaces it.
    pub fn of(words: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let words: Vec<OsString> = words.into_iter().collect();
        Self::try_parse_from(&words).map_err(|error| {
            let retired = RETIRED_FLAGS.iter().find(|(flag, _)| {
                let is_flag = |word: &str| word == *flag || word.starts_with(&format!("{flag}="));
                words.iter().any(|word| word.to_str().is_some_and(is_flag))
            });
            match retired.filter(|_| error.kind() == ErrorKind::UnknownArgument) {
                Some((flag, instead)) => {
                    let text = format!("{flag} is no option any more: {instead}");
                    Self::command().error(ErrorKind::UnknownArgument, text)
                }
                None => error,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
        visible().debug_assert();
    }

    #[test]
    fn what_is_visible_has_the_programs_own_help_and_version() {
        let (mut whole, mut visible) = (Cli::command(), visible());
        let help = |program: &mut clap::Command| program.render_long_help().to_string();
        assert_eq!(help(&mut visible), help(&mut whole));
        assert_eq!(visible.render_version(), whole.render_version());
        assert_eq!(visible.render_long_version(), whole.render_long_version());
        assert!(visible.get_subcommands().all(|c| !c.is_hide_set()));
    }

    #[test]
    fn a_retired_flag_is_named_with_what_replaces_it() {
        let of = |text: &str| {
            let words = text.split_whitespace().map(OsString::from);
            Cli::of(words).unwrap_err().to_string()
        };
        for flag in ["--depth-order rows", "--depth-order=rows"] {
            let error = of(&format!("rilievo shade scene.json {flag} -o out"));
            assert!(error.contains("no option any more: depth files"), "{error}");
        }
        assert!(!of("rilievo shade --other").contains("any more"));
    }

    #[test]
    fn every_command_has_examples_that_it_understands() {
        let program = Cli::command();
        for command in program.get_subcommands().filter(|c| !c.is_hide_set()) {
            let help = command.get_after_help().map(ToString::to_string);
            let help = help.unwrap_or_default();
            let examples: Vec<&str> = help.lines().skip(1).collect();
            assert!(!examples.is_empty(), "{}", command.get_name());
            for example in examples {
                let parsed = Cli::try_parse_from(example.split_whitespace());
                assert!(parsed.is_ok(), "{example}: {:?}", parsed.err());
            }
        }
    }
}
