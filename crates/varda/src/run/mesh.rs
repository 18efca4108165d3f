//! The same estimate with twice the segments: what the mesh does to constants.

use std::time::Instant;

use crate::Error;
use crate::outcome::{Estimated, Status};
use crate::scene::SceneFile;
use crate::setup::Problem;
use crate::setup::finer::Finer;

/// Where 2J/m is larger, more than the mesh is wrong, and nothing is computed.
const MOST_CHI2: f64 = 4.0;
/// A finer mesh that fits so many times worse, and worse than noise alone, came to another minimum.
const WORSE: f64 = 2.0;

/// What came of a finer mesh.
pub(super) struct Finest {
    pub(super) status: Status,
    pub(super) chi2: f64,
    /// The constants of each problem.
    pub(super) estimates: Vec<Vec<Estimated>>,
}

/// Adds to the estimates of problems what twice the segments make of them; the run of the scenes' own mesh
/// ended as `status` with 2J/m = `chi2`, and `assimilate` runs the scenes of the finer one. Returns remarks,
/// and the seconds that it took: 0 where nothing was computed.
pub(super) fn allow(
    problems: &[&Problem],
    estimates: &mut [&mut Vec<Estimated>],
    (status, chi2): (Status, f64),
    assimilate: impl FnOnce(&[&SceneFile]) -> Result<Finest, Error>,
) -> (Vec<String>, f64) {
    let without = |reason: String| {
        vec![format!("σ of the estimated constants is without an allowance for the mesh: {reason}")]
    };
    let (mut files, mut of_differences) = (Vec::new(), Vec::new());
    for problem in problems {
        match &problem.finer {
            // a twin has the same mesh in truth and model
            _ if problem.truth.is_some() => return (Vec::new(), 0.0),
            Finer::Unwanted => return (Vec::new(), 0.0),
            Finer::Without(reason) => return (without(reason.to_string()), 0.0),
            Finer::Scene(file, of_difference) => {
                files.push(file.as_ref());
                of_differences.push(*of_difference);
            }
        }
    }
    if !status.is_settled() {
        return (without(format!("the minimization ended as {}", status.name())), 0.0);
    }
    if !(chi2 <= MOST_CHI2) {
        let reason = format!("2J/m is {chi2:.2}, above {MOST_CHI2}: more than the mesh is wrong");
        return (without(reason), 0.0);
    }
    let began = Instant::now();
    let finer = assimilate(&files);
    let seconds = began.elapsed().as_secs_f64();
    let without = |reason: String| (without(format!("with twice the segments {reason}")), seconds);
    let finer = match finer {
        Ok(finer) => finer,
        Err(error) => return without(error.to_string()),
    };
    if !finer.status.is_settled() {
        return without(format!("the minimization ended as {}", finer.status.name()));
    }
    if !(finer.chi2 <= WORSE * chi2.max(1.0)) {
        return without(format!("it came to another minimum, with 2J/m = {:.2}", finer.chi2));
    }
    let mut coarse: Vec<String> = Vec::new();
    for (((problem, estimates), finest), of_difference) in
        problems.iter().zip(estimates).zip(&finer.estimates).zip(&of_differences)
    {
        let constants = &problem.system.estimates().constants;
        for (estimate, constant) in estimates.iter_mut().zip(constants) {
            // fields have other vertices
            let Some(fine) = finest.iter().find(|fine| fine.name == estimate.name) else { continue };
            let [coarse, fine] = [estimate.value, fine.value].map(|value| constant.number_of(value));
            estimate.allow_for(of_difference * (fine - coarse).abs(), coarse, constant);
        }
        let moved = estimates.iter().filter(|e| e.is_of_mesh() && !coarse.contains(&e.name));
        let moved: Vec<String> = moved.map(|e| e.name.clone()).collect();
        coarse.extend(moved);
    }
    if coarse.is_empty() {
        return (Vec::new(), seconds);
    }
    let remark = format!(
        "twice the segments move {} by more than what the observations leave open (2J/m {:.3} there, \
         {chi2:.3} here): their σ is the mesh's, and more segments would lower it",
        coarse.join(", "),
        finer.chi2
    );
    (vec![remark], seconds)
}
