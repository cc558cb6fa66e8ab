//! Which photo a posed view belongs to.

use crate::error::ShadingError;
use rilievo_scene::{Photo, PhotoSet, PosedView};

/// The photo of a posed view.
///
/// # Errors
/// [`ShadingError::UnknownView`] when there is none of that number.
pub(crate) fn photo_of<'a>(
    photos: &'a PhotoSet,
    posed: &PosedView,
) -> Result<&'a Photo, ShadingError> {
    photos
        .photos
        .get(posed.photo.0)
        .ok_or(ShadingError::UnknownView {
            what: "a posed view's photo",
            index: posed.photo.0,
            num_views: photos.photos.len(),
        })
}
