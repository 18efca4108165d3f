//! Variational data assimilation.

mod analysis;
mod control;
mod cost;
mod error;
mod minimize;
mod observation;
mod posterior;

pub use analysis::Analysis;
pub use control::ControlTransform;
pub use cost::{CostFunction, CostTerms, Counts, GaussNewton, StrongConstraint};
pub use error::Error;
pub use minimize::{
    Iteration, Minimizer, Minimum, NewtonCgOptions, NewtonOptions, RitzPair, Status, TrustRegionOptions,
    continuation, newton, newton_cg, trust_region,
};
pub use observation::{LinearObservation, Observation, ObservationOperator, ObservationSet, Selection};
pub use posterior::Posterior;
