//! What is done with a problem: one window assimilated or run forward, many windows in turn, methods
//! compared.

mod amplification;
mod between_steps;
pub mod compare;
mod considered;
mod covariances;
mod cycle_checks;
mod cycle_runs;
pub mod cycles;
mod departure_series;
pub mod departures;
mod estimates;
mod fit;
mod interrupted;
mod members;
mod mesh;
mod model_errors;
mod modes;
mod next_observation;
mod passes;
mod recordings;
mod second_minimum;
mod seen_spread;
mod sequence;
mod shapes;
mod shares;
mod simulate;
mod sources;
mod spread;
mod verdict;
pub mod window;

pub use modes::modes;
pub use passes::assimilate;
pub use recordings::assimilate_recordings;
pub use simulate::simulate;
pub use window::Listener;
