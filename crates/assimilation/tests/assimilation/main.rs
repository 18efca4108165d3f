//! Tests of the crate through its public face.

mod cost;
mod coverage;
mod cycles;
mod ensemble;
mod family;
mod fixtures;
mod growth;
mod matrix;
mod minima;
mod minimizers;
mod models;
mod observations;
mod posteriors;
mod robust;
mod state_length;
mod storage;
mod weak;
