//! Failures as exceptions of the package, whose classes are Python's.

use pyo3::prelude::*;
use rilievo::embedded::CommandFailure;

/// Module of the exception classes.
const ERRORS: &str = "rilievo._errors";

/// The exception of a failed command.
pub fn raised(py: Python<'_>, failure: &CommandFailure) -> PyErr {
    if failure.exit_code == CommandFailure::INTERRUPTED {
        return pyo3::exceptions::PyKeyboardInterrupt::new_err(failure.message.clone());
    }
    let exception = py.import(ERRORS).and_then(|errors| {
        let problems = failure.problems.clone();
        errors.call_method1("of_code", (failure.exit_code, &failure.message, problems))
    });
    exception.map_or_else(|error| error, PyErr::from_value)
}

/// The exception of an argument with values or a shape that cannot be used.
pub fn unusable(py: Python<'_>, message: String) -> PyErr {
    raised(py, &CommandFailure::new(CommandFailure::INPUT, message))
}

/// The exception of an argument of a wrong type.
pub fn wrong_type(py: Python<'_>, message: String) -> PyErr {
    let exception = py
        .import(ERRORS)
        .and_then(|errors| errors.call_method1("InputTypeError", (message,)));
    exception.map_or_else(|error| error, PyErr::from_value)
}
