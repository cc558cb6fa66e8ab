//! The native part of the Python package `rilievo`: the program's commands, from and to NumPy arrays.
//!
//! What people call is in `python/rilievo/*.py`; functions here take arguments in one form only. Work is done
//! without Python's lock, on threads of its own, while the calling thread passes news on and answers signals.
//! Nothing here panics across the boundary: failures are exceptions.

mod arrays;
mod failures;
mod results;
mod views;
mod working;

use arrays::{image_array, map_array, normal_array};
use failures::raised;
use pyo3::prelude::*;
use results::RunResults;
use rilievo::embedded::{self, ShadeRequest, SolvedView};
use std::ffi::OsString;
use std::path::PathBuf;
use working::work;

/// Runs `reconstruct` or `synth` with the arguments of its command line; `on_news` takes `(kind, text)`.
#[pyfunction]
fn run_command(
    py: Python<'_>,
    arguments: Vec<OsString>,
    on_news: &Bound<'_, PyAny>,
) -> PyResult<()> {
    work(py, on_news, |stop, tell| {
        embedded::run_command(&arguments, stop, tell)
    })
}

/// Runs `evaluate` with the arguments of its command line; its result as JSON.
#[pyfunction]
fn evaluate(
    py: Python<'_>,
    arguments: Vec<OsString>,
    on_news: &Bound<'_, PyAny>,
) -> PyResult<String> {
    work(py, on_news, |stop, tell| {
        Ok(embedded::evaluate(&arguments, stop, tell)?.to_string())
    })
}

/// Shapes views; a tuple `(depth, normals, rendered, confidence)` for each, and the report as JSON.
#[pyfunction]
fn shade<'py>(
    py: Python<'py>,
    views: Vec<views::View<'py>>,
    matches: Vec<views::Match<'py>>,
    options: Vec<OsString>,
    on_news: &Bound<'py, PyAny>,
) -> PyResult<(Vec<ShadedTuple<'py>>, String)> {
    let num_views = views.len();
    let request = ShadeRequest {
        views: views
            .into_iter()
            .map(|view| view.read(py))
            .collect::<PyResult<_>>()?,
        matches: matches
            .into_iter()
            .map(|found| found.read(py, num_views))
            .collect::<PyResult<_>>()?,
        options,
    };
    let (shaded, report) = work(py, on_news, |stop, tell| {
        embedded::shade(request, stop, tell)
    })?;
    let shaded: PyResult<_> = shaded.into_iter().map(|view| arrays_of(py, view)).collect();
    Ok((shaded?, report.to_string()))
}

/// Depth, normals, rendered image, confidence.
type ShadedTuple<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
);

fn arrays_of(py: Python<'_>, view: SolvedView) -> PyResult<ShadedTuple<'_>> {
    Ok((
        map_array(py, view.depth)?,
        normal_array(py, view.normal)?,
        image_array(py, view.rendered)?,
        map_array(py, view.confidence)?,
    ))
}

/// Has camera RAW files decoded by another process: a program with its arguments, to which a name is added, that calls
/// `decode_raw`.
#[pyfunction]
fn decode_raw_with(program: Vec<OsString>) {
    embedded::decode_raw_with(program);
}

/// Decodes the RAW file on stdin to stdout and ends the process.
#[pyfunction]
fn decode_raw(name: PathBuf) {
    std::process::exit(embedded::decode_raw(&name).into())
}

/// Opens a run directory to read it.
#[pyfunction]
fn open_run(py: Python<'_>, path: PathBuf) -> PyResult<RunResults> {
    let opened = py.detach(|| embedded::RunResults::open(&path));
    opened
        .map(RunResults)
        .map_err(|failure| raised(py, &failure))
}

/// The native part of the package.
#[pymodule]
fn _rilievo(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(run_command, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(shade, module)?)?;
    module.add_function(wrap_pyfunction!(decode_raw_with, module)?)?;
    module.add_function(wrap_pyfunction!(decode_raw, module)?)?;
    module.add_function(wrap_pyfunction!(open_run, module)?)?;
    module.add_class::<RunResults>()
}
