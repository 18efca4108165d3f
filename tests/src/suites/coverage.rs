//! Whether 95 % intervals contain the truth 95 times in a hundred, at three times of window and forecast.

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use varda::outcome;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

/// A 95 % interval is ± this many σ.
const INTERVAL: f64 = 1.96;

/// A twin whose background and observations are drawn from the B and R that it assumes.
struct Twin {
    name: &'static str,
    scene: &'static str,
    sets: &'static [&'static str],
    /// What the share of truths inside may be off by beyond three standard errors of its mean.
    allowance: f64,
}

const TWINS: [Twin; 10] = [
    Twin { name: "linear advection", scene: "linear-advection", sets: &[], allowance: 0.02 },
    Twin {
        name: "Lorenz-63, short window",
        scene: "lorenz63",
        sets: &["time.window=20", "background.covariance.sigma=0.3"],
        allowance: 0.02,
    },
    Twin {
        name: "rod, case 2",
        scene: "hanging-rod-case2",
        sets: &["background.draw=\"covariance\""],
        allowance: 0.02,
    },
    Twin {
        name: "rod, case 3",
        scene: "hanging-rod-case3",
        sets: &["background.draw=\"covariance\""],
        allowance: 0.02,
    },
    Twin { name: "starter scene", scene: "starter", sets: &[], allowance: 0.02 },
    Twin {
        name: "rod with unknown modulus, damping and curvature",
        scene: "starter",
        sets: &[
            "model.damping.stiffness=0.01",
            "model.damping.mass=0.5",
            "estimate.youngs_modulus={sigma=\"15%\"}",
            "estimate.damping_stiffness={sigma=\"30%\"}",
            "estimate.natural_curvature={sigma=0.2}",
        ],
        allowance: 0.02,
    },
    // clock and constants of the model in one Hessian, with the second derivatives of both
    Twin {
        name: "rod with unknown modulus, damping, curvature and clock, exact Hessian",
        scene: "starter",
        sets: &[
            "model.damping.stiffness=0.01",
            "model.damping.mass=0.5",
            "estimate.youngs_modulus={sigma=\"15%\"}",
            "estimate.damping_stiffness={sigma=\"30%\"}",
            "estimate.natural_curvature={sigma=0.2}",
            "estimate.clock={sigma=0.004}",
            "algorithm.hessian=\"exact\"",
        ],
        allowance: 0.02,
    },
    Twin {
        name: "rod with unknown clamp direction and drive",
        scene: "starter",
        sets: &[
            "estimate.clamp_direction={sigma=0.05}",
            "estimate.drive_radii={sigma=\"10%\"}",
            "estimate.drive_phase={sigma=0.1}",
        ],
        allowance: 0.02,
    },
    // two cameras at 1.3 m: half a pixel is half a millimetre; coordinates say little beside them
    Twin {
        name: "rod in pixels of two cameras",
        scene: "starter",
        sets: &[
            "observations.sigma=0.05",
            "observations.cameras=[\
             { name = \"left\", focal_length = [1400.0, 1400.0], principal_point = [960.0, 540.0], \
             distortion = [-0.12, 0.05, 1e-3, -5e-4, 0.0], position = [-0.6, -1.2, -0.1], sigma = 0.5, \
             rotation = [[0.894427, -0.447214, 0.0], [-0.049689, -0.099379, -0.993808], \
             [0.444445, 0.888889, -0.111111]] }, \
             { name = \"right\", focal_length = [1400.0, 1400.0], principal_point = [960.0, 540.0], \
             position = [0.7, -1.1, -0.2], sigma = 0.5, \
             rotation = [[0.843661, 0.536875, 0.0], [0.020584, -0.032347, -0.999265], \
             [-0.536481, 0.843041, -0.038341]] }]",
        ],
        allowance: 0.02,
    },
    Twin {
        name: "Lorenz-96, unknown forcing",
        scene: "lorenz96",
        sets: &["estimate.forcing={sigma=\"5%\"}", "background.covariance.sigma=0.1"],
        allowance: 0.02,
    },
];

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("coverage").of(options);
    rows.area("95 % intervals");
    let seeds = if options.quick { 20 } else { 200 };
    for twin in &TWINS {
        rows.case(twin.name, |case| covered(case, twin, seeds));
    }
    rows.finish()
}

/// Shares of the truth inside, seed by seed, of one group of the state at one time.
struct Shares {
    name: String,
    components: usize,
    of_seeds: Vec<f64>,
}

/// Adds the share of components inside to the group of this name.
fn add(all: &mut Vec<Shares>, name: String, inside: &[bool]) {
    let share = inside.iter().filter(|inside| **inside).count() as f64 / inside.len() as f64;
    match all.iter_mut().find(|shares| shares.name == name) {
        Some(shares) => shares.of_seeds.push(share),
        None => all.push(Shares { name, components: inside.len(), of_seeds: vec![share] }),
    }
}

fn covered(case: &mut Case, twin: &Twin, seeds: u64) -> Outcome {
    let mut all: Vec<Shares> = Vec::new();
    for seed in 0..seeds {
        let (problem, outcome) = ended(twin, seed)?;
        let runs = &outcome.trajectories;
        let grid = &outcome.experiment.grid;
        let times = [("start", 0), ("end", grid.steps), ("forecast", grid.last_step())];
        for (when, k) in times {
            let states = [&runs.truth, &runs.analysis, &outcome.sigma_states].map(|s| runs.state(s, k));
            let [Some(truth), Some(analysis), Some(sigma)] = states else {
                return Err(format!("seed {seed}: no state or σ at step {k}").into());
            };
            for e in outcome.estimates.iter().filter(|_| k == 0) {
                // in the number that is normal under the prior: a log-normal interval is not even about the
                // value
                let (truth, interval) = (e.truth.ok_or("no truth")?, e.interval.ok_or("no σ")?);
                add(&mut all, e.name.clone(), &[interval[0] <= truth && truth <= interval[1]]);
            }
            for group in &outcome.experiment.state.groups {
                let within = |c: usize| (truth[c] - analysis[c]).abs() <= INTERVAL * sigma[c];
                let inside: Vec<bool> = group.range.clone().map(within).collect();
                add(&mut all, format!("{}, {when}", group.name), &inside);
            }
            // at the start the stretch that B allows makes tension a square of what is not known
            if let (Some(rod), Some(shapes), true) = (problem.system.rod(), &outcome.shapes, k > 0) {
                let state = |k: usize| &runs.truth[k * runs.dim..(k + 1) * runs.dim];

                let truth = {
                    let (mut of_truth, now) = rod.with_constants_of(state(k))?;
                    let (_, then) = rod.with_constants_of(state(k - 1))?;
                    of_truth.internal_forces(grid.time(k), &now, (grid.time(k - 1), &then))?
                };
                let (analysis, sigma) = (&shapes.forces[k - 1], &shapes.sigma_forces[k - 1]);
                let within =
                    |e: usize| (truth.tension[e] - analysis.tension[e]).abs() <= INTERVAL * sigma.tension[e];
                let inside: Vec<bool> = (0..truth.tension.len()).map(within).collect();
                add(&mut all, format!("tension, {when}"), &inside);
            }
        }
    }
    for shares in all {
        let n = shares.of_seeds.len() as f64;
        let mean = shares.of_seeds.iter().sum::<f64>() / n;
        let variance = shares.of_seeds.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
        // At least as uncertain as if all components were independent: of few, all may be inside by chance.
        let independent = 0.95 * 0.05 / (n * shares.components as f64);
        let error = (variance / n).max(independent).sqrt();
        case.at_most(&shares.name, (mean - 0.95).abs(), twin.allowance + 3.0 * error, "-")
            .because("95 ± 2 % within three standard errors of the mean over seeds")
            .computed(mean);
    }
    Ok(())
}

fn ended(twin: &Twin, seed: u64) -> Result<(Problem, outcome::Outcome), Box<dyn std::error::Error>> {
    let mut sets: Vec<String> = twin.sets.iter().map(|s| s.to_string()).collect();
    sets.push(format!("seed={seed}"));
    let forecast = "report.forecast";
    let file = if twin.scene == "starter" {
        sets.push(format!("{forecast}=0.3"));
        SceneFile::parse("starter", "starter.toml", varda::scene::STARTER, None, &sets)?
    } else {
        let base = SceneFile::open(twin.scene, &sets)?;
        let seconds = 0.5 * base.grid()?.steps as f64 * base.grid()?.step;
        sets.push(format!("{forecast}={seconds}"));
        SceneFile::open(twin.scene, &sets)?
    };
    let problem = Problem::from_scene(&file)?;
    let outcome = assimilate(&problem, &mut Listener::silent())?;
    Ok((problem, outcome))
}
