//! Tests of the crate through its public face.

mod between;
mod correlated;
mod cost;
mod coverage;
mod cycle_checks;
mod cycles;
mod cycles_along_a_line;
mod endings;
mod ensemble;
mod envar_status;
mod family;
mod fixtures;
mod growth;
mod honest;
mod matrix;
mod minima;
mod minimizers;
mod models;
mod nothing;
mod observations;
mod posteriors;
mod robust;
mod short_form;
mod state_length;
mod storage;
mod weak;
