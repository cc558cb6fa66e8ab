//! Stage 5: coupled multi-view shape from shading to depth and normal maps.
//!
//! **In**: views with linear images, masks, cameras, lighting, and whatever is known of depth (a
//! start, anchors, matches with other views, a depth prior). **Out**: depth, normals, re-rendered image
//! and confidence per view, and a report of energies, residuals and times.
//!
//! Two models explain the photos: [`paper`], distant harmonics and depth anchors view by view, and [`photo`],
//! light with shadow and bounce, and the photos' agreement with each other. [`run`] chooses.
//!
//! Source: Quéau, Mélou, Durou, Cremers, ICCV 2017 (`queau2017`).

#[cfg(test)]
// Tests in the sources share scenes with those outside.
extern crate self as rilievo_shading;

mod error;
mod options;
pub mod paper;
pub mod photo;
mod photo_of;
mod report;
mod surroundings;

pub use error::{LightMisfit, ShadingError};
pub use options::{RETIRED_KEYS, ShadingModel, ShadingOptions};
pub use report::ShadingReport;
pub use surroundings::Surroundings;

use rilievo_scene::{LightingCalibration, PhotoSet, PosedViews, ShadedView, ShadedViews};

/// Raised with every change of the stage that changes its results.
pub const VERSION: u32 = 40;

/// Dense shape of every posed view, from photos, poses with anchors, and lighting.
///
/// One posed view alone is always solved by the paper's model: agreement between photos needs two.
///
/// # Errors
/// See [`ShadingError`].
pub fn run(
    photos: &PhotoSet,
    posed: &PosedViews,
    lighting: &LightingCalibration,
    options: &ShadingOptions,
    surroundings: Surroundings<'_>,
) -> Result<(Shaded, ShadingReport), ShadingError> {
    options.validate()?;
    if options.model == ShadingModel::Photo && posed.views.len() > 1 {
        let (shaped, mut facts) =
            photo::run(photos, posed, lighting, &options.photo, surroundings)?;
        let report = ShadingReport {
            light: std::mem::take(&mut facts.light),
            photo: Some(facts),
            ..ShadingReport::default()
        };
        return Ok((Shaded::Photo(Box::new(shaped)), report));
    }
    let (shaded, facts) = paper::run(
        photos,
        posed,
        lighting,
        &options.paper,
        surroundings.observer,
    )?;
    let report = ShadingReport {
        paper: facts,
        light: lighting.views.clone(),
        photo: None,
    };
    Ok((Shaded::Paper(shaded), report))
}

/// What [`run`] found, by model.
#[derive(Debug)]
pub enum Shaded {
    /// Of [`photo`]: maps are made when they are asked for.
    Photo(Box<photo::ShapedViews>),
    /// Of [`paper`].
    Paper(ShadedViews),
}

impl Shaded {
    /// Number of views.
    pub fn num_views(&self) -> usize {
        match self {
            Self::Photo(shaped) => shaped.num_views(),
            Self::Paper(shaded) => shaded.views.len(),
        }
    }

    /// All maps of a view.
    ///
    /// # Errors
    /// [`ShadingError::Scratch`] when they cannot be read back.
    pub fn view(&self, index: usize) -> Result<ShadedView, ShadingError> {
        match self {
            Self::Photo(shaped) => shaped.view(index),
            Self::Paper(shaded) => Ok(shaded.views[index].clone()),
        }
    }

    /// All maps of all views.
    ///
    /// # Errors
    /// As [`Self::view`].
    pub fn views(&self) -> Result<ShadedViews, ShadingError> {
        match self {
            Self::Photo(shaped) => shaped.views(),
            Self::Paper(shaded) => Ok(shaded.clone()),
        }
    }
}
