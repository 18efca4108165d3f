//! Work space of covariances made of others.

use std::sync::{Mutex, PoisonError};

/// A buffer behind one lock: share a covariance between threads freely, clone it where they would wait for
/// each other.
#[derive(Debug)]
pub(crate) struct Scratch(Mutex<Vec<f64>>);

impl Scratch {
    pub(crate) fn new(length: usize) -> Self {
        Self(Mutex::new(vec![0.0; length]))
    }

    /// Nothing in the buffer outlives a call, so that a panic in another one did no harm.
    pub(crate) fn with(&self, act: impl FnOnce(&mut [f64])) {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn length(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).len()
    }
}

impl Clone for Scratch {
    fn clone(&self) -> Self {
        Self::new(self.length())
    }
}
