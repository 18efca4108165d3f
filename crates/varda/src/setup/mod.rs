//! From a scene to a [`Problem`]: models, background, covariance, observations.

pub(crate) mod adaptive_steps;
mod clocked;
mod component_model;
mod component_observations;
mod component_rows;
pub mod components;
mod continuity;
pub mod covariance;
pub mod csv;
pub mod ensemble;
mod error_correlation;
pub mod estimate;
mod estimate_supports;
pub mod files;
pub(crate) mod finer;
pub mod inputs;
mod loads;
pub mod memory;
mod motion;
pub mod observations;
pub mod plan;
pub mod problem;
pub mod random;
mod reachable;
mod recorded_rows;
mod recording;
pub mod recording_scene;
pub mod rod;
pub mod rod_model;
pub mod rod_observations;
pub mod runs;
mod seen_with;
pub mod system;

pub use inputs::Inputs;
pub use plan::Plan;
pub use problem::Problem;
