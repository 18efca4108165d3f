//! What is done with a problem: one window assimilated or simulated, many windows in turn, methods compared.

pub(crate) mod amplification;
pub mod compare;
pub mod cycles;
pub mod fit;
pub mod window;
