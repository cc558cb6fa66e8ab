//! Exposure and white balance of the photos, from the spheres.
//!
//! Under a resting light every point of a sphere has one brightness. What differs between photos
//! at equal normals in the world is a gain per photo and channel; one factor common to all photos
//! stays undetermined (it is part of the albedo) and is set so that the gains' geometric mean is 1.
//! Under a light fixed to the camera the light may differ from photo to photo as well, and gain and
//! light cannot be separated; that does not matter, since each photo has its own lighting.

use crate::cells::{CellMean, TwoWay, cell_means, two_way};
use crate::side::Side;
use rilievo_photometry::harmonics::LightingFit;
use rilievo_photometry::samples::NUM_CELLS;

/// Gains of all views.
#[derive(Clone, Debug)]
pub(crate) struct Gains {
    /// Per view and channel.
    pub gain: Vec<Vec<f64>>,
    /// Relative standard deviation per view, the worst channel; `None` where it is unknown.
    pub sigma: Vec<Option<f64>>,
    /// Whether they differ from 1 by more than their uncertainty.
    pub apply: bool,
}

/// Differences of exposure below this are left alone: no photo's light is known better.
const SMALLEST_GAIN: f64 = 0.01;

/// Finds them. `environment` in the world, where one is known already, takes the light's slope
/// within a cell out of the comparison.
pub(crate) fn find(side: &Side, environment: Option<&LightingFit>) -> Gains {
    let num_views = side.views.len();
    let num_channels = side.num_channels();
    let mut gains = Gains {
        gain: vec![vec![1.0; num_channels]; num_views],
        sigma: vec![None; num_views],
        apply: false,
    };
    for channel in 0..num_channels {
        let mut means: Vec<CellMean> = Vec::new();
        for patch in &side.patches {
            let rotation = &side.world_from_cam[patch.view];
            let usable = patch.samples.readings.iter().filter(|r| r.usable[channel]);
            let ratios = usable.map(|reading| {
                let normal = rotation * reading.normal;
                let predicted =
                    environment.map_or(1.0, |e| e.channels[channel].coefficients.evaluate(&normal));
                (normal, reading.values[channel] / predicted.max(1e-6))
            });
            // A sphere is compared with itself alone.
            let first_cell = patch.sphere * NUM_CELLS;
            means.extend(cell_means(patch.view, first_cell, ratios));
        }
        let TwoWay { ln_gain, sigma, .. } = two_way(num_views, &means);
        for view in 0..num_views {
            gains.gain[view][channel] = ln_gain[view].exp();
            let worst = match (gains.sigma[view], sigma[view]) {
                (Some(a), Some(b)) => Some(f64::max(a, b)),
                (a, b) if channel == 0 => a.or(b),
                _ => None,
            };
            gains.sigma[view] = worst;
        }
    }
    gains.apply = gains.gain.iter().zip(&gains.sigma).any(|(gain, sigma)| {
        let threshold = sigma.map_or(f64::INFINITY, |s| (3.0 * s).max(SMALLEST_GAIN));
        gain.iter().any(|g| g.ln().abs() > threshold)
    });
    gains
}
