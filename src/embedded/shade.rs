//! `rilievo shade` on arrays.

use super::arguments::parsed;
use super::failure::CommandFailure;
use super::host::{NewsSink, Stop, console, guarded, in_own_threads};
use crate::cli::Command;
use crate::commands::{Described, ViewParts, reporting, shade_options, solve_shading};
use rilievo_shading::paper::{SolvedView, ViewMatches};
use std::ffi::OsString;

/// Views to be solved together.
#[derive(Debug, Default)]
pub struct ShadeRequest {
    /// The views, all rasters of each of its photo's size.
    pub views: Vec<ViewParts>,
    /// Matches between them: indices of two views, and `[x1, y1, x2, y2]` in pixels.
    pub matches: Vec<([usize; 2], Vec<[f64; 4]>)>,
    /// Options of the command line (`--order=1`), without those that name files of views.
    pub options: Vec<OsString>,
}

/// Solves the views; answers with their shapes in order, and with what `rilievo shade` writes to
/// `report.json`.
///
/// # Errors
/// As the command line fails, with its exit code.
pub fn shade(
    request: ShadeRequest,
    stop: &Stop,
    news: NewsSink,
) -> Result<(Vec<SolvedView>, serde_json::Value), CommandFailure> {
    guarded(|| {
        // The scene and the folder are never looked at: the views are here, and so will the results
        // be.
        let mut arguments: Vec<OsString> = ["shade", "--output=-"].map(OsString::from).into();
        arguments.extend(request.options);
        arguments.extend(["--", "arrays"].map(OsString::from));
        let Command::Shade(args) = parsed(&arguments)? else {
            return Err(CommandFailure::usage("this is not `shade`"));
        };
        let console = console(stop, news);
        let (views, matches) = (request.views, request.matches);
        in_own_threads(args.work.threads, || {
            let (mut shaded, mut report) = (Vec::new(), serde_json::Value::Null);
            reporting(&console, serde_json::json!({}), |console| {
                let options = shade_options(&args)?;
                let mut described = Described::default();
                for view in views {
                    described.add(view, args.prior_weight, &options, console)?;
                }
                described.problem.matches = matches
                    .into_iter()
                    .map(|(views, pixels)| ViewMatches { views, pixels })
                    .collect();
                described.tell_of_matches(console);
                let solved = solve_shading(&described, &options, console, |_, view| {
                    shaded.push(view);
                    Ok(())
                })?;
                solved.report(console);
                report = solved.report;
                Ok(())
            })?;
            Ok((shaded, report))
        })
    })
}
