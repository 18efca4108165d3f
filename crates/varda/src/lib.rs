//! Scenes, twin experiments, real observations and reports for variational data assimilation; the command line `varda`.
pub mod check;
pub mod cli;
pub mod covariance;
pub mod csv_input;
mod error;
pub mod fit;
pub mod output;
pub mod problem;
pub mod report;
pub mod rod_model;
pub mod rod_observation;
pub mod run;
pub mod scene;
pub mod timed;
pub mod twin;

pub use error::Error;
