//! The command line `varda`.
fn main() {}
