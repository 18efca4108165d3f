//! An assimilation in passes: where the clock of a recording or σ of its observations is estimated, each
//! pass reads the observations as the one before has found them.

use super::estimates::INTERVAL;
use super::mesh::{self, Coarse, Finest};
use super::window::{self, Listener};
use crate::Error;
use crate::outcome::{Estimated, IDENTIFIABLE, Outcome, Verdict, remarks_on_estimates};
use crate::scene::{Adjusted, PriorSpread, SceneFile};
use crate::setup::{Inputs, Problem};

/// Passes at most.
const PASSES: usize = 8;
/// The clock is as good as read where it moves by less than this share of a step: the state there is off by
/// ½δ² of its acceleration.
const OF_STEP: f64 = 0.02;
/// σ is found where it moves by less than this share of what is left open of it.
const OF_SIGMA: f64 = 0.05;

/// Minimises the cost of a problem by the method of its scene, and collects all that a report needs. The same
/// problem gives the same bits every time.
///
/// Where the clock of a recording is estimated, the times of its rows take up what a pass has found, until it
/// no longer moves: the observation operator is of first order in what they have not. σ of observations is
/// that of largest likelihood of all that was observed, the state and the constants being integrated over in
/// their Gauss–Newton posterior (Laplace): with m values, d degrees of freedom for signal, r the residuals
/// over σ of the scene and ln s ~ N(0, τ²),
///
/// ```text
///     m − d − Σ r²/s² + ln s/τ² = 0,   1/σ²(ln s) = 2 (m − d) + 1/τ²,
/// ```
///
/// solved for s after each pass. It is no number of the control: the cost of a pass has a given σ.
///
/// # Errors
/// [`Error::Assimilation`] where the cost cannot be evaluated at the background; [`Error::Model`],
/// [`Error::Rod`]. How a minimization ended is a [`Status`](crate::outcome::Status).
pub fn assimilate(problem: &Problem, listener: &mut Listener) -> Result<Outcome, Error> {
    let mut outcome = window::assimilate(problem, listener)?;
    let mut last: Option<Problem> = None;
    if let Some(file) = &problem.adjustable {
        let mut file = SceneFile::clone(file);
        let (mut passes, mut settled) = (1, false);
        while passes < PASSES && outcome.status.is_settled() && !settled {
            let next = adjusted(&file, last.as_ref().unwrap_or(problem), &outcome)?;
            settled = next == file.adjusted;
            if !settled {
                file.adjusted = next;
                let again = Problem::new(Inputs::read(&file)?)?;
                outcome = window::assimilate(&again, listener)?;
                last = Some(again);
                passes += 1;
            }
        }
        if !settled {
            let remark = format!("clock or σ of the observations were not found in {passes} passes");
            outcome.warnings.push(remark);
        }
        if let Some(found) = sigma(&file, last.as_ref().unwrap_or(problem), &outcome)? {
            outcome.estimates.push(found);
            let remark = "σ of the observations is estimated from their own residuals: 2J/m is near 1 \
                          whatever the model, and no test of it";
            outcome.warnings.push(remark.to_string());
        }
    }
    let here = last.as_ref().unwrap_or(problem);
    let run = Coarse {
        status: outcome.status,
        verdict: outcome.judgement.verdict,
        iterations: outcome.iterations[0],
        chi2: outcome.analysis.chi2,
    };
    let (of_mesh, seconds) = mesh::allow(&[here], &mut [&mut outcome.estimates], run, |files| {
        let finer = window::assimilate(&Problem::new(Inputs::read(&files[0])?)?, &mut listener.quiet())?;
        Ok(Finest { status: finer.status, chi2: finer.analysis.chi2, estimates: vec![finer.estimates] })
    });
    outcome.warnings.extend(of_mesh);
    let fits = outcome.judgement.verdict == Verdict::Fits;
    outcome.warnings.extend(remarks_on_estimates(&outcome.estimates, fits));
    outcome.seconds.mesh = seconds;
    outcome.seconds.total = listener.started.elapsed().as_secs_f64();
    Ok(outcome)
}

/// How the next pass reads the observations; as this one, where it has found what there is.
fn adjusted(file: &SceneFile, problem: &Problem, outcome: &Outcome) -> Result<Adjusted, Error> {
    let (mut next, estimates) = (file.adjusted, problem.system.estimates());
    // the times of a twin are those of its truth
    if let (Some(clock), None) = (estimates.seen.clock, &problem.truth) {
        let control = &outcome.analysis.analysis;
        let found = control[control.len() - estimates.len() + clock];
        if !((found - next.clock).abs() <= OF_STEP * problem.experiment.grid.step) {
            next.clock = found;
        }
    }
    if let Some(share) = share(file)? {
        let [log, open] = likely(outcome, next.sigma, share);
        if !((log - next.sigma.ln()).abs() <= OF_SIGMA * open) {
            next.sigma = log.exp();
        }
    }
    Ok(next)
}

/// τ, how well σ is known before; `None` where it is not estimated.
fn share(file: &SceneFile) -> Result<Option<f64>, Error> {
    let unknown = &file.scene.estimate.observation_sigma;
    Ok(match file.prior_of_one("estimate.observation_sigma", unknown)? {
        None => None,
        Some(PriorSpread::LogNormal(share)) => Some(share),
        Some(PriorSpread::Normal(_)) => unreachable!("the scene was checked"),
    })
}

/// ln s of largest likelihood and its σ, from a pass with s = `now`.
fn likely(outcome: &Outcome, now: f64, share: f64) -> [f64; 2] {
    let analysis = &outcome.analysis;
    let squares = 2.0 * analysis.terms.observation * now * now;
    solved(analysis.observations as f64 - analysis.degrees_of_freedom, squares, share)
}

/// The root ln s of free − Σ/s² + ln s/τ² and 1/√(2 free + 1/τ²), by Newton's method: the function
/// grows and is concave, so that steps from below it stay below it.
fn solved(free: f64, squares: f64, share: f64) -> [f64; 2] {
    let (free, precision) = (free.max(0.0), 1.0 / (share * share));
    let mut log = if free > 0.0 && squares > 0.0 { 0.5 * (squares / free).ln() } else { 0.0 };
    for _ in 0..60 {
        let of_squares = squares * (-2.0 * log).exp();
        let step = (free - of_squares + precision * log) / (2.0 * of_squares + precision);
        log = (log - step).clamp(-30.0, 30.0);
        if step.abs() < 1e-13 {
            break;
        }
    }
    [log, 1.0 / (2.0 * free + precision).sqrt()]
}

/// σ of the observations among the estimates: that of the scene where all values have the same, else a
/// factor.
fn sigma(file: &SceneFile, problem: &Problem, outcome: &Outcome) -> Result<Option<Estimated>, Error> {
    let Some(share) = share(file)? else { return Ok(None) };
    let [log, open] = likely(outcome, file.adjusted.sigma, share);
    let mut all = problem.observed.seen.iter().map(|seen| seen.sigma / file.adjusted.sigma);
    let first = all.next().unwrap_or(1.0);
    let is_one = all.all(|sigma| (sigma / first - 1.0).abs() < 1e-12);
    let unit = if is_one && problem.system.rod().is_some() { "m" } else { "1" };
    let prior = if is_one { first } else { 1.0 };
    let at = |deviations: f64| prior * (log + deviations * open).exp();
    Ok(Some(Estimated {
        arc_length: None,
        name: "observation_sigma".to_string(),
        unit,
        prior,
        prior_sigma: prior * share,
        value: at(0.0),
        sigma: Some(at(0.0) * open),
        sigma_on_mesh: Some(at(0.0) * open),
        mesh: None,
        interval: Some([at(-INTERVAL), at(INTERVAL)]),
        identifiable: Some(open <= IDENTIFIABLE * share),
        by_interval_alone: false,
        truth: problem.truth.as_ref().map(|_| prior),
        correlations: Vec::new(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_is_that_of_the_residuals_where_nothing_else_is_known() {
        let [log, open] = solved(90.0, 360.0, 1e6);
        assert!((log - 2.0_f64.ln()).abs() < 1e-10 && (open - 1.0 / 180.0_f64.sqrt()).abs() < 1e-10);
        // and that of the scene where that is known
        let [log, open] = solved(90.0, 360.0, 1e-6);
        assert!(log.abs() < 1e-9 && (open - 1e-6).abs() < 1e-12);
        for (free, squares) in [(0.0, 0.0), (10.0, 0.0), (0.0, 5.0), (1e6, 1e-6), (3.0, 1e12)] {
            let [log, open] = solved(free, squares, 0.5);
            let rest = free - squares * (-2.0 * log).exp() + 4.0 * log;
            let size = free + squares * (-2.0 * log).exp() + 1.0;
            assert!(rest.abs() < 1e-9 * size && open > 0.0, "{free} {squares}: {log}, {rest}");
        }
    }
}
