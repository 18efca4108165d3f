//! Discrete elastic rods.
