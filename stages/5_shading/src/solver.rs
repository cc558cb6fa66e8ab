//! Driver: prepares the views, solves each, and gathers maps and report.

use crate::error::ShadingError;
use crate::levels::ladder;
use crate::options::{PenaltySchedule, ShadingOptions};
use crate::prepare::prepare;
use crate::problem::{ShadingProblem, ShadingView};
use crate::result::{maps, rms_residual};
use crate::solution::{ShadingReport, ShadingSolution, SolvedView, Termination, ViewReport};
use crate::splitting::{self, Course, Schedule, Setting, Ties, slopes};
use crate::start;
use rilievo_numerics::robust::median;
use rilievo_scene::Observer;
use std::time::Instant;

/// Most levels of the ladder.
const MAX_LEVELS: usize = 4;

pub(crate) fn solve(
    problem: &ShadingProblem,
    options: &ShadingOptions,
    observer: &dyn Observer,
) -> Result<ShadingSolution, ShadingError> {
    options.validate()?;
    if problem.views.is_empty() {
        return Err(ShadingError::NoViews);
    }
    let mut views = Vec::new();
    let mut report = ShadingReport::default();
    for view in &problem.views {
        let (solved, facts) = solve_view(view, options, observer)?;
        views.push(solved);
        report.views.push(facts);
    }
    Ok(ShadingSolution { views, report })
}

/// Depth that fixes the unknown's zero: the median of what is known.
fn reference_depth(view: &ShadingView) -> Option<f64> {
    let mut known: Vec<f64> = view.anchors.iter().map(|a| a.depth).collect();
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

fn solve_view(
    view: &ShadingView,
    options: &ShadingOptions,
    observer: &dyn Observer,
) -> Result<(SolvedView, ViewReport), ShadingError> {
    let begun = Instant::now();
    let reference = reference_depth(view).ok_or_else(|| ShadingError::NoDepth {
        view: view.name.clone(),
    })?;
    let prepared = prepare(view, options, reference)?;
    let geometry = prepared.geometry;
    let mut report = prepared.report;
    let max_levels = if options.coarse_to_fine {
        MAX_LEVELS
    } else {
        1
    };
    let levels = ladder(prepared.grid, prepared.pixels, max_levels);
    let finest = &levels[0];
    let mut y = match &view.initial_depth {
        Some(depth) => start::from_depth(&finest.grid, &geometry, depth),
        None => vec![0.0; finest.grid.padded_len()],
    };
    let mut p = vec![0.0; finest.pixels.padded];
    let mut q = p.clone();
    slopes(&finest.grid, geometry.aspect, &y, &mut p, &mut q);
    report.rms_start = rms_residual(&finest.pixels, &p, &q);
    let schedule = match options.schedule {
        PenaltySchedule::Automatic => Schedule {
            beta_start: 0.02,
            growth: 1.1,
            courses: vec![Course {
                num_iterations: 40,
                num_search_iterations: 0,
            }],
        },
        PenaltySchedule::Explicit {
            start,
            growth,
            num_iterations,
            num_search_iterations,
        } => {
            let mut courses = vec![];
            let env = std::env::var("COURSES").unwrap_or(format!("{num_iterations}"));
            for (i, n) in env.split(',').enumerate() {
                courses.push(Course {
                    num_iterations: n.parse().unwrap_or(0),
                    num_search_iterations: if i == 0 { num_search_iterations } else { 0 },
                });
            }
            Schedule {
                beta_start: start,
                growth,
                courses,
            }
        }
    };
    let ties = Ties::default();
    let setting = Setting {
        ties: &ties,
        area: options.area_weight as f32,
        aspect: geometry.aspect,
        schedule: &schedule,
        observer,
    };
    report.seconds.start = begun.elapsed().as_secs_f64();
    let outcome = splitting::solve(&levels, &mut y, &setting)?;
    report.rms_rendered = rms_residual(&finest.pixels, &outcome.p, &outcome.q);
    report.iterations = outcome.records;
    report.seconds.theta = outcome.seconds.theta;
    report.seconds.z = outcome.seconds.z;
    report.termination = Some(Termination::ScheduleEnded);
    let solved = maps(
        &view.name,
        (view.image.width, view.image.height),
        finest,
        &geometry,
        &y,
        (&outcome.p, &outcome.q),
    );
    report.seconds.total = begun.elapsed().as_secs_f64();
    Ok((solved, report))
}
