//! A photo as its file holds it: samples as stored, with what the file states of them.

use crate::raster::Mask;
use serde::{Deserialize, Serialize};

/// Samples as stored, row by row, channels together, without any decoding of their encoding.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Samples {
    /// 8-bit integers, 255 is white.
    U8(Vec<u8>),
    /// 16-bit integers, 65535 is white.
    U16(Vec<u16>),
    /// Floating point, 1 is white.
    F32(Vec<f32>),
}

impl Samples {
    /// Number of samples.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::U16(v) => v.len(),
            Self::F32(v) => v.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bits of one sample.
    pub fn bits(&self) -> u32 {
        match self {
            Self::U8(_) => 8,
            Self::U16(_) => 16,
            Self::F32(_) => 32,
        }
    }
}

/// What EXIF says of the exposure and the camera; absent where the file does not say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ExifFacts {
    /// Focal length, mm.
    pub focal_mm: Option<f64>,
    /// Focal length of the 35 mm film camera with the same field of view, mm.
    pub focal_35mm: Option<f64>,
    /// Pixels per mm on the sensor, along x, for an image of `pixel_x_dimension` columns.
    pub focal_plane_px_per_mm: Option<f64>,
    /// Columns that the camera recorded, before any later resizing.
    pub pixel_x_dimension: Option<u32>,
    /// Rows that the camera recorded.
    pub pixel_y_dimension: Option<u32>,
    /// Orientation, 1 to 8; never applied to the pixels.
    pub orientation: Option<u8>,
    /// Maker of the camera.
    pub make: Option<String>,
    /// Model of the camera.
    pub model: Option<String>,
    /// Serial number of the body.
    pub serial: Option<String>,
    /// Lens.
    pub lens: Option<String>,
    /// Exposure time, seconds.
    pub exposure_time_s: Option<f64>,
    /// Focal length over aperture.
    pub f_number: Option<f64>,
    /// Sensitivity.
    pub iso: Option<f64>,
    /// When it was taken, as written by the camera.
    pub date: Option<String>,
}

impl ExifFacts {
    /// Light that the exposure lets through, `t · ISO / N²` (seconds at ISO 1 and f/1).
    ///
    /// Two photos of one scene relate in brightness as these numbers do.
    pub fn relative_exposure(&self) -> Option<f64> {
        let value = self.exposure_time_s? * self.iso? / self.f_number?.powi(2);
        (value.is_finite() && value > 0.0).then_some(value)
    }
}

/// A decoded photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DecodedPhoto {
    /// File name with its ending.
    pub file_name: String,
    /// Columns as stored (orientation is not applied).
    pub width: usize,
    /// Rows as stored.
    pub height: usize,
    /// 1 (grey) or 3 (red, green, blue); alpha is taken out.
    pub channels: usize,
    /// `height * width * channels` values.
    pub samples: Samples,
    /// Whether the file's format and metadata say that samples are proportional to light.
    pub linear_by_metadata: bool,
    /// Whether white is where the sensor or the file saturates, so that such samples mean nothing;
    /// floating-point pictures have no such limit, camera RAW has.
    pub saturates_at_white: bool,
    /// Why, in words ("OpenEXR", "8 bit", "16 bit without colour metadata", "gAMA 1.0").
    pub encoding_reason: String,
    /// Tone curve of the embedded colour profile, where there is one that is neither linear nor
    /// sRGB: linear value at equal steps of the stored value from 0 to white.
    pub profile_curve: Option<Vec<f32>>,
    /// Pixels whose alpha is at least one half, where there is an alpha channel that is not
    /// opaque everywhere.
    pub alpha: Option<Mask>,
    /// What EXIF says.
    pub exif: ExifFacts,
}
