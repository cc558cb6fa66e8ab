//! From photos and poses to the views that are solved: linear images cropped to the object, their
//! pyramid, and the choice of the views with which each is compared.

use super::memory;
use super::options::PhotoOptions;
use super::surround::SmallPhoto;
use crate::error::ShadingError;
use crate::photo_of::photo_of;
use nalgebra::Point3;
use rayon::prelude::*;
use rilievo_scene::{Mask, PhotoSet, PosedViews, ViewIdx};
use rilievo_stereo::camera::Camera;
use rilievo_stereo::level::{self, Level, LevelView};
use rilievo_stereo::rectify::Rectification;

/// One posed view with everything that leads back to its photo.
#[derive(Debug)]
pub(crate) struct SolvedFrame {
    pub view: ViewIdx,
    pub name: String,
    /// Corner of the crop in the rectified photo.
    pub corner: (usize, usize),
    pub rectification: Rectification,
    /// The mask in the photo's own frame.
    pub mask: Mask,
    /// Exposure gain that the pyramid's images were divided by.
    pub gain: [f64; 3],
}

/// All views of a run.
#[derive(Debug)]
pub(crate) struct Scene {
    pub frames: Vec<SolvedFrame>,
    /// Finest first.
    pub pyramid: Vec<Level>,
    /// Index of the level at which the surface is found.
    pub coarse: usize,
    /// Whether every view has a mask of its own.
    pub masked: bool,
    /// For every view, the views it is compared with.
    pub sources: Vec<Vec<usize>>,
    /// Whole photos, small.
    pub small: Vec<SmallPhoto>,
}

impl Scene {
    /// Memory that images and log depths take, about.
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
        for (frame, gain) in self.frames.iter_mut().zip(gains) {
            frame.gain = *gain;
        }
        for (photo, gain) in self.small.iter_mut().zip(gains) {
            photo.divide_by_gain(*gain);
        }
    }
}

/// Loads all posed views.
pub(crate) fn load(
    photos: &PhotoSet,
    posed: &PosedViews,
    options: &PhotoOptions,
) -> Result<Scene, ShadingError> {
    if posed.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    let loaded = posed
        .views
        .par_iter()
        .enumerate()
        .map(|(index, posed_view)| {
            let photo = photo_of(photos, posed_view)?;
            let image = photo.linear()?;
            let mask = match &photo.mask {
                Some(mask) => mask.as_ref().clone(),
                None => Mask::filled(image.width, image.height, true),
            };
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
            let rectification = Rectification::new(intrinsics);
            let camera = Camera::new(&rectification.pinhole, &posed_view.cam_from_world);
            let straight =
                (!rectification.is_identity()).then(|| rectification.straighten(&image, &mask));
            let (pixels, straight_mask) = match &straight {
                Some((pixels, straight_mask)) => (pixels, straight_mask),
                None => (image.as_ref(), &mask),
            };
            let small = SmallPhoto::new(&camera, pixels, straight_mask, photo.clip_level);
            let (view, corner) =
                LevelView::from_photo(&camera, pixels, straight_mask, photo.clip_level);
            if view.pixels.is_empty() {
                return Err(ShadingError::EmptyMask {
                    view: posed_view.name.clone(),
                    num_masked: 0,
                    advice: "give a mask that covers the object, or leave the photo out",
                });
            }
            let frame = SolvedFrame {
                view: ViewIdx(index),
                name: posed_view.name.clone(),
                corner,
                rectification,
                mask,
                gain: [1.0; 3],
            };
            Ok((frame, view, small, photo.mask.is_some()))
        })
        .collect::<Vec<_>>();
    let (mut frames, mut views, mut masked) = (Vec::new(), Vec::new(), true);
    let mut small = Vec::new();
    for result in loaded {
        let (frame, view, small_photo, own_mask) = result?;
        frames.push(frame);
        small.push(small_photo);
        views.push(view);
        masked &= own_mask;
    }
    let target = object_center(&views, posed);
    let sources = level::choose_sources(&views, &target, options.max_num_sources);
    let mut pyramid = vec![Level::new(views, &sources)];
    loop {
        let last = &pyramid[pyramid.len() - 1];
        // One level more than the coarse one serves the first search and the first outer iterations with shading.
        let below_coarse = pyramid
            .iter()
            .filter(|level| level.mean_pixels() <= options.coarse_pixels)
            .count();
        if below_coarse >= 2 {
            break;
        }
        let halved: Vec<LevelView> = last.views.par_iter().map(LevelView::halved).collect();
        if halved.iter().any(|v| v.pixels.len() < 500) {
            break;
        }
        pyramid.push(Level::new(halved, &sources));
    }
    let coarse = pyramid
        .iter()
        .position(|level| level.mean_pixels() <= options.coarse_pixels)
        .unwrap_or(pyramid.len() - 1);
    Ok(Scene {
        frames,
        pyramid,
        coarse,
        masked,
        sources,
        small,
    })
}

/// Middle of the known points, else of the optical axes' closest approach.
fn object_center(views: &[LevelView], posed: &PosedViews) -> Point3<f64> {
    let mut coordinates: [Vec<f64>; 3] = Default::default();
    let known: Vec<[f64; 3]> = if posed.anchors.is_empty() {
        posed.points.iter().map(|p| p.position).collect()
    } else {
        posed.anchors.iter().map(|a| a.position).collect()
    };
    for point in &known {
        for k in 0..3 {
            coordinates[k].push(point[k]);
        }
    }
    if known.len() >= 10 {
        let middle =
            [0, 1, 2].map(|k| rilievo_numerics::robust::median(&mut coordinates[k]).unwrap_or(0.0));
        return Point3::from(middle);
    }
    let outlines: Vec<_> = views.iter().map(|view| view.outline(true)).collect();
    rilievo_stereo::hull::object_ball(&outlines)
        .map(|(center, _)| center)
        .unwrap_or_else(Point3::origin)
}
