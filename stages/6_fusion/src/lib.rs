//! Stage 6: depth and normal maps of all views to one oriented point cloud and a mesh.

mod error;
mod options;
mod report;

pub use error::FusionError;
pub use options::{ColorMode, FusionOptions};
pub use report::{FusionReport, Layering, MeshReport, ViewFusion};

use rilievo_scene::{FusedCloud, Observer, PhotoSet, PosedViews, ShadedViews};

/// Fuses the views.
///
/// # Errors
/// See [`FusionError`].
pub fn run(
    _photos: &PhotoSet,
    _posed: &PosedViews,
    shaded: &ShadedViews,
    options: &FusionOptions,
    _observer: &dyn Observer,
) -> Result<(FusedCloud, FusionReport), FusionError> {
    options.validate()?;
    Err(FusionError::NoDepth {
        num_views: shaded.views.len(),
    })
}
