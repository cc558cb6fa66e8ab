//! From photos and poses to the views that are solved: linear images cropped to the object, their
//! pyramid, and the choice of the views with which each is compared.

use super::light::{self, Light};
use super::memory::{self, Budget};
use super::options::PhotoOptions;
use super::shading::PixelHarmonics;
use super::shape::FineShape;
use super::surround::SmallPhoto;
use crate::error::ShadingError;
use crate::photo_of::photo_of;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_scene::{Mask, PackedMask, PhotoSet, PosedViews, Scratch, ScratchError, ViewIdx};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::hull::object_ball;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::rectify::Rectification;
use rilievo_stereo::sightings::choose_sources;
use rilievo_stereo::stored::{StoredLevel, StoredView};
use std::borrow::Cow;
use std::sync::Arc;

/// One posed view with everything that leads back to its photo.
#[derive(Debug)]
pub(crate) struct SolvedFrame {
    pub view: ViewIdx,
    pub name: String,
    /// Columns and rows of the photo.
    pub size: (usize, usize),
    /// Corner of the crop in the rectified photo.
    pub corner: (usize, usize),
    pub rectification: Rectification,
    /// The mask in the photo's own frame; none: all of it.
    pub mask: Option<Arc<PackedMask>>,
    /// Exposure gain that the pyramid's images were divided by.
    pub gain: [f64; 3],
}

impl SolvedFrame {
    /// The mask in the photo's own frame.
    pub fn own_mask(&self) -> Mask {
        match &self.mask {
            Some(mask) => mask.unpacked(),
            None => Mask::filled(self.size.0, self.size.1, true),
        }
    }
}

/// All views of a run. Levels that are solved as a whole are in memory; all levels are out of core, and the finer ones
/// are read from there in parts.
#[derive(Debug)]
pub(crate) struct Scene {
    pub frames: Vec<SolvedFrame>,
    /// All levels out of core.
    pub stored: Vec<StoredView>,
    /// Levels that are solved as a whole, the finest first.
    pub pyramid: Vec<Level>,
    /// Number of the first of them.
    pub finest: usize,
    /// Number of the level at which the surface is found.
    pub coarse: usize,
    /// Whether every view has a mask of its own.
    pub masked: bool,
    /// For every view, the views it is compared with.
    pub sources: Vec<Vec<usize>>,
    /// Whole photos, small.
    pub small: Vec<SmallPhoto>,
}

impl Scene {
    /// A level that is solved as a whole.
    pub fn level(&self, at: usize) -> &Level {
        &self.pyramid[at - self.finest]
    }

    /// The same, to be changed.
    pub fn level_mut(&mut self, at: usize) -> &mut Level {
        &mut self.pyramid[at - self.finest]
    }

    /// A finer level, at the surface there.
    pub fn stored_level<'a>(
        &'a self,
        shape: &'a FineShape,
        sharpness: &'a [f64],
    ) -> StoredLevel<'a> {
        StoredLevel {
            views: &self.stored,
            at: shape.at,
            sources: &self.sources,
            sharpness,
            surface: &shape.surface,
        }
    }

    /// The next coarser level, or this one where there is none.
    pub fn coarser(&self, at: usize) -> &Level {
        self.level((at + 1).min(self.num_levels() - 1))
    }

    /// The light's coefficients of a view at a level that is solved as a whole, not coarser than the coarse one.
    pub fn harmonics<'a>(
        &self,
        light: &'a Light,
        view: usize,
        at: usize,
    ) -> Cow<'a, [PixelHarmonics]> {
        let mut harmonics = light.own(view);
        // Levels finer than the one that they were fitted at.
        for finer in (at..self.coarse).rev() {
            let parent = &self.level(finer + 1).views[view];
            let child = &self.level(finer).views[view];
            harmonics = Cow::Owned(light::finer(parent, child, &harmonics));
        }
        harmonics
    }

    /// Number of levels, those out of core counted.
    pub fn num_levels(&self) -> usize {
        self.finest + self.pyramid.len()
    }

    /// Memory that is in use throughout, about.
    pub fn bytes(&self) -> f64 {
        let views = &self.pyramid[0].views;
        let crops: usize = views.iter().map(|v| v.mask.data.len()).sum();
        let masked: usize = views.iter().map(|v| v.pixels.len()).sum();
        memory::resident(crops as f64, masked as f64)
    }

    /// Divides all images by their photos' gains.
    pub fn divide_by_gains(&mut self, gains: &[[f64; 3]]) {
        for level in &mut self.pyramid {
            for (view, gain) in level.views.iter_mut().zip(gains) {
                view.divide_by_gain(*gain);
            }
        }
        for (stored, gain) in self.stored.iter_mut().zip(gains) {
            stored.gain = *gain;
        }
        for (frame, gain) in self.frames.iter_mut().zip(gains) {
            frame.gain = *gain;
        }
        for (photo, gain) in self.small.iter_mut().zip(gains) {
            photo.divide_by_gain(*gain);
        }
    }
}

fn mean_pixels(stored: &[StoredView], at: usize) -> usize {
    let sum: usize = stored.iter().map(|view| view.num_masked(at)).sum();
    sum / stored.len().max(1)
}

/// A view with fewer masked pixels than this is halved no more.
const MIN_PIXELS: usize = 500;

/// Loads all posed views, as many at once as the memory allows.
pub(crate) fn load(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &PhotoOptions,
    scratch: &dyn Scratch,
) -> Result<Scene, ShadingError> {
    if posed.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    let budget = Budget {
        given: options.memory,
        in_use: 0.0,
    };
    let at_once = budget.photos(posed);
    let (mut frames, mut small, mut stored) = (Vec::new(), Vec::new(), Vec::new());
    let indices: Vec<usize> = (0..posed.views.len()).collect();
    for some in indices.chunks(at_once) {
        let loaded: Vec<_> = some
            .par_iter()
            .with_max_len(1)
            .map(|&index| load_view(photos, posed, index, scratch))
            .collect();
        for result in loaded {
            let (frame, small_photo, view) = result?;
            frames.push(frame);
            small.push(small_photo);
            stored.push(view);
        }
    }
    // One level more than the coarse one serves the first search and the first outer iterations with shading.
    let most = stored.iter().map(StoredView::num_levels).min().unwrap_or(1);
    let is_coarse = |at: &usize| mean_pixels(&stored, *at) <= options.effort.coarse_pixels;
    let num_levels = (0..most)
        .filter(is_coarse)
        .nth(1)
        .map_or(most, |second| second + 1);
    let coarse = (0..num_levels).find(is_coarse).unwrap_or(num_levels - 1);
    let mut finest = coarse;
    while finest > 0 && mean_pixels(&stored, finest - 1) <= options.max_fine_pixels {
        finest -= 1;
    }
    let at_level = |at: usize| -> Result<Vec<LevelView>, ScratchError> {
        stored.par_iter().map(|view| view.view(at)).collect()
    };
    let views = at_level(finest)?;
    let target = object_center(&views, posed);
    let sources = choose_sources(&views, &target, options.max_num_sources);
    let mut pyramid = vec![Level::new(views, &sources)];
    for at in finest + 1..num_levels {
        pyramid.push(Level::new(at_level(at)?, &sources));
    }
    Ok(Scene {
        masked: frames.iter().all(|frame| frame.mask.is_some()),
        frames,
        stored,
        pyramid,
        finest,
        coarse,
        sources,
        small,
    })
}

/// A view cropped to its mask, stored at all levels.
fn load_view(
    photos: &PhotoSet,
    posed: &PosedViews,
    index: usize,
    scratch: &dyn Scratch,
) -> Result<(SolvedFrame, SmallPhoto, StoredView), ShadingError> {
    let posed_view = &posed.views[index];
    let photo = photo_of(photos, posed_view)?;
    let image = photo.linear()?;
    let frame = SolvedFrame {
        view: ViewIdx(index),
        name: posed_view.name.clone(),
        size: (image.width, image.height),
        corner: (0, 0),
        rectification: Rectification::new(&posed_view.intrinsics),
        mask: photo.mask.clone(),
        gain: [1.0; 3],
    };
    let mask = frame.own_mask();
    let size = |w: usize, h: usize| format!("{w}x{h}");
    let intrinsics = &posed_view.intrinsics;
    for (what, w, h) in [
        ("the mask", mask.width, mask.height),
        ("its camera's image", intrinsics.width, intrinsics.height),
    ] {
        if (w, h) != (image.width, image.height) {
            return Err(ShadingError::SizeMismatch {
                view: posed_view.name.clone(),
                what,
                found: size(w, h),
                image: size(image.width, image.height),
            });
        }
    }
    let rectification = &frame.rectification;
    let camera = Camera::new(&rectification.original, &posed_view.cam_from_world);
    let straight = (!rectification.is_identity()).then(|| rectification.straighten(&image, &mask));
    let (pixels, straight_mask) = match &straight {
        Some((pixels, straight_mask)) => (pixels, straight_mask),
        None => (image.as_ref(), &mask),
    };
    let small = SmallPhoto::new(&camera, pixels, straight_mask, photo.clip_level);
    let (view, corner) = LevelView::from_photo(&camera, pixels, straight_mask, photo.clip_level);
    if view.pixels.is_empty() {
        return Err(ShadingError::EmptyMask {
            view: posed_view.name.clone(),
            num_masked: 0,
            advice: "give a mask that covers the object (--masks), or leave the photo out",
        });
    }
    drop((mask, straight, image));
    let stored = StoredView::put(view, MIN_PIXELS, scratch)?;
    Ok((SolvedFrame { corner, ..frame }, small, stored))
}

/// Middle of the known points, else of the optical axes' closest approach.
fn object_center(views: &[LevelView], posed: &PosedViews) -> Point3<f64> {
    let known: Vec<[f64; 3]> = if posed.anchors.is_empty() {
        posed.points.iter().map(|p| p.position).collect()
    } else {
        posed.anchors.iter().map(|a| a.position).collect()
    };
    if known.len() >= 10 {
        let middle = |k: usize| median(&mut known.iter().map(|p| p[k]).collect::<Vec<_>>());
        return Point3::from([0, 1, 2].map(|k| middle(k).unwrap_or(0.0)));
    }
    let outlines: Vec<_> = views.iter().map(|view| view.outline(true)).collect();
    object_ball(&outlines).map_or_else(Point3::origin, |(center, _)| center)
}
