//! Errors of the library as exceptions of Python, with the text of the command line.

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use varda::Error;

create_exception!(varda_da, VardaError, PyException, "Anything that stops a scene or an assimilation.");
create_exception!(varda_da, SceneError, VardaError, "A scene says something impossible, or is not there.");
create_exception!(varda_da, DataError, VardaError, "A file of data cannot be read or used.");
create_exception!(varda_da, ResultError, VardaError, "A result cannot be written.");
create_exception!(varda_da, ModelError, VardaError, "The model stopped, or refuses a state.");
create_exception!(varda_da, AssimilationError, VardaError, "The assimilation stopped, or cannot be set up.");

/// All classes, by name.
pub(crate) fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("VardaError", py.get_type::<VardaError>())?;
    module.add("SceneError", py.get_type::<SceneError>())?;
    module.add("DataError", py.get_type::<DataError>())?;
    module.add("ResultError", py.get_type::<ResultError>())?;
    module.add("ModelError", py.get_type::<ModelError>())?;
    module.add("AssimilationError", py.get_type::<AssimilationError>())
}

/// The exception of an error.
pub(crate) fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Scene { .. } | Error::NoScene { .. } => SceneError::new_err(text),
        Error::Data { .. } | Error::Read { .. } => DataError::new_err(text),
        Error::Write { .. }
        | Error::Occupied { .. }
        | Error::Unfinished { .. }
        | Error::Resume { .. }
        | Error::Plot { .. } => ResultError::new_err(text),
        Error::Rod(_) | Error::Preparation { .. } | Error::Model(_) => ModelError::new_err(text),
        Error::Covariance(_) | Error::Assimilation(_) => AssimilationError::new_err(text),
        _ => VardaError::new_err(text),
    }
}
