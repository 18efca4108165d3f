//! An unknown constant, and what of a rod it changes.

use varda_rod::{Change, Damping, Law};

/// An unknown constant: a number p of the control whose prior is N(0, σ²).
#[derive(Debug, Clone, PartialEq)]
pub struct Constant {
    /// Its name, as `ei[0]`.
    pub name: String,
    /// Its SI unit; "1" for none.
    pub unit: &'static str,
    /// Its value at p = 0.
    pub value: f64,
    /// Linear: the constant is `value` + p. Exponential: it is `value` eᵖ.
    pub law: Law,
    /// σ of p.
    pub sigma: f64,
}

/// How the names of constants begin in the control.
const OF_CONTROL: [&str; 2] = ["change of ", "ln of "];

/// Whether this is the name of a constant's number in the control, and of no component of the state.
pub(crate) fn is_of_constant(name: &str) -> bool {
    OF_CONTROL.iter().any(|start| name.starts_with(start))
}

impl Constant {
    /// Name and unit of its number in the control.
    pub(crate) fn of_control(&self) -> (String, &'static str) {
        let [change, ln] = OF_CONTROL;
        match self.law {
            Law::Linear => (format!("{change}{}", self.name), self.unit),
            Law::Exponential => (format!("{ln}{} over its prior", self.name), "1"),
        }
    }

    /// The constant at p.
    pub fn at(&self, p: f64) -> f64 {
        match self.law {
            Law::Linear => self.value + p,
            Law::Exponential => self.value * p.exp(),
        }
    }

    /// Its derivative by p.
    pub(crate) fn slope_at(&self, p: f64) -> f64 {
        match self.law {
            Law::Linear => 1.0,
            Law::Exponential => self.at(p),
        }
    }

    /// The number p at which the constant has a value.
    pub(crate) fn number_of(&self, value: f64) -> f64 {
        match self.law {
            Law::Linear => value - self.value,
            Law::Exponential => (value / self.value).ln(),
        }
    }

    /// Its σ where that of p is `sigma`, to first order about p.
    pub fn sigma_at(&self, p: f64, sigma: f64) -> f64 {
        match self.law {
            Law::Linear => sigma,
            Law::Exponential => self.at(p).abs() * sigma,
        }
    }
}

/// A constant of a rod.
pub(super) struct Kind {
    pub(super) name: String,
    pub(super) unit: &'static str,
    pub(super) value: f64,
    pub(super) change: Effect,
}

/// What a constant changes.
pub(super) enum Effect {
    /// At its full value: the change is proportional to it.
    Share(Change),
    /// Where it grows by one unit.
    Unit(Change),
}

/// The change times a factor.
pub(super) fn times(change: Change, factor: f64) -> Change {
    let scaled = |v: Vec<f64>| v.into_iter().map(|v| factor * v).collect();
    Change {
        ea: scaled(change.ea),
        ei: change.ei.into_iter().map(|k| k.map(|k| factor * k)).collect(),
        gj: scaled(change.gj),
        natural_curvature: change.natural_curvature.into_iter().map(|k| k.map(|k| factor * k)).collect(),
        natural_twist: scaled(change.natural_twist),
        masses: scaled(change.masses),
        spin_inertia: scaled(change.spin_inertia),
        damping: Damping { stiffness: factor * change.damping.stiffness, mass: factor * change.damping.mass },
        gravity: change.gravity * factor,
        gravity_turn: change.gravity_turn * factor,
        supports: change.supports.into_iter().map(|moved| moved.times(factor)).collect(),
    }
}
