//! Scenes, twin experiments, real observations and reports for variational data assimilation; the command line `varda`.
//!
//! The crate is the one that knows all the others. It reads a scene (TOML), builds a model, a background, its covariance and
//! the observations from it, minimises the cost, and writes numbers, figures and a report:
//!
//! ```text
//! scene ──> problem ──> outcome ──> report
//! scene::SceneFile   problem::Problem   run::assimilate   report::write
//! ```
//!
//! Every stage is plain data and can be used alone; `main.rs` only calls [`cli::main`].
//!
//! # When not to use it
//!
//! To assimilate into a model of your own, take `varda-assimilation` and implement `Model`: no scene is needed, and nothing
//! here is. To simulate a rod, take `varda-rod`.
//!
//! # Example
//!
//! A twin experiment with Lorenz's three equations, without files:
//!
//! ```
//! use std::time::Instant;
//! use varda::{problem::Problem, run::{Listener, Status, assimilate}, scene::SceneFile};
//!
//! let file = SceneFile::open("lorenz63", &["seed=3".to_string()])?;
//! let mut problem = Problem::from_scene(&file)?;
//! let mut listener = Listener { on_iteration: &mut |_| {}, interrupted: &|| false, started: Instant::now() };
//! let outcome = assimilate(&mut problem, &mut listener)?;
//!
//! assert_eq!(outcome.status, Status::Converged);
//! assert!(outcome.rmse.position_analysis < outcome.rmse.position_background);
//! # Ok::<(), varda::Error>(())
//! ```

#![forbid(unsafe_code)]

pub mod check;
pub mod cli;
pub mod climatology;
pub mod compare;
mod component_model;
pub mod covariance;
pub mod csv_input;
pub mod cycles;
mod divided;
pub mod ensemble;
mod error;
pub mod fit;
mod horizon;
pub mod memory;
mod method;
pub mod output;
pub mod partial;
pub mod problem;
pub mod report;
pub mod rod_model;
pub mod rod_observation;
pub mod run;
pub mod scene;
pub mod timed;
pub mod twin;

pub use error::Error;

/// The README's example, compiled and run as a test.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
