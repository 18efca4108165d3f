//! The error covariance of one observation, and errors correlated from one observation to others.

use std::fmt;
use std::sync::Arc;
use varda_covariance::{Covariance, Kernel, Precision};

/// The error covariance R_k of one observation whose rows have correlated errors; shared by all observations
/// of one instrument.
#[derive(Clone)]
pub struct Correlated(pub(crate) Arc<dyn Precision + Send + Sync>);

impl Correlated {
    /// R_k.
    pub fn covariance(&self) -> &dyn Precision {
        &*self.0
    }
}

impl fmt::Debug for Correlated {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "Correlated({} rows)", self.0.dim())
    }
}

/// Equal if they are the same object.
impl PartialEq for Correlated {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::addr_eq(Arc::as_ptr(&self.0), Arc::as_ptr(&other.0))
    }
}

/// Errors that are correlated along a line, from one observation to others: those of one marker in time, or
/// those of many at one time along a rod.
///
/// R_ij = σ_i σ_j k(|s_i − s_j|) for values of the same chain, with a Matérn kernel k and s_i the
/// place of a value on the line; 0 for values of different chains. R^{-1/2} is a recursion along the chain
/// ([`Markov`](varda_covariance::Markov)): O(m). A chain of which values are left out is the chain of the
/// rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// k, Matérn with its length in the unit of the places.
    pub kernel: Kernel,
    /// The chain of each row, and its place on it.
    pub entries: Vec<(usize, f64)>,
}
