//! Options whose values are words, with the help of each value. A word is the value's name in
//! configuration files.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde::de::DeserializeOwned;

/// Words with their help.
type Words = &'static [(&'static str, &'static str)];

/// `--model`
pub(super) const MODELS: Words = &[
    (
        "photo",
        "Shading with visibility, and the photos' agreement with each other",
    ),
    ("paper", "Distant harmonics and depth anchors only"),
];

/// `--formats`
pub(super) const MESH_FORMATS: Words = &[
    ("ply", "Stanford's PLY, which is always written"),
    (
        "asset",
        "A light mesh with textures, as binary glTF and OBJ",
    ),
    ("obj", "Wavefront OBJ"),
    ("glb", "Binary glTF, for viewers and the web"),
];

/// `--encoding`
pub(super) const ENCODINGS: Words = &[
    ("auto", "By format and metadata"),
    ("srgb", "The sRGB curve"),
    ("linear", "Proportional to light"),
];

/// `--splitting`
pub(super) const SPLITTINGS: Words = &[
    ("full", "The whole shading term on the slopes"),
    ("paper", "Frozen linearisation, as in the paper"),
    (
        "fixed-point",
        "The plain fixed point without splitting, for comparison only",
    ),
];

/// `--projection`
pub(super) const PROJECTIONS: Words = &[
    ("perspective", "Pinhole"),
    ("orthographic", "Parallel rays"),
];

/// `--align`
pub(super) const ALIGNMENTS: Words = &[
    (
        "auto",
        "None where the cameras stand in the truth's frame already, else a similarity; it is said",
    ),
    ("none", "None"),
    ("se3", "Rotation and translation"),
    ("sim3", "Rotation, translation and scale"),
];

/// The value that is named by one of some words.
pub(super) fn words<T>(words: Words) -> impl TypedValueParser<Value = T>
where
    T: DeserializeOwned + Clone + Send + Sync + 'static,
{
    let named = |&(word, help)| PossibleValue::new(word).help(help);
    let known = PossibleValuesParser::new(words.iter().map(named).collect::<Vec<_>>());
    known.try_map(|word| serde_json::from_value::<T>(word.replace('-', "_").into()))
}
