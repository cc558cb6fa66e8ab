//! What two halves of the photos agree on, by wavelength.

use super::plot;
use maud::{Markup, html};
use rilievo_synthetic::compare::{HalvesComparison, RESOLVED_CORRELATION};

/// The section: the table of numbers, and the curve.
pub fn section(table: &str, found: &HalvesComparison) -> Markup {
    let curve: Vec<(f64, f64)> = found
        .relief
        .iter()
        .filter_map(|band| Some((band.wavelength_px, band.correlation?)))
        .collect();
    html! {
        section id="halves" {
            h2 { "What two halves of the photos agree on" }
            pre { (table) }
            (plot::by_wavelength(
                "Correlation of the halves by wavelength, pixels",
                &curve,
                RESOLVED_CORRELATION,
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_synthetic::compare::{HalvesBand, Resolved};

    #[test]
    fn the_section_has_its_numbers_and_one_curve() {
        let band = |wavelength_px: f64, correlation: Option<f64>| HalvesBand {
            wavelength_px,
            wavelength: None,
            rms_deg: 1.0,
            correlation,
            num_px: 1000,
        };
        let found = HalvesComparison {
            relief: vec![band(4.7, None), band(9.4, Some(0.4)), band(18.8, Some(0.9))],
            resolved: Resolved::None,
        };
        let html = section("a < b", &found).into_string();
        assert!(html.contains("a &lt; b") && !html.contains("NaN"), "{html}");
        assert_eq!(html.matches("<svg").count(), 1);
        assert_eq!(html.matches("<polyline").count(), 1);
        let nothing = HalvesComparison {
            relief: Vec::new(),
            resolved: Resolved::None,
        };
        assert!(!section("-", &nothing).into_string().contains("<svg"));
    }
}
