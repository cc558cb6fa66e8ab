//! A view at one resolution: linear image, usable pixels, mask and camera, cropped to the object.

use crate::camera::{Camera, Warp};
use crate::hull::Outline;
use crate::sampling;
use crate::window::{Window, block_mean, blocks_where};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::plate_system::PixelNumbering;
#[cfg(test)]
use rilievo_scene::{Intrinsics, RigidTransform};
use rilievo_scene::{LinearImage, Mask, Raster};
use std::ops::Deref;

/// Steps `(dx, dy)` to a pixel's eight neighbours.
pub const NEIGHBOURS: [(i32, i32); 8] = [
    (1, 0),
    (-1, 0),
    (0, 1),
    (0, -1),
    (1, 1),
    (-1, -1),
    (1, -1),
    (-1, 1),
];

/// Pixels kept around the mask's bounding box, so that interpolation never meets the crop.
const MARGIN_PX: usize = 8;

/// Share of the object's mean intensity below which relative errors are those of the dark noise.
const DARK_SHARE: f64 = 0.02;

/// The object's pixels in a view at one resolution: what is known without the photo's intensities.
#[derive(Clone, Debug)]
pub struct ViewGrid {
    /// Camera of the crop.
    pub camera: Camera,
    /// The object.
    pub mask: Mask,
    /// Numbers of the masked pixels, row by row.
    pub pixels: PixelNumbering,
    /// Whether the mask reaches the photo's end ([`is_cut_by_frame`]).
    pub cut_by_frame: bool,
}

/// One view at one pyramid level.
#[derive(Clone, Debug)]
pub struct LevelView {
    /// Its pixels; their fields and methods are the view's too.
    pub grid: ViewGrid,
    /// Three channels; grey photos are repeated.
    pub image: LinearImage,
    /// Mean of the channels.
    pub grey: Raster<f32>,
    /// 1 where no channel is clipped.
    pub usable: Raster<f32>,
    /// Intensity below which a pixel is as dark as the photo's noise: a fiftieth of the object's mean.
    pub dark: f32,
    /// Strength of the finest detail against that of the sharpest photo; 1 until it is measured
    /// ([`crate::sharpness`]).
    pub sharpness: f64,
}

impl Deref for LevelView {
    type Target = ViewGrid;

    fn deref(&self) -> &ViewGrid {
        &self.grid
    }
}

impl ViewGrid {
    /// The masked pixels of a camera's crop.
    pub fn new(camera: Camera, mask: Mask, cut_by_frame: bool) -> Self {
        Self {
            camera,
            pixels: PixelNumbering::new(&mask),
            mask,
            cut_by_frame,
        }
    }

    /// Where the view shows the object; without masks any pixel may.
    pub fn outline(&self, is_masked: bool) -> Outline<'_> {
        Outline {
            camera: &self.camera,
            mask: &self.mask,
            is_masked,
            cut_by_frame: self.cut_by_frame,
        }
    }

    /// Column and row of a masked pixel.
    #[inline]
    pub fn xy(&self, index: usize) -> (f64, f64) {
        let (xs, ys) = (&self.pixels.xs, &self.pixels.ys);
        (f64::from(xs[index]), f64::from(ys[index]))
    }

    /// The same, to index rasters with.
    #[inline]
    pub fn place(&self, index: usize) -> (usize, usize) {
        let (xs, ys) = (&self.pixels.xs, &self.pixels.ys);
        (xs[index] as usize, ys[index] as usize)
    }

    /// Whether the photo shows something else than the object there. What lies beyond the photo or the raster, which may be
    /// a part of it, is not known.
    #[inline]
    pub fn is_outside(&self, x: i32, y: i32) -> bool {
        self.mask.get(x as isize, y as isize) == Some(&false) && self.camera.shows(x, y)
    }

    /// Whether the object ends beside a masked pixel: its intensity is partly the background's.
    #[inline]
    pub fn is_on_outline(&self, index: usize) -> bool {
        let (x, y) = (self.pixels.xs[index] as i32, self.pixels.ys[index] as i32);
        NEIGHBOURS[..4]
            .iter()
            .any(|&(dx, dy)| self.is_outside(x + dx, y + dy))
    }

    /// Cosine of the angle between a masked pixel's line of sight and its normal, camera frame; negative
    /// where the surface turns away.
    #[inline]
    pub fn incidence_cosine(&self, index: usize, normal: [f64; 3]) -> f64 {
        let (x, y) = self.xy(index);
        -self
            .camera
            .ray(x, y)
            .normalize()
            .dot(&Vector3::from(normal))
    }

    /// Whether the surface `raster` (log depths of this view) has a value at a position: four masked pixels
    /// around it, of one surface. Between the two sides of an edge of depth there is none; a mean of both
    /// would confirm any surface that bridges the edge along a line of sight of this view.
    #[inline]
    pub(crate) fn has_surface_at(&self, raster: &Raster<f32>, x: f64, y: f64) -> bool {
        sampling::inside(&self.mask, x, y) && self.is_one_surface(raster, x, y)
    }

    /// Log depth of the surface `raster` at a position, where it has one.
    #[inline]
    pub fn depth_at(&self, raster: &Raster<f32>, x: f64, y: f64) -> Option<f64> {
        self.has_surface_at(raster, x, y)
            .then(|| f64::from(sampling::bilinear(raster, x, y)))
    }

    /// Whether the four values around a position, which must be [`sampling::inside`], are of one surface.
    #[inline]
    pub(crate) fn is_one_surface(&self, raster: &Raster<f32>, x: f64, y: f64) -> bool {
        f64::from(sampling::range_around(raster, x, y)) * self.camera.focal() <= MAX_STEP_PX
    }

    /// Spreads values of the masked pixels over the raster.
    pub fn spread(&self, values: &[f64], outside: f32) -> Raster<f32> {
        let mut raster = Raster::filled(self.mask.width, self.mask.height, outside);
        for (i, &value) in values.iter().enumerate() {
            let (x, y) = self.place(i);
            *raster.at_mut(x, y) = value as f32;
        }
        raster
    }
}

impl LevelView {
    /// Crops a photo to its mask.
    ///
    /// Returns the view and the crop's corner in the photo.
    pub fn from_photo(
        camera: &Camera,
        image: &LinearImage,
        mask: &Mask,
        clip_level: f32,
    ) -> (Self, (usize, usize)) {
        let window = Window::around(mask, MARGIN_PX).unwrap_or_default();
        let (x0, y0, width, height) = (window.x0, window.y0, window.width, window.height);
        let mut cropped = LinearImage::filled(width, height, 3, 0.0);
        let usable = Raster::from_fn(width, height, |x, y| {
            let pixel = image.pixel(x0 + x, y0 + y);
            for (c, out) in cropped.pixel_mut(x, y).iter_mut().enumerate() {
                let value = pixel[c.min(image.channels - 1)];
                *out = if value.is_finite() {
                    value.max(0.0)
                } else {
                    0.0
                };
            }
            let is_clipped = pixel.iter().any(|&v| !v.is_finite() || v >= clip_level);
            f32::from(u8::from(!is_clipped))
        });
        let (camera, mask) = (camera.cropped(x0, y0, width, height), window.cut(mask));
        let cut_by_frame = is_cut_by_frame(&camera, &mask);
        let grid = ViewGrid::new(camera, mask, cut_by_frame);
        let view = Self::assemble(grid, cropped, usable).with_own_dark();
        (view, (x0, y0))
    }

    /// All but [`Self::dark`], which is left at zero.
    pub(crate) fn assemble(grid: ViewGrid, image: LinearImage, usable: Raster<f32>) -> Self {
        Self {
            grid,
            grey: image.to_grey(),
            image,
            usable,
            dark: 0.0,
            sharpness: 1.0,
        }
    }

    /// With [`Self::dark`] from its own pixels.
    fn with_own_dark(self) -> Self {
        Self {
            dark: dark_intensity(self.mean_intensity()),
            ..self
        }
    }

    /// Mean intensities of the masked pixels.
    pub(crate) fn mean_intensity(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for p in 0..self.pixels.len() {
            for (sum, value) in sum.iter_mut().zip(self.intensity(p)) {
                *sum += f64::from(value);
            }
        }
        sum.map(|sum| sum / self.pixels.len().max(1) as f64)
    }

    /// The view at half resolution; a pixel is masked where all four of its parents are.
    pub fn halved(&self) -> Self {
        let is_usable = blocks_where(&self.usable, 2, |&v| v > 0.5);
        let usable = Raster::from_fn(is_usable.width, is_usable.height, |x, y| {
            f32::from(u8::from(*is_usable.at(x, y)))
        });
        let (camera, image) = (self.camera.reduced(2), block_mean(&self.image, 2));
        let mask = blocks_where(&self.mask, 2, |&v| v);
        let grid = ViewGrid::new(camera, mask, self.cut_by_frame);
        Self::assemble(grid, image, usable).with_own_dark()
    }

    /// Divides the image by a gain.
    pub fn divide_by_gain(&mut self, gain: [f64; 3]) {
        for pixel in self.image.data.chunks_exact_mut(3) {
            for (value, g) in pixel.iter_mut().zip(gain) {
                *value /= g as f32;
            }
        }
        self.grey = self.image.to_grey();
        self.dark = dark_intensity(self.mean_intensity());
    }

    /// Intensities of a masked pixel.
    #[inline]
    pub fn intensity(&self, index: usize) -> [f32; 3] {
        let (x, y) = self.place(index);
        let p = self.image.pixel(x, y);
        [p[0], p[1], p[2]]
    }

    /// Whether a masked pixel is unclipped.
    #[inline]
    pub fn is_usable(&self, index: usize) -> bool {
        let (x, y) = self.place(index);
        *self.usable.at(x, y) > 0.5
    }

    /// Whether a masked pixel's intensity is that of the surface: unclipped, and not partly the background's.
    #[inline]
    pub fn shows_surface(&self, index: usize) -> bool {
        self.is_usable(index) && !self.is_on_outline(index)
    }

    /// Whether the four pixels around a position, which must be [`sampling::inside`], are unclipped.
    #[inline]
    pub(crate) fn is_unclipped_at(&self, x: f64, y: f64) -> bool {
        sampling::bilinear(&self.usable, x, y) > 0.999
    }
}

/// Pixels from the photo's end within which a mask may miss that it goes on.
const FRAME_PX: i32 = 3;

/// Whether a mask reaches the photo's end, or almost; `camera` is that of the mask's raster, which may be a part of the
/// photo that holds the whole mask.
pub fn is_cut_by_frame(camera: &Camera, mask: &Mask) -> bool {
    let is_at_end = |x: i32, y: i32| {
        NEIGHBOURS[..4].iter().any(|(dx, dy)| {
            !mask.contains((x + dx) as isize, (y + dy) as isize)
                && !camera.shows(x + FRAME_PX * dx, y + FRAME_PX * dy)
        })
    };
    (0..mask.height)
        .any(|y| (0..mask.width).any(|x| *mask.at(x, y) && is_at_end(x as i32, y as i32)))
}

/// Intensity below which a pixel is as dark as the noise of a photo whose object has these mean intensities.
pub(crate) fn dark_intensity(mean: [f64; 3]) -> f32 {
    (DARK_SHARE * mean.iter().sum::<f64>() / 3.0).max(1e-6) as f32
}

/// All views at one resolution, with the sources of each: the views it is compared with.
#[derive(Clone, Debug)]
pub struct Level {
    /// The views.
    pub views: Vec<LevelView>,
    /// For every view, its sources (best first) and the warps into them.
    pub sources: Vec<Vec<(usize, Warp)>>,
}

impl Level {
    /// Views with their sources, each a list of indices, best first.
    pub fn new(views: Vec<LevelView>, sources: &[Vec<usize>]) -> Self {
        let sources = sources
            .iter()
            .enumerate()
            .map(|(i, list)| {
                list.iter()
                    .filter_map(|&j| {
                        Warp::between(&views[i].camera, &views[j].camera).map(|warp| (j, warp))
                    })
                    .collect()
            })
            .collect();
        Self { views, sources }
    }

    /// Typical focal length, pixels: one over it is the relative depth of a pixel's footprint.
    pub fn focal(&self) -> f64 {
        let sum: f64 = self.views.iter().map(|v| v.camera.focal()).sum();
        sum / self.views.len().max(1) as f64
    }
}

/// Log depth of every view's raster (0 outside), for sampling by other views.
pub fn depth_rasters(level: &Level, depths: &[Vec<f64>]) -> Vec<Raster<f32>> {
    level
        .views
        .par_iter()
        .zip(depths)
        .map(|(view, depth)| view.spread(depth, 0.0))
        .collect()
}

/// Difference of log depth between neighbours beyond which they belong to different surfaces, pixel
/// footprints: a surface seen at 80° and more is hardly measured.
pub const MAX_STEP_PX: f64 = 8.0;

/// A wholly masked grey view at the origin that looks along +z, for tests.
#[cfg(test)]
pub fn flat_view(width: usize, height: usize, focal: f64) -> LevelView {
    let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let intrinsics = Intrinsics::pinhole(width, height, focal, cx, cy);
    let camera = Camera::new(&intrinsics, &RigidTransform::identity());
    let image = LinearImage::filled(width, height, 3, 0.5);
    let mask = Raster::filled(width, height, true);
    LevelView::from_photo(&camera, &image, &mask, 1.0).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rectify::Rectification;
    use rilievo_scene::Distortion;

    /// Of a photo with distortion, straightened.
    fn straightened(k1: f64, mask: &Mask) -> LevelView {
        let intrinsics = Intrinsics {
            distortion: Distortion {
                k1,
                ..Distortion::default()
            },
            ..Intrinsics::pinhole(mask.width, mask.height, 110.0, 60.2, 44.1)
        };
        let image = LinearImage::filled(mask.width, mask.height, 1, 0.5);
        let (image, mask) = Rectification::new(&intrinsics).straighten(&image, mask);
        let camera = Camera::new(&intrinsics, &RigidTransform::identity());
        LevelView::from_photo(&camera, &image, &mask, 1.0).0
    }

    fn num_on_outline(view: &ViewGrid) -> usize {
        (0..view.pixels.len())
            .filter(|&p| view.is_on_outline(p))
            .count()
    }

    #[test]
    fn where_a_straightened_photo_ends_no_object_ends() {
        for k1 in [-0.2, 0.0, 0.2] {
            let whole = straightened(k1, &Mask::filled(120, 90, true));
            let disc = straightened(
                k1,
                &Mask::from_fn(120, 90, |x, y| {
                    (x as f64 - 60.0).hypot(y as f64 - 44.0) < 30.0
                }),
            );
            for level in [whole.clone(), whole.halved(), whole.halved().halved()] {
                assert!(level.cut_by_frame);
                assert_eq!(num_on_outline(&level), 0, "{k1}");
            }
            for (level, expected) in [(disc.clone(), 150), (disc.halved(), 70)] {
                assert!(!level.cut_by_frame);
                assert!(num_on_outline(&level) > expected, "{k1}");
            }
        }
        // The test's rasters do have such ends.
        let whole = straightened(0.2, &Mask::filled(120, 90, true));
        assert!(whole.mask.data.iter().filter(|&&is| !is).count() > 100);
    }

    /// On both sides of a step there is a surface, on a steep slope too, across the step there is none.
    #[test]
    fn between_two_surfaces_there_is_none() {
        let view = flat_view(40, 20, 100.0);
        let height = |x: f64| if x < 20.0 { 0.0 } else { 30.0 + 3.0 * x };
        let values: Vec<f64> = (0..view.pixels.len())
            .map(|p| height(view.xy(p).0) / view.camera.focal())
            .collect();
        let raster = view.spread(&values, 0.0);
        for (x, expected) in [
            (10.3, true),
            (18.7, true),
            (19.5, false),
            (20.2, true),
            (30.9, true),
        ] {
            assert_eq!(view.has_surface_at(&raster, x, 8.4), expected, "at {x}");
        }
        assert!(!view.has_surface_at(&raster, 39.5, 8.4), "outside the mask");
    }
}
