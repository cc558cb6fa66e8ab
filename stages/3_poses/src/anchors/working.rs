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

use super::filter::{box_dilate, gaussian_blur};
use nalgebra::{Matrix3, Point2, Point3, Vector3};
use rilievo_scene::{Intrinsics, LinearImage, Mask, Photo, PosedView, Raster, RigidTransform};

/// Offset under the logarithm, relative to the mean intensity of the object.
const BLACK_LEVEL: f32 = 0.02;
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
    /// Columns of the crop.
    pub width: usize,
    /// Rows of the crop.
    pub height: usize,
    /// Camera matrix of the crop, working pixels.
    pub k: Matrix3<f64>,
    /// Inverse of `k`.
    pub k_inv: Matrix3<f64>,
    /// Pose.
    pub cam_from_world: RigidTransform,
    /// Rotation of `cam_from_world` as a matrix.
    pub rotation: Matrix3<f64>,
    /// Camera centre in the world.
    pub center: Point3<f64>,
    /// The photo's own camera, with distortion.
    lens: Intrinsics,
    /// The crop's origin in the frame, working pixels.
    origin: [usize; 2],
    /// Size of the whole frame, working pixels.
    frame: [usize; 2],
    /// `width * height` texels.
    pub texels: Vec<Texel>,
    /// The object (everything without a mask), not eroded.
    pub object: Mask,
    /// Whether `object` comes from a mask.
    pub has_mask: bool,
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
        let grey = image.to_grey();
        let clipped = Raster::from_fn(image.width, image.height, |x, y| {
            image.pixel(x, y).iter().any(|&v| v >= photo.clip_level)
        });
        let mask = photo.mask.as_deref().filter(|mask| mask.same_size(&grey));
        let object = match mask {
            Some(mask) => mask.clone(),
            None => Mask::filled(grey.width, grey.height, true),
        };
        let (grey, object, clipped, seen) = undistort(&lens, grey, object, clipped);
        let mpx = (grey.width * grey.height) as f64 / 1e6;
        let reduction = (mpx / max_working_mpx).sqrt().ceil().max(1.0) as usize;
        let grey = reduce(&grey, reduction);
        let object = reduce_flag(&object, reduction, false);
        let seen = reduce_flag(&seen, reduction, false);
        let clipped = reduce_flag(&clipped, reduction, true);
        let frame = [object.width, object.height];
        let (origin, width, height) = bounding_box(&object, 4)?;
        let crop = |raster: &Raster<f32>| {
            Raster::from_fn(width, height, |x, y| {
                *raster.at(x + origin[0], y + origin[1])
            })
        };
        let crop_flag = |raster: &Mask| {
            Raster::from_fn(width, height, |x, y| {
                *raster.at(x + origin[0], y + origin[1])
            })
        };
        let (grey, object) = (crop(&grey), crop_flag(&object));
        let clipped = box_dilate(&crop_flag(&clipped), CLIP_REACH_PX);
        let mut outside = crop_flag(&seen);
        for (flag, &inside) in outside.data.iter_mut().zip(&object.data) {
            *flag = !(*flag && inside);
        }
        // Beyond the frame nothing is known, as beyond the mask.
        let margin = box_dilate(&outside, MASK_MARGIN_PX);
        let texels = texels(&grey, &object, |x, y| {
            !*clipped.at(x, y)
                && !*margin.at(x, y)
                && x >= MASK_MARGIN_PX
                && y >= MASK_MARGIN_PX
                && x + MASK_MARGIN_PX < width
                && y + MASK_MARGIN_PX < height
        });
        let s = reduction as f64;
        let half = 0.5 * (s - 1.0);
        let k = Matrix3::new(
            lens.fx / s,
            0.0,
            (lens.cx - half) / s - origin[0] as f64,
            0.0,
            lens.fy / s,
            (lens.cy - half) / s - origin[1] as f64,
            0.0,
            0.0,
            1.0,
        );
        Some(Self {
            width,
            height,
            k,
            k_inv: k.try_inverse()?,
            cam_from_world: posed.cam_from_world,
            rotation: posed.cam_from_world.rotation_matrix(),
            center: posed.cam_from_world.center_in_source(),
            lens,
            origin,
            frame,
            texels,
            object,
            has_mask: mask.is_some(),
        })
    }

    /// Mean focal length, working pixels.
    pub fn focal(&self) -> f64 {
        0.5 * (self.k[(0, 0)] + self.k[(1, 1)])
    }

    /// Ray of a working pixel in the camera frame, `z = 1`.
    pub fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        self.k_inv * Vector3::new(x, y, 1.0)
    }

    /// Point in the world at a working pixel and an inverse depth.
    pub fn point(&self, x: f64, y: f64, inverse_depth: f64) -> Point3<f64> {
        self.center + self.rotation.transpose() * self.ray(x, y) / inverse_depth
    }

    /// Working pixel and depth of a point in the world; `None` behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<(f64, f64, f64)> {
        let p = self.cam_from_world.apply(point);
        if p.z.is_nan() || p.z <= 0.0 {
            return None;
        }
        let h = self.k * p.coords;
        Some((h.x / h.z, h.y / h.z, p.z))
    }

    /// Pixel of the photo under a working pixel.
    pub fn photo_pixel(&self, x: f64, y: f64) -> Point2<f64> {
        let ray = self.ray(x, y);
        let (xd, yd) = self.lens.distortion.distort(ray.x, ray.y);
        Point2::new(
            self.lens.fx * xd + self.lens.cx,
            self.lens.fy * yd + self.lens.cy,
        )
    }

    /// Whether the photo shows a working position at all (the crop shows less).
    pub fn in_frame(&self, x: f64, y: f64) -> bool {
        let (u, v) = (x + self.origin[0] as f64, y + self.origin[1] as f64);
        u >= 0.0 && v >= 0.0 && u <= (self.frame[0] - 1) as f64 && v <= (self.frame[1] - 1) as f64
    }

    /// Whether the object covers the pixel nearest to a position.
    pub fn on_object(&self, x: f64, y: f64) -> bool {
        self.object.contains(x.round() as isize, y.round() as isize)
    }

    /// Texel at a whole pixel.
    #[inline]
    pub fn texel(&self, x: usize, y: usize) -> &Texel {
        &self.texels[y * self.width + x]
    }
}

/// Images of the same lens without distortion, and where they were seen at all.
fn undistort(
    lens: &Intrinsics,
    grey: Raster<f32>,
    object: Mask,
    clipped: Mask,
) -> (Raster<f32>, Mask, Mask, Mask) {
    let (width, height) = (grey.width, grey.height);
    if lens.distortion.is_none() {
        let seen = Mask::filled(width, height, true);
        return (grey, object, clipped, seen);
    }
    let image = LinearImage {
        width,
        height,
        channels: 1,
        data: grey.data,
    };
    let mut straight = Raster::filled(width, height, 0.0);
    let mut seen = Mask::filled(width, height, false);
    let mut new_object = seen.clone();
    let mut new_clipped = seen.clone();
    for y in 0..height {
        for x in 0..width {
            let (xd, yd) = lens.distortion.distort(
                (x as f64 - lens.cx) / lens.fx,
                (y as f64 - lens.cy) / lens.fy,
            );
            let (u, v) = (lens.fx * xd + lens.cx, lens.fy * yd + lens.cy);
            let Some(value) = image.sample(u, v, 0) else {
                continue;
            };
            *straight.at_mut(x, y) = value;
            *seen.at_mut(x, y) = true;
            let (ui, vi) = (u.round() as isize, v.round() as isize);
            *new_object.at_mut(x, y) = object.contains(ui, vi);
            *new_clipped.at_mut(x, y) = clipped.contains(ui, vi);
        }
    }
    (straight, new_object, new_clipped, seen)
}

/// Means over blocks of `factor × factor` pixels; an incomplete last block is dropped.
fn reduce(raster: &Raster<f32>, factor: usize) -> Raster<f32> {
    if factor == 1 {
        return raster.clone();
    }
    let scale = 1.0 / (factor * factor) as f32;
    Raster::from_fn(raster.width / factor, raster.height / factor, |x, y| {
        let mut sum = 0.0;
        for v in 0..factor {
            for u in 0..factor {
                sum += raster.at(x * factor + u, y * factor + v);
            }
        }
        sum * scale
    })
}

/// Flags of blocks: set where `any` (or else all) of a block's pixels are.
fn reduce_flag(raster: &Mask, factor: usize, any: bool) -> Mask {
    if factor == 1 {
        return raster.clone();
    }
    Raster::from_fn(raster.width / factor, raster.height / factor, |x, y| {
        let mut block = (0..factor * factor)
            .map(|k| *raster.at(x * factor + k % factor, y * factor + k / factor));
        if any {
            block.any(|flag| flag)
        } else {
            block.all(|flag| flag)
        }
    })
}

/// Origin and size of the box around set pixels, widened by `margin` inside the frame.
fn bounding_box(mask: &Mask, margin: usize) -> Option<([usize; 2], usize, usize)> {
    let (mut low, mut high) = ([usize::MAX; 2], [0_usize; 2]);
    for y in 0..mask.height {
        for x in 0..mask.width {
            if *mask.at(x, y) {
                low = [low[0].min(x), low[1].min(y)];
                high = [high[0].max(x), high[1].max(y)];
            }
        }
    }
    if low[0] == usize::MAX {
        return None;
    }
    let origin = [low[0].saturating_sub(margin), low[1].saturating_sub(margin)];
    let end = [
        (high[0] + margin + 1).min(mask.width),
        (high[1] + margin + 1).min(mask.height),
    ];
    Some((origin, end[0] - origin[0], end[1] - origin[1]))
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
