//! Colours of points from the photos.
//!
//! A point's colour is the mean of the linear photos that see it: a matte surface looks the same
//! from everywhere, and the mean evens out noise and the photos' small differences. In albedo mode
//! the albedo of stage 5 takes the photo's place; without one the photo is divided by the image
//! that stage 5 explains it with. Light and shadow leave, the surface's own tone stays.

use crate::error::FusionError;
use crate::options::ColorMode;
use crate::pixel::Pixel;
use crate::view::{View, bilinear_weights};
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::{
    BaseColor, Intrinsics, LinearImage, MapSource, PageCache, Photo, ShadedImages, srgb,
};
use std::sync::Arc;

/// Grey where there is no photo.
pub(crate) const GREY: [u8; 3] = [180; 3];
/// Display level of a surface of mean albedo in albedo mode, linear.
const MEAN_ALBEDO_LEVEL: f32 = 0.5;
/// Share of the interpolation's weight that pixels with a surface must have, so that an albedo is
/// read between them.
const MIN_ALBEDO_WEIGHT: f64 = 0.25;
/// Rendered intensities below this are too dark to divide by.
const MIN_RENDERED: f32 = 0.01;

/// What a view shows of the surface: its photo, or the albedo; and which of them it is.
pub(crate) fn shown(
    photo: &Photo,
    maps: &dyn MapSource,
    maps_idx: usize,
    mode: ColorMode,
) -> Result<(Arc<LinearImage>, BaseColor), FusionError> {
    let images = match mode {
        ColorMode::Photographed => ShadedImages::default(),
        ColorMode::Albedo => maps.images(maps_idx)?,
    };
    Ok(match (images.albedo, images.rendered) {
        (Some(mut albedo), _) => {
            albedo.data.iter_mut().for_each(|a| *a *= MEAN_ALBEDO_LEVEL);
            (Arc::new(albedo), BaseColor::Albedo)
        }
        (None, Some(rendered)) => {
            let bare = without_shading(&*photo.pixels.load()?, &rendered);
            (Arc::new(bare), BaseColor::Albedo)
        }
        (None, None) => (photo.pixels.load()?, BaseColor::Photographed),
    })
}

/// The way from the views' 8-bit sRGB colours to means of them.
pub(crate) struct Palette {
    /// Linear values of the bytes.
    linear: Vec<f32>,
}

/// Linear colours of several views.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Blend {
    sum: [f32; 3],
    count: f32,
}

impl Blend {
    /// The mean, linear; `None` of nothing.
    pub fn mean(self) -> Option<[f32; 3]> {
        (self.count > 0.0).then(|| self.sum.map(|s| s / self.count))
    }

    /// The mean, grey of nothing.
    pub fn color(self) -> [u8; 3] {
        self.mean().map_or(GREY, |mean| mean.map(srgb::encode_byte))
    }
}

impl Palette {
    pub fn new() -> Self {
        Self {
            linear: (0..=255u8)
                .map(|byte| srgb::decode(f64::from(byte) / 255.0) as f32)
                .collect(),
        }
    }

    /// Colour of a world point that view `own` sees, with those of `views` whose surface lies
    /// within `tolerance` of it along their rays.
    pub fn color(
        &self,
        pixels: &mut PageCache<'_>,
        views: &[&View],
        own: usize,
        point: &Point3<f64>,
        tolerance: f64,
    ) -> [u8; 3] {
        let mut blend = Blend::default();
        for view in views.iter().filter(|view| view.has_photo) {
            let in_cam = view.pose.apply(point);
            let Some(place) = view.camera.project(&in_cam) else {
                continue;
            };
            if view.idx != own {
                let [x, y] = [place.x.round(), place.y.round()];
                let is_inside = x >= 0.0
                    && y >= 0.0
                    && x < view.camera.width as f64
                    && y < view.camera.height as f64;
                if !is_inside {
                    continue;
                }
                let seen = f64::from(view.pixel(pixels, x as usize, y as usize).depth);
                let agrees = (seen - in_cam.z).abs() <= 2.0 * tolerance;
                if !agrees {
                    continue;
                }
            }
            self.add(pixels, view, [place.x, place.y], &mut blend);
        }
        blend.color()
    }

    /// Adds a view's bilinear linear colour at a camera's pixel.
    pub fn add(
        &self,
        pixels: &mut PageCache<'_>,
        view: &View,
        [x, y]: [f64; 2],
        blend: &mut Blend,
    ) {
        let Some((corners, [fx, fy])) = around(pixels, view, [x, y]) else {
            return;
        };
        let (fx, fy) = (fx as f32, fy as f32);
        if corners.iter().any(|pixel| !pixel.is_kept) {
            return;
        }
        for (c, sum) in blend.sum.iter_mut().enumerate() {
            let [a, b, d, e] = corners.map(|p| self.linear[usize::from(p.color[c])]);
            let (top, bottom) = (a * (1.0 - fx) + b * fx, d * (1.0 - fx) + e * fx);
            *sum += top * (1.0 - fy) + bottom * fy;
        }
        blend.count += 1.0;
    }

    /// Adds a view's linear albedo at a camera's pixel, of a weight. Beside the surface there is
    /// none, so that pixels without depth are left out of the interpolation.
    pub fn add_albedo(
        &self,
        pixels: &mut PageCache<'_>,
        view: &View,
        [x, y]: [f64; 2],
        (weight, blend): (f64, &mut Blend),
    ) {
        let Some((corners, [fx, fy])) = around(pixels, view, [x, y]) else {
            return;
        };
        let weights = bilinear_weights(fx, fy);
        let on_surface = || {
            corners
                .iter()
                .zip(weights)
                .filter(|(pixel, _)| pixel.depth > 0.0)
        };
        let total: f64 = on_surface().map(|(_, w)| w).sum();
        if total < MIN_ALBEDO_WEIGHT {
            return;
        }
        for (pixel, of_corner) in on_surface() {
            let share = (weight * of_corner / total) as f32;
            for (sum, &byte) in blend.sum.iter_mut().zip(&pixel.albedo) {
                *sum += share * self.linear[usize::from(byte)];
            }
        }
        blend.count += weight as f32;
    }
}

/// The four pixels around a camera's pixel, and where it lies between them; `None` at the map's
/// border.
fn around(
    pixels: &mut PageCache<'_>,
    view: &View,
    [x, y]: [f64; 2],
) -> Option<([Pixel; 4], [f64; 2])> {
    let (x0, y0) = (x.floor(), y.floor());
    let (width, height) = (view.camera.width as f64, view.camera.height as f64);
    // Beside the last column and row there is a neighbour, if only of no weight.
    let is_inside = x0 >= 0.0 && y0 >= 0.0 && x0 + 1.0 < width && y0 + 1.0 < height;
    is_inside.then(|| {
        let corners = view.square(pixels, x0 as usize, y0 as usize);
        (corners, [x - x0, y - y0])
    })
}

/// A photo divided by the image that explains it, where the latter is not too dark to divide by.
fn without_shading(pixels: &LinearImage, rendered: &LinearImage) -> LinearImage {
    let mut shown = pixels.clone();
    let sizes = [pixels, rendered].map(|i| (i.width, i.height, i.channels));
    if sizes[0] == sizes[1] {
        for (value, shading) in shown.data.iter_mut().zip(&rendered.data) {
            if *shading > MIN_RENDERED {
                *value *= MEAN_ALBEDO_LEVEL / shading;
            }
        }
    }
    shown
}

/// The part of an image that a cut map covers, as 8-bit sRGB, row by row.
pub(crate) fn encode(
    image: &LinearImage,
    camera: &Intrinsics,
    corner_px: [usize; 2],
    [width, height]: [usize; 2],
) -> Vec<[u8; 3]> {
    let scale = [
        image.width as f64 / camera.width as f64,
        image.height as f64 / camera.height as f64,
    ];
    // An image that is larger than its camera is averaged over the pixel.
    let num_places = (scale[0].round() as usize).max(1);
    (0..width * height)
        .into_par_iter()
        .map(|i| {
            let mut sum = [0.0_f32; 3];
            for k in 0..num_places * num_places {
                let part = |k: usize| (k as f64 + 0.5) / num_places as f64;
                let place = [
                    (i % width) as f64 + part(k % num_places),
                    (i / width) as f64 + part(k / num_places),
                ];
                // Pixel centres at integers: the first pixel's near edge is at -1/2.
                let [x, y] =
                    std::array::from_fn(|a| (corner_px[a] as f64 + place[a]) * scale[a] - 0.5);
                // Beyond its border the image is carried on.
                let x = x.clamp(0.0, (image.width - 1) as f64);
                let y = y.clamp(0.0, (image.height - 1) as f64);
                for (c, sum) in sum.iter_mut().enumerate() {
                    let value = image.sample(x, y, c.min(image.channels - 1));
                    *sum += value.unwrap_or_default();
                }
            }
            let count = (num_places * num_places) as f32;
            sum.map(|s| srgb::encode_byte(s / count))
        })
        .collect()
}
