//! The error covariance of one observation.

use std::fmt;
use std::sync::Arc;
use varda_covariance::{Covariance, Precision};

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
