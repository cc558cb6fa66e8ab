//! Examples that the help of each command ends with.

pub const DEMO: &str = "\
Examples:
  rilievo demo
  rilievo demo -o another --seed 7";

pub const CHECK: &str = "\
Examples:
  rilievo check photos
  rilievo check photos --masks masks --cameras intrinsics.json";

pub const MASK: &str = "\
Examples:
  rilievo mask photos -o masks
  rilievo mask photos -o masks --run run";

pub const RECONSTRUCT: &str = "\
Examples:
  rilievo reconstruct photos --masks masks --sphere sphere.json -o run
  rilievo reconstruct photos --sphere auto --sphere-radius 0.02 -o run
  rilievo reconstruct photos --cameras colmap/sparse/0 --until 3_poses -o run";

pub const RUN: &str = "\
Example:
  rilievo run 6_fusion run";

pub const STATUS: &str = "\
Examples:
  rilievo status run
  rilievo status run --verify";

pub const WHY: &str = "\
Example:
  rilievo why run 5_shading";

pub const CLEAN: &str = "\
Example:
  rilievo clean run 6_fusion";

pub const SHADE: &str = "\
Examples:
  rilievo shade --image photo.exr --mask mask.png --camera camera.json --lighting lighting.json -o shaded
  rilievo shade --image photo.png --mask mask.png --camera camera.json --prior depth.exr -o refined
  rilievo shade scene.json -o shaded";

pub const FUSE: &str = "\
Examples:
  rilievo fuse colmap/dense/0 --photos photos -o fused
  rilievo fuse run/5_shading --spacing 0.001 --watertight -o fused";

pub const EVALUATE: &str = "\
Examples:
  rilievo evaluate run --truth truth
  rilievo evaluate run --truth truth --align sim3 --json
  rilievo evaluate run --halves";

pub const SYNTH: &str = "\
Examples:
  rilievo synth set --views 8 --size 1280x960 --seed 3
  rilievo synth set --mesh bust.ply --format tiff";

pub const IMPORT: &str = "\
Examples:
  rilievo import transforms.json -o cameras.json
  rilievo import bundle.out -o cameras.json";

pub const EXPORT: &str = "\
Examples:
  rilievo export run --format colmap -o colmap
  rilievo export run --format npz -o cameras.npz";

pub const COMPLETIONS: &str = "\
Examples:
  rilievo completions bash
  rilievo completions zsh";

pub const MAN: &str = "\
Examples:
  rilievo man
  rilievo man -o man1";
