//! Camera before poses: `f_px` from what EXIF says, else a guess; principal point in the middle.
//!
//! In this order, the first that gives a plausible value:
//! 1. the user's word (a camera file, or the option `focal_35mm`);
//! 2. EXIF focal length in 35 mm equivalents, `f_px = f₃₅ · d_px / 43.27 mm` with the image's
//!    diagonal `d_px` (CIPA DC-008 defines the equivalent by the diagonal). Where it equals the
//!    true focal length the sensor is a full frame, whose longer side is 36 mm whatever part of
//!    its height the file keeps: `f_px = f · max(w, h) / 36 mm`;
//! 3. EXIF focal length and focal-plane resolution, `f_px = f · r`, scaled to the image's size;
//! 4. EXIF focal length and the sensor of a known camera;
//! 5. a guess, `1.2 · max(w, h)`, which is refined with the poses.
//!
//! Of a photo that was cropped, by the pixels that the camera recorded, EXIF describes the whole frame.

use rilievo_scene::{ExifFacts, FocalSource, Intrinsics};

/// Focal length of a camera of which nothing is known, over the longer side: between a phone's wide
/// angle (26 mm in 35 mm equivalents, 0.7) and a portrait lens (85 mm, 2.4). Poses may fail from a
/// start that is off by more than half.
const GUESS_OVER_SIDE: f64 = 1.2;

/// Diagonal of the 36 x 24 mm film frame, mm.
const FILM_DIAGONAL_MM: f64 = 43.266_615_305_567_875;

/// Longer side of the film frame, mm.
const FILM_WIDTH_MM: f64 = 36.0;

/// Fields of view from 140° to 2° over the longer side; beyond them EXIF is wrong.
const PLAUSIBLE_FOCAL_OVER_SIDE: std::ops::RangeInclusive<f64> = 0.18..=30.0;

/// Widths of sensors, mm, of cameras that write neither a 35 mm equivalent nor a focal-plane
/// resolution: part of the model's name in lower case, and the longer side.
const SENSOR_WIDTHS_MM: [(&str, f64); 24] = [
    ("eos 5d", 35.8),
    ("eos 6d", 35.8),
    ("eos-1ds", 36.0),
    ("eos r5", 36.0),
    ("eos r6", 35.9),
    ("eos 7d", 22.3),
    ("eos 10d", 22.7),
    ("eos 20d", 22.5),
    ("eos 30d", 22.5),
    ("eos 40d", 22.2),
    ("eos 300d", 22.7),
    ("eos 350d", 22.2),
    ("eos 400d", 22.2),
    ("nikon d70", 23.7),
    ("nikon d80", 23.6),
    ("nikon d90", 23.6),
    ("nikon d700", 36.0),
    ("nikon d800", 35.9),
    ("nikon d3", 36.0),
    ("ilce-7", 35.8),
    ("ilce-6", 23.5),
    ("x-t", 23.5),
    ("e-m", 17.3),
    ("dmc-g", 17.3),
];

/// A camera before poses, and how it came about.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FirstCamera {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// Where its focal length came from.
    pub source: FocalSource,
    /// How it was computed, in words.
    pub note: String,
}

/// The camera of an image of which the user gave none.
pub(crate) fn first_camera(
    width: usize,
    height: usize,
    exif: &ExifFacts,
    given_35mm: Option<f64>,
) -> FirstCamera {
    let cropped_from = cropped_from(width, height, exif);
    let (whole_width, whole_height) = cropped_from.unwrap_or((width, height));
    let side = whole_width.max(whole_height) as f64;
    let diagonal = (whole_width as f64).hypot(whole_height as f64);
    let plausible = |focal_px: f64| PLAUSIBLE_FOCAL_OVER_SIDE.contains(&(focal_px / side));
    let camera = |focal_px: f64, source: FocalSource, note: String| FirstCamera {
        intrinsics: Intrinsics::pinhole(
            width,
            height,
            focal_px,
            0.5 * (width as f64 - 1.0),
            0.5 * (height as f64 - 1.0),
        ),
        source,
        note,
    };

    if let Some(focal_35mm) = given_35mm {
        let focal_px = focal_35mm * diagonal / FILM_DIAGONAL_MM;
        let note = format!("given, {focal_35mm} mm in 35 mm equivalents");
        return camera(focal_px, FocalSource::CameraFile, note);
    }

    let mut implausible = None;
    let candidates = [
        by_equivalent(side, diagonal, exif),
        by_focal_plane(side, exif),
        by_sensor_table(side, exif),
    ];
    for (focal_px, source, note) in candidates.into_iter().flatten() {
        if plausible(focal_px) {
            let note = match cropped_from {
                Some((w, h)) => format!("{note}, cropped from {w} x {h}"),
                None => note,
            };
            return camera(focal_px, source, note);
        }
        implausible.get_or_insert(note);
    }

    let mut note = format!("guess, {GUESS_OVER_SIDE} times the longer side");
    if let Some(what) = implausible {
        note += &format!(" ({what} is not plausible)");
    }
    camera(GUESS_OVER_SIDE * side, FocalSource::Guess, note)
}

/// Size of the frame that a photo was cropped from without resizing: one of its sides is as the camera recorded
/// it, the other shorter by more than the 16 pixels that a JPEG's blocks are padded to.
pub(crate) fn cropped_from(
    width: usize,
    height: usize,
    exif: &ExifFacts,
) -> Option<(usize, usize)> {
    let recorded = (exif.pixel_x_dimension?, exif.pixel_y_dimension?);
    let (whole_width, whole_height) = (recorded.0 as usize, recorded.1 as usize);
    let is_cut = |is: usize, was: usize| is + 16 < was;
    let is_cropped = (width == whole_width && is_cut(height, whole_height))
        || (height == whole_height && is_cut(width, whole_width));
    is_cropped.then_some((whole_width, whole_height))
}

type Candidate = Option<(f64, FocalSource, String)>;

fn by_equivalent(side: f64, diagonal: f64, exif: &ExifFacts) -> Candidate {
    let equivalent = exif.focal_35mm?;
    // Equivalents are written in whole millimetres.
    let full_frame = exif
        .focal_mm
        .is_some_and(|focal| (focal - equivalent).abs() <= 0.5);
    let focal_px = if full_frame {
        equivalent * side / FILM_WIDTH_MM
    } else {
        equivalent * diagonal / FILM_DIAGONAL_MM
    };
    let note = format!("EXIF {equivalent} mm in 35 mm equivalents");
    Some((focal_px, FocalSource::Exif35mm, note))
}

fn by_focal_plane(side: f64, exif: &ExifFacts) -> Candidate {
    let (focal, resolution) = (exif.focal_mm?, exif.focal_plane_px_per_mm?);
    let recorded = exif
        .pixel_x_dimension
        .into_iter()
        .chain(exif.pixel_y_dimension)
        .max()
        .map_or(side, f64::from);
    let sensor_mm = recorded / resolution;
    // Sensors are 3 mm (endoscope) to 60 mm (medium format) wide.
    if !(3.0..=60.0).contains(&sensor_mm) {
        return None;
    }
    let focal_px = focal * resolution * side / recorded;
    let note = format!("EXIF {focal} mm on a sensor {sensor_mm:.1} mm wide");
    Some((focal_px, FocalSource::ExifSensor, note))
}

fn by_sensor_table(side: f64, exif: &ExifFacts) -> Candidate {
    let focal = exif.focal_mm?;
    let model = exif.model.as_ref()?.to_lowercase();
    // The longest name that fits: "nikon d3" is part of "nikon d300".
    let (_, sensor_mm) = SENSOR_WIDTHS_MM
        .iter()
        .filter(|(name, _)| {
            model.find(name).is_some_and(|at| {
                !model[at + name.len()..].starts_with(|c: char| c.is_ascii_digit())
                    || name.ends_with(['-', 't', 'm', 'g'])
            })
        })
        .max_by_key(|(name, _)| name.len())?;
    let note = format!("EXIF {focal} mm, sensor of {model} {sensor_mm} mm wide");
    Some((focal * side / sensor_mm, FocalSource::ExifSensor, note))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(exif: ExifFacts) -> FirstCamera {
        first_camera(2832, 2128, &exif, None)
    }

    fn close(found: f64, expected: f64) {
        assert!(
            (found / expected - 1.0).abs() < 1e-12,
            "{found} instead of {expected}"
        );
    }

    #[test]
    fn a_compact_cameras_equivalent_goes_by_the_diagonal() {
        let found = camera(ExifFacts {
            focal_mm: Some(5.85),
            focal_35mm: Some(35.0),
            ..ExifFacts::default()
        });
        assert_eq!(found.source, FocalSource::Exif35mm);
        let expected = 35.0 * 2832f64.hypot(2128.0) / 36f64.hypot(24.0);
        close(found.intrinsics.fx, expected);
        close(found.intrinsics.cx, 1415.5);
        close(found.intrinsics.cy, 1063.5);
    }

    #[test]
    fn a_full_frame_goes_by_its_width() {
        let exif = ExifFacts {
            focal_mm: Some(50.0),
            focal_35mm: Some(50.0),
            ..ExifFacts::default()
        };
        let found = first_camera(1280, 960, &exif, None);
        close(found.intrinsics.fx, 1280.0 / 36.0 * 50.0);
    }

    #[test]
    fn the_focal_plane_counts_recorded_pixels() {
        let found = camera(ExifFacts {
            focal_mm: Some(50.0),
            focal_plane_px_per_mm: Some(5664.0 / 22.0),
            pixel_x_dimension: Some(5664),
            pixel_y_dimension: Some(4256),
            ..ExifFacts::default()
        });
        assert_eq!(found.source, FocalSource::ExifSensor);
        close(found.intrinsics.fx, 50.0 / 22.0 * 2832.0);
    }

    #[test]
    fn a_cropped_photo_keeps_the_focal_length_of_the_whole() {
        let exif = |columns: u32, rows: u32| ExifFacts {
            focal_mm: Some(5.85),
            focal_35mm: Some(35.0),
            pixel_x_dimension: Some(columns),
            pixel_y_dimension: Some(rows),
            ..ExifFacts::default()
        };
        let whole = first_camera(2832, 2128, &exif(2832, 2128), None);
        for (width, height) in [(2360, 2128), (2832, 1600)] {
            let cut = first_camera(width, height, &exif(2832, 2128), None);
            close(cut.intrinsics.fx, whole.intrinsics.fx);
            assert!(
                cut.note.contains("cropped from 2832 x 2128"),
                "{}",
                cut.note
            );
        }
        // Resized, turned, and padded by a JPEG's blocks.
        for (width, height, exif) in [
            (1416, 1064, exif(2832, 2128)),
            (2128, 2832, exif(2832, 2128)),
            (2832, 2128, exif(2832, 2144)),
        ] {
            assert_eq!(
                cropped_from(width, height, &exif),
                None,
                "{width} x {height}"
            );
        }
    }

    #[test]
    fn known_bodies_and_their_longer_named_siblings() {
        let of = |model: &str| {
            camera(ExifFacts {
                focal_mm: Some(36.0),
                model: Some(model.to_owned()),
                ..ExifFacts::default()
            })
        };
        close(of("NIKON D3").intrinsics.fx, 2832.0);
        assert_eq!(of("NIKON D300").source, FocalSource::Guess);
        close(of("ILCE-7M3").intrinsics.fx, 36.0 / 35.8 * 2832.0);
        assert_eq!(of("Unknown 1").source, FocalSource::Guess);
    }

    #[test]
    fn nothing_known_or_nothing_plausible_is_a_guess() {
        let found = camera(ExifFacts::default());
        assert_eq!(found.source, FocalSource::Guess);
        close(found.intrinsics.fx, 1.2 * 2832.0);
        let found = camera(ExifFacts {
            focal_35mm: Some(65535.0),
            ..ExifFacts::default()
        });
        assert_eq!(found.source, FocalSource::Guess);
        assert!(found.note.contains("65535"), "{}", found.note);
    }
}
