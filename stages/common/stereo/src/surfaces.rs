//! The surfaces of all views, and the depths that each proposes for another's pixels.
//!
//! Seen along the ray of pixel `x`, view j's surface is where `r(ζ) = ln z_j(ζ) − ζ_j(x'(ζ))`
//! vanishes, `z_j` the point's depth in view j; `∂r/∂ζ = ∂ ln z_j/∂ζ − ∇ζ_j · ∂x'/∂ζ` is about 1
//! for a surface that both face. One Newton step leads to the depth that view j proposes, `ζ − r /
//! (∂r/∂ζ)`.

use crate::level::{self, Level, ViewGrid};
use crate::{plate, sampling};
use rayon::prelude::*;
use rilievo_scene::Raster;

/// How a surface is read between its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Averages neighbours: flattens detail, and noise.
    Bilinear,
    /// Keeps detail. Bilinear beside borders and breaks, over which the spline would swing.
    Cubic,
}

/// Range that the sixteen values of a cubic reading may span, in footprints: they reach over three pixels
/// where four reach over one, and what is as steep as a break in all of them is one.
pub(crate) const CUBIC_RANGE_PX: f64 = 2.0 * level::MAX_STEP_PX;

/// Log depths of all views with their weights, for the other views to read.
pub struct Surfaces<'a> {
    /// The views.
    pub level: &'a Level,
    /// Log depth of every view.
    pub rasters: Vec<Raster<f32>>,
    /// [`incidence_weights`].
    weights: Vec<Raster<f32>>,
    reading: Reading,
    /// How certain each view's depths are, if they were searched.
    certainty: Option<&'a [Vec<f32>]>,
}

/// A source's surface where a pixel of another view lands.
pub struct Proposal {
    /// `r`, how much farther than the source's surface the pixel's point lies, log depth.
    pub r: f64,
    /// `∂r/∂ζ`.
    pub slope: f64,
    /// The source's [`incidence_weights`] where the point lands.
    pub weight: f64,
}

impl<'a> Surfaces<'a> {
    /// Surfaces at the log depths `depths`, one list per view.
    pub fn new(level: &'a Level, depths: &[Vec<f64>], reading: Reading) -> Self {
        Self {
            level,
            rasters: level::depth_rasters(level, depths),
            weights: incidence_weights(level, depths),
            reading,
            certainty: None,
        }
    }

    /// With how certain the depths are that the surfaces started from, per view and pixel
    /// ([`certainties`](crate::search::certainties)).
    #[must_use]
    pub fn with_certainty(self, certainty: Option<&'a [Vec<f32>]>) -> Self {
        Self { certainty, ..self }
    }

    /// How certain the surfaces are at a pixel of view `index`, 0 to 1.
    #[inline]
    pub fn certainty(&self, index: usize, pixel: usize) -> f64 {
        self.certainty
            .map_or(1.0, |of_views| f64::from(of_views[index][pixel]))
    }

    /// Log depth of view `j`'s surface at a position, with its derivatives along x and y.
    #[inline]
    fn depth_with_slope(&self, j: usize, x: f64, y: f64) -> Option<(f64, f64, f64)> {
        let (view, raster) = (&self.level.views[j], &self.rasters[j]);
        if !view.has_surface_at(raster, x, y) {
            return None;
        }
        let cubic = match self.reading {
            Reading::Cubic => {
                let max_range = CUBIC_RANGE_PX / view.camera.focal();
                sampling::cubic_with_slope(raster, &view.mask, x, y, max_range)
            }
            Reading::Bilinear => None,
        };
        Some(cubic.unwrap_or_else(|| sampling::bilinear_with_slope(raster, x, y)))
    }

    /// The [`incidence_weights`] of a pixel of view `index`.
    #[inline]
    pub fn weight(&self, index: usize, pixel: usize) -> f64 {
        let (x, y) = self.level.views[index].place(pixel);
        f64::from(*self.weights[index].at(x, y))
    }

    /// The proposal of source `k` of view `index` for a pixel at log depth `zeta`, when `|r|` is
    /// within `reach`.
    #[inline]
    pub fn propose(
        &self,
        index: usize,
        k: usize,
        pixel: usize,
        zeta: f64,
        reach: f64,
    ) -> Option<Proposal> {
        let j = self.level.sources[index][k].0;
        let landing = self.level.landing(index, k, pixel, zeta)?;
        let (other, gx, gy) = self.depth_with_slope(j, landing.u, landing.v)?;
        let r = landing.zeta - other;
        if r.abs() > reach {
            return None;
        }
        let slope = (landing.dzeta - gx * landing.du - gy * landing.dv).clamp(-3.0, 3.0);
        Some(Proposal {
            r,
            slope,
            weight: f64::from(sampling::bilinear(&self.weights[j], landing.u, landing.v)),
        })
    }
}

/// Weight of every view's own pixels: cos² of the angle of incidence, small at the mask's rim, times the photo's squared
/// sharpness.
pub fn incidence_weights(level: &Level, depths: &[Vec<f64>]) -> Vec<Raster<f32>> {
    level
        .views
        .par_iter()
        .zip(depths)
        .map(|(view, depth)| {
            let normals = plate::normals(view, depth);
            let weights: Vec<f64> = (0..view.pixels.len())
                .map(|i| {
                    let cos = view.incidence_cosine(i, normals[i]);
                    let rim = if is_rim(view, i) { 0.1 } else { 1.0 };
                    rim * (view.sharpness * cos.clamp(0.05, 1.0)).powi(2)
                })
                .collect();
            view.spread(&weights, 0.0)
        })
        .collect()
}

/// Whether the mask ends within two pixels.
pub fn is_rim(view: &ViewGrid, pixel: usize) -> bool {
    [
        (2, 0),
        (-2, 0),
        (0, 2),
        (0, -2),
        (1, 1),
        (-1, 1),
        (1, -1),
        (-1, -1),
    ]
    .iter()
    .any(|&(dx, dy)| view.pixels.neighbour(pixel, dx, dy).is_none())
}
