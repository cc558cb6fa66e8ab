//! Stored samples to linear intensities, `L = f(s)`, 1 = white.
//!
//! # What is taken as linear, and why
//! | photo | `auto` takes it as |
//! |---|---|
//! | OpenEXR, Radiance HDR, float TIFF | linear: such files hold scene-referred values |
//! | camera RAW | linear: the sensor counts light |
//! | 16-bit TIFF or PNG whose profile or gamma is linear | linear |
//! | 16-bit TIFF or PNG that says nothing of its colours | linear: display-referred exports carry a profile or an `sRGB` chunk, stored measurements carry none |
//! | any photo with another profile | by the profile's own tone curve |
//! | everything else (JPEG, 8-bit PNG and TIFF) | sRGB |
//!
//! `srgb` and `linear` overrule all of it. Negative values of float photos are kept: they are
//! noise around black, and clamping it would bias every mean.

use crate::options::Encoding;
use crate::report::AppliedEncoding;
use rilievo_scene::{DecodedPhoto, LinearImage, Samples, srgb};

/// The curve that applies to a photo.
enum Curve<'a> {
    Linear,
    Srgb,
    Table(&'a [f32]),
}

impl<'a> Curve<'a> {
    fn of(decoded: &'a DecodedPhoto, encoding: Encoding) -> Self {
        match (encoding, &decoded.profile_curve) {
            (Encoding::Linear, _) => Self::Linear,
            (Encoding::Srgb, _) => Self::Srgb,
            (Encoding::Auto, _) if decoded.linear_by_metadata => Self::Linear,
            (Encoding::Auto, Some(table)) if table.len() >= 2 => Self::Table(table),
            (Encoding::Auto, _) => Self::Srgb,
        }
    }

    fn applied(&self) -> AppliedEncoding {
        match self {
            Self::Linear => AppliedEncoding::Linear,
            Self::Srgb => AppliedEncoding::Srgb,
            Self::Table(_) => AppliedEncoding::Profile,
        }
    }

    fn linear(&self, stored: f64) -> f64 {
        match self {
            Self::Linear => stored,
            Self::Srgb => srgb::decode(stored),
            Self::Table(table) => {
                let last = table.len() - 1;
                let position = stored.clamp(0.0, 1.0) * last as f64;
                let low = (position as usize).min(last - 1);
                let share = position - low as f64;
                f64::from(table[low]) * (1.0 - share) + f64::from(table[low + 1]) * share
            }
        }
    }

    /// Linear values of all integers up to white.
    fn lookup(&self, white: u32) -> Vec<f32> {
        (0..=white)
            .map(|stored| self.linear(f64::from(stored) / f64::from(white)) as f32)
            .collect()
    }
}

/// Linear intensities of a decoded photo, and the curve that was undone.
///
/// # Shapes
/// The image has the photo's size and channels; samples that are missing are zero.
pub fn linearize(decoded: &DecodedPhoto, encoding: Encoding) -> (LinearImage, AppliedEncoding) {
    let curve = Curve::of(decoded, encoding);
    let mut data: Vec<f32> = match &decoded.samples {
        Samples::U8(samples) => {
            let table = curve.lookup(255);
            samples.iter().map(|&s| table[usize::from(s)]).collect()
        }
        Samples::U16(samples) => {
            let table = curve.lookup(65535);
            samples.iter().map(|&s| table[usize::from(s)]).collect()
        }
        Samples::F32(samples) => match curve {
            Curve::Linear => samples.clone(),
            _ => samples
                .iter()
                .map(|&s| curve.linear(f64::from(s)) as f32)
                .collect(),
        },
    };
    data.resize(decoded.width * decoded.height * decoded.channels, 0.0);
    let image = LinearImage {
        width: decoded.width,
        height: decoded.height,
        channels: decoded.channels,
        data,
    };
    (image, curve.applied())
}

/// Linear value at and above which a channel counts as clipped, for a stored value of
/// `clip_fraction` of white; beyond all values where white is no limit.
pub(crate) fn clip_level(decoded: &DecodedPhoto, encoding: Encoding, clip_fraction: f64) -> f32 {
    if !decoded.saturates_at_white {
        return f32::MAX;
    }
    // A little below, so that rounding of the fraction does not let the step itself through.
    Curve::of(decoded, encoding).linear(clip_fraction) as f32 * (1.0 - 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::ExifFacts;

    fn photo(samples: Samples, linear_by_metadata: bool) -> DecodedPhoto {
        DecodedPhoto {
            file_name: "a".to_owned(),
            width: samples.len(),
            height: 1,
            channels: 1,
            saturates_at_white: samples.bits() < 32,
            samples,
            linear_by_metadata,
            encoding_reason: String::new(),
            profile_curve: None,
            alpha: None,
            exif: ExifFacts::default(),
        }
    }

    #[test]
    fn one_scene_in_three_encodings_is_one_linear_image() {
        let scene: Vec<f64> = (0..200).map(|i| f64::from(i) / 199.0).collect();
        let srgb8 = scene
            .iter()
            .map(|&v| (srgb::encode(v) * 255.0).round() as u8);
        let linear16 = scene.iter().map(|&v| (v * 65535.0).round() as u16);
        let float = scene.iter().map(|&v| v as f32);
        let images = [
            linearize(&photo(Samples::U8(srgb8.collect()), false), Encoding::Auto),
            linearize(
                &photo(Samples::U16(linear16.collect()), true),
                Encoding::Auto,
            ),
            linearize(&photo(Samples::F32(float.collect()), true), Encoding::Auto),
        ];
        assert_eq!(images[0].1, AppliedEncoding::Srgb);
        assert_eq!(images[2].1, AppliedEncoding::Linear);
        for (image, _) in &images {
            for (value, truth) in image.data.iter().zip(&scene) {
                // Half an 8-bit step, times the steepest slope of the curve (2.27 at white).
                let error = (f64::from(*value) - truth).abs();
                assert!(error < 0.5 / 255.0 * 2.3, "{value} {truth}");
            }
        }
    }

    #[test]
    fn the_users_word_overrules_metadata_and_profiles() {
        let mut decoded = photo(Samples::U8(vec![128]), false);
        decoded.profile_curve = Some(vec![0.0, 0.5, 1.0]);
        let value = |encoding| {
            let (image, applied) = linearize(&decoded, encoding);
            (image.data[0], applied)
        };
        let (by_profile, applied) = value(Encoding::Auto);
        assert!((by_profile - 128.0 / 255.0).abs() < 1e-6);
        assert_eq!(applied, AppliedEncoding::Profile);
        assert!((value(Encoding::Srgb).0 - 0.215_86).abs() < 1e-5);
        assert_eq!(value(Encoding::Linear).1, AppliedEncoding::Linear);
    }

    #[test]
    fn clipping_is_judged_on_the_stored_value() {
        let decoded = photo(Samples::U8(vec![253, 254, 255]), false);
        let (image, _) = linearize(&decoded, Encoding::Auto);
        let level = clip_level(&decoded, Encoding::Auto, 254.0 / 255.0);
        let clipped: Vec<bool> = image.data.iter().map(|&v| v >= level).collect();
        assert_eq!(clipped, [false, true, true]);
    }
}
