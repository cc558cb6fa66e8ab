//! Views and matches as the package hands them over.

use crate::arrays::Argument;
use crate::failures::unusable;
use pyo3::prelude::*;
use rilievo::embedded::{
    DecodedPhoto, ExifFacts, Intrinsics, Lighting, Samples, SphericalHarmonics, ViewParts,
    pose_of_rows,
};

/// A view; fields that are `None` are not given.
#[derive(FromPyObject)]
pub struct View<'py> {
    /// Name for messages and the report.
    name: String,
    /// What is put behind an argument's name to say which view is meant: `[2]`, or nothing.
    place: String,
    image: Bound<'py, PyAny>,
    mask: Option<Bound<'py, PyAny>>,
    /// `fx, fy, cx, cy`, checked.
    camera: [f64; 4],
    /// `cam_from_world`, `[R | t]`.
    pose: Option<[[f64; 4]; 3]>,
    lighting: Option<Bound<'py, PyAny>>,
    initial: Option<Bound<'py, PyAny>>,
    prior: Option<Bound<'py, PyAny>>,
}

impl<'py> View<'py> {
    /// The view with its arrays copied.
    ///
    /// # Errors
    /// Names the argument that does not fit.
    pub fn read(self, py: Python<'py>) -> PyResult<ViewParts> {
        let argument = |name, value| named(name, &self.place, value);
        let (size, channels, samples) = argument("images", &self.image).image()?;
        let mask = self.mask.as_ref();
        let mask = mask.map(|mask| argument("masks", mask).mask(size));
        let depth = |name: &str, map: Option<&Bound<'py, PyAny>>| {
            map.map(|map| named(name, &self.place, map).depth(size))
                .transpose()
        };
        let lighting = self.lighting.as_ref().map(|lighting| {
            let argument = argument("lighting", lighting);
            let rows: Vec<[f64; 9]> = argument.rows()?;
            if rows.len() != channels {
                let wanted =
                    format!("it must have a row for each of the image's {channels} channel(s)");
                return Err(argument.unusable(&wanted));
            }
            let channels = rows.into_iter().map(SphericalHarmonics).collect();
            Ok(Lighting { channels })
        });
        let pose = self.pose.map(|rows| {
            pose_of_rows(&rows).ok_or_else(|| {
                let message = format!(
                    "cameras{}: cam_from_world must be a rotation beside a translation, finite",
                    self.place
                );
                unusable(py, message)
            })
        });
        let view = ViewParts {
            mask: mask.transpose()?,
            intrinsics: Intrinsics::undistorted(size, self.camera),
            cam_from_world: pose.transpose()?,
            lighting: lighting
                .transpose()?
                .map(|light| (light, "given".to_owned())),
            initial: depth("initial", self.initial.as_ref())?,
            prior: depth("prior", self.prior.as_ref())?,
            photo: photo(&self.name, size, channels, samples),
            name: self.name,
        };
        let has_light = view.lighting.is_some() || view.prior.is_some() || view.initial.is_some();
        if has_light {
            return Ok(view);
        }
        let message = format!(
            "lighting{}: it is needed, or a shape to fit it on (initial or prior, a depth map)",
            self.place
        );
        Err(unusable(py, message))
    }
}

/// An argument of the view at a place.
fn named<'a, 'py>(name: &str, place: &str, value: &'a Bound<'py, PyAny>) -> Argument<'a, 'py> {
    let name = format!("{name}{place}");
    Argument { name, value }
}

/// An array as a file without metadata would hold it: floats are linear, integers as the encoding says.
fn photo(
    name: &str,
    (width, height): (usize, usize),
    channels: usize,
    samples: Samples,
) -> DecodedPhoto {
    let is_float = samples.bits() == 32;
    DecodedPhoto {
        file_name: name.to_owned(),
        width,
        height,
        channels,
        linear_by_metadata: samples.bits() > 8,
        saturates_at_white: !is_float,
        encoding_reason: format!("an array of {} bits", samples.bits()),
        samples,
        profile_curve: None,
        alpha: None,
        exif: ExifFacts::default(),
    }
}

/// Matches of two views.
#[derive(FromPyObject)]
pub struct Match<'py>(usize, usize, Bound<'py, PyAny>);

impl<'py> Match<'py> {
    /// Indices of the views, and the pixels.
    ///
    /// # Errors
    /// When there is no such view, or the array does not fit.
    pub fn read(self, py: Python<'py>, num_views: usize) -> PyResult<([usize; 2], Vec<[f64; 4]>)> {
        let Self(first, second, pixels) = self;
        let name = format!("matches of views {first} and {second}");
        if first >= num_views || second >= num_views || first == second {
            let message = format!("{name}: they must be two of the {num_views} views, from 0");
            return Err(unusable(py, message));
        }
        let value = &pixels;
        Ok(([first, second], Argument { name, value }.rows()?))
    }
}
