//! One forward run: how far the background is from what was seen, and how long a run takes.

use std::time::Instant;

use varda_implicit::Model;

use serde::Serialize;
use varda_rod::Rest;

use crate::Error;
use crate::scene::{Scene, TimeGrid};
use crate::setup::rod_model::RodParts;
use crate::setup::runs::run_states;
use crate::setup::{Inputs, Problem};

/// How far what was seen is from the background.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Misfit {
    /// 2J/m at the background: the mean of (d/σ)².
    pub chi2: f64,
    /// Observed values m.
    pub values: usize,
    /// Name and root mean square of d/σ of the marker that is farthest off.
    pub worst: (String, f64),
}

/// What one forward run of the first window tells.
pub(super) struct ForwardRun {
    /// Seconds it took.
    pub(super) seconds: f64,
    /// The distance of its places from what was seen, of a recording.
    pub(super) misfit: Option<Misfit>,
    /// The rod, and its shape at rest with the time of it, where one was found on the way.
    pub(super) rod: Option<(RodParts, Option<(Rest, f64)>)>,
}

/// Runs the truth of a twin through its spin-up and the window, or the background of a recording through the
/// window.
pub(super) fn run(mut inputs: Inputs) -> Result<ForwardRun, Error> {
    let steps = inputs.file.scene.time.window;
    let grid = TimeGrid { steps, ..inputs.grid };
    let rod_of = |system: &crate::setup::system::System| {
        system.rod().map(|rod| (rod.parts.clone(), rod.parts.first.clone()))
    };
    if inputs.is_twin() {
        let truth = inputs.system.truth()?;
        let mut model = inputs.system.models()(0);
        let began = Instant::now();
        run_states(model.as_mut(), &truth, steps)?;
        let seconds = began.elapsed().as_secs_f64();
        return Ok(ForwardRun { seconds, misfit: None, rod: rod_of(&inputs.system) });
    }
    let problem = Problem::new(inputs)?;
    let mut model = problem.model();
    let mut x = vec![0.0; model.dim()];
    let began = Instant::now();
    model.initial_state(&problem.background, &mut x)?;
    let states = run_states(model.as_mut(), &x, steps)?;
    let seconds = began.elapsed().as_secs_f64();
    let misfit = misfit(&problem, &grid, model.as_ref(), &states)?;
    Ok(ForwardRun { seconds, misfit, rod: rod_of(&problem.system) })
}

/// d = y − H(x) of the window in σ, of correlated errors what each value says beyond those before it;
/// `None` where nothing was seen.
fn misfit(
    problem: &Problem,
    grid: &TimeGrid,
    model: &dyn Model,
    states: &[f64],
) -> Result<Option<Misfit>, Error> {
    let (n, mut observations) = (model.dim(), problem.observed.set(grid)?);
    observations.follow(model.rate());
    let Some(last) = observations.last_step() else { return Ok(None) };
    let mut predicted = observations.prediction();
    for k in 0..=last {
        observations.observe_add(k, &states[k * n..(k + 1) * n], &mut predicted)?;
    }
    let mut d = vec![0.0; observations.dim()];
    observations.innovations(predicted.values(), &mut d);
    observations.whiten(&mut d);
    let squares: Vec<f64> = d.iter().map(|d| d.powi(2)).collect();
    let mut sites: Vec<(&str, f64, usize)> = Vec::new();
    for (i, o) in observations.observations().iter().enumerate() {
        let rows = observations.rows(i);
        let (sum, count) = (squares[rows.clone()].iter().sum::<f64>(), rows.len());
        match sites.iter_mut().find(|s| s.0 == o.label) {
            Some(site) => (site.1, site.2) = (site.1 + sum, site.2 + count),
            None => sites.push((&o.label, sum, count)),
        }
    }
    let rms = |s: &(&str, f64, usize)| (s.1 / s.2 as f64).sqrt();
    let worst = sites.iter().max_by(|a, b| rms(a).total_cmp(&rms(b)));
    let Some(worst) = worst.map(|s| (s.0.to_string(), rms(s))) else { return Ok(None) };
    let values = squares.len();
    Ok(Some(Misfit { chi2: squares.iter().sum::<f64>() / values as f64, values, worst }))
}

/// Seconds that a minimization may take, from those of a forward run, roughly: a gradient is 1.3 runs, a
/// column of a dense Hessian some 2 % of one, a product with it 0.3; iterations are seldom fewer than 3 or,
/// in a fit, more than 60.
pub(super) fn expected_seconds(scene: &Scene, forward: f64, control: usize) -> [f64; 2] {
    let algorithm = &scene.algorithm;
    let windows = algorithm.cycles.as_ref().map_or(1.0, |c| c.count as f64);
    let each = if let Some(ensemble) = algorithm.members() {
        ensemble.members as f64 + 1.0
    } else if algorithm.minimizer.settings().is_dense() {
        1.3 + 0.02 * control as f64
    } else {
        1.3 + 0.3 * 15.0
    };
    let posterior = if scene.report.posterior { 0.02 * control as f64 } else { 0.0 };
    [3.0, 60.0].map(|iterations: f64| {
        let iterations = iterations.min(algorithm.max_iterations as f64);
        windows * forward * (3.0 + iterations * each + posterior)
    })
}
