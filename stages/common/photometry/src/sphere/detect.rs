//! Finding the sphere without marks.

use super::locate::{SphereFit, WorldScale};
use super::request::PosedImage;
use super::{SphereError, SphereOptions};

/// Finds the sphere in posed photos.
///
/// # Errors
/// [`SphereError::NotFound`].
pub fn detect(
    _images: &[PosedImage],
    _radius: f64,
    _scale: WorldScale,
    options: &SphereOptions,
) -> Result<SphereFit, SphereError> {
    options.validate()?;
    Err(SphereError::NotFound {
        why: "no candidate".to_owned(),
    })
}
