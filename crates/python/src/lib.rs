//! The Python module `varda_da._core`: what the package `varda_da` is made of. The package itself, with its
//! documentation, is in `python/varda_da`.

#![forbid(unsafe_op_in_unsafe_fn)]

mod assimilate;
mod cycle;
mod error;
mod model;
mod outcome;
mod problem;
mod rod;
mod scene;
mod signals;

use pyo3::prelude::*;

/// Functions and classes in compiled form.
#[pymodule]
mod _core {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::assimilate::{AnalysisOf, analyse, check_model};
    #[pymodule_export]
    use crate::cycle::{Between, cycle_window};
    #[pymodule_export]
    use crate::outcome::{Outcome, Simulation};
    #[pymodule_export]
    use crate::rod::Rod;
    #[pymodule_export]
    use crate::scene::{check, modes, run, scenes, show, simulate};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        crate::error::add(module)
    }
}
