//! Discrete elastic rods: energies with exact gradients and Hessians, dynamics, statics.

mod damping;
mod dynamics;
mod element;
mod energy;
mod equilibrium;
mod error;
mod geometry;
mod layout;
mod marker;
mod material;
mod predict;
mod rod;
mod shape;
mod support;
mod system;

pub use dynamics::{BackwardEuler, TwistUnknowns};
pub use energy::{Derivatives, Energy, Framed, derivatives};
pub use equilibrium::{Rest, equilibrium, straight_guess};
pub use error::Error;
pub use marker::{Marker, Markers};
pub use material::{Material, Section};
pub use rod::{Place, Rod};
pub use support::{Clamp, Damping, EllipseDrive, Loads, Motion, Supports};
