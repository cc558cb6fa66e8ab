//! Options whose values are words, with the help of each value.

use super::parse::one_of;
use clap::builder::{PossibleValue, TypedValueParser};
use rilievo_fusion::{ColorMode, MeshFormat};
use rilievo_photos::Encoding;
use rilievo_shading::ShadingModel;
use rilievo_shading::paper::{Projection, Splitting};
use rilievo_synthetic::compare::AlignmentRequest;

/// Values with their words and what the help says of them.
type Words<T> = &'static [(T, &'static str, &'static str)];

/// `--model`
pub(super) const MODELS: Words<ShadingModel> = &[
    (
        ShadingModel::Photo,
        "photo",
        "Shading with visibility, and the photos' agreement with each other",
    ),
    (
        ShadingModel::Paper,
        "paper",
        "Distant harmonics and depth anchors only",
    ),
];

/// `--formats`
pub(super) const MESH_FORMATS: Words<MeshFormat> = &[
    (
        MeshFormat::Ply,
        "ply",
        "Stanford's PLY, which is always written",
    ),
    (
        MeshFormat::Asset,
        "asset",
        "A light mesh with textures, as binary glTF and OBJ",
    ),
    (MeshFormat::Obj, "obj", "Wavefront OBJ"),
    (
        MeshFormat::Glb,
        "glb",
        "Binary glTF, for viewers and the web",
    ),
];

/// `--color`
pub(super) const COLORS: Words<ColorMode> = &[
    (
        ColorMode::Photographed,
        "photographed",
        "The mean of the photos",
    ),
    (ColorMode::Albedo, "albedo", "The surface's own colour"),
];

/// `--encoding`
pub(super) const ENCODINGS: Words<Encoding> = &[
    (Encoding::Auto, "auto", "By format and metadata"),
    (Encoding::Srgb, "srgb", "The sRGB curve"),
    (Encoding::Linear, "linear", "Proportional to light"),
];

/// `--splitting`
pub(super) const SPLITTINGS: Words<Splitting> = &[
    (
        Splitting::Full,
        "full",
        "The whole shading term on the slopes",
    ),
    (
        Splitting::Paper,
        "paper",
        "Frozen linearisation, as in the paper",
    ),
    (
        Splitting::FixedPoint,
        "fixed-point",
        "The plain fixed point without splitting, for comparison only",
    ),
];

/// `--projection`
pub(super) const PROJECTIONS: Words<Projection> = &[
    (Projection::Perspective, "perspective", "Pinhole"),
    (Projection::Orthographic, "orthographic", "Parallel rays"),
];

/// `--align`
pub(super) const ALIGNMENTS: Words<AlignmentRequest> = &[
    (
        AlignmentRequest::Auto,
        "auto",
        "None where the cameras stand in the truth's frame already, else a similarity; it is said",
    ),
    (AlignmentRequest::None, "none", "None"),
    (AlignmentRequest::Se3, "se3", "Rotation and translation"),
    (
        AlignmentRequest::Sim3,
        "sim3",
        "Rotation, translation and scale",
    ),
];

/// One of the values, by its word.
pub(super) fn words<T>(words: Words<T>) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    let named = |&(value, word, help): &(T, _, _)| (PossibleValue::new(word).help(help), value);
    one_of(words.iter().map(named).collect())
}
