//! Photos made ready for patch alignment.
//!
//! For every view, from linear grey `L` (mean of the channels) and the object's mask `M`:
//! 1. lens distortion taken out: `L'(x) = L(d(x))`, `d` the distortion of the view's own lens, so
//!    that a plane of the scene maps between views by a homography;
//! 2. reduced by a whole factor `s` while the frame has more than the allowed megapixels;
//! 3. cropped to the mask;
//! 4. `I = G_σ * ln(L' + ε)`: a gain in exposure becomes an offset of `I`, and noise, about
//!    proportional to intensity in tone-mapped files, becomes uniform; the blur makes bilinear
//!    interpolation harmless. `ε` keeps the noise of black pixels down;
//! 5. gradients of `I` by Sobel differences, and a flag for pixels that may take part: inside the
//!    mask by two pixels, not clipped (every pixel that the blur carries a clipped one into is
//!    left out too).
//!
//! Value, gradient and flag of a pixel lie together in one 16-byte texel: one cache line serves
//! the four interpolations of a sample.

use super::filter::gaussian_blur;
use nalgebra::Point2;
use rilievo_scene::{Intrinsics, LinearImage, Mask, Photo, PosedView, Raster};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::hull::{Outline, dilate};
use rilievo_stereo::level::is_cut_by_frame;
use rilievo_stereo::rectify::Rectification;
use rilievo_stereo::window::{Window, block_mean, blocks_where};

/// Offset under the logarithm, relative to the mean intensity of the object.
const BLACK_LEVEL: f32 = 0.02;
/// Pixels kept around the mask's bounding box, working pixels.
const CROP_MARGIN_PX: usize = 4;
/// Erosion of the mask, working pixels: the reach of the blur and of the lens at the outline.
const MASK_MARGIN_PX: usize = 2;
/// Reach of a clipped pixel through the blur, working pixels.
const CLIP_REACH_PX: usize = 2;
/// Deviation of the blur before the logarithm is interpolated, working pixels.
const BLUR_PX: f32 = 0.8;

/// Value, derivative along x, derivative along y, and 1 where the pixel may take part.
pub(super) type Texel = [f32; 4];

/// A view ready for patch alignment: an ideal pinhole camera with its texels.
#[derive(Clone, Debug)]
pub(super) struct WorkingView {
    /// Camera of the crop, working pixels.
    pub camera: Camera,
    /// The photo's own camera, with distortion.
    lens: Intrinsics,
    /// One per pixel of the crop, row by row; none while the image is not held.
    pub texels: Vec<Texel>,
    /// The object (everything without a mask), not eroded.
    pub object: Mask,
    /// Whether `object` comes from a mask.
    pub has_mask: bool,
    /// Whether it reaches the photo's end.
    cut_by_frame: bool,
}

impl WorkingView {
    /// Prepares a view; `None` when nothing of the object is in it.
    pub fn new(
        photo: &Photo,
        posed: &PosedView,
        image: &LinearImage,
        max_working_mpx: f64,
    ) -> Option<Self> {
        let lens = posed.intrinsics;
        let grey = LinearImage {
            width: image.width,
            height: image.height,
            channels: 1,
            data: image.to_grey().data,
        };
        let unclipped = Raster::from_fn(image.width, image.height, |x, y| {
            image.pixel(x, y).iter().all(|&v| v < photo.clip_level)
        });
        let mask = photo.mask.as_ref().map(|mask| mask.unpacked());
        let mask = mask.filter(|mask| mask.same_size(&unclipped));
        let has_mask = mask.is_some();
        let object = mask.unwrap_or_else(|| Mask::filled(image.width, image.height, true));
        let rectification = Rectification::new(&lens);
        let (grey, [object, unclipped]) = if rectification.is_identity() {
            (grey, [object, unclipped])
        } else {
            rectification.straighten_with(&grey, [&object, &unclipped])
        };
        let mpx = (grey.width * grey.height) as f64 / 1e6;
        let reduction = (mpx / max_working_mpx).sqrt().ceil().max(1.0) as usize;
        let grey = block_mean(&grey, reduction);
        let object = blocks_where(&object, reduction, |&inside| inside);
        let unclipped = blocks_where(&unclipped, reduction, |&unclipped| unclipped);
        let whole = Camera::new(&rectification.original, &posed.cam_from_world).reduced(reduction);
        let window = Window::around(&object, CROP_MARGIN_PX)?;
        let Window {
            x0,
            y0,
            width,
            height,
        } = window;
        let grey = window.cut(&Raster {
            width: grey.width,
            height: grey.height,
            data: grey.data,
        });
        let object = window.cut(&object);
        let camera = whole.cropped(x0, y0, width, height);
        let clipped = dilate(&window.cut(&unclipped).inverted(), CLIP_REACH_PX);
        let margin = dilate(&object.clone().inverted(), MASK_MARGIN_PX);
        let texels = texels(&grey, &object, |x, y| {
            !*clipped.at(x, y)
                && !*margin.at(x, y)
                && x >= MASK_MARGIN_PX
                && y >= MASK_MARGIN_PX
                && x + MASK_MARGIN_PX < width
                && y + MASK_MARGIN_PX < height
        });
        Some(Self {
            cut_by_frame: is_cut_by_frame(&camera, &object),
            camera,
            lens,
            texels,
            object,
            has_mask,
        })
    }

    /// Bytes that the image takes, with the detail of the epipolar search.
    pub fn image_bytes(&self) -> usize {
        self.camera.width * self.camera.height * (size_of::<Texel>() + 2)
    }

    /// Pixel of the photo under a working pixel.
    pub fn photo_pixel(&self, x: f64, y: f64) -> Point2<f64> {
        let ray = self.camera.ray(x, y);
        let (xd, yd) = self.lens.distortion.distort(ray.x, ray.y);
        Point2::new(
            self.lens.fx * xd + self.lens.cx,
            self.lens.fy * yd + self.lens.cy,
        )
    }

    /// Where the object may lie, with a mask that is widened already.
    pub fn outline<'a>(&'a self, mask: &'a Mask) -> Outline<'a> {
        Outline {
            camera: &self.camera,
            mask,
            is_masked: self.has_mask,
            cut_by_frame: self.cut_by_frame,
        }
    }

    /// Whether the object covers the pixel nearest to a position.
    pub fn on_object(&self, x: f64, y: f64) -> bool {
        self.object.contains(x.round() as isize, y.round() as isize)
    }

    #[inline]
    pub fn texel(&self, x: usize, y: usize) -> &Texel {
        &self.texels[y * self.camera.width + x]
    }
}

/// Blurred logarithm, its gradient and the flag of every pixel.
fn texels(grey: &Raster<f32>, object: &Mask, usable: impl Fn(usize, usize) -> bool) -> Vec<Texel> {
    let (mut sum, mut count) = (0.0_f64, 0_usize);
    for (&value, &inside) in grey.data.iter().zip(&object.data) {
        if inside {
            sum += f64::from(value.max(0.0));
            count += 1;
        }
    }
    let mean = (sum / count.max(1) as f64) as f32;
    let epsilon = (BLACK_LEVEL * mean).max(1e-6);
    let logarithm = Raster {
        width: grey.width,
        height: grey.height,
        data: grey
            .data
            .iter()
            .map(|&value| (value.max(0.0) + epsilon).ln())
            .collect(),
    };
    let smooth = gaussian_blur(&logarithm, BLUR_PX);
    let (width, height) = (grey.width, grey.height);
    let mut texels = Vec::with_capacity(width * height);
    for y in 0..height {
        let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
        for x in 0..width {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
            let at = |x: usize, y: usize| *smooth.at(x, y);
            let gx = (at(right, above) - at(left, above) + at(right, below) - at(left, below)
                + 2.0 * (at(right, y) - at(left, y)))
                / 8.0;
            let gy = (at(left, below) - at(left, above) + at(right, below) - at(right, above)
                + 2.0 * (at(x, below) - at(x, above)))
                / 8.0;
            let flag = if usable(x, y) { 1.0 } else { 0.0 };
            texels.push([at(x, y), gx, gy, flag]);
        }
    }
    texels
}
