//! From a scene to a [`Problem`](problem::Problem): model, background, covariance, observations.

pub(crate) mod adaptive_steps;
pub mod climatology;
mod component_model;
pub mod covariance;
pub mod csv;
pub mod ensemble;
pub mod memory;
pub mod plan;
pub mod problem;
pub mod random;
pub mod rod_model;
pub mod rod_observations;
