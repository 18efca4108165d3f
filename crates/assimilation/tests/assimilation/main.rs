//! Tests of the crate through its public face.

mod cost;
mod family;
mod fixtures;
mod matrix;
mod minima;
mod minimizers;
mod models;
mod observations;
mod weak;
mod posteriors;
