//! A model written in Python.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};
use varda_implicit::{ControlMap, Error, Model, Refusal, Work};
use varda_linalg::interrupt::Ends;

/// The first exception that a model raised.
#[derive(Clone, Default)]
pub(crate) struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    /// Keeps an exception, unless there is one.
    fn keep(&self, error: PyErr) {
        if let Ok(mut first) = self.0.lock() {
            first.get_or_insert(error);
        }
    }

    /// The exception.
    pub(crate) fn take(&self) -> Option<PyErr> {
        self.0.lock().ok().and_then(|mut first| first.take())
    }

    /// Whether there is one.
    pub(crate) fn is_there(&self) -> bool {
        self.0.lock().is_ok_and(|first| first.is_some())
    }
}

/// An object with `step(k, x)` and, unless the method does without, `tangent(k, x, dx)` and
/// `adjoint(k, x, dy)`.
pub(crate) struct PythonModel {
    object: Py<PyAny>,
    dim: usize,
    raised: Raised,
    /// Whether the run is to end; `None`: it ends with the exceptions of the object alone.
    ends: Option<Ends>,
    /// The step and the state that each slot is linearized at.
    slots: Vec<Option<(usize, Vec<f64>)>>,
}

impl PythonModel {
    pub(crate) fn new(object: Py<PyAny>, dim: usize, raised: Raised) -> Self {
        PythonModel { object, dim, raised, ends: None, slots: Vec::new() }
    }

    /// The same, whose steps are refused once `ends` says so.
    pub(crate) fn ending(self, ends: Ends) -> Self {
        PythonModel { ends: Some(ends), ..self }
    }

    /// Calls a function of the object; its result has the length of a state and only finite numbers.
    fn call(&self, name: &str, k: usize, vectors: &[&[f64]]) -> PyResult<Vec<f64>> {
        Python::attach(|py| {
            let of = |v: &[f64]| PyArray1::from_slice(py, v).into_any();
            let result = match vectors {
                [x] => self.object.bind(py).call_method1(name, (k, of(x)))?,
                [x, y] => self.object.bind(py).call_method1(name, (k, of(x), of(y)))?,
                _ => return Err(PyValueError::new_err("a function of a model takes one vector or two")),
            };
            let result = vector(&result, &format!("{name}({k}, …)"))?;
            if result.len() != self.dim {
                let text = format!("{name}({k}, …) has {} numbers, a state {}", result.len(), self.dim);
                return Err(PyValueError::new_err(text));
            }
            Ok(result)
        })
    }

    /// A product with one or several columns. What comes after an exception is not looked at.
    fn product(&self, name: &str, slot: usize, columns: &mut [f64]) {
        let Some(Some((k, x))) = self.slots.get(slot) else {
            panic!("slot {slot} of the model is empty");
        };
        for column in columns.chunks_exact_mut(self.dim) {
            if self.raised.is_there() {
                return column.fill(f64::NAN);
            }
            match self.call(name, *k, &[x, column]) {
                Ok(result) => column.copy_from_slice(&result),
                Err(error) => {
                    self.raised.keep(error);
                    column.fill(f64::NAN);
                }
            }
        }
    }
}

/// An array, or anything that NumPy makes one of, as numbers.
pub(crate) fn vector(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<f64>> {
    let py = value.py();
    let wrong =
        |e: &dyn std::fmt::Display| PyValueError::new_err(format!("{what} is no vector of numbers: {e}"));
    let asarray = py.import("numpy")?.getattr("asarray")?;
    let array = asarray.call1((value, "float64")).map_err(|e| wrong(&e))?;
    let array: PyReadonlyArray1<'_, f64> = array.extract().map_err(|e| wrong(&e))?;
    Ok(array.as_array().to_vec())
}

impl Model for PythonModel {
    fn dim(&self) -> usize {
        self.dim
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        if self.raised.is_there() || self.ends.as_ref().is_some_and(|ends| ends()) {
            return Err(Error::Refused { step: k, reason: Refusal::new("the run was told to end") });
        }
        match self.call("step", k, &[x]) {
            Ok(next) => {
                if !next.iter().all(|v| v.is_finite()) {
                    return Err(Error::NonFinite { step: k, what: "x_{k+1}" });
                }
                x_next.copy_from_slice(&next);
                Ok(Work::default())
            }
            Err(error) => {
                let reason = Refusal::new(error.to_string());
                self.raised.keep(error);
                Err(Error::Refused { step: k, reason })
            }
        }
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], _x_next: &[f64]) -> Result<Work, Error> {
        if self.slots.len() <= slot {
            self.slots.resize(slot + 1, None);
        }
        self.slots[slot] = Some((k, x.to_vec()));
        Ok(Work::default())
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.product("tangent", slot, dx);
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.product("adjoint", slot, lambda);
    }

    fn release(&mut self, from_slot: usize) {
        self.slots.truncate(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        8 * self.dim
    }

    fn bytes(&self) -> usize {
        self.slot_bytes() * self.slots.iter().flatten().count()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }
}
