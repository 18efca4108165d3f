//! Scenes, twin experiments, real observations and reports for variational data assimilation; the command line `varda`.
//!
//! The crate is the one that knows all the others. It reads a scene (TOML), builds a model, a background, its covariance and
//! the observations from it, minimises the cost, and writes numbers, figures and a report:
//!
//! ```text
//! scene ──> problem ──> outcome ──> report
//! scene::SceneFile   setup::problem::Problem   run::window::assimilate   report::write
//! ```
//!
//! Every stage is plain data and can be used alone; `main.rs` only calls [`cli::main`].
//!
//! # When not to use it
//!
//! To assimilate into a model of your own, take `varda-assimilation` and implement `Model`: no scene is needed, and nothing
//! here is. To simulate a rod, take `varda-rod`.
//!
//! # Range
//!
//! What is accurate is what the crates below say of themselves; here are the bounds of scenes. Beyond them is an [`Error`] that names the key, file,
//! line or step.
//!
//! - Numbers: 0, or between 1e-50 and 1e50 in size. A scene has at most 1 MiB, a CSV file 256 MiB.
//! - Runs: at most 1e7 steps, 1e9 numbers in the states of a run, 1e7 observed values. Memory is counted before anything is built ([`memory`](setup::memory)) and held
//!   against `[limits] memory`, 8 GB where it is not given: within some 10 MB of what a process takes. B of a rod is two dense blocks: 5000 segments
//!   take 1.8 GB; σ of its analysis takes five dense matrices of the control, 0.8 GB for 700 segments, 8 GB for 2300.
//! - Windows: a gradient is right to about ε‖M‖. Every run of a strong constraint estimates it ([`run::window::Outcome::amplification`]) and warns beyond 1e-4:
//!   some 22 time units of Lorenz-63, 16 of Lorenz-96. There the Hessian can be indefinite by rounding: an analysis without posterior, which says so.
//! - Folders: a result is whole or absent, whatever ends the run and whenever; runs into one folder at a time replace one another. Renaming and locks
//!   are those of a local file system; on one without locks the hidden folders of killed runs stay.
//!
//! # Example
//!
//! A twin experiment with Lorenz's three equations, without files:
//!
//! ```
//! use std::time::Instant;
//! use varda::{setup::problem::Problem, run::window::{Listener, Status, assimilate}, scene::SceneFile};
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

pub mod cli;
mod error;
pub mod outcome;
pub mod report;
pub mod run;
pub mod scene;
pub mod setup;
pub mod solve;
pub mod state;

pub use error::Error;

/// The README's example, compiled and run as a test.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
