//! Errors of stages as failures with an exit code.

use crate::exit::Failure;
use rilievo_features::FeaturesError;
use rilievo_fusion::FusionError;
use rilievo_lighting::LightingError;
use rilievo_photometry::surface_check::CheckError;
use rilievo_photos::PhotosError;
use rilievo_poses::PosesError;
use rilievo_scene::Inconsistent;
use rilievo_shading::ShadingError;

/// Results of an earlier stage that cannot be as that stage left them.
fn damaged(error: &Inconsistent) -> anyhow::Error {
    let stage = error.made_by;
    Failure::RunDirectory(format!(
        "{error}; `rilievo run {stage} RUN` makes them anew"
    ))
    .into()
}

/// Stage 1, of the set as a whole.
pub fn from_photos(error: PhotosError) -> Failure {
    match error {
        PhotosError::Interrupted => Failure::Interrupted,
        other => Failure::NoResult(other.to_string()),
    }
}

/// Stage 2.
pub fn from_features(error: FeaturesError) -> anyhow::Error {
    match error {
        FeaturesError::Interrupted => Failure::Interrupted.into(),
        FeaturesError::Inconsistent(error) => damaged(&error),
        FeaturesError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
        FeaturesError::InvalidOption { .. } | FeaturesError::NoListedPair { .. } => {
            Failure::Usage(error.to_string()).into()
        }
        FeaturesError::OpenCv { .. } | FeaturesError::Team(_) => anyhow::Error::new(error),
    }
}

/// Stage 3.
pub fn from_poses(error: PosesError) -> anyhow::Error {
    match error {
        PosesError::Interrupted => Failure::Interrupted.into(),
        PosesError::Inconsistent(error) => damaged(&error),
        PosesError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
        PosesError::InvalidOption { .. } => Failure::Usage(error.to_string()).into(),
        PosesError::Team(error) => error.into(),
        PosesError::TooFewPhotos { num_photos: 1 } => {
            Failure::NoResult(ONE_PHOTO.to_owned()).into()
        }
        other => Failure::NoResult(other.to_string()).into(),
    }
}

/// One photo has no pose, but a command of its own.
const ONE_PHOTO: &str = "1 usable photo, poses need at least 2: add photos from other directions, \
     or shade this one view by itself: rilievo shade --image PHOTO --mask MASK --camera CAMERA.json \
     --lighting FILE -o DIR (in place of --lighting a shape on which the light is fitted: --init or \
     --prior DEPTH.exr)";

/// Stage 4.
pub fn from_lighting(error: LightingError) -> anyhow::Error {
    match error {
        LightingError::Interrupted => Failure::Interrupted.into(),
        LightingError::InvalidOption { .. } => Failure::Usage(error.to_string()).into(),
        LightingError::Inconsistent(error) => damaged(&error),
        LightingError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
        other => Failure::NoResult(other.to_string()).into(),
    }
}

/// Stage 5.
pub fn from_shading(error: ShadingError) -> anyhow::Error {
    match error {
        ShadingError::Interrupted => Failure::Interrupted.into(),
        ShadingError::Inconsistent(error) => damaged(&error),
        ShadingError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
        ShadingError::OutOfMemory { given_mib, .. } => {
            Failure::input(format!("--memory {given_mib}M"), error.to_string()).into()
        }
        ShadingError::Checkpoint(error) => Failure::ReadOrWrite(error.to_string()).into(),
        ShadingError::Team(error) => error.into(),
        ShadingError::Scratch(error) => Failure::ReadOrWrite(error.to_string()).into(),
        ShadingError::InvalidOption { .. } => Failure::Usage(error.to_string()).into(),
        ShadingError::Numerics { .. } => anyhow::Error::new(error),
        other => Failure::NoResult(other.to_string()).into(),
    }
}

/// The comparison of light and surface.
pub fn from_check(error: CheckError) -> anyhow::Error {
    match error {
        CheckError::Interrupted => Failure::Interrupted.into(),
        CheckError::Inconsistent(error) => damaged(&error),
        CheckError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
    }
}

/// Stage 6.
pub fn from_fusion(error: FusionError) -> anyhow::Error {
    match error {
        FusionError::Interrupted => Failure::Interrupted.into(),
        FusionError::Inconsistent(error) => damaged(&error),
        FusionError::Pixels(error) => Failure::ReadOrWrite(error.to_string()).into(),
        FusionError::Team(error) => error.into(),
        FusionError::Scratch(error) => Failure::ReadOrWrite(error.to_string()).into(),
        FusionError::Cloud(error) => Failure::ReadOrWrite(error.to_string()).into(),
        FusionError::OutOfMemory { given_mib, .. } => {
            Failure::input(format!("--memory {given_mib}M"), error.to_string()).into()
        }
        FusionError::InvalidOption { .. } => Failure::Usage(error.to_string()).into(),
        other => Failure::NoResult(other.to_string()).into(),
    }
}
