//! Colours of points from the photos.
//!
//! A point's colour is the mean of the linear photos that see it: a matte surface looks the same
//! from everywhere, and the mean evens out noise and the photos' small differences. In albedo mode the photo is divided by the image
//! that stage 5 explains it with, so that light and shadow leave and the surface's own tone stays.

use crate::error::FusionError;
use crate::options::{ColorMode, FusionOptions};
use crate::views::View;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::{LinearImage, PhotoSet, PosedViews, ShadedViews, srgb};

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

struct Image {
    width: usize,
    height: usize,
    data: Vec<[u8; 3]>,
    /// From the camera's pixels to the photo's.
    scale: [f64; 2],
}

impl ColorSource {
    /// Loads the photos of the views, one at a time; a view whose photo is not in the set is grey.
    pub fn new(
        photos: &PhotoSet,
        posed: &PosedViews,
        shaded: &ShadedViews,
        views: &[View],
        options: &FusionOptions,
    ) -> Result<Self, FusionError> {
        let mut images = Vec::with_capacity(views.len());
        for (view, maps) in views.iter().zip(&shaded.views) {
            let photo = posed
                .views
                .get(view.posed_idx)
                .and_then(|p| photos.photos.get(p.photo.0));
            let Some(photo) = photo else {
                images.push(None);
                continue;
            };
            let pixels = photo.pixels.load()?;
            let fits = |r: &&LinearImage| {
                options.color == ColorMode::Albedo
                    && (r.width, r.height, r.channels)
                        == (pixels.width, pixels.height, pixels.channels)
            };
            let rendered = maps.rendered.as_ref().filter(fits);
            let albedo = maps.albedo.as_ref().filter(fits);
            images.push(Some(encode(&pixels, rendered, albedo, view)));
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
        let (x, y) = (
            (x + 0.5) * image.scale[0] - 0.5,
            (y + 0.5) * image.scale[1] - 0.5,
        );
        if x < 0.0 || y < 0.0 || x > (image.width - 1) as f64 || y > (image.height - 1) as f64 {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let (i1, j1) = ((i + 1).min(image.width - 1), (j + 1).min(image.height - 1));
        let at = |i: usize, j: usize, c: usize| {
            self.linear[usize::from(image.data[j * image.width + i][c])]
        };
        Some(std::array::from_fn(|c| {
            (at(i, j, c) * (1.0 - fx) + at(i1, j, c) * fx) * (1.0 - fy)
                + (at(i, j1, c) * (1.0 - fx) + at(i1, j1, c) * fx) * fy
        }))
    }
}

/// `albedo` is the one that `rendered` contains; without it, the mean albedo.
fn encode(
    pixels: &LinearImage,
    rendered: Option<&LinearImage>,
    albedo: Option<&LinearImage>,
    view: &View,
) -> Image {
    let channels = pixels.channels;
    let data = (0..pixels.width * pixels.height)
        .into_par_iter()
        .map(|i| {
            std::array::from_fn(|c| {
                let k = i * channels + c.min(channels - 1);
                let value = match rendered.map(|r| r.data[k]) {
                    Some(shading) if shading > MIN_RENDERED => {
                        let own = albedo.map_or(1.0, |a| a.data[k]);
                        MEAN_ALBEDO_LEVEL * own * pixels.data[k] / shading
                    }
                    _ => pixels.data[k],
                };
                srgb::encode_byte(value)
            })
        })
        .collect();
    Image {
        width: pixels.width,
        height: pixels.height,
        data,
        scale: [
            pixels.width as f64 / view.camera.width as f64,
            pixels.height as f64 / view.camera.height as f64,
        ],
    }
}
