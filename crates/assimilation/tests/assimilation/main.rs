//! Tests of the crate through its public face.

mod cost;
mod coverage;
mod cycles;
mod ensemble;
mod fixtures;
mod growth;
mod minima;
mod models;
mod observations;
mod robust;
