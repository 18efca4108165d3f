//! Tests of the crate through its public face.

mod cost;
mod fixtures;
mod minima;
mod minimizers;
mod models;
mod observations;
mod posteriors;
