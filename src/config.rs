//! Options of all stages, from defaults, `--config FILE.toml` and the command line.

use crate::cli::{Anchors, Encoding, Model};
use crate::exit::Failure;
use rilievo_features::FeaturesOptions;
use rilievo_fusion::FusionOptions;
use rilievo_io::read_regular_text;
use rilievo_lighting::LightingOptions;
use rilievo_photos::PhotosOptions;
use rilievo_poses::PosesOptions;
use rilievo_poses::anchors::AnchorMode;
use rilievo_shading::{ShadingModel, ShadingOptions};
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
        path.map_or_else(|| Ok(Self::default()), read_toml)
    }

    /// Takes over what the command line says.
    pub fn override_with(
        &mut self,
        model: Option<Model>,
        anchors: Option<Anchors>,
        encoding: Option<Encoding>,
    ) {
        match model {
            Some(Model::Photo) => self.shading.model = ShadingModel::Photo,
            Some(Model::Paper) => self.shading.model = ShadingModel::Paper,
            None => {}
        }
        match anchors {
            Some(Anchors::Grown) => self.poses.anchors.mode = AnchorMode::Grown,
            Some(Anchors::Guided) => self.poses.anchors.mode = AnchorMode::Guided,
            Some(Anchors::Sift) => self.poses.anchors.mode = AnchorMode::Sift,
            None => {}
        }
        if let Some(encoding) = encoding {
            self.photos.encoding = encoding.into();
        }
    }

    /// Checks the values of all stages, so that a wrong one is told before hours of work.
    ///
    /// # Errors
    /// [`Failure::Usage`] with the first value that is out of range.
    pub fn validate(&self) -> Result<(), Failure> {
        let usage = |table: &str, error: &dyn std::fmt::Display| {
            Failure::Usage(format!("options of [{table}]: {error}"))
        };
        self.photos.validate().map_err(|e| usage("photos", &e))?;
        self.features
            .validate()
            .map_err(|e| usage("features", &e))?;
        self.poses.validate().map_err(|e| usage("poses", &e))?;
        self.lighting
            .validate()
            .map_err(|e| usage("lighting", &e))?;
        self.shading.validate().map_err(|e| usage("shading", &e))?;
        self.fusion.validate().map_err(|e| usage("fusion", &e))
    }
}

/// Reads options from a TOML file.
///
/// # Errors
/// When it cannot be read, or a key is unknown or has a wrong value; names file, line and key.
pub fn read_toml<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, Failure> {
    let text = read_regular_text(path).map_err(Failure::from)?;
    toml::from_str(&text)
        .map_err(|error| Failure::Usage(format!("config file {}: {error}", path.display())))
}

impl From<Encoding> for rilievo_photos::Encoding {
    fn from(encoding: Encoding) -> Self {
        match encoding {
            Encoding::Auto => Self::Auto,
            Encoding::Srgb => Self::Srgb,
            Encoding::Linear => Self::Linear,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<StageOptions, Failure> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        StageOptions::read(Some(file.path()))
    }

    #[test]
    fn what_is_left_out_keeps_its_default() {
        let options = read("[shading]\nnoise = 0.02\n").unwrap();
        assert_eq!(options.shading.noise, 0.02);
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
    fn defaults_survive_a_round_trip() {
        let text = toml::to_string(&StageOptions::default()).unwrap();
        assert_eq!(read(&text).unwrap(), StageOptions::default());
    }
}
