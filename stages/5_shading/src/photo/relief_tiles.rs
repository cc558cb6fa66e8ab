//! A Gauss-Newton step of one tile of a view, under the light of a coarser level.

use super::chroma::ChromaNoise;
use super::light::{self, Light};
use super::matching::Likeness;
use super::shading::{PixelHarmonics, PixelLight, ShadingTerm, ShadingWeights};
use super::step::{self, StepOptions};
use rayon::prelude::*;
use rilievo_numerics::plate_solver::PlateSolver;
use rilievo_numerics::plate_system::{PixelNumbering, PlateError};
use rilievo_scene::ScratchError;
use rilievo_stereo::level::{Level, ViewGrid, depth_rasters};
use rilievo_stereo::patch_cost::PATCH_SIGMA_PX;
use rilievo_stereo::sampling;
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
/// Standard deviation of the Gaussian beyond which the coarser level has resolved the surface, pixels: that of a patch there.
const RESOLVED_PX: f64 = 2.0 * PATCH_SIGMA_PX;
/// Largest increment that counts in the mean over the Gaussian, pixel footprints: more moves an edge of depth, whose
/// surroundings stay.
const MAX_RELIEF_PX: f32 = 1.0;

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

/// Takes from increments of log depth what the coarser level has resolved, their mean over a Gaussian: there patches, or
/// larger pixels of less noise, held the surface, which single pixels hold less.
pub(crate) fn keep_unresolved(pixels: &PixelNumbering, focal: f64, increment: &mut [f64]) {
    let all = vec![1.0; increment.len()];
    let relief: Vec<[f32; 1]> = increment
        .iter()
        .map(|&d| [((d * focal) as f32).clamp(-MAX_RELIEF_PX, MAX_RELIEF_PX)])
        .collect();
    let slow = sampling::smooth(pixels, &relief, &all, RESOLVED_PX);
    for (d, slow) in increment.iter_mut().zip(slow) {
        *d -= f64::from(slow[0]) / focal;
    }
}

impl ViewAtLevel<'_> {
    /// One Gauss-Newton step of a tile.
    pub(crate) fn step(&self, core: &Window) -> Result<TileStep, TileError> {
        let tile = Tile::cut(self.level, self.index, core)?;
        let surfaces = Surfaces::new(&tile.level, &tile.depths, self.reading);
        let (light, depth) = (self.light_of(&tile), &tile.depths[0]);
        let rasters = &surfaces.rasters;
        let term = ShadingTerm::new(&tile.level, 0, depth, rasters, &light, &self.shading);
        let pixels = &tile.level.views[0].pixels;
        let solver = PlateSolver::iterative(pixels);
        let outcome = step::improve(&surfaces, 0, &solver, depth, Some(&term), self.options)?;
        let increment = outcome.depth.iter().zip(depth);
        let mut increment: Vec<f64> = increment.map(|(after, before)| after - before).collect();
        keep_unresolved(pixels, self.level.focal(), &mut increment);
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

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::Mask;
    use std::f64::consts::TAU;

    /// What a wave of increments of .3 footprints along x keeps of its size, far from the border.
    fn kept(wavelength: f64) -> f64 {
        const FOCAL: f64 = 1000.0;
        let pixels = PixelNumbering::new(&Mask::filled(240, 24, true));
        let wave: Vec<f64> = (0..pixels.len())
            .map(|p| 0.3 / FOCAL * (TAU * f64::from(pixels.xs[p]) / wavelength).sin())
            .collect();
        let mut increment = wave.clone();
        keep_unresolved(&pixels, FOCAL, &mut increment);
        let inner = (0..pixels.len()).filter(|&p| (60..180).contains(&pixels.xs[p]));
        let (product, square) = inner.fold((0.0, 0.0), |(product, square), p| {
            (product + wave[p] * increment[p], square + wave[p] * wave[p])
        });
        product / square
    }

    #[test]
    fn only_what_the_coarser_level_did_not_resolve_is_kept() {
        for wavelength in [6.0, 12.0, 30.0, 60.0, 120.0] {
            let passed = 1.0 - (-0.5 * (TAU * RESOLVED_PX / wavelength).powi(2)).exp();
            let found = kept(wavelength);
            // The Gaussian is made of boxes of whole pixels.
            assert!(
                (found - passed).abs() < 0.04,
                "{found} at {wavelength}, {passed} expected"
            );
        }
    }

    #[test]
    fn an_edge_that_moves_leaves_the_surface_beside_it() {
        const FOCAL: f64 = 1000.0;
        let pixels = PixelNumbering::new(&Mask::filled(61, 9, true));
        let jump = 40.0 / FOCAL;
        let mut increment: Vec<f64> = (0..pixels.len())
            .map(|p| if pixels.xs[p] == 30 { jump } else { 0.0 })
            .collect();
        keep_unresolved(&pixels, FOCAL, &mut increment);
        for (p, d) in increment.iter().enumerate() {
            let left = if pixels.xs[p] == 30 { d - jump } else { *d };
            assert!(
                left.abs() < 0.15 / FOCAL,
                "{} at {}",
                left * FOCAL,
                pixels.xs[p]
            );
        }
    }
}
