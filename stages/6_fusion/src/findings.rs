//! What speaks against cloud and mesh.

use crate::report::{FusionReport, Layering};
use rilievo_scene::{Finding, FindingCode};

/// Distance between overlapping views, in pixel footprints, above which they form layers.
const DOUBTFUL_LAYERING_PX: f64 = 2.0;

impl FusionReport {
    /// What the user should know of the views' surfaces in one frame.
    pub fn findings(&self) -> Vec<Finding> {
        let Layering {
            median, footprint, ..
        } = self.layering;
        let apart_px = median / footprint;
        let is_layered = footprint > 0.0 && apart_px > DOUBTFUL_LAYERING_PX;
        let layers = is_layered.then(|| FindingCode::SurfacesInLayers { apart_px }.into());
        layers.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Verdict;

    #[test]
    fn surfaces_two_footprints_apart_are_layers() {
        let verdict = |median| {
            let report = FusionReport {
                layering: Layering {
                    median,
                    footprint: 2e-4,
                    ..Layering::default()
                },
                ..FusionReport::default()
            };
            Verdict::of(&report.findings())
        };
        assert_eq!(verdict(1e-4), Verdict::Good);
        assert_eq!(verdict(1e-3), Verdict::NotToBeTrusted);
    }
}
