//! Brings photos to one exposure by their EXIF.
//!
//! A pixel's intensity is proportional to `H = t · ISO / N²` (exposure time, sensitivity,
//! f-number), so that photo `i` of a set with middle exposure `H_m` is multiplied by
//! `g_i = H_m / H_i`. Done only where EXIF states every photo's exposure and they differ; without
//! EXIF the gains are left to the stages that compare the photos' contents.

use crate::measures::ratio;
use crate::report::PhotoFacts;
use rilievo_numerics::robust::median;
use rilievo_scene::{LinearImage, PixelError, PixelSource};
use std::sync::Arc;

/// Spread of exposure between photos, in EV, from which the user is warned and the photos are
/// brought to one exposure; smaller differences are those of EXIF's rounding.
pub(crate) const EXPOSURE_SPREAD_EV: f64 = 0.1;

/// Factor of every photo; `None` when nothing is to be done.
pub(crate) fn gains(facts: &[PhotoFacts]) -> Option<Vec<f64>> {
    let exposures: Vec<f64> = facts
        .iter()
        .map(|f| f.exif.relative_exposure())
        .collect::<Option<_>>()?;
    if ratio(&exposures)?.log2() <= EXPOSURE_SPREAD_EV {
        return None;
    }
    let middle = median(&mut exposures.clone())?;
    Some(exposures.iter().map(|h| middle / h).collect())
}

/// Pixels times a factor.
#[derive(Debug)]
pub(crate) struct Exposed {
    pub pixels: Arc<dyn PixelSource>,
    pub gain: f32,
}

impl PixelSource for Exposed {
    fn load(&self) -> Result<Arc<LinearImage>, PixelError> {
        let mut image = Arc::unwrap_or_clone(self.pixels.load()?);
        image.data.iter_mut().for_each(|value| *value *= self.gain);
        Ok(Arc::new(image))
    }
}
