//! Scenes, twin experiments, real observations and reports for variational data assimilation; the command
//! line `varda`.
//!
//! This crate knows all the others. It reads a scene (TOML), builds models, a background, its covariance and
//! the observations from it, minimises the cost, and writes numbers, figures and a report. Its stages follow
//! one another, and a stage imports only those above it:
//!
//! | stage | from | to |
//! |---|---|---|
//! | [`scene`] | a TOML file | [`SceneFile`](scene::SceneFile): plain data, checked |
//! | [`setup`] | a scene and its files | [`Problem`](setup::Problem): models, x_b, B, observations |
//! | [`solve`] | a problem | the minimum of its cost over one window |
//! | [`run`] | a problem | [`Outcome`](outcome::Outcome): all that a report needs, plain data |
//! | [`sweep`] | a scene, values, seeds | [`Table`](sweep::table::Table): a process each, rows and means |
//! | [`report`] | an outcome | a folder with tables, figures and a page |
//! | [`cli`] | arguments | all of these, and messages |
//! | [`convert`] | a file of a motion-capture system | [`Recording`](convert::Recording): markers, to our CSV
//! |
//!
//! Every stage can be used alone; `main.rs` only calls [`cli::main`].
//!
//! # When not to use it
//!
//! To assimilate into a model of your own, use `varda-assimilation` and implement `Model`: you need no scene,
//! and nothing of this crate. To simulate a rod, use `varda-rod`.
//!
//! # Limits
//!
//! How accurate a method is stands with the crate that has it; here are the limits of scenes. Beyond them is
//! an [`Error`] that names the key, file, line or step.
//!
//! - Numbers: 0, or between 1e-50 and 1e50 in size. A scene has at most 1 MiB, a CSV file 256 MiB.
//! - Runs: at most 1e7 steps, 1e9 numbers in the states of a run, 1e7 observed values. Memory is counted
//!   before anything is built ([`memory`](setup::memory)) and compared with `[limits] memory`, 8 GB by
//!   default; a process takes some 10 MB more. B of a rod is two dense blocks: 5000 segments take 1.8 GB; σ
//!   of its analysis takes five dense matrices of the control, 0.8 GB for 700 segments, 8 GB for 2300.
//! - Windows: the relative error of a gradient is about ε‖M‖. Every run of a strong constraint estimates
//!   it ([`amplification`](outcome::Outcome::amplification)) and warns beyond 1e-4: some 22 time units of
//!   Lorenz-63, 16 of Lorenz-96. There the Hessian can be indefinite by rounding; the run then ends without a
//!   posterior and says why.
//! - Folders: a result is whole or absent, however and whenever a run ends; runs into one folder at the same
//!   time replace one another. This needs a local file system with renaming and locks; without locks the
//!   hidden folders of killed runs are not removed.
//!
//! # Example
//!
//! A twin experiment with Lorenz's three equations:
//!
//! ```
//! use varda::outcome::Status;
//! use varda::run::{Listener, assimilate};
//! use varda::scene::SceneFile;
//! use varda::setup::Problem;
//!
//! let file = SceneFile::open("lorenz63", &["seed=3".to_string()])?;
//! let problem = Problem::from_scene(&file)?;
//! let outcome = assimilate(&problem, &mut Listener::silent())?;
//!
//! assert_eq!(outcome.status, Status::Converged);
//! let rmse = outcome.rmse.of("state").expect("a Lorenz model has one group, its state");
//! assert!(rmse.analysis < rmse.background);
//! # Ok::<(), varda::Error>(())
//! ```

#![forbid(unsafe_code)]

pub mod cli;
pub mod convert;
mod error;
pub mod outcome;
pub mod preview;
pub mod report;
pub mod run;
pub mod scene;
pub mod setup;
pub mod solve;
pub mod state;
pub mod sweep;

pub use error::Error;

/// The README's example, compiled and run as a test.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
