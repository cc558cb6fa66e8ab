//! Options of all stages, from defaults, `--config FILE.toml` and the command line.

use crate::exit::Failure;
use rilievo_features::FeaturesOptions;
use rilievo_fusion::FusionOptions;
use rilievo_io::read_regular_text;
use rilievo_lighting::LightingOptions;
use rilievo_photos::PhotosOptions;
use rilievo_poses::PosesOptions;
use rilievo_scene::{InTable, RetiredKey};
use rilievo_shading::ShadingOptions;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Options of the stages; every table and key of the TOML file is one of these fields.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StageOptions {
    /// Stage 1.
    pub photos: PhotosOptions,
    /// Stage 2.
    pub features: FeaturesOptions,
    /// Stage 3.
    pub poses: PosesOptions,
    /// Stage 4.
    pub lighting: LightingOptions,
    /// Stage 5.
    pub shading: ShadingOptions,
    /// Stage 6.
    pub fusion: FusionOptions,
}

impl StageOptions {
    /// Reads a TOML file; every key that it leaves out keeps its default, all without a file.
    ///
    /// # Errors
    /// When it cannot be read, or a key is unknown or has a wrong value; names file, line and key.
    pub fn read(path: Option<&Path>) -> Result<Self, Failure> {
        path.map_or_else(
            || Ok(Self::default()),
            |path| read_toml(path, &RETIRED_KEYS),
        )
    }

    /// Checks the values of all stages, so that a wrong one is reported before hours of work.
    ///
    /// # Errors
    /// [`Failure::Usage`] with the first value that is out of range.
    pub fn validate(&self) -> Result<(), Failure> {
        let checks = [
            (self.photos.validate(), "photos"),
            (self.features.validate(), "features"),
            (self.poses.validate(), "poses"),
            (self.lighting.validate(), "lighting"),
            (self.shading.validate(), "shading"),
            (self.fusion.validate(), "fusion"),
        ];
        let mut tables = checks.into_iter();
        tables
            .try_for_each(|(checked, table)| checked.in_table(table))
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Keys that the stages' tables had once, by table.
const RETIRED_KEYS: [(&str, &[RetiredKey]); 6] = [
    ("photos", rilievo_photos::RETIRED_KEYS),
    ("features", rilievo_features::RETIRED_KEYS),
    ("poses", rilievo_poses::RETIRED_KEYS),
    ("lighting", rilievo_lighting::RETIRED_KEYS),
    ("shading", rilievo_shading::RETIRED_KEYS),
    ("fusion", rilievo_fusion::RETIRED_KEYS),
];

/// Replaces an option by what the command line says of it, if anything.
pub fn take_over<T>(option: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *option = given;
    }
}

/// Reads options from a TOML file.
///
/// # Errors
/// When it cannot be read, or a key is unknown, retired or has a wrong value; names file, line and key.
pub fn read_toml<T: serde::de::DeserializeOwned>(
    path: &Path,
    retired: &[(&str, &[RetiredKey])],
) -> Result<T, Failure> {
    let text = read_regular_text(path)?;
    toml::from_str(&text).map_err(|error| {
        let reason = retired_keys(&text, retired).unwrap_or_else(|| reason_of(&error, &text));
        Failure::Usage(format!("config file {}: {reason}", path.display()))
    })
}

/// The retired keys that a file has, a line each with what replaces them; `None` without any.
fn retired_keys(text: &str, retired: &[(&str, &[RetiredKey])]) -> Option<String> {
    let file: toml::Table = toml::from_str(text).ok()?;
    let all = retired
        .iter()
        .flat_map(|(table, keys)| keys.iter().map(move |key| (table, key)));
    let used = all.filter_map(|(table, RetiredKey { path, instead })| {
        let mut path_in_table = path.iter();
        path_in_table.try_fold(file.get(*table)?, |value, part| value.get(part))?;
        let path = path.join(".");
        Some(format!("{table}.{path} is no option any more: {instead}"))
    });
    let lines: Vec<String> = used.collect();
    (!lines.is_empty()).then(|| lines.join("\n"))
}

/// The error as its library shows it, with the line of the file and a mark below; of endless lines the number
/// and the beginning of the message.
fn reason_of(error: &toml::de::Error, text: &str) -> String {
    const MAX_CHARS: usize = 1500;
    let whole = error.to_string();
    if whole.len() <= MAX_CHARS {
        return whole;
    }
    let start = error.span().map_or(0, |span| span.start).min(text.len());
    let line = 1 + text.as_bytes()[..start]
        .iter()
        .filter(|&&b| b == b'\n')
        .count();
    let message: String = error.message().chars().take(MAX_CHARS / 5).collect();
    format!("line {line}, which is very long: {message}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::SynthOptions;
    use rilievo_numerics::robust::RobustLoss;

    fn read(text: &str) -> Result<StageOptions, Failure> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        StageOptions::read(Some(file.path()))
    }

    #[test]
    fn what_is_left_out_keeps_its_default() {
        let options = read("[shading.paper]\nnoise = 0.02\n").unwrap();
        assert_eq!(options.shading.paper.noise, 0.02);
        assert_eq!(options.poses, PosesOptions::default());
    }

    #[test]
    fn an_unknown_key_is_named_with_its_place() {
        let error = read("[shading]\nnoize = 0.02\n").unwrap_err();
        assert_eq!(error.code(), 2);
        let message = error.to_string();
        assert!(
            message.contains("noize") && message.contains("line 2"),
            "{message}"
        );
        assert!(read("[shadin]\n").is_err());
    }

    #[test]
    fn a_retired_key_is_named_with_what_replaces_it() {
        const OLD: &[RetiredKey] = &[RetiredKey {
            path: &["old", "key"],
            instead: "it is fixed",
        }];
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "[poses.old]\nkey = 3\n").unwrap();
        let error = read_toml::<StageOptions>(file.path(), &[("poses", OLD)]).unwrap_err();
        assert_eq!(error.code(), 2);
        let message = error.to_string();
        assert!(
            message.contains("poses.old.key is no option any more: it is fixed"),
            "{message}"
        );
    }

    #[test]
    fn every_retired_key_is_one_that_no_file_may_have() {
        for (table, keys) in RETIRED_KEYS {
            for key in keys {
                let dotted = format!("{table}.{}", key.path.join("."));
                let error = read(&format!("{dotted} = 1\n")).expect_err(&dotted);
                assert_eq!(error.code(), 2);
                let message = error.to_string();
                let named = message.contains(&dotted) && message.contains(key.instead);
                assert!(named, "{dotted}: {message}");
            }
        }
    }

    #[test]
    fn an_endless_line_is_told_by_its_number() {
        let error = read(&format!(
            "[shading.paper]\nnoise = {}\n",
            "[".repeat(100_000)
        ))
        .unwrap_err();
        let message = error.to_string();
        assert!(
            message.len() < 1000 && message.contains("line 2"),
            "{} bytes",
            message.len()
        );
    }

    #[test]
    fn defaults_survive_a_round_trip() {
        let text = toml::to_string(&StageOptions::default()).unwrap();
        assert_eq!(read(&text).unwrap(), StageOptions::default());
    }

    /// Options with every part that the defaults leave out, so that each number stands in their TOML.
    fn with_every_number() -> Vec<StageOptions> {
        let point = rilievo_poses::MarkedPoints {
            image: "a".to_owned(),
            first: [1.0, 2.0],
            second: [3.0, 4.0],
        };
        let mut options = StageOptions::default();
        options.photos.focal_35mm = Some(35.0);
        options.poses.known_distance = Some(rilievo_poses::KnownDistance {
            metres: 1.0,
            sigma_metres: 0.01,
            cameras: None,
            marks: vec![point.clone(), point],
        });
        [
            RobustLoss::Huber,
            RobustLoss::Cauchy,
            RobustLoss::GemanMcClure,
        ]
        .map(|loss| {
            let mut options = options.clone();
            options.shading.paper.loss = loss(0.1);
            options
        })
        .into()
    }

    /// Paths to all numbers of a table, with their last key.
    fn numbers(value: &toml::Value, path: &mut Vec<String>, into: &mut Vec<Vec<String>>) {
        let parts: Vec<(String, &toml::Value)> = match value {
            toml::Value::Table(table) => table.iter().map(|(k, v)| (k.clone(), v)).collect(),
            toml::Value::Array(items) => {
                let numbered = items.iter().enumerate();
                numbered.map(|(k, v)| (k.to_string(), v)).collect()
            }
            toml::Value::Integer(_) | toml::Value::Float(_) => return into.push(path.clone()),
            _ => return,
        };
        for (key, part) in parts {
            path.push(key);
            numbers(part, path, into);
            path.pop();
        }
    }

    fn at<'a>(value: &'a mut toml::Value, path: &[String]) -> &'a mut toml::Value {
        path.iter().fold(value, |value, key| match value {
            toml::Value::Array(items) => &mut items[key.parse::<usize>().unwrap()],
            table => &mut table[key.as_str()],
        })
    }

    /// Sets every number in turn to values that make no sense: each is refused by its key, or lies in
    /// the range that the refusal of an immense one tells.
    fn every_number_has_a_range<T>(base: &T, validate: impl Fn(&T) -> Result<(), Failure>)
    where
        T: Serialize + serde::de::DeserializeOwned,
    {
        let base = toml::Value::try_from(base).unwrap();
        let mut paths = Vec::new();
        numbers(&base, &mut Vec::new(), &mut paths);
        assert!(paths.len() > 20, "{paths:?}");
        for path in paths {
            // Places in arrays and names of enum variants stand in the file, but are no keys.
            let is_key = |part: &&str| {
                let variants = ["huber", "cauchy", "geman_mc_clure"];
                part.parse::<usize>().is_err() && !variants.contains(part)
            };
            let keys: Vec<&str> = path.iter().map(String::as_str).filter(is_key).collect();
            let (dotted, key) = (keys.join("."), keys[keys.len() - 1]);
            // Every seed serves.
            if key == "seed" {
                continue;
            }
            let with = |wrong: toml::Value| {
                let mut value = base.clone();
                *at(&mut value, &path) = wrong;
                value.try_into::<T>()
            };
            let told = |wrong: toml::Value| match with(wrong) {
                // The file's reader tells line and key.
                Err(_) => Some(format!("{key} has a type that cannot hold it")),
                Ok(options) => validate(&options).err().map(|error| {
                    assert_eq!(error.code(), 2);
                    error.to_string()
                }),
            };
            let is_integer = at(&mut base.clone(), &path).is_integer();
            let immense = [1e308, -1e308, f64::NAN, f64::INFINITY, 2f64.powi(63)];
            let range = if is_integer {
                // A narrow type holds no immense value.
                let highest = if with(toml::Value::Integer(i64::MAX)).is_ok() {
                    i64::MAX
                } else {
                    255
                };
                let refusal = told(toml::Value::Integer(highest));
                vec![refusal.unwrap_or_else(|| panic!("{path:?} takes {highest}"))]
            } else {
                let refusal = |value: f64| {
                    let message = told(toml::Value::Float(value));
                    message.unwrap_or_else(|| panic!("{path:?} takes {value:e}"))
                };
                immense.map(refusal).to_vec()
            };
            for message in &range {
                assert!(
                    message.contains(&dotted),
                    "{message} does not name {dotted}"
                );
            }
            let limits = range[0].split_once("must lie within ");
            let limits = limits.and_then(|(_, limits)| limits.split_once(" to "));
            let (lowest, highest) = limits.unwrap_or_else(|| panic!("no range in {}", range[0]));
            let (lowest, highest): (f64, f64) = (lowest.parse().unwrap(), highest.parse().unwrap());
            for value in [-1.0, 0.0, f64::from(u32::MAX)] {
                let wrong = match is_integer {
                    true => toml::Value::Integer(value as i64),
                    false => toml::Value::Float(value),
                };
                let inside = (lowest..=highest).contains(&value);
                match told(wrong) {
                    Some(message) => assert!(message.contains(key), "{message}: {key}"),
                    None => assert!(
                        inside,
                        "{path:?} takes {value}, not in {lowest} to {highest}"
                    ),
                }
            }
        }
    }

    #[test]
    fn every_number_of_the_options_has_a_range() {
        for options in with_every_number() {
            options.validate().unwrap();
            every_number_has_a_range(&options, StageOptions::validate);
        }
    }

    #[test]
    fn every_number_of_synthetic_scenes_has_a_range() {
        let mut options = SynthOptions::default();
        options.scene.more_spheres = vec![rilievo_synthetic::BallOptions {
            at_m: [0.3, 0.2],
            radius_m: 0.01,
        }];
        options.validate().unwrap();
        every_number_has_a_range(&options, SynthOptions::validate);
    }
}
