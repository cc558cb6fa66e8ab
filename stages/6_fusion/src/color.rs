//! Colours of points from the photos.
//!
//! A point's colour is the mean of the linear photos that see it: a matte surface looks the same
//! from everywhere, and the mean evens out noise and the photos' small differences. In albedo mode
//! the albedo of stage 5 takes the photo's place; without one the photo is divided by the image that
//! stage 5 explains it with. Light and shadow leave, the surface's own tone stays.

use crate::error::FusionError;
use crate::options::{ColorMode, FusionOptions};
use crate::view::View;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::{
    Intrinsics, LinearImage, MapSource, PhotoSet, PosedViews, ShadedImages, bilinear, srgb,
};
use std::sync::Arc;

/// Grey where there is no photo.
const GREY: [u8; 3] = [180; 3];
/// Display level of a surface of mean albedo in albedo mode, linear.
const MEAN_ALBEDO_LEVEL: f32 = 0.5;
/// Rendered intensities below this are too dark to divide by.
const MIN_RENDERED: f32 = 0.01;

/// 8-bit sRGB images of the views, and the way back to linear values. Eight bits keep a view of
/// 12 megapixels at 36 MB.
pub(crate) struct ColorSource {
    images: Vec<Option<Image>>,
    linear: Vec<f32>,
}

/// Colours of a view's own pixels.
struct Image {
    width: usize,
    height: usize,
    data: Vec<[u8; 3]>,
}

impl ColorSource {
    /// Loads the photos of the views, one at a time; a view whose photo is not in the set is grey.
    pub fn new(
        photos: &PhotoSet,
        posed: &PosedViews,
        maps: &dyn MapSource,
        views: &[View],
        options: &FusionOptions,
    ) -> Result<Self, FusionError> {
        let mut images = Vec::with_capacity(views.len());
        for view in views {
            let posed_view = posed.views.get(view.posed_idx);
            let photo = posed_view.and_then(|p| photos.photos.get(p.photo.0));
            let (Some(posed_view), Some(photo)) = (posed_view, photo) else {
                images.push(None);
                continue;
            };
            let images_of_view = match options.color {
                ColorMode::Photographed => ShadedImages::default(),
                ColorMode::Albedo => maps.images(view.maps_idx)?,
            };
            let shown = match (images_of_view.albedo, images_of_view.rendered) {
                (Some(mut albedo), _) => {
                    albedo.data.iter_mut().for_each(|a| *a *= MEAN_ALBEDO_LEVEL);
                    Arc::new(albedo)
                }
                (None, Some(rendered)) => {
                    Arc::new(without_shading(&*photo.pixels.load()?, &rendered))
                }
                (None, None) => photo.pixels.load()?,
            };
            images.push(Some(encode(&shown, &posed_view.intrinsics, view)));
        }
        Ok(Self {
            images,
            linear: (0..=255u8)
                .map(|byte| srgb::decode(f64::from(byte) / 255.0) as f32)
                .collect(),
        })
    }

    /// Number of views without a photo.
    pub fn num_missing(&self) -> usize {
        self.images.iter().filter(|i| i.is_none()).count()
    }

    /// Colour of a world point that view `idx` sees, with the other views whose surface lies within
    /// `tolerance` of it along their rays.
    pub fn color(
        &self,
        views: &[View],
        idx: usize,
        point: &Point3<f64>,
        tolerance: f64,
    ) -> [u8; 3] {
        let (mut sum, mut count) = ([0.0_f32; 3], 0.0_f32);
        for (j, (view, image)) in views.iter().zip(&self.images).enumerate() {
            let Some(image) = image else { continue };
            let in_cam = view.pose.apply(point);
            let Some(pixel) = view.camera.project(&in_cam) else {
                continue;
            };
            if j != idx {
                let seen = view
                    .depth
                    .get(pixel.x.round() as isize, pixel.y.round() as isize);
                let agrees =
                    seen.is_some_and(|&z| (f64::from(z) - in_cam.z).abs() <= 2.0 * tolerance);
                if !agrees {
                    continue;
                }
            }
            if let Some(value) = self.sample(image, pixel.x, pixel.y) {
                for c in 0..3 {
                    sum[c] += value[c];
                }
                count += 1.0;
            }
        }
        if count == 0.0 {
            return GREY;
        }
        sum.map(|s| srgb::encode_byte(s / count))
    }

    /// Bilinear linear value at a camera's pixel.
    fn sample(&self, image: &Image, x: f64, y: f64) -> Option<[f32; 3]> {
        let value = |c: usize| {
            bilinear((image.width, image.height), x, y, |i| {
                self.linear[usize::from(image.data[i][c])]
            })
        };
        Some([value(0)?, value(1)?, value(2)?])
    }
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

/// The part of an image that a view covers, at the view's own resolution: a pixel is the mean of as
/// many places as it has pixels of the image along each side.
fn encode(image: &LinearImage, camera: &Intrinsics, view: &View) -> Image {
    let (width, height) = (view.depth.width, view.depth.height);
    let step = f64::from(1_u32 << view.num_halvings);
    let scale = [
        image.width as f64 / camera.width as f64,
        image.height as f64 / camera.height as f64,
    ];
    let num_places = ((step * scale[0]).round() as usize).max(1);
    let data = (0..width * height)
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
                    std::array::from_fn(|a| (view.corner_px[a] + step * place[a]) * scale[a] - 0.5);
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
        .collect();
    Image {
        width,
        height,
        data,
    }
}
