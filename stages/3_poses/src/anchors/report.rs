//! Facts about the anchors.

use super::grow::Node;
use rilievo_scene::{Anchor, AnchorObservation, Mask, PhotoSet, PosedViews};
use serde::{Deserialize, Serialize};

/// Anchors of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewAnchors {
    /// The photo's file name.
    pub file_name: String,
    /// Anchors that the view sees.
    pub num_anchors: usize,
    /// Share of the mask within 20 px of an anchor; `None` without a mask.
    pub coverage: Option<f64>,
    /// Median standard deviation of ln depth.
    pub median_sigma_ln_depth: Option<f64>,
}

/// Facts about the anchors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AnchorReport {
    /// Anchors in all.
    pub num_anchors: usize,
    /// One entry per view.
    pub views: Vec<ViewAnchors>,
    /// Patches that were aligned, before other views were asked.
    pub num_patches: usize,
    /// Mean zero-mean correlation of those patches with their sources.
    pub mean_correlation: Option<f64>,
    /// RMS residual of those patches, log intensity.
    pub rms_residual: Option<f64>,
    /// How much larger the deviations are than least squares with independent residuals claims.
    pub noise_factor: Option<f64>,
    /// Views without a mask, in which anchors may lie on the background.
    pub unmasked_views: usize,
}

/// Distance within which an anchor covers a pixel of the mask.
const COVERAGE_RADIUS_PX: f64 = 20.0;

impl AnchorReport {
    /// Counts patches and averages their residuals.
    pub(super) fn add_patches(&mut self, nodes: &[Vec<Option<Node>>]) {
        let (mut correlation, mut squares) = (0.0, 0.0);
        for node in nodes.iter().flatten().flatten() {
            self.num_patches += 1;
            correlation += node.alignment.correlation;
            squares += node.alignment.rms.powi(2);
        }
        if self.num_patches > 0 {
            let count = self.num_patches as f64;
            self.mean_correlation = Some(correlation / count);
            self.rms_residual = Some((squares / count).sqrt());
        }
    }

    /// Counts, coverage and precision per view.
    pub(super) fn count(&mut self, photos: &PhotoSet, posed: &PosedViews, anchors: &[Anchor]) {
        self.num_anchors = anchors.len();
        let mut seen_by: Vec<Vec<&AnchorObservation>> = vec![Vec::new(); posed.views.len()];
        for observation in anchors.iter().flat_map(|a| &a.observations) {
            seen_by[observation.view.0].push(observation);
        }
        let views = posed.views.iter().zip(seen_by).map(|(view, seen)| {
            let mut sigmas: Vec<f64> = seen.iter().map(|o| o.sigma_ln_depth).collect();
            let mask = photos.photos[view.photo.0].mask.as_ref();
            let coverage = mask.map(|mask| {
                let mut covered = Mask::filled(mask.width(), mask.height(), false);
                let radius = COVERAGE_RADIUS_PX as isize;
                for o in &seen {
                    let (cx, cy) = (o.pixel[0].round() as isize, o.pixel[1].round() as isize);
                    for dy in -radius..=radius {
                        for dx in -radius..=radius {
                            if dx * dx + dy * dy <= radius * radius
                                && mask.contains(cx + dx, cy + dy)
                            {
                                *covered.at_mut((cx + dx) as usize, (cy + dy) as usize) = true;
                            }
                        }
                    }
                }
                covered.count() as f64 / mask.count().max(1) as f64
            });
            ViewAnchors {
                file_name: view.file_name.clone(),
                num_anchors: seen.len(),
                coverage,
                median_sigma_ln_depth: rilievo_numerics::robust::median(&mut sigmas),
            }
        });
        self.views = views.collect();
    }
}
