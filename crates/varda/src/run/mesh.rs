//! The same estimate with twice the segments: what the mesh does to constants.

use crate::Error;
use crate::outcome::{Estimated, Outcome, Status};
use crate::setup::Problem;

/// Errors of the mesh fall with h² (clamps at their faces): all of the difference between a mesh and one
/// twice as fine, and a third of it more.
const OF_DIFFERENCE: f64 = 4.0 / 3.0;

/// Adds to the estimates what twice the segments make of them: `ended` is that estimate, with its error.
/// Returns remarks.
pub(super) fn allow(
    problem: &Problem,
    estimates: &mut [Estimated],
    ended: Result<Outcome, Error>,
) -> Result<Vec<String>, Error> {
    let without = |reason: String| {
        Ok(vec![format!(
            "σ of the estimated constants is without an allowance for the mesh: with twice the segments \
                {reason}"
        )])
    };
    let ended = match ended {
        Ok(ended) => ended,
        Err(error) => return without(error.to_string()),
    };
    if !matches!(ended.status, Status::Converged | Status::Stalled) {
        return without(format!("the minimization ended as {}", ended.status.name()));
    }
    let constants = &problem.system.estimates().constants;
    for (estimate, constant) in estimates.iter_mut().zip(constants) {
        // fields have other vertices
        let Some(fine) = ended.estimates.iter().find(|fine| fine.name == estimate.name) else { continue };
        let [coarse, fine] = [estimate.value, fine.value].map(|value| constant.number_of(value));
        estimate.allow_for(OF_DIFFERENCE * (fine - coarse).abs(), coarse, constant);
    }
    let coarse: Vec<&str> = estimates.iter().filter(|e| e.is_of_mesh()).map(|e| e.name.as_str()).collect();
    Ok(match coarse.is_empty() {
        true => Vec::new(),
        false => vec![format!(
            "twice the segments move {} by more than what the observations leave open: their σ is the \
             mesh's, and more segments would lower it",
            coarse.join(", ")
        )],
    })
}
