//! What speaks against the photos.

use crate::outline::MaskOutline;
use crate::report::PhotosReport;
use rilievo_scene::{Finding, FindingCode, Orientation};

impl PhotosReport {
    /// What the user should know of photos and masks.
    pub fn findings(&self) -> Vec<Finding> {
        let photos = || self.photos.iter();
        let orientations = photos().map(|p| (p.file_name.as_str(), p.orientation));
        let rejected = self.rejected.iter().map(|photo| photo.file.as_str());
        let num_rejected = FindingCode::PhotosRejected {
            photos: self.rejected.len() as f64,
        };
        let outlines = photos().map(|p| (p.file_name.as_str(), p.mask_outline));
        let found = [
            mirrored(orientations),
            Finding::about(rejected, num_rejected),
            without_masks(self.num_masks, self.photos.len()),
            too_large(outlines),
        ];
        found.into_iter().flatten().collect()
    }
}

fn mirrored<'a>(photos: impl Iterator<Item = (&'a str, Orientation)>) -> Option<Finding> {
    let mirrored = photos.filter(|(_, orientation)| orientation.is_mirrored());
    Finding::about(mirrored.map(|(name, _)| name), FindingCode::PhotosMirrored)
}

fn without_masks(num_masks: usize, num_photos: usize) -> Option<Finding> {
    let code = match num_masks {
        n if n >= num_photos => return None,
        0 => FindingCode::MasksNone,
        n => FindingCode::MasksMissing {
            missing: (num_photos - n) as f64,
            photos: num_photos as f64,
        },
    };
    Some(code.into())
}

fn too_large<'a>(
    outlines: impl Iterator<Item = (&'a str, Option<MaskOutline>)>,
) -> Option<Finding> {
    let harmful = outlines.filter(|(_, outline)| outline.is_some_and(|o| o.is_harmful()));
    Finding::about(harmful.map(|(name, _)| name), FindingCode::MaskTooLarge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Verdict;

    fn verdict(found: Option<Finding>) -> Verdict {
        Verdict::of(found.as_slice())
    }

    #[test]
    fn mirrored_photos_make_a_mirrored_model() {
        let level = |number| {
            let orientation = Orientation::of_exif(number).unwrap();
            verdict(mirrored([("a.jpg", orientation)].into_iter()))
        };
        assert_eq!(level(6), Verdict::Good);
        assert_eq!(level(5), Verdict::NotToBeTrusted);
    }

    #[test]
    fn missing_and_wide_masks_are_found() {
        assert_eq!(verdict(without_masks(4, 4)), Verdict::Good);
        assert_eq!(verdict(without_masks(3, 4)), Verdict::Usable);
        assert_eq!(verdict(without_masks(0, 4)), Verdict::Usable);
        let outline = |beyond_px| MaskOutline {
            beyond_px,
            share_on_outline: 0.1,
            tolerance_px: 2.0,
        };
        for (beyond, expected) in [
            (6.0, Verdict::Usable),
            (3.0, Verdict::Good),
            (-6.0, Verdict::Good),
        ] {
            let found = [("a.jpg", None), ("b.jpg", Some(outline(beyond)))];
            assert_eq!(verdict(too_large(found.into_iter())), expected);
        }
    }
}
