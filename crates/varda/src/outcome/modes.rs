//! Natural modes of a rod.

use varda_rod::Modes;

/// The natural modes of a rod about its shape at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct RodModes {
    /// Name of the scene.
    pub name: String,
    /// Time at which its supports stand \[s\].
    pub time: f64,
    /// Arc length of every vertex \[m\].
    pub arc_lengths: Vec<f64>,
    /// Place of every vertex at rest \[m\].
    pub vertices: Vec<[f64; 3]>,
    /// The modes.
    pub found: Modes,
}
