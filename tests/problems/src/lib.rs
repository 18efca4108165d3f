//! Problems that the verification suites and the benchmarks of Varda share: hanging and driven rods, small
//! windows, one assembled cost for every kind of model and for every method.

pub mod allocations;
pub mod costs;
pub mod counted;
pub mod long_rod;
pub mod methods;
pub mod recordings;
pub mod registers;
pub mod rods;
mod scene;
pub mod small_problems;
pub mod statics;
