//! Options of stages that are words: the same as in the config file, with `-` for its `_`.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use rilievo_fusion::ColorMode;
use rilievo_photos::Encoding;
use rilievo_poses::anchors::AnchorMode;
use rilievo_shading::ShadingModel;
use rilievo_shading::paper::{Projection, Splitting};
use rilievo_synthetic::compare::AlignmentRequest;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde::de::IntoDeserializer;
use serde::de::value::Error;

/// Words with their help; a stage's option reads them as it reads its config file.
type Words = &'static [(&'static str, &'static str)];

const MODELS: Words = &[
    (
        "photo",
        "Shading with visibility, and the photos' agreement with each other",
    ),
    ("paper", "Distant harmonics and depth anchors only"),
];

const ANCHORS: Words = &[
    ("grown", "Grown over the surface from refined matches"),
    ("guided", "Matched along epipolar lines and refined"),
    ("sift", "Keypoint tracks alone"),
];

const COLORS: Words = &[
    ("photographed", "The mean of the photos"),
    ("albedo", "The surface's own colour"),
];

const ENCODINGS: Words = &[
    ("auto", "By format and metadata"),
    ("srgb", "The sRGB curve"),
    ("linear", "Proportional to light"),
];

const SPLITTINGS: Words = &[
    ("full", "The whole shading term on the slopes"),
    ("paper", "Frozen linearisation, as in the paper"),
    (
        "fixed-point",
        "The plain fixed point without splitting, for comparison only",
    ),
];

const PROJECTIONS: Words = &[
    ("perspective", "Pinhole"),
    ("orthographic", "Parallel rays"),
];

const ALIGNMENTS: Words = &[
    (
        "auto",
        "None where the cameras stand in the truth's frame already, else a similarity; it is said",
    ),
    ("none", "None"),
    ("se3", "Rotation and translation"),
    ("sim3", "Rotation, translation and scale"),
];

/// `--model`
pub(super) fn models() -> impl TypedValueParser<Value = ShadingModel> {
    one_of(MODELS)
}

/// `--anchors`
pub(super) fn anchors() -> impl TypedValueParser<Value = AnchorMode> {
    one_of(ANCHORS)
}

/// `--color`
pub(super) fn colors() -> impl TypedValueParser<Value = ColorMode> {
    one_of(COLORS)
}

/// `--encoding`
pub(super) fn encodings() -> impl TypedValueParser<Value = Encoding> {
    one_of(ENCODINGS)
}

/// `--splitting`
pub(super) fn splittings() -> impl TypedValueParser<Value = Splitting> {
    one_of(SPLITTINGS)
}

/// `--projection`
pub(super) fn projections() -> impl TypedValueParser<Value = Projection> {
    one_of(PROJECTIONS)
}

/// `--align`
pub(super) fn alignments() -> impl TypedValueParser<Value = AlignmentRequest> {
    one_of(ALIGNMENTS)
}

fn one_of<T>(words: Words) -> impl TypedValueParser<Value = T>
where
    T: DeserializeOwned + Clone + Send + Sync + 'static,
{
    let values = words
        .iter()
        .map(|(word, help)| PossibleValue::new(*word).help(*help));
    PossibleValuesParser::new(values).try_map(|word| value(&word))
}

fn value<'a, T: Deserialize<'a>>(word: &str) -> Result<T, Error> {
    T::deserialize(word.replace('-', "_").into_deserializer())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stages_know_every_word() {
        fn known<T: DeserializeOwned>(words: Words) {
            for (word, _) in words {
                assert!(value::<T>(word).is_ok(), "{word}");
            }
        }
        known::<ShadingModel>(MODELS);
        known::<AnchorMode>(ANCHORS);
        known::<ColorMode>(COLORS);
        known::<Encoding>(ENCODINGS);
        known::<Splitting>(SPLITTINGS);
        known::<Projection>(PROJECTIONS);
        known::<AlignmentRequest>(ALIGNMENTS);
        assert_eq!(value("fixed-point"), Ok(Splitting::FixedPoint));
    }
}
