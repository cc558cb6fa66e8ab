//! A Gauss-Newton step of one tile of a view, under the light of a coarser level.

use super::chroma::ChromaNoise;
use super::light::{self, Light};
use super::matching::Likeness;
use super::shading::{PixelHarmonics, PixelLight, ShadingTerm, ShadingWeights};
use super::step::{self, StepOptions};
use rayon::prelude::*;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::PlateError;
use rilievo_scene::ScratchError;
use rilievo_stereo::level::{Level, ViewGrid, depth_rasters};
use rilievo_stereo::spread::Parents;
use rilievo_stereo::stored::StoredLevel;
use rilievo_stereo::surfaces::{Reading, Surfaces};
use rilievo_stereo::tile::{self, Tile};
use rilievo_stereo::window::Window;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Side of the samples on which a view's noise is measured, pixels, and their largest number.
const SAMPLE_PX: usize = 128;
const MAX_NUM_SAMPLES: usize = 8;

/// The light of a view at a coarser level, to be read at finer ones.
pub(crate) struct CoarseLight<'a> {
    light: &'a Light,
    index: usize,
    at: usize,
    focal: f64,
    harmonics: Cow<'a, [PixelHarmonics]>,
    parents: Parents<'a>,
}

/// Why a tile's step failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TileError {
    #[error(transparent)]
    Plate(#[from] PlateError),
    #[error(transparent)]
    Scratch(#[from] ScratchError),
}

/// What all tiles of one view at one level share.
pub(crate) struct ViewAtLevel<'a> {
    pub level: &'a StoredLevel<'a>,
    pub index: usize,
    pub reading: Reading,
    pub light: &'a CoarseLight<'a>,
    pub options: &'a StepOptions,
    pub shading: ShadingWeights,
}

/// The result of a tile's step.
#[derive(Serialize, Deserialize)]
pub(crate) struct TileStep {
    /// Places of its pixels in the whole view's raster.
    pub places: Vec<u32>,
    /// Share of each of them in the blend.
    pub shares: Vec<f32>,
    /// Increments of the log depths of its pixels.
    pub increment: Vec<f64>,
    /// Some of the relative residuals between the photos.
    pub residuals: Vec<f64>,
    /// How alike they are in neighbouring pixels.
    pub likeness: Likeness,
}

impl<'a> CoarseLight<'a> {
    /// The light of view `index`, whose `harmonics` are of `level`, number `at`.
    pub(crate) fn new(
        level: &'a Level,
        at: usize,
        index: usize,
        light: &'a Light,
        harmonics: Cow<'a, [PixelHarmonics]>,
    ) -> Self {
        Self {
            light,
            index,
            at,
            focal: level.focal(),
            harmonics,
            parents: Parents::new(&level.views[index]),
        }
    }

    /// The light of a tile of the view, cut at level `at` of focal length `focal`.
    fn of(&self, tile: &Tile, at: usize, focal: f64) -> PixelLight<'static> {
        let light = self.light;
        let (pigment, trust) = (light.pigment_of(self.index), light.trust.get(self.index));
        let scale = f64::from(1_u32 << (self.at - at)).recip();
        let view = &tile.level.views[0];
        let rows: Vec<[f32; 31]> = (0..view.pixels.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|p| {
                let (x, y) = view.xy(p);
                let coarse = |v: f64, corner: usize| (v + corner as f64 + 0.5) * scale - 0.5;
                let (x, y) = (coarse(x, tile.corner.0), coarse(y, tile.corner.1));
                self.parents.at(x, y, |parent| {
                    let mut row = [0.0; 31];
                    for (c, l) in self.harmonics[parent].iter().enumerate() {
                        row[9 * c..9 * c + 9].copy_from_slice(l);
                    }
                    if let Some(pigment) = pigment {
                        row[27..30].copy_from_slice(&pigment[parent]);
                    }
                    if let Some(trust) = trust {
                        row[30] = trust[parent];
                    }
                    row
                })
            })
            .collect();
        PixelLight {
            harmonics: rows.iter().map(|r| light::pixel_harmonics(r)).collect(),
            pigment: pigment.map(|_| rows.iter().map(|r| [r[27], r[28], r[29]]).collect()),
            trust: trust.map(|_| rows.iter().map(|r| r[30]).collect()),
            mean_tolerance: light.mean_tolerance * self.focal / focal,
            openness_exponent: light.openness_exponent.unwrap_or(0.0),
        }
    }
}

/// Some windows spread over a view's object, where there are such that it fills.
pub(crate) fn sample_cores(view: &ViewGrid) -> Vec<Window> {
    let cores = tile::cores(view, SAMPLE_PX);
    let is_full = |core: &Window| core.cut(&view.mask).data.iter().all(|&is| is);
    let (full, cut): (Vec<Window>, Vec<Window>) = cores.into_iter().partition(is_full);
    let inner = if full.is_empty() { cut } else { full };
    let step = inner.len().div_ceil(MAX_NUM_SAMPLES).max(1);
    inner.into_iter().step_by(step).collect()
}

impl ViewAtLevel<'_> {
    /// One Gauss-Newton step of a tile.
    pub(crate) fn step(&self, core: &Window) -> Result<TileStep, TileError> {
        let tile = Tile::cut(self.level, self.index, core)?;
        let surfaces = Surfaces::new(&tile.level, &tile.depths, self.reading);
        let (light, depth) = (self.light_of(&tile), &tile.depths[0]);
        let rasters = &surfaces.rasters;
        let term = ShadingTerm::new(&tile.level, 0, depth, rasters, &light, &self.shading);
        let solver = PlateSolver::iterative(&tile.level.views[0].pixels);
        let outcome = step::improve(&surfaces, 0, &solver, depth, Some(&term), self.options)?;
        let increment = outcome.depth.iter().zip(depth);
        let increment = increment.map(|(after, before)| after - before).collect();
        let residuals = outcome.matches.some_residuals().collect();
        Ok(TileStep {
            places: tile.places,
            shares: tile.shares,
            increment,
            residuals,
            likeness: outcome.matches.likeness,
        })
    }

    fn light_of(&self, tile: &Tile) -> PixelLight<'static> {
        let focal = self.level.focal();
        self.light.of(tile, self.level.at, focal)
    }

    /// Noise of the view's chroma, from samples all over the object.
    pub(crate) fn chroma_noise(
        &self,
        samples: &[Window],
    ) -> Result<Option<ChromaNoise>, ScratchError> {
        let parts = samples
            .par_iter()
            .map(|core| {
                let tile = Tile::cut(self.level, self.index, core)?;
                let rasters = depth_rasters(&tile.level, &tile.depths);
                let (light, depth) = (self.light_of(&tile), &tile.depths[0]);
                let term = ShadingTerm::new(&tile.level, 0, depth, &rasters, &light, &self.shading);
                Ok(term.chroma_noise)
            })
            .collect::<Result<Vec<ChromaNoise>, ScratchError>>()?;
        Ok(ChromaNoise::median_of(&parts))
    }
}
