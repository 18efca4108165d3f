//! The same estimate with twice the segments: what the mesh does to constants.

use crate::Error;
use crate::outcome::{Estimated, Outcome, Status};
use crate::setup::Problem;

/// Errors of the mesh fall with h² (clamps at their faces): all of the difference between a mesh and one
/// twice as fine, and a third of it more.
const OF_DIFFERENCE: f64 = 4.0 / 3.0;
/// Where 2J/m is larger, more than the mesh is wrong, and nothing is computed.
pub(super) const MOST_CHI2: f64 = 4.0;
/// A finer mesh that fits so many times worse came to another minimum.
const WORSE: f64 = 2.0;

/// Adds to the estimates what twice the segments make of them: `finer` is that estimate, `chi2` is 2J/m of
/// the scene's own mesh. Returns remarks.
pub(super) fn allow(
    problem: &Problem,
    estimates: &mut [Estimated],
    chi2: f64,
    finer: Result<Outcome, Error>,
) -> Vec<String> {
    let without = |reason: String| {
        vec![format!(
            "σ of the estimated constants is without an allowance for the mesh: with twice the segments \
                {reason}"
        )]
    };
    let finer = match finer {
        Ok(finer) => finer,
        Err(error) => return without(error.to_string()),
    };
    if !matches!(finer.status, Status::Converged | Status::Stalled) {
        return without(format!("the minimization ended as {}", finer.status.name()));
    }
    if !(finer.analysis.chi2 <= WORSE * chi2) {
        return without(format!("it came to another minimum, with 2J/m = {:.2}", finer.analysis.chi2));
    }
    let constants = &problem.system.estimates().constants;
    for (estimate, constant) in estimates.iter_mut().zip(constants) {
        // fields have other vertices
        let Some(fine) = finer.estimates.iter().find(|fine| fine.name == estimate.name) else { continue };
        let [coarse, fine] = [estimate.value, fine.value].map(|value| constant.number_of(value));
        estimate.allow_for(OF_DIFFERENCE * (fine - coarse).abs(), coarse, constant);
    }
    let coarse: Vec<&str> = estimates.iter().filter(|e| e.is_of_mesh()).map(|e| e.name.as_str()).collect();
    if coarse.is_empty() {
        return Vec::new();
    }
    vec![format!(
        "twice the segments move {} by more than what the observations leave open (2J/m {:.3} there, \
         {chi2:.3} here): their σ is the mesh's, and more segments would lower it",
        coarse.join(", "),
        finer.analysis.chi2
    )]
}
