//! Options of stage 5: the choice between its two models, and the options of each.

use crate::paper::PaperOptions;
use crate::photo::PhotoOptions;
use rilievo_scene::{InTable, OptionError, RetiredKey};
use serde::de::value::{MapAccessDeserializer, StrDeserializer};
use serde::de::{DeserializeSeed, Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Which model explains the photos.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShadingModel {
    /// Shading with visibility, and the photos' agreement with each other (several posed views).
    #[default]
    Photo,
    /// The paper's model: distant harmonics and depth anchors only.
    Paper,
}

/// Keys that the table `[shading]` had once, with what to do instead: see [`rilievo_scene::RetiredKey`].
pub const RETIRED_KEYS: &[RetiredKey] = &[
    fixed(&["photo", "coarse_pixels"], "it is fixed at 90000"),
    fixed(&["photo", "num_sweeps"], "it is fixed at 4"),
    fixed(&["photo", "round_move_px"], "it is fixed at 0.1 px"),
    fixed(&["photo", "round_turn_deg"], "it is fixed at 0.4°"),
    fixed(&["photo", "max_num_rounds"], "it is fixed at 10"),
    fixed(
        &["photo", "num_laps"],
        "use `shading.photo.num_outer_iterations`",
    ),
    fixed(&["photo", "outer_turn_deg"], "it is fixed at 2°"),
    fixed(&["photo", "lap_turn_deg"], "it is fixed at 2°"),
    fixed(&["photo", "max_more_iterations"], "it is fixed at 3"),
    fixed(&["photo", "max_more_laps"], "it is fixed at 3"),
    fixed(&["photo", "num_half_iterations"], "it is fixed at 3"),
    fixed(&["photo", "num_half_laps"], "it is fixed at 3"),
    fixed(&["photo", "noisy_search_px"], "it is fixed at 0.65 px"),
    fixed(
        &["photo", "finer_search"],
        "photos that disagree are always searched at finer levels",
    ),
    fixed(&["photo", "num_rays"], "it is fixed at 256"),
];

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// Options of [`crate::run`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ShadingOptions {
    /// What explains the photos, for several posed views.
    pub model: ShadingModel,
    /// Options of the paper's model, beside `model`.
    #[serde(flatten)]
    pub paper: PaperOptions,
    /// Options of the photo model, in a table of their own.
    pub photo: PhotoOptions,
}

impl ShadingOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        self.paper.validate()?;
        self.photo.validate().in_table("photo")
    }
}

/// The paper's options stand beside `model` and `photo` in one table. Derived, this would be read into a
/// buffer, and an unknown key told without its line.
impl<'de> Deserialize<'de> for ShadingOptions {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(Table)
    }
}

struct Table;

impl<'de> Visitor<'de> for Table {
    type Value = ShadingOptions;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a table of options")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<ShadingOptions, A::Error> {
        let mut options = ShadingOptions::default();
        let rest = Rest {
            map,
            model: &mut options.model,
            photo: &mut options.photo,
        };
        options.paper = PaperOptions::deserialize(MapAccessDeserializer::new(rest))?;
        Ok(options)
    }
}

/// The table without `model` and `photo`, which are put into their places.
struct Rest<'a, A> {
    map: A,
    model: &'a mut ShadingModel,
    photo: &'a mut PhotoOptions,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for Rest<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, A::Error> {
        let mut seed = Some(seed);
        loop {
            match self.map.next_key_seed(KeySeed(&mut seed))? {
                Some(Key::Model) => *self.model = self.map.next_value()?,
                Some(Key::Photo) => *self.photo = self.map.next_value()?,
                Some(Key::Other(key)) => return Ok(Some(key)),
                None => return Ok(None),
            }
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.map.next_value_seed(seed)
    }
}

enum Key<T> {
    Model,
    Photo,
    Other(T),
}

/// Reads a key, with the paper's own reader where it is none of the two. The reader serves once.
struct KeySeed<'a, K>(&'a mut Option<K>);

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for KeySeed<'_, K> {
    type Value = Key<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Self::Value, D::Error> {
        from.deserialize_identifier(self)
    }
}

impl<'de, K: DeserializeSeed<'de>> Visitor<'de> for KeySeed<'_, K> {
    type Value = Key<K::Value>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of an option")
    }

    fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Self::Value, E> {
        match name {
            "model" => Ok(Key::Model),
            "photo" => Ok(Key::Photo),
            other => match self.0.take() {
                Some(seed) => seed
                    .deserialize(StrDeserializer::new(other))
                    .map(Key::Other),
                None => Err(E::custom("a key was read twice")),
            },
        }
    }
}
