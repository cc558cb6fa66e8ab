//! What speaks against the light.

use crate::report::LightingReport;
use rilievo_photometry::surface_check::missed_photos;
use rilievo_scene::{Finding, FindingCode};

impl LightingReport {
    /// What the user should know of where the light comes from.
    pub fn findings(&self) -> Vec<Finding> {
        let check = self.kind_check.as_ref();
        let contradicted = check.is_some_and(|check| check.contradicts);
        let found = [
            (self.uncalibrated, FindingCode::LightUncalibrated),
            (contradicted, FindingCode::LightKindContradicted),
        ];
        let found = found.into_iter().filter(|(is_so, _)| *is_so);
        found.map(|(_, code)| code.into()).collect()
    }

    /// Where no shape was solved yet: what the light leaves of its own samples.
    pub fn fit_finding(&self) -> Option<Finding> {
        let views = self.views.iter();
        missed_photos(views.filter_map(|v| Some((v.name.as_str(), v.relative_rms?))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::ViewLightReport;
    use rilievo_scene::Verdict;

    #[test]
    fn a_light_that_leaves_much_of_its_samples_is_doubtful() {
        let verdict = |residual| {
            let report = LightingReport {
                views: vec![ViewLightReport {
                    relative_rms: Some(residual),
                    ..ViewLightReport::default()
                }],
                ..LightingReport::default()
            };
            Verdict::of(report.fit_finding().as_slice())
        };
        assert_eq!(verdict(0.1), Verdict::Good);
        assert_eq!(verdict(0.3), Verdict::Usable);
        assert_eq!(verdict(0.5), Verdict::NotToBeTrusted);
    }
}
