//! Exposure of the photos, and the surface that dense search finds.
//!
//! Correlation needs no exposure, so it searches one level coarser; where views agree their intensities
//! give the gains, and what the gains leave is the photos' disagreement, from which σ_m follows. With
//! the gains divided out the coarse level is searched again, where patches' means are compared as well. A
//! search is repeated against the depths that the other views found.
//!
//! Finer levels that are solved as a whole are searched where photos disagree too much for single pixels
//! to find a surface. Gloss, bounce and dirt make two photos of one point differ; σ_m grows with that disagreement, and
//! single pixels lose their hold on the surface. The correlation of patches cancels gain and
//! offset, and still finds depth to a fraction of a pixel. So the tangent planes of the solved
//! surface are searched around once more, and the surface starts again from the depths that another
//! view confirms, fused over all views. The search knows no smoothness, and so finds the breaks
//! that a plate bridges. What no other view confirms keeps the depth of the solved surface. Where patches hold little
//! but noise, searched depths follow it in all views alike, and the views hold each other to it less.

use super::memory;
use super::report::PhotoViewReport;
use super::solve::FUSION_PX;
use super::solver::Solver;
use super::steps::PhotoStep;
use crate::error::ShadingError;
use nalgebra::Point3;
use rilievo_scene::{LightKind, PosedViews};
use rilievo_stereo::gains;
use rilievo_stereo::patch_cost::Plane;
use rilievo_stereo::patchmatch::{self, SearchOptions};
use rilievo_stereo::search::{self, Search};
use rilievo_stereo::searched_depths::SearchedDepths;
use rilievo_stereo::start;
use std::time::Instant;

/// Relative noise of 8-bit photographs: no photos agree better than this.
const MIN_DISAGREEMENT: f64 = 0.012;
/// Beyond this the photos hardly show the same object.
const MAX_DISAGREEMENT: f64 = 0.2;
/// Disagreement from which single pixels find no surface.
const LARGE_DISAGREEMENT: f64 = 0.055;
/// The match term's σ as a share of the photos' disagreement: the rest varies slowly over the
/// surface and moves nothing.
const SIGMA_SHARE: f64 = 0.4;
/// Sources that count in a search without a start: the best ones.
const NUM_BEST: usize = 3;
/// Fusions of the surfaces searched at a finer level: every view's search errs by itself, their
/// mean errs less. The second takes in what the first brought near.
const NUM_FUSIONS: usize = 2;
/// Distance within which they are fused, footprints: searched depths scatter more than solved ones.
const SEARCHED_FUSION_PX: f64 = 2.0 * FUSION_PX;

/// Planes about the pixels of all views.
type Planes = Vec<Vec<Plane>>;

impl Solver<'_> {
    /// Whether brightness is so far from constant that single pixels are no match.
    pub fn photos_disagree(&self) -> bool {
        self.report.disagreement >= LARGE_DISAGREEMENT
    }

    fn bounded_disagreement(&self) -> f64 {
        let disagreement = self.report.disagreement;
        disagreement.clamp(MIN_DISAGREEMENT, MAX_DISAGREEMENT)
    }

    /// Planes of every view, searched from those that `start` returns, each by itself and then against what the other views
    /// found; with the search that found the latter.
    fn consistent_search<'s>(
        &'s self,
        search: Search<'s>,
        start: Option<&(dyn Fn(usize) -> Vec<Plane> + Sync)>,
    ) -> Result<(Search<'s>, [Planes; 2]), ShadingError> {
        let first = self.searched(&search, start)?;
        let search = search.against(&log_depths(&first));
        let planes = self.searched(&search, Some(&|i| first[i].clone()))?;
        Ok((search, [first, planes]))
    }

    /// Planes of every view, searched from those that `start` returns.
    fn searched(
        &self,
        search: &Search<'_>,
        start: Option<&(dyn Fn(usize) -> Vec<Plane> + Sync)>,
    ) -> Result<Planes, ShadingError> {
        self.divided(memory::search_bytes(search.level()), |i| {
            let start = start.map(|of_view| of_view(i));
            Ok(search.view(i, start.as_deref()))
        })
    }

    /// Searched log depths, not a number where the patch is clipped all over: there all views can agree on any depth.
    fn known(
        &self,
        search: &Search<'_>,
        depths: &[Vec<f64>],
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let clipped = self.divided(memory::search_bytes(search.level()), |i| {
            Ok(search.clipped_all_over(i))
        })?;
        let mut known = depths.to_vec();
        for (depth, clipped) in known
            .iter_mut()
            .flatten()
            .zip(clipped.into_iter().flatten())
        {
            if clipped {
                *depth = f64::NAN;
            }
        }
        Ok(known)
    }

    /// A search of a level; `mean_deviation`: as in [`SearchOptions`].
    fn search(
        &self,
        at: usize,
        posed: &PosedViews,
        mean_deviation: Option<f32>,
    ) -> Result<Search<'_>, ShadingError> {
        let points: Vec<Point3<f64>> = posed
            .points
            .iter()
            .map(|p| Point3::from(p.position))
            .chain(posed.anchors.iter().map(|a| Point3::from(a.position)))
            .collect();
        let options = SearchOptions {
            mean_deviation,
            num_sweeps: self.options.effort.num_sweeps,
            num_best: NUM_BEST,
            seed: self.options.seed,
        };
        let (level, masked) = (self.scene.level(at), self.scene.masked);
        let search = Search::new(level, masked, &points, &options);
        search.ok_or_else(|| ShadingError::NoDepth {
            view: self.scene.frames[0].name.clone(),
        })
    }

    /// Gains of the photos, divided out of every level, and the weight of the match term. Returns the
    /// planes of the first search.
    ///
    /// Under a light fixed to the camera a point's brightness differs between the views for the light's
    /// sake, and exposures cannot be measured: they are taken as they stand.
    pub fn find_exposure(
        &mut self,
        posed: &PosedViews,
        kind: LightKind,
    ) -> Result<Planes, ShadingError> {
        let began = Instant::now();
        let at = (self.scene.coarse + 1).min(self.scene.num_levels() - 1);
        self.progress(PhotoStep::Exposure, 0, 1)?;
        let planes = self.searched(&self.search(at, posed, None)?, None)?;
        let level = self.scene.level(at);
        let depths = log_depths(&planes);
        let agreement = start::agreement(level, &depths);
        let mut exposure = gains::estimate(level, &depths, &agreement);
        if kind == LightKind::Camera {
            exposure.gains.fill([1.0; 3]);
        }
        self.scene.divide_by_gains(&exposure.gains);
        self.report.disagreement = exposure.disagreement;
        self.report.sigma_match = SIGMA_SHARE * self.bounded_disagreement();
        self.report.add_step(PhotoStep::Exposure, at, began);
        self.report.views = self
            .scene
            .frames
            .iter()
            .enumerate()
            .map(|(i, frame)| PhotoViewReport {
                name: frame.name.clone(),
                num_pixels: self.scene.stored[i].num_masked(0),
                sources: self.scene.sources[i]
                    .iter()
                    .map(|&j| self.scene.frames[j].name.clone())
                    .collect(),
                gain: exposure.gains[i],
                disagreement: exposure.per_view[i],
                sharpness: 1.0,
                ..PhotoViewReport::default()
            })
            .collect();
        Ok(planes)
    }

    /// The surface that the views agree on, continued over their masks; and what they found.
    pub fn find_surface(
        &mut self,
        posed: &PosedViews,
        planes: &[Vec<Plane>],
    ) -> Result<(Vec<Vec<f64>>, SearchedDepths), ShadingError> {
        let began = Instant::now();
        let at = self.scene.coarse;
        self.progress(PhotoStep::Search, 0, 1)?;
        let mean_deviation = Some(self.bounded_disagreement() as f32);
        let level = self.scene.level(at);
        let coarser = self.scene.coarser(at);
        let start =
            |i: usize| patchmatch::refine_start(&coarser.views[i], &level.views[i], &planes[i]);
        let start: Option<&(dyn Fn(usize) -> Vec<Plane> + Sync)> =
            (at + 1 < self.scene.num_levels()).then_some(&start);
        let search = self.search(at, posed, mean_deviation)?;
        let (search, planes) = self.consistent_search(search, start)?;
        let [alone, depths] = planes.map(|planes| log_depths(&planes));
        let known = self.known(&search, &depths)?;
        let agreement = start::agreement(level, &known);
        let surface = self.continued(at, &known, &agreement)?;
        self.report.search_scatter_px = start::scatter(level, &depths);
        for (view, agreement) in self.report.views.iter_mut().zip(&agreement) {
            let confirmed = agreement.iter().filter(|&&bits| bits != 0).count();
            view.confirmed = confirmed as f64 / agreement.len().max(1) as f64;
        }
        self.report.add_step(PhotoStep::Search, at, began);
        let searched = SearchedDepths::new(&alone, &depths, &agreement);
        Ok((surface, searched))
    }

    /// The surface at level `at`, searched around `depths`: the mean of what the views find. What no view confirms stays.
    /// How certain it is is kept for the rounds around it.
    pub fn search_again(
        &mut self,
        at: usize,
        depths: &[Vec<f64>],
        posed: &PosedViews,
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let began = Instant::now();
        self.progress(PhotoStep::FinerSearch, 0, 1)?;
        let level = self.scene.level(at);
        let tangent = |i: usize| patchmatch::tangent_planes(&level.views[i], &depths[i]);
        let search = self.search(at, posed, None)?;
        let (search, [_, planes]) = self.consistent_search(search, Some(&tangent))?;
        let variances = self.divided(memory::search_bytes(level), |i| {
            Ok(search.variances(i, &planes[i]))
        })?;
        let certainty = search::certainties(level, &variances);
        let mut surface = log_depths(&planes);
        let agreement = start::agreement(level, &self.known(&search, &surface)?);
        let scatter_px = start::scatter(level, &surface);
        for ((found, before), agreement) in surface.iter_mut().zip(depths).zip(&agreement) {
            for ((found, &before), &bits) in found.iter_mut().zip(before).zip(agreement) {
                if bits == 0 {
                    *found = before;
                }
            }
        }
        self.show(at, "searched", &surface)?;
        for _ in 0..NUM_FUSIONS {
            surface = self.fused(at, &surface, SEARCHED_FUSION_PX)?;
        }
        self.report.finer_search_scatter_px = Some(scatter_px);
        self.report.add_step(PhotoStep::FinerSearch, at, began);
        self.show(at, "searched, fused", &surface)?;
        self.certainty = Some(certainty);
        Ok(surface)
    }

    /// The surface through those searched log depths that sources confirm, continued over the masks.
    fn continued(
        &self,
        at: usize,
        depths: &[Vec<f64>],
        agreement: &[Vec<u8>],
    ) -> Result<Vec<Vec<f64>>, ShadingError> {
        let (level, solvers) = (self.scene.level(at), self.exact_solvers(at));
        self.divided(memory::solve_bytes(level), |i| {
            let view = &level.views[i];
            let weights = agreement[i]
                .iter()
                .map(|&bits| start::confirmed_weight(bits));
            let weights: Vec<f64> = weights.collect();
            let solver = solvers.of(i, &view.pixels);
            solver
                .and_then(|s| start::continued(view, &s, &depths[i], &weights, 1.0 / level.focal()))
                .map_err(|e| self.failed(i, &e))
        })
    }
}

/// Log depths of the views' planes.
fn log_depths(planes: &[Vec<Plane>]) -> Vec<Vec<f64>> {
    let of_view = |planes: &Vec<Plane>| planes.iter().map(Plane::log_depth).collect();
    planes.iter().map(of_view).collect()
}
