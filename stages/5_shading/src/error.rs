//! Errors of the stage.

use rilievo_scene::{Inconsistent, LightSource, Observer, OptionError, StageId, first_and_more};

/// How badly a given light fits a view.
#[derive(Debug, Clone, PartialEq)]
pub struct LightMisfit {
    /// The view's name.
    pub view: String,
    /// Relative residual that the given light leaves after the best gain.
    pub given: f64,
    /// What nine harmonics fitted on the view leave.
    pub fitted: f64,
}

fn described(views: &[LightMisfit]) -> String {
    let one = |m: &LightMisfit| {
        let (given, fitted) = (100.0 * m.given, 100.0 * m.fitted);
        format!("{} ({given:.0} % against {fitted:.0} %)", m.view)
    };
    let described: Vec<String> = views.iter().map(one).collect();
    first_and_more(described.iter().map(String::as_str)).unwrap_or_default()
}

fn origin(source: LightSource) -> &'static str {
    match source {
        LightSource::CalibrationPhoto => "the light of the calibration photo",
        _ => "the given light",
    }
}

fn remedy(source: LightSource) -> &'static str {
    match source {
        LightSource::CalibrationPhoto => {
            "take the calibration photo in the same light and from the same place, leave it out of the \
             sphere file"
        }
        _ => {
            "check that the file belongs to these photos, its frame (each view's own camera, x right, y \
             down, z forward) and its order of coefficients, leave --lighting out"
        }
    }
}

/// Errors of stage 5; each carries the facts and names what to try.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum ShadingError {
    /// The observer asked to stop.
    #[error("interrupted")]
    Interrupted,
    /// An option lies outside its range.
    #[error(transparent)]
    InvalidOption(#[from] OptionError),
    /// What an earlier stage left contradicts itself.
    #[error(transparent)]
    Inconsistent(#[from] Inconsistent),
    /// There is nothing to solve.
    #[error("no view to solve: give at least one image with a mask")]
    NoViews,
    /// A view's inputs do not fit together.
    #[error("view {view}: {what} is {found}, but the image is {image}; give maps of one size")]
    SizeMismatch {
        /// The view's name.
        view: String,
        /// Which input.
        what: &'static str,
        /// Its size.
        found: String,
        /// Size of the image.
        image: String,
    },
    /// The mask leaves no usable pixel.
    #[error("view {view}: no usable pixel inside the mask ({num_masked} masked); {advice}")]
    EmptyMask {
        /// The view's name.
        view: String,
        /// Pixels of the mask.
        num_masked: usize,
        /// What to try.
        advice: &'static str,
    },
    /// The lighting does not depend on the normal, so that intensities say nothing on shape.
    #[error(
        "view {view}: the lighting is {reason}, so the image says nothing about shape; check the lighting file \
         (--lighting), or have it found (no --lighting)"
    )]
    UninformativeLighting {
        /// The view's name.
        view: String,
        /// "zero", "not finite" or "the same for every normal".
        reason: &'static str,
    },
    /// Number of channels of lighting and image differ.
    #[error("view {view}: the lighting has {lighting} channel(s), the image {image}")]
    ChannelMismatch {
        /// The view's name.
        view: String,
        /// Rows of the lighting.
        lighting: usize,
        /// Channels of the image.
        image: usize,
    },
    /// The camera cannot be used.
    #[error("view {view}: {reason}")]
    BadCamera {
        /// The view's name.
        view: String,
        /// Why.
        reason: String,
    },
    /// A view index in matches or lighting does not exist.
    #[error("{what} names view {index}, but there are only {num_views}")]
    UnknownView {
        /// Where the index stands.
        what: &'static str,
        /// The index.
        index: usize,
        /// Views in the problem.
        num_views: usize,
    },
    /// Views that are coupled by matches need poses.
    #[error(
        "views {first} and {second} are matched but {missing} has no pose; add it to its camera file"
    )]
    MissingPose {
        /// First view's name.
        first: String,
        /// Second view's name.
        second: String,
        /// The one without a pose.
        missing: String,
    },
    /// A posed view has no lighting.
    #[error("view {view} has no lighting: give it in --lighting, or have it found (no --lighting)")]
    MissingLighting {
        /// The view's name.
        view: String,
    },
    /// Neither anchors, nor a start, nor a pose fixes the depth of the object.
    #[error(
        "view {view}: nothing fixes its depth; give an initial depth (--init), a prior (--prior), anchors or \
         matches"
    )]
    NoDepth {
        /// The view's name.
        view: String,
    },
    /// A light from elsewhere is not the light of the photos.
    #[error(
        "{} is not the light of these photos: in {} of {num_views} views it leaves far more of the \
         brightness unexplained than a light fitted on them: {}; {}, or say --trust-lighting to use it all \
         the same",
        origin(*from), views.len(), described(views), remedy(*from)
    )]
    LightContradicts {
        /// Where the light came from.
        from: LightSource,
        /// The views that contradict it.
        views: Vec<LightMisfit>,
        /// Views that were compared.
        num_views: usize,
    },
    /// Pixels of a photo could not be loaded.
    #[error(transparent)]
    Pixels(#[from] rilievo_scene::PixelError),
    /// The memory that the run was given is too little.
    #[error(
        "stage 5 needs {needed_mib} MiB for these photos at once; give it --memory {needed_mib}M or more, \
         smaller photos, tighter masks or fewer photos at a time"
    )]
    OutOfMemory {
        /// What it was given, MiB.
        given_mib: u64,
        /// The smallest memory that would do, MiB.
        needed_mib: u64,
    },
    /// Another process of the run failed.
    #[error(transparent)]
    Team(#[from] rilievo_scene::TeamError),
    /// Working data could not be put aside or read back.
    #[error(transparent)]
    Scratch(#[from] rilievo_scene::ScratchError),
    /// How far the stage is could not be kept.
    #[error(transparent)]
    Checkpoint(#[from] rilievo_scene::CheckpointError),
    /// A linear system could not be solved.
    #[error("view {view}: {reason}")]
    Numerics {
        /// The view's name.
        view: String,
        /// What failed.
        reason: String,
    },
}

/// Warns the user; the stage goes on.
pub(crate) fn warn(observer: &dyn Observer, message: String) -> Result<(), ShadingError> {
    let flow = observer.warn(StageId::Shading, message);
    flow.ok_or(ShadingError::Interrupted)
}
