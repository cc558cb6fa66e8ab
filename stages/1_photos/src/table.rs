//! The preflight as a table for people.

use crate::report::{PhotoFacts, PhotosReport};
use rilievo_scene::Orientation;
use std::fmt;

impl PhotosReport {
    /// One line per photo, then the groups, the photos left out and what was warned of.
    pub fn table<'a>(&'a self, warnings: &'a [String]) -> Table<'a> {
        Table {
            report: self,
            warnings,
        }
    }
}

/// A report that writes itself as text.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    report: &'a PhotosReport,
    warnings: &'a [String],
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), |share| format!("{:.1}", 100.0 * share))
}

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = self.report;
        let width = report
            .photos
            .iter()
            .map(|photo| photo.file_name.chars().count())
            .max()
            .unwrap_or(0)
            .max(5);
        writeln!(
            f,
            "{:width$}  {:>11}  {:>8}  {:>6}  {:>6}  {:>7}  {:>6}  {:>6}  camera",
            "photo", "pixels", "focal px", "mask %", "clip %", "level", "noise", "sharp"
        )?;
        for photo in &report.photos {
            let clipped = photo.clipped_share_on_object.or(Some(photo.clipped_share));
            let pixels = format!("{} x {}", photo.width, photo.height);
            writeln!(
                f,
                "{:width$}  {pixels:>11}  {:>8.1}  {:>6}  {:>6}  {:>7.4}  {:>6.4}  {:>6.3}  {}",
                photo.file_name,
                photo.intrinsics.focal_px(),
                percent(photo.mask_coverage),
                percent(clipped),
                photo.median_level,
                photo.noise_sigma,
                photo.sharpness,
                camera(photo),
            )?;
        }
        for group in &report.camera_groups {
            writeln!(f, "{} photos: {}", group.photos.len(), group.description)?;
        }
        if report.num_masks > 0 {
            writeln!(
                f,
                "masks: {}/{} matched, mean coverage {} %",
                report.num_masks,
                report.photos.len(),
                percent(report.mean_mask_coverage)
            )?;
        }
        if let Some(spread) = report.exposure_spread_ev {
            let evened = if report.exposure_gains.is_empty() {
                ""
            } else {
                ", evened out"
            };
            writeln!(f, "exposure by EXIF: spread {spread:.2} EV{evened}")?;
        }
        for photo in &report.rejected {
            writeln!(f, "left out: {}: {}", photo.file, photo.reason)?;
        }
        for warning in self.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        Ok(())
    }
}

fn camera(photo: &PhotoFacts) -> String {
    let turned = match photo.orientation {
        Orientation::UPRIGHT => String::new(),
        turned => format!(", orientation {}, used as stored", turned.number()),
    };
    format!("{}{turned}; {}", photo.focal_note, photo.encoding_reason)
}
