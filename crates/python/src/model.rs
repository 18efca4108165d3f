//! A model written in Python.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex};
use varda_implicit::{ControlMap, Error, Model, Refusal, Work};
use varda_linalg::interrupt::Ends;

use crate::error::VardaError;

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

    /// The exception of the model, if there is one, in the place of what became of it.
    pub(crate) fn or<T>(&self, result: PyResult<T>) -> PyResult<T> {
        self.take().map_or(result, Err)
    }

    /// The same, but a signal of Python that ended the run goes first.
    pub(crate) fn or_interrupted<T>(&self, py: Python<'_>, result: PyResult<T>) -> PyResult<T> {
        match result {
            Err(error) if !error.is_instance_of::<VardaError>(py) => Err(error),
            result => self.or(result),
        }
    }
}

/// An object with `step(k, x)` and, unless the method does without, `tangent(k, x, dx)` and
/// `adjoint(k, x, dy)`.
pub(crate) struct PythonModel {
    object: Py<PyAny>,
    dim: usize,
    /// The step of a long run that step 0 is.
    first: usize,
    /// Whether `tangent` and `adjoint` take several vectors at once, one a row.
    batched: bool,
    raised: Raised,
    /// Whether the run is to end; `None`: it ends with the exceptions of the object alone.
    ends: Option<Ends>,
    /// The step and the state that each slot is linearized at.
    slots: Vec<Option<(usize, Vec<f64>)>>,
}

impl PythonModel {
    pub(crate) fn new(object: Py<PyAny>, dim: usize, raised: Raised) -> Self {
        let batched = Python::attach(|py| {
            let batched = object.bind(py).getattr("batched").and_then(|b| b.is_truthy());
            batched.unwrap_or(false)
        });
        PythonModel { object, dim, first: 0, batched, raised, ends: None, slots: Vec::new() }
    }

    /// The same, whose step 0 is a later step of a long run.
    pub(crate) fn from(self, first: usize) -> Self {
        PythonModel { first, ..self }
    }

    /// The same, whose steps are refused once `ends` says so.
    pub(crate) fn ending(self, ends: Ends) -> Self {
        PythonModel { ends: Some(ends), ..self }
    }

    /// Calls a function of the object with a state and, beside `step`, one vector or several.
    fn call(&self, name: &str, k: usize, x: &[f64], vectors: Option<&[f64]>) -> PyResult<Vec<f64>> {
        Python::attach(|py| {
            let (object, k) = (self.object.bind(py), self.first + k);
            let x = PyArray1::from_slice(py, x);
            let what = format!("{name}({k}, …)");
            let Some(vectors) = vectors else {
                return numbers(&object.call_method1(name, (k, x))?, &what, &[self.dim]);
            };
            let shape = [vectors.len() / self.dim, self.dim];
            let shape = if self.batched { &shape[..] } else { &shape[1..] };
            let vectors = PyArray1::from_slice(py, vectors).reshape(shape)?;
            numbers(&object.call_method1(name, (k, x, vectors))?, &what, shape)
        })
    }

    /// A product with one or several columns. What comes after an exception is not looked at.
    fn product(&self, name: &str, slot: usize, columns: &mut [f64]) {
        let Some(Some((k, x))) = self.slots.get(slot) else {
            panic!("slot {slot} of the model is empty");
        };
        let at_once = if self.batched { columns.len() } else { self.dim };
        for vectors in columns.chunks_exact_mut(at_once.max(1)) {
            if self.raised.is_there() {
                vectors.fill(f64::NAN);
                continue;
            }
            match self.call(name, *k, x, Some(vectors)) {
                Ok(result) => vectors.copy_from_slice(&result),
                Err(error) => {
                    self.raised.keep(error);
                    vectors.fill(f64::NAN);
                }
            }
        }
    }
}

/// An array of a shape, or anything that NumPy makes one of, as finite or other numbers.
fn numbers(value: &Bound<'_, PyAny>, what: &str, shape: &[usize]) -> PyResult<Vec<f64>> {
    let py = value.py();
    let wrong =
        |e: &dyn std::fmt::Display| PyValueError::new_err(format!("{what} is no array of numbers: {e}"));
    let asarray = py.import("numpy")?.getattr("asarray")?;
    let array = asarray.call1((value, "float64")).map_err(|e| wrong(&e))?;
    let array: PyReadonlyArrayDyn<'_, f64> = array.extract().map_err(|e| wrong(&e))?;
    match (array.shape(), shape) {
        (found, shape) if found == shape => Ok(array.as_array().iter().copied().collect()),
        ([found], [n]) => Err(PyValueError::new_err(format!("{what} has {found} numbers, a state {n}"))),
        (found, shape) => {
            Err(PyValueError::new_err(format!("{what} has the shape {found:?}, what it is given {shape:?}")))
        }
    }
}

impl Model for PythonModel {
    fn dim(&self) -> usize {
        self.dim
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        if self.raised.is_there() || self.ends.as_ref().is_some_and(|ends| ends()) {
            return Err(Error::Refused { step: k, reason: Refusal::new("the run was told to end") });
        }
        match self.call("step", k, x, None) {
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
