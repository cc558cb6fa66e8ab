//! Driver: prepares the views, solves each, and gathers maps and report.

use super::confidence;
use super::levels::{Level, ladder};
use super::linearized;
use super::matches;
use super::options::{PaperOptions, Projection, Splitting, StartShape};
use super::pixels::Slopes;
use super::prepare::{Geometry, PreparedView, empty_mask, prepare};
use super::problem::{DepthAnchor, ShadingProblem, ShadingView};
use super::result::{maps, rms_residual};
use super::schedule::{Informativeness, level_schedules};
use super::solution::{PaperReport, ShadingSolution, SolvedView, Termination, ViewReport};
use super::splitting::{self, Setting, Ties, slopes_of};
use super::start;
use super::theta::{ThetaProblem, ThetaTerms, theta_step};
use crate::error::{ShadingError, warn};
use rilievo_numerics::robust::median;
use rilievo_scene::Observer;
use std::time::Instant;

/// Most levels of the ladder.
const MAX_LEVELS: usize = 4;
/// Fewest anchors that give a shape: below, a given depth knows more.
const MIN_ANCHORS: usize = 4;
/// Errors of the shading model are alike over about this many pixels, so that many pixels together
/// know their common slope no better than one: the weight of anchors against shading grows by its
/// square (measured: 1 to 10 lowers the angle in every case with anchors, most where they are
/// noisy).
const SHADING_CORRELATION_PX: f64 = 10.0;
/// By how much slopes of the integrated surface may err (curvature within a pixel, edges): normals
/// are drawn towards shading where that is surer.
const SLOPE_ERROR: f64 = 0.05;

/// Solves the views, tied by their matches.
pub(crate) fn solve(
    problem: &ShadingProblem,
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<ShadingSolution, ShadingError> {
    options.validate()?;
    if problem.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    let tied = matches::anchors(problem)?;
    let mut views = Vec::new();
    let mut report = PaperReport {
        num_matches: tied.num_matches,
        num_matches_rejected: tied.num_rejected,
        match_sigma_px: tied.sigma_px,
        ..PaperReport::default()
    };
    for (view, from_matches) in problem.views.iter().zip(&tied.by_view) {
        let anchors: Vec<DepthAnchor> = view.anchors.iter().chain(from_matches).copied().collect();
        let (solved, facts) = solve_view(view, &anchors, options, observer)?;
        if known_depth(view, &anchors).is_none() {
            let message = format!(
                "{}: nothing tells its depth: shape is known up to one factor, and the middle of the \
                 object is put at depth 1",
                view.name
            );
            warn(observer, message)?;
        }
        views.push(solved);
        report.views.push(facts);
    }
    Ok(ShadingSolution { views, report })
}

/// Depth that fixes the unknown's zero: the median of what is known, or 1 where a plane is asked
/// for and shape up to a factor is all that one photo determines.
fn reference_depth(
    view: &ShadingView,
    anchors: &[DepthAnchor],
    options: &PaperOptions,
) -> Option<f64> {
    let free = options.start == StartShape::Plane && options.projection == Projection::Perspective;
    known_depth(view, anchors).or(free.then_some(1.0))
}

/// Median of what is known of a view's depth.
fn known_depth(view: &ShadingView, anchors: &[DepthAnchor]) -> Option<f64> {
    let mut known: Vec<f64> = anchors.iter().map(|a| a.depth).collect();
    if known.is_empty() {
        let map = view
            .initial_depth
            .as_ref()
            .or(view.prior.as_ref().map(|prior| &prior.depth))?;
        known = map
            .data
            .iter()
            .zip(&view.mask.data)
            .filter(|&(&z, &inside)| inside && z > 0.0 && z.is_finite())
            .map(|(&z, _)| f64::from(z))
            .collect();
    }
    median(&mut known)
}

/// Node values of the start, and the anchors that agree with it.
fn start_shape(
    view: &ShadingView,
    prepared: &PreparedView,
    anchors: &[DepthAnchor],
    options: &PaperOptions,
    report: &mut ViewReport,
) -> Result<(Vec<f32>, Vec<DepthAnchor>), ShadingError> {
    let (grid, geometry) = (&prepared.grid, &prepared.geometry);
    let flat = || vec![0.0; grid.padded_len()];
    let given = view
        .initial_depth
        .as_ref()
        .or(view.prior.as_ref().map(|prior| &prior.depth));
    let by_anchors = match options.start {
        StartShape::Anchors => !anchors.is_empty(),
        StartShape::Automatic => anchors.len() >= MIN_ANCHORS,
        StartShape::Given | StartShape::Plane => false,
    };
    report.num_anchors = anchors.len();
    if by_anchors {
        let plate =
            start::plate(grid, geometry, anchors).map_err(|error| ShadingError::Numerics {
                view: view.name.clone(),
                reason: error.to_string(),
            })?;
        if let Some(plate) = plate {
            let kept: Vec<DepthAnchor> = anchors
                .iter()
                .zip(&plate.inliers)
                .filter_map(|(anchor, &inlier)| inlier.then_some(*anchor))
                .collect();
            report.num_anchors_rejected = anchors.len() - kept.len();
            report.num_anchors = kept.len();
            return Ok((plate.nodes, kept));
        }
    }
    let y = match (options.start, given) {
        (StartShape::Plane, _) | (_, None) => flat(),
        (_, Some(depth)) => start::from_depth(grid, geometry, depth),
    };
    Ok((y, anchors.to_vec()))
}

/// Anchors and prior as terms on the unknown, in intensity² (see [`splitting`]).
fn ties(view: &ShadingView, prepared: &PreparedView, anchors: &[DepthAnchor], sigma: f64) -> Ties {
    let geometry = &prepared.geometry;
    let points = anchors
        .iter()
        .filter(|a| a.depth > 0.0 && a.sigma_ln_depth > 0.0)
        .map(|anchor| {
            let sigma_y = geometry.sigma(anchor.depth, anchor.sigma_ln_depth);
            let weight = (SHADING_CORRELATION_PX * sigma / sigma_y).powi(2);
            (
                anchor.pixel,
                weight as f32,
                geometry.unknown(anchor.depth) as f32,
            )
        })
        .collect();
    let mut ties = Ties {
        points,
        ..Ties::default()
    };
    if let Some(prior) = &view.prior {
        let (mass, wanted) = start::prior(&prepared.grid, geometry, prior);
        ties.mass = mass;
        ties.wanted = wanted;
    }
    ties
}

/// Penalty under which a pixel's own slopes and the surface's have the weights of their errors.
fn normal_beta(sigma: f64) -> f32 {
    (2.0 * (sigma / SLOPE_ERROR).powi(2)) as f32
}

/// Normals: slopes of the surface, drawn towards what each pixel's intensity says; all the more
/// where the surface breaks.
fn draw_to_shading(
    level: &Level,
    sigma: f64,
    surface: &Slopes,
    outcome: splitting::Outcome,
) -> Slopes {
    let mut theta = outcome.theta;
    let problem = ThetaProblem {
        pixels: &level.pixels,
        target: surface,
        terms: ThetaTerms {
            beta: normal_beta(sigma),
            stiffness: &outcome.stiffness,
            area: 0.0,
            num_steps: 8,
        },
        candidates: None,
    };
    theta_step(&problem, &mut theta);
    theta
}

/// The terms of the energy at the integrated surface.
fn energies(
    view: &ShadingView,
    level: &Level,
    geometry: &Geometry,
    options: &PaperOptions,
    y: &[f32],
    [p, q]: &Slopes,
    report: &mut ViewReport,
) {
    let pixels = &level.pixels;
    let mut values = vec![0.0; pixels.padded];
    level.grid.values(y, &mut values);
    for (k, (x, row)) in level.grid.pixels().enumerate() {
        if pixels.weight[k] > 0.0 {
            for r in pixels.residuals(k, [p[k], q[k]]) {
                report.energy_shading += f64::from(pixels.weight[k] * r * r);
            }
        }
        let facet = pixels.facet(k, [p[k], q[k]]);
        report.energy_area += options.area_weight * f64::from(facet.length());
        if let Some(prior) = &view.prior {
            let z = f64::from(*prior.depth.at(x, row));
            if z > 0.0 {
                let away = (geometry.depth(f64::from(values[k])) / z).ln();
                report.energy_prior += prior.weight * away * away;
            }
        }
    }
}

/// Solves one view.
fn solve_view(
    view: &ShadingView,
    anchors: &[DepthAnchor],
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<(SolvedView, ViewReport), ShadingError> {
    let begun = Instant::now();
    let reference =
        reference_depth(view, anchors, options).ok_or_else(|| match view.mask.count() {
            0 => empty_mask(view),
            _ => ShadingError::NoDepth {
                view: view.name.clone(),
            },
        })?;
    let prepared = prepare(view, options, reference)?;
    let (geometry, white) = (prepared.geometry, prepared.white);
    let mut report = prepared.report.clone();
    let sigma = options.noise.max(view.noise.unwrap_or(0.0)) * white;
    let (mut y, anchors) = start_shape(view, &prepared, anchors, options, &mut report)?;
    let ties = ties(view, &prepared, &anchors, sigma);
    let is_full = options.splitting == Splitting::Full;
    let max_levels = if is_full { MAX_LEVELS } else { 1 };
    let levels = ladder(prepared.grid, prepared.pixels, max_levels, white);
    let finest = &levels[0];
    let start = slopes_of(finest, geometry.aspect, &y);
    report.rms_start = rms_residual(&finest.pixels, &start);
    let known = Informativeness::of(&finest.pixels, &start, sigma);
    report.informativeness = known.squared[1].sqrt();
    let schedules = level_schedules(levels.len(), &known, !ties.is_empty());
    report.beta_start = schedules
        .first()
        .map_or(0.0, |schedule| schedule.beta_start);
    report.seconds.start = begun.elapsed().as_secs_f64();
    let mut outcome = None;
    if is_full {
        let setting = Setting {
            ties: &ties,
            area: options.area_weight as f32,
            loss: options.loss,
            white: white as f32,
            aspect: geometry.aspect,
            edge_beta: (options.depth_edges && known.determined()).then(|| normal_beta(sigma)),
            schedules: &schedules,
            observer,
        };
        let mut solved = splitting::solve(&levels, &mut y, &setting)?;
        report.num_depth_breaks += solved.num_breaks;
        report.iterations = std::mem::take(&mut solved.records);
        report.seconds.theta = solved.seconds.theta;
        report.seconds.z = solved.seconds.z;
        report.termination = Some(Termination::ScheduleEnded);
        outcome = Some(solved);
    } else {
        let setting = linearized::Setting {
            splits: options.splitting == Splitting::Paper,
            ties: &ties,
            aspect: geometry.aspect,
            white,
            observer,
        };
        let (records, termination) = linearized::solve(finest, &mut y, &setting)?;
        report.iterations = records;
        report.termination = Some(termination);
    }
    let surface = slopes_of(finest, geometry.aspect, &y);
    energies(view, finest, &geometry, options, &y, &surface, &mut report);
    // The paper's methods return the surface's own normals; the full splitting draws them to
    // shading.
    let theta = outcome.map_or_else(
        || surface.clone(),
        |outcome| draw_to_shading(finest, sigma, &surface, outcome),
    );
    report.rms_rendered = rms_residual(&finest.pixels, &theta);
    let size = (view.image.width, view.image.height);
    let confidence = confidence::map(size, finest, &theta, &surface, sigma);
    let solved = maps(view, finest, &geometry, &y, &theta, confidence);
    report.seconds.total = begun.elapsed().as_secs_f64();
    Ok((solved, report))
}
