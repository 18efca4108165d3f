//! A cable between two grippers that move, recorded: what markers kept back, and the time after, say of it.

use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use crate::suites::gripped_cable::{SIGMA, gripped_cable};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::ops::ControlFlow;
use std::time::Instant;
use varda::setup::Problem;
use varda_assimilation::{
    ControlTransform, CostFunction, Posterior, StrongConstraint, TrustRegionOptions, trust_region,
};

/// End of the window \[s\]; RMS distance \[mm\] of the even markers from a cubic spline through the odd ones
/// and the grippers; of all markers half a second later from where they were seen last.
const WINDOWS: [(f64, f64, f64); 9] = [
    (1.5, 2.3, 12.8),
    (0.5, 2.7, 35.9),
    (1.0, 2.6, 98.7),
    (2.0, 2.1, 22.1),
    (2.5, 6.0, 101.1),
    (3.0, 2.3, 30.9),
    (3.5, 2.1, 26.5),
    (4.0, 2.1, 109.8),
    (4.5, 1.7, 39.4),
];

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("gripped cable");
    let every = if options.quick { 10 } else { 1 };
    for window in WINDOWS.into_iter().step_by(every) {
        rows.case(&format!("to {} s", window.0), |case| gripped(case, window));
    }
}

fn gripped(case: &mut Case, (end, spline, persistence): (f64, f64, f64)) -> Outcome {
    let began = Instant::now();
    let problem = Problem::from_scene(&gripped_cable(end - 0.5, &[])?)?;
    let mut observations = problem.observations()?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform.clone(), &mut observations)?;
    let mut v = vec![0.0; cost.dim()];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-5);
    let minimum = trust_region(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
    let mut gradient = vec![0.0; v.len()];
    cost.evaluate(&v, Some(&mut gradient))?;
    let posterior = Posterior::new(&mut cost)?;
    drop(cost);

    let mut control = transform.background().to_vec();
    transform.control(&v, &mut control);
    let analysis = places(&problem, &control)?;
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    const DRAWS: usize = 24;
    let draws: Result<Vec<_>, _> =
        (0..DRAWS).map(|_| places(&problem, &posterior.draw(&transform, &v, &mut rng))).collect();
    let draws = draws?;

    let (mut kept, mut forecast, mut covered) = (Squares::default(), Squares::default(), Squares::default());
    for seen in &problem.observed.seen {
        let (step, rows) = (seen.step, problem.observed.sites[seen.site].rows.clone());
        let inside = seen.at() <= 50.0;
        for (row, value) in rows.zip(&seen.values) {
            let Some(value) = value else { continue };
            let d = value - analysis[step][row];
            if !inside {
                forecast.add(d * d);
            } else if problem.observed.sites[seen.site].withheld {
                kept.add(d * d);
                let spread = draws.iter().map(|run| (run[step][row] - analysis[step][row]).powi(2));
                let sigma = (spread.sum::<f64>() / DRAWS as f64 + SIGMA * SIGMA).sqrt();
                covered.add(f64::from(u8::from(d.abs() <= 1.96 * sigma)));
            }
        }
    }
    // Distances in space: three coordinates.
    let distance = |s: &Squares| (3.0 * s.mean()).sqrt();
    let noise = 3.0_f64.sqrt() * SIGMA;
    let without_noise = (distance(&kept).powi(2) - noise * noise).max(0.0).sqrt();
    case.at_most("withheld, less their noise", without_noise, 1e-3 * spline, "m")
        .computed(distance(&kept))
        .because("a spline through the other markers and the grippers");
    case.at_most("covered, off 0.945", (covered.mean() - 0.945).abs(), 0.045, "-")
        .computed(covered.mean())
        .because("90 to 99 % of coordinates kept back within 1.96 σ");
    case.at_most("forecast of 0.5 s", distance(&forecast), 0.4e-3 * persistence, "m")
        .computed(distance(&forecast))
        .because("two fifths of persistence, noise of 1.7 mm included");
    let chi2 = 2.0 * minimum.value / problem.observations()?.dim() as f64;
    case.at_most("2J/m off 1", (chi2 - 1.0).abs(), 0.3, "-")
        .computed(chi2)
        .because("3√(2/m) = 0.14, and the mesh and the start out of equilibrium that the prior carries");
    case.inform("seconds, with the posterior", began.elapsed().as_secs_f64(), "s");
    Ok(())
}

#[derive(Default)]
struct Squares {
    sum: f64,
    count: usize,
}

impl Squares {
    fn add(&mut self, square: f64) {
        self.sum += square;
        self.count += 1;
    }

    fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }
}

/// What a run from a control has at every marker, step by step, the forecast included.
fn places(problem: &Problem, control: &[f64]) -> Result<Vec<Vec<f64>>, Box<dyn std::error::Error>> {
    let mut model = problem.model();
    let mut operator = problem.observed.operator()?;
    let grid = &problem.experiment.grid;
    let mut x = vec![0.0; model.dim()];
    model.initial_state(control, &mut x)?;
    let mut all = Vec::new();
    for k in 0..=grid.last_step() {
        let mut y = vec![0.0; operator.dim()];
        operator.observe(grid.at(k), &x, &mut y)?;
        all.push(y);
        if k < grid.last_step() {
            let mut next = vec![0.0; x.len()];
            model.step(k, &x, &mut next)?;
            x = next;
        }
    }
    Ok(all)
}
