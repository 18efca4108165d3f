//! Tests of the crate through its public face.

mod cost;
mod ensemble;
mod fixtures;
mod minima;
mod models;
mod observations;
