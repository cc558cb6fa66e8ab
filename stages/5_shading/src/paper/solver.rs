//! Driver: prepares the views, solves each, and gathers maps and report.

use super::confidence;
use super::levels::{Level, ladder};
use super::linearized;
use super::matches;
use super::model::Facet;
use super::options::{Coupling, PaperOptions, PenaltySchedule, Projection, Splitting, StartShape};
use super::prepare::{Geometry, PreparedView, prepare};
use super::problem::{DepthAnchor, ShadingProblem, ShadingView};
use super::result::{maps, rms_residual};
use super::schedule::{Informativeness, automatic};
use super::solution::{PaperReport, ShadingSolution, SolvedView, Termination, ViewReport};
use super::splitting::{self, Course, Setting, Ties, slopes};
use super::start;
use super::theta::{ThetaProblem, ThetaTerms, theta_step};
use crate::error::{ShadingError, warn};
use rilievo_numerics::robust::median;
use rilievo_scene::{DepthMap, Observer};
use std::time::Instant;

/// Most levels of the ladder.
const MAX_LEVELS: usize = 4;
/// Turns that each view takes under the literal coupling.
const NUM_TURNS: usize = 2;
/// Fewest anchors that give a shape: below, a given depth knows more.
const MIN_ANCHORS: usize = 4;
/// Errors of the shading model are alike over about this many pixels, so that many pixels together
/// know their common slope no better than one: the weight of anchors against shading grows by its
/// square (measured: 1 to 10 lowers the angle in every case with anchors, most where they are noisy).
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
    let tied = matches::anchors(problem, options.match_noise_px)?;
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
    if options.coupling == Coupling::Literal && tied.num_matches > tied.num_rejected {
        take_turns(problem, &tied, options, observer, &mut views, &mut report)?;
    }
    Ok(ShadingSolution { views, report })
}

/// Eq. 15 by views in turn, from the surfaces that triangulated anchors gave.
fn take_turns(
    problem: &ShadingProblem,
    tied: &matches::MatchAnchors,
    options: &PaperOptions,
    observer: &dyn Observer,
    views: &mut [SolvedView],
    report: &mut PaperReport,
) -> Result<(), ShadingError> {
    let options = PaperOptions {
        start: StartShape::Given,
        coarse_to_fine: false,
        ..options.clone()
    };
    let mut depths: Vec<DepthMap> = views.iter().map(|view| view.depth.clone()).collect();
    for _ in 0..NUM_TURNS {
        for (index, view) in problem.views.iter().enumerate() {
            let mut view = view.clone();
            view.initial_depth = Some(depths[index].clone());
            let coupled = matches::literal(problem, tied, index, &depths);
            let anchors: Vec<DepthAnchor> = view.anchors.iter().chain(&coupled).copied().collect();
            let (solved, facts) = solve_view(&view, &anchors, &options, observer)?;
            depths[index] = solved.depth.clone();
            views[index] = solved;
            report.views[index] = facts;
        }
    }
    Ok(())
}

/// Depth that fixes the unknown's zero: the median of what is known, or 1 where a plane is asked for
/// and shape up to a factor is all that one photo tells.
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

fn schedule(
    options: &PaperOptions,
    num_levels: usize,
    known: &Informativeness,
    anchored: bool,
) -> Vec<Course> {
    match options.schedule {
        PenaltySchedule::Automatic => automatic(num_levels, known, anchored),
        PenaltySchedule::Explicit {
            start,
            growth,
            num_iterations,
            num_search_iterations,
        } => vec![Course {
            beta_start: start,
            growth,
            num_iterations,
            num_search_iterations,
        }],
    }
}

/// Penalty under which a pixel's own slopes and the surface's have the weights of their errors.
fn normal_beta(sigma: f64) -> f32 {
    (2.0 * (sigma / SLOPE_ERROR).powi(2)) as f32
}

/// Slopes of the integrated surface.
fn surface_slopes(level: &Level, geometry: &Geometry, y: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let mut p = vec![0.0; level.pixels.padded];
    let mut q = p.clone();
    slopes(&level.grid, geometry.aspect, y, &mut p, &mut q);
    (p, q)
}

/// Normals: slopes of the surface, drawn towards what each pixel's intensity says; all the more where
/// the surface breaks.
fn refine_slopes(
    level: &Level,
    geometry: &Geometry,
    sigma: f64,
    y: &[f32],
    outcome: splitting::Outcome,
) -> (Vec<f32>, Vec<f32>) {
    let target = surface_slopes(level, geometry, y);
    let [mut p, mut q] = outcome.theta;
    let terms = ThetaTerms {
        beta: normal_beta(sigma),
        stiffness: &outcome.stiffness,
        area: 0.0,
        num_steps: 8,
    };
    let problem = ThetaProblem {
        pixels: &level.pixels,
        target: (&target.0, &target.1),
        terms,
        candidates: None,
    };
    theta_step(&problem, &mut p, &mut q);
    (p, q)
}

/// The terms of the energy at the integrated surface.
fn energies(
    view: &ShadingView,
    level: &Level,
    geometry: &Geometry,
    options: &PaperOptions,
    y: &[f32],
    (p, q): (&[f32], &[f32]),
    report: &mut ViewReport,
) {
    let pixels = &level.pixels;
    let mut values = vec![0.0; pixels.padded];
    level.grid.values(y, &mut values);
    for (k, (x, row)) in level.grid.pixels().enumerate() {
        let facet = Facet::new([pixels.ray_x[k], pixels.ray_y[k]], [p[k], q[k]]);
        if pixels.weight[k] > 0.0 {
            for c in 0..pixels.channels {
                let r =
                    facet.shade(&pixels.light(c, k)).0 - pixels.intensity[c * pixels.padded + k];
                report.energy_shading += f64::from(pixels.weight[k] * r * r);
            }
        }
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

fn solve_view(
    view: &ShadingView,
    anchors: &[DepthAnchor],
    options: &PaperOptions,
    observer: &dyn Observer,
) -> Result<(SolvedView, ViewReport), ShadingError> {
    let begun = Instant::now();
    if view.mask.count() == 0 {
        return Err(ShadingError::EmptyMask {
            view: view.name.clone(),
            num_masked: 0,
            advice: "check the mask: white is the object",
        });
    }
    let reference =
        reference_depth(view, anchors, options).ok_or_else(|| ShadingError::NoDepth {
            view: view.name.clone(),
        })?;
    let prepared = prepare(view, options, reference)?;
    let geometry = prepared.geometry;
    let mut report = prepared.report.clone();
    let sigma = options.noise.max(view.noise.unwrap_or(0.0)) * prepared.white;
    let (mut y, anchors) = start_shape(view, &prepared, anchors, options, &mut report)?;
    let ties = ties(view, &prepared, &anchors, sigma);
    let explicit = options.schedule != PenaltySchedule::Automatic;
    let full = options.splitting == Splitting::Full;
    let max_levels = if options.coarse_to_fine && !explicit && full {
        MAX_LEVELS
    } else {
        1
    };
    let levels = ladder(
        prepared.grid,
        prepared.pixels,
        prepared.stiffness,
        max_levels,
        prepared.white,
    );
    let finest = &levels[0];
    let mut p = vec![0.0; finest.pixels.padded];
    let mut q = p.clone();
    slopes(&finest.grid, geometry.aspect, &y, &mut p, &mut q);
    report.rms_start = rms_residual(&finest.pixels, &p, &q);
    let known = Informativeness::of(&finest.pixels, &p, &q, sigma);
    report.informativeness = known.squared[1].sqrt();
    let courses = schedule(options, levels.len(), &known, !ties.is_empty());
    report.beta_start = courses.first().map_or(0.0, |course| course.beta_start);
    report.seconds.start = begun.elapsed().as_secs_f64();
    let method = match options.splitting {
        Splitting::Full => None,
        Splitting::Paper => Some(linearized::Method::Splitting),
        Splitting::FixedPoint => Some(linearized::Method::FixedPoint),
    };
    let mut solved_fully = None;
    match method {
        None => {
            let setting = Setting {
                ties: &ties,
                area: options.area_weight as f32,
                loss: options.loss,
                white: prepared.white as f32,
                aspect: geometry.aspect,
                edge_beta: (options.depth_edges && known.determined()).then(|| normal_beta(sigma)),
                courses: &courses,
                observer,
            };
            let mut outcome = splitting::solve(&levels, &mut y, &setting)?;
            report.num_depth_breaks += outcome.num_breaks;
            report.iterations = std::mem::take(&mut outcome.records);
            report.seconds.theta = outcome.seconds.theta;
            report.seconds.z = outcome.seconds.z;
            report.termination = Some(Termination::ScheduleEnded);
            solved_fully = Some(outcome);
        }
        Some(method) => {
            let setting = linearized::Setting {
                method,
                ties: &ties,
                aspect: geometry.aspect,
                white: prepared.white,
                max_num_iterations: options.max_num_iterations,
                relative_tolerance: options.relative_tolerance,
                observer,
            };
            let (records, termination) = linearized::solve(finest, &mut y, &setting)?;
            report.iterations = records;
            report.termination = Some(termination);
        }
    }
    slopes(&finest.grid, geometry.aspect, &y, &mut p, &mut q);
    energies(view, finest, &geometry, options, &y, (&p, &q), &mut report);
    // The paper's methods give the surface's own normals; the full splitting draws them to shading.
    if let Some(outcome) = solved_fully {
        (p, q) = refine_slopes(finest, &geometry, sigma, &y, outcome);
    }
    report.rms_rendered = rms_residual(&finest.pixels, &p, &q);
    let confidence = options.confidence.then(|| {
        let surface = surface_slopes(finest, &geometry, &y);
        confidence::map(
            (view.image.width, view.image.height),
            finest,
            (&p, &q),
            (&surface.0, &surface.1),
            sigma,
        )
    });
    let mut solved = maps(
        &view.name,
        (view.image.width, view.image.height),
        finest,
        &geometry,
        &y,
        (&p, &q),
    );
    solved.confidence = confidence;
    report.seconds.total = begun.elapsed().as_secs_f64();
    Ok((solved, report))
}
