//! Camera RAW to linear intensities in the camera's own colours.
//!
//! A sample `s` behind a filter of colour `c`, with the sensor's black level `b` and white level
//! `w` there, becomes
//!
//! ```text
//! L_c = (s - b) / (w - b),      1 where the sensor saturates
//! ```
//!
//! and the two colours that a pixel lacks are interpolated from its neighbours by the RAW library.
//!
//! - Nothing else is done: no tone curve, no colour matrix, no rotation. Values below black stay
//!   negative: they are noise, and clamping it would bias every mean.
//! - *White balance* is not applied, so that light and albedo are in the camera's colours and all photos
//!   of one camera relate alike, whatever its automatic balance chose. Interpolation compares the
//!   colours' slopes, for which grey must be grey: colours are multiplied by the camera's own balance
//!   before it and divided by it afterwards.
//! - *Saturation*: each pixel within the reach of a saturated sample has at least 1 in that sample's
//!   colour, so that no pixel made up from clipped samples passes for a measured one.
//! - The frame is the sensor's recommended area, as that of the camera's own JPEG.

use super::exif_facts;
use super::parts::of_floats;
use crate::error::IoError;
use rawler::cfa::{CFA, PlaneColor};
use rawler::decoders::{Decoder, FormatHint, RawDecodeParams, RawMetadata};
use rawler::imgop::sensor::bayer::ppg::PPGDemosaic;
use rawler::imgop::sensor::xtrans::bilinear::XTransBilinearDemosaic;
use rawler::imgop::sensor::{Demosaic, SensorType};
use rawler::imgop::{Point, Rect};
use rawler::pixarray::{Color2D, PixF32};
use rawler::rawimage::{CFAConfig, RawPhotometricInterpretation};
use rawler::rawsource::RawSource;
use rawler::{RawImage, RawlerError};
use rilievo_scene::{DecodedPhoto, ExifFacts};
use std::cmp::Ordering;
use std::path::Path;

/// Samples from a pixel to the farthest that its interpolated colours rest on to a quarter or more.
const REACH_PX: usize = 2;

/// Smallest frame, of twice the interpolation's own border.
const MIN_SIDE_PX: usize = 8;

/// Decodes a RAW file; the caller catches the library's panics.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<DecodedPhoto, IoError> {
    let refuse = |error: RawlerError| {
        let what = match error {
            RawlerError::Unsupported { what, .. } | RawlerError::DecoderFailed(what) => what,
        };
        refused(path, &what)
    };
    let source = RawSource::new_from_slice(bytes).with_path(path);
    let decoder = rawler::get_decoder(&source).map_err(refuse)?;
    let params = RawDecodeParams::default();
    let raw = decoder.raw_image(&source, &params, false).map_err(refuse)?;
    let mut exif = exif_facts::read(bytes);
    if let Ok(metadata) = decoder.raw_metadata(&source, &params) {
        complete(&mut exif, &metadata);
    }
    let orientation = raw.orientation.to_u16();
    if exif.orientation.is_none() && (1..=8).contains(&orientation) {
        exif.orientation = Some(orientation as u8);
    }
    let (width, height, channels, data) =
        linear(&raw, decoder.as_ref()).map_err(|reason| refused(path, &reason))?;
    Ok(DecodedPhoto {
        saturates_at_white: true,
        exif,
        ..of_floats(path, (width, height, channels), data, "camera RAW")
    })
}

fn refused(path: &Path, reason: &str) -> IoError {
    IoError::input(path, format!("the RAW file cannot be decoded: {reason}"))
}

/// Columns, rows, channels and values.
type Linear = (usize, usize, usize, Vec<f32>);

fn linear(raw: &RawImage, decoder: &dyn Decoder) -> Result<Linear, String> {
    let (width, height, cpp) = (raw.width, raw.height, raw.cpp);
    if raw.fuji_rotation_width.is_some() {
        return Err("sensors turned by 45 degrees are not supported".to_owned());
    }
    let frame = Rect::new(Point::zero(), raw.dim());
    let active = raw.active_area.unwrap_or(frame);
    let frame = raw.crop_area.unwrap_or(active);
    let (right, bottom) = (frame.p.x + frame.d.w, frame.p.y + frame.d.h);
    if frame.d.w.min(frame.d.h) < MIN_SIDE_PX || right > width || bottom > height {
        let (w, h) = (frame.d.w, frame.d.h);
        return Err(format!(
            "its frame of {w} x {h} pixels lies outside the sensor or is too small"
        ));
    }
    let stored = raw.data.as_f32();
    if stored.len() != width * height * cpp {
        let found = stored.len();
        return Err(format!(
            "it has {found} samples for {width} x {height} x {cpp}"
        ));
    }
    // The DNG specification counts the pattern of black levels from the active area.
    let origin = match decoder.format_hint() {
        FormatHint::DNG => active.p,
        _ => Point::zero(),
    };
    let levels = Levels::of(raw, origin)?;
    match (&raw.photometric, cpp) {
        (RawPhotometricInterpretation::Cfa(config), 1) => {
            let mosaic = Mosaic {
                config,
                balance: balance(raw),
                width,
                levels: &levels,
            };
            let data = mosaic.interpolate(&stored, frame)?;
            Ok((frame.d.w, frame.d.h, 3, data))
        }
        (RawPhotometricInterpretation::Cfa(_), _) | (_, 0 | 2 | 4..) => {
            Err(format!("{cpp} samples a pixel are not supported"))
        }
        (_, channels) => {
            let mut data = Vec::with_capacity(frame.d.w * frame.d.h * channels);
            for y in frame.p.y..bottom {
                for x in frame.p.x..right {
                    let at = (y * width + x) * channels;
                    data.extend((0..channels).map(|c| levels.linear(x, y, c, stored[at + c])));
                }
            }
            Ok((frame.d.w, frame.d.h, channels, data))
        }
    }
}

/// Black and white level of every sample.
struct Levels {
    /// Black levels of a repeated block of `columns x rows` pixels of `planes` samples.
    black: Vec<f32>,
    columns: usize,
    rows: usize,
    planes: usize,
    /// Where the first block begins.
    origin: Point,
    /// One level for all, one a plane, or those of a block of 2 x 2 pixels.
    white: Vec<f32>,
}

impl Levels {
    fn of(raw: &RawImage, origin: Point) -> Result<Self, String> {
        let black = &raw.blacklevel;
        let levels = Self {
            black: black.as_vec(),
            columns: black.width,
            rows: black.height,
            planes: black.cpp,
            origin,
            white: raw.whitelevel.as_vec(),
        };
        let complete = levels.columns * levels.rows * levels.planes == levels.black.len();
        if !complete || levels.black.is_empty() || levels.white.is_empty() {
            return Err("its black or white level is missing".to_owned());
        }
        let darkest = levels.white.iter().copied().fold(f32::MAX, f32::min);
        let brightest = levels.black.iter().copied().fold(f32::MIN, f32::max);
        // Levels that are no numbers are refused too.
        if brightest.partial_cmp(&darkest) != Some(Ordering::Less) {
            return Err(format!(
                "its black level {brightest} is not below its white level {darkest}"
            ));
        }
        Ok(levels)
    }

    fn white(&self, x: usize, y: usize, plane: usize) -> f32 {
        match self.white.len() {
            4 if self.planes == 1 => self.white[y % 2 * 2 + x % 2],
            len => self.white[plane.min(len - 1)],
        }
    }

    fn linear(&self, x: usize, y: usize, plane: usize, stored: f32) -> f32 {
        let column = (x + self.columns - self.origin.x % self.columns) % self.columns;
        let row = (y + self.rows - self.origin.y % self.rows) % self.rows;
        let at = (row * self.columns + column) * self.planes + plane.min(self.planes - 1);
        let black = self.black[at];
        (stored - black) / (self.white(x, y, plane) - black)
    }
}

/// Factors of red, green and blue for which grey is about equal in all; 1 where the file has none.
fn balance(raw: &RawImage) -> [f32; 3] {
    let [red, green, blue, _] = raw.wb_coeffs;
    let factors = [red / green, 1.0, blue / green];
    // Beyond this no light that people photograph under lies: such a file is wrong.
    let plausible = factors.iter().all(|f| (0.05..20.0).contains(f));
    if plausible { factors } else { [1.0; 3] }
}

/// One colour a pixel.
struct Mosaic<'a> {
    config: &'a CFAConfig,
    balance: [f32; 3],
    width: usize,
    levels: &'a Levels,
}

impl Mosaic<'_> {
    /// All three colours of the pixels of `frame`, row by row.
    fn interpolate(&self, stored: &[f32], frame: Rect) -> Result<Vec<f32>, String> {
        let (cfa, colors) = (&self.config.cfa, &self.config.colors);
        if !cfa.is_rgb() {
            return Err(format!("filters of the colours {cfa} are not supported"));
        }
        let mut samples = Vec::with_capacity(stored.len());
        let mut saturated = Vec::new();
        for (i, &value) in stored.iter().enumerate() {
            let (x, y) = (i % self.width, i / self.width);
            let color = cfa.color_at(y, x);
            let linear = self.levels.linear(x, y, 0, value);
            if linear >= 1.0 {
                saturated.push((x, y, color));
            }
            samples.push(linear * self.balance[color]);
        }
        let height = samples.len() / self.width;
        let samples = PixF32::new_with(samples, self.width, height);
        let rgb = demosaic(self.config.sensor, &samples, (cfa, colors), frame);
        let mut data = rgb.into_flatten();
        for pixel in data.chunks_exact_mut(3) {
            for (value, factor) in pixel.iter_mut().zip(&self.balance) {
                *value /= factor;
            }
        }
        for (x, y, color) in saturated {
            let span = |at: usize, from: usize, len: usize| {
                let first = at.saturating_sub(REACH_PX).max(from);
                (first..(at + REACH_PX + 1).min(from + len)).map(move |at| at - from)
            };
            for row in span(y, frame.p.y, frame.d.h) {
                for column in span(x, frame.p.x, frame.d.w) {
                    let value = &mut data[3 * (row * frame.d.w + column) + color];
                    *value = value.max(1.0);
                }
            }
        }
        Ok(data)
    }
}

fn demosaic(
    sensor: SensorType,
    samples: &PixF32,
    (cfa, colors): (&CFA, &PlaneColor),
    frame: Rect,
) -> Color2D<f32, 3> {
    match sensor {
        SensorType::Bayer => PPGDemosaic::new().demosaic(samples, cfa, colors, frame),
        SensorType::Xtrans => XTransBilinearDemosaic::new().demosaic(samples, cfa, colors, frame),
    }
}

/// Adds what the RAW library found in containers that the EXIF reader does not know.
fn complete(exif: &mut ExifFacts, metadata: &RawMetadata) {
    fn fill<T>(known: &mut Option<T>, found: Option<T>) {
        *known = known.take().or(found);
    }
    let number = |value: &Option<rawler::formats::tiff::Rational>| {
        let value = value.as_ref()?;
        let number = f64::from(value.n) / f64::from(value.d);
        (number.is_finite() && number > 0.0).then_some(number)
    };
    let text = |value: &str| (!value.trim().is_empty()).then(|| value.trim().to_owned());
    let own_text = |value: &Option<String>| value.as_deref().and_then(text);
    let found = &metadata.exif;
    let iso = found.iso_speed_ratings.map(f64::from);
    let orientation = found.orientation.filter(|v| (1..=8).contains(v));
    fill(&mut exif.focal_mm, number(&found.focal_length));
    fill(&mut exif.exposure_time_s, number(&found.exposure_time));
    fill(&mut exif.f_number, number(&found.fnumber));
    fill(&mut exif.iso, iso.filter(|&iso| iso > 0.0));
    fill(&mut exif.make, text(&metadata.make));
    fill(&mut exif.model, text(&metadata.model));
    fill(&mut exif.serial, own_text(&found.serial_number));
    fill(&mut exif.lens, own_text(&found.lens_model));
    fill(&mut exif.date, own_text(&found.date_time_original));
    fill(&mut exif.orientation, orientation.map(|v| v as u8));
}

#[cfg(test)]
mod tests;
