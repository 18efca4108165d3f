//! The same estimate with half the step and twice the segments: what the mesh does to constants.

use std::time::Instant;

use crate::Error;
use crate::outcome::{Estimated, Status, Verdict};
use crate::scene::SceneFile;
use crate::setup::Problem;
use crate::setup::finer::Finer;

/// Where 2J/m is larger, more than the mesh is wrong, and nothing is computed.
const MOST_CHI2: f64 = 4.0;
/// A finer mesh that fits so many times worse, and worse than noise alone, came to another minimum.
const WORSE: f64 = 2.0;
/// On a finer mesh a cost that is smooth takes as many iterations as on the coarse one. One that takes more
/// than so many times as many, and these, is not, and would take minutes.
const ITERATIONS: [usize; 2] = [2, 20];

/// How the run of the scenes' own mesh ended.
pub(super) struct Coarse {
    pub(super) status: Status,
    pub(super) verdict: Verdict,
    pub(super) iterations: usize,
    pub(super) chi2: f64,
}

/// What came of a finer mesh.
pub(super) struct Finest {
    pub(super) status: Status,
    pub(super) chi2: f64,
    /// The constants of each problem.
    pub(super) estimates: Vec<Vec<Estimated>>,
}

/// Adds to the estimates of problems what a finer mesh makes of them; `assimilate` runs the scenes of the
/// finer one. Returns remarks, and the seconds that it took: 0 where nothing was computed.
pub(super) fn allow(
    problems: &[&Problem],
    estimates: &mut [&mut Vec<Estimated>],
    Coarse { status, verdict, iterations, chi2 }: Coarse,
    assimilate: impl FnOnce(&[SceneFile]) -> Result<Finest, Error>,
) -> (Vec<String>, f64) {
    let without = |reason: String| {
        vec![format!("σ of the estimated constants is without an allowance for the mesh: {reason}")]
    };
    let mut scenes = Vec::new();
    for problem in problems {
        match &problem.finer {
            // a twin has the same mesh in truth and model
            _ if problem.truth.is_some() => return (Vec::new(), 0.0),
            Finer::Unwanted => return (Vec::new(), 0.0),
            Finer::Without(reason) => return (without(reason.to_string()), 0.0),
            Finer::Scene(finer) => scenes.push(finer.as_ref()),
        }
    }
    if status.is_settled() && !(chi2 <= MOST_CHI2) {
        let reason = format!("2J/m is {chi2:.2}, above {MOST_CHI2}: more than the mesh is wrong");
        return (without(reason), 0.0);
    }
    if !status.is_settled() || verdict == Verdict::NotConverged {
        return (without(format!("the minimization ended as {}", status.name())), 0.0);
    }
    let Some(change) = scenes.first().map(|scene| scene.change) else { return (Vec::new(), 0.0) };
    let began = Instant::now();
    let mut files: Vec<SceneFile> = scenes.iter().map(|scene| scene.file.clone()).collect();
    for file in &mut files {
        let most = &mut file.scene.algorithm.max_iterations;
        *most = ITERATIONS[0].saturating_mul(iterations).saturating_add(ITERATIONS[1]).min(*most);
    }
    let finer = assimilate(&files);
    let seconds = began.elapsed().as_secs_f64();
    let without = |reason: String| (without(format!("with {change} {reason}")), seconds);
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
    for (((problem, estimates), finest), scene) in
        problems.iter().zip(estimates).zip(&finer.estimates).zip(&scenes)
    {
        let constants = &problem.system.estimates().constants;
        for (estimate, constant) in estimates.iter_mut().zip(constants) {
            // fields have other vertices
            let Some(fine) = finest.iter().find(|fine| fine.name == estimate.name) else { continue };
            let [coarse, fine] = [estimate.value, fine.value].map(|value| constant.number_of(value));
            estimate.allow_for(scene.of_difference * (fine - coarse).abs(), coarse, constant);
        }
        let moved = estimates.iter().filter(|e| e.is_of_mesh() && !coarse.contains(&e.name));
        let moved: Vec<String> = moved.map(|e| e.name.clone()).collect();
        coarse.extend(moved);
    }
    if coarse.is_empty() {
        return (Vec::new(), seconds);
    }
    let remark = format!(
        "{change} move {} by more than what the observations leave open (2J/m {:.3} there, {chi2:.3} here): \
         their σ is the mesh's, and a finer one would lower it",
        coarse.join(", "),
        finer.chi2
    );
    (vec![remark], seconds)
}
