//! Natural modes of a rod.

use varda_rod::{Mode, Modes};

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
    /// Inertia of every edge against spin \[kg m²\]; empty where twist is massless.
    pub spin_inertia: Vec<f64>,
    /// Radius of gyration about the tangent, √(ΣI/Σm) \[m\].
    pub gyration: f64,
    /// The modes.
    pub found: Modes,
}

impl RodModes {
    /// Whether sections have inertia against spin.
    pub fn spins(&self) -> bool {
        !self.spin_inertia.is_empty()
    }

    /// What share of the kinetic energy of a mode is that of spins: one for a mode of twist alone.
    pub fn spin_share(&self, mode: &Mode) -> f64 {
        self.spin_inertia.iter().zip(&mode.turns).map(|(i, turn)| i * turn * turn).sum()
    }
}
