//! Sensors of forces that read the start of a window.

use super::finding::Finding;
use crate::outcome::Quantity;
use crate::setup::Inputs;

/// Steps that damp what a start strains a rod by: a step of backward Euler or BDF2 takes most of an axial
/// vibration, whose period is much shorter.
const STEPS: f64 = 2.0;

/// The first reading of a force or an acceleration, where it is of the start itself.
pub(super) fn reading(inputs: &Inputs) -> Option<Finding> {
    let scene = &inputs.file.scene;
    let at_rest = inputs.system.rod().is_none_or(|rod| rod.parts.at_rest_always);
    if at_rest || scene.background.covariance.is_of_known_state() {
        return None;
    }
    let sites = &inputs.observed.sites;
    let of_forces = |site: usize| {
        let moment = matches!(sites[site].quantity, Quantity::SupportMoment | Quantity::Moment);
        moment
            || matches!(sites[site].quantity, Quantity::Force | Quantity::AxialForce | Quantity::Acceleration)
    };
    let early = inputs.observed.seen.iter().filter(|seen| of_forces(seen.site) && seen.at() < STEPS);
    let first = early.min_by(|a, b| a.at().total_cmp(&b.at()))?;
    let site = &sites[first.site];
    Some(Finding::warning(
        "observations.sensors",
        format!(
            "{} is read {:.1} steps after the start: what it reads there is the strain that the start has by \
             itself, which no place shows, and the minimization may take hundreds of iterations; let the \
             model start {STEPS:.0} steps before the first reading (observations.time_zero)",
            site.label,
            first.at()
        ),
    ))
}
