//! What is done with a problem: one window assimilated or run forward, many windows in turn, methods
//! compared.

mod amplification;
pub mod compare;
pub mod cycles;
mod fit;
mod modes;
mod shapes;
pub mod window;

pub use modes::modes;
pub use window::{Listener, assimilate, simulate};
