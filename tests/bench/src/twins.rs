//! Twenty twins of a scene by each method: how much of the error is left, whether 95 % intervals contain the
//! truth, and what it costs.

use super::clock;
use super::{Options, Page, Result, Table};
use crate::cells;
use varda::outcome::Outcome;
use varda::run::cycles::{CycleListener, Sequence};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut windows = Table::new("windows", "One window", WINDOWS);
    for study in STUDIES {
        let seeds = if options.quick { 2 } else { study.seeds };
        windows.push(Scored::of(study, seeds)?.row(study, seeds));
    }
    let mut cycles = Table::new("cycles", "Rods in cycles", CYCLES);
    for (name, sets) in SEQUENCES {
        cycles.push(sequence(name, sets, if options.quick { 1 } else { 3 })?);
    }
    Ok(Page {
        title: "Twins over seeds",
        text: TEXT.into(),
        tables: vec![windows, cycles],
        remarks: REMARKS.into(),
        ..Page::default()
    })
}

const WINDOWS: &[&str] = &[
    "twin",
    "method",
    "seeds",
    "fit (2J/m)",
    "error of places, analysis / background",
    "spread over seeds",
    "of velocities",
    "places inside 95 %",
    "velocities inside",
    "model steps and products",
    "CPU s",
];

const CYCLES: &[&str] = &[
    "sequence",
    "seeds",
    "error of places (m)",
    "RMSE / spread",
    "error of velocities (m/s)",
    "RMSE / spread of velocities",
    "CPU ms a window",
];

const TEXT: &str = "\
The truth is a run of the scene's own model. *Error*: RMSE at the start of the window over all components, \
mean over seeds; for models without groups the first column is of the state. *Inside*: share of components \
whose truth is within 1.96 σ_a, mean over seeds; 0.95 is right. *Model steps and products*: steps of the \
model, tangent and adjoint products of all seeds, over the seeds. Rows of one twin differ in nothing but the \
method; compare their error at the CPU seconds beside it.";

const REMARKS: &str = "\
Twins `as the paper` draw the background's error from a kernel without the taper that B has, as the paper \
does. An ensemble of few members sees a covariance of as few directions: σ_a is then too small, and its \
localization cuts signals that travel farther than its length within the window; use 4D-Var where there is \
an adjoint.";

/// A row of the table.
struct Study {
    twin: &'static str,
    method: &'static str,
    scene: &'static str,
    seeds: u64,
    sets: &'static [&'static str],
}

const DRAWN: &str = "background.draw=\"covariance\"";
const ENSEMBLE: &str = "algorithm.method=4denvar";

const STUDIES: &[Study] = &[
    Study {
        twin: "case 1, as the paper",
        method: "4D-Var",
        scene: "hanging-rod-case1",
        seeds: 20,
        sets: &[],
    },
    Study { twin: "case 1", method: "4D-Var", scene: "hanging-rod-case1", seeds: 20, sets: &[DRAWN] },
    Study { twin: "case 2", method: "4D-Var", scene: "hanging-rod-case2", seeds: 20, sets: &[DRAWN] },
    Study {
        twin: "case 2",
        method: "4D-EnVar, 80 members",
        scene: "hanging-rod-case2",
        seeds: 20,
        sets: &[DRAWN, ENSEMBLE, "algorithm.ensemble.members=80"],
    },
    Study {
        twin: "case 2",
        method: "4D-EnVar, 80 members, localized to L",
        scene: "hanging-rod-case2",
        seeds: 20,
        sets: &[DRAWN, ENSEMBLE, "algorithm.ensemble={members=80, localization_length=1.0}"],
    },
    Study {
        twin: "case 2",
        method: "4D-EnVar, 640 members",
        scene: "hanging-rod-case2",
        seeds: 5,
        sets: &[DRAWN, ENSEMBLE, "algorithm.ensemble.members=640"],
    },
    Study { twin: "case 4", method: "4D-Var", scene: "hanging-rod-case4", seeds: 20, sets: &[DRAWN] },
    Study { twin: "Lorenz-96", method: "4D-Var", scene: "lorenz96", seeds: 20, sets: &[] },
    Study {
        twin: "Lorenz-96",
        method: "4D-EnVar, 20 members, localized",
        scene: "lorenz96",
        seeds: 20,
        sets: &[ENSEMBLE, "algorithm.ensemble={members=20, localization_length=12.0}"],
    },
    Study {
        twin: "Lorenz-96",
        method: "4D-EnVar, 80 members",
        scene: "lorenz96",
        seeds: 20,
        sets: &[ENSEMBLE, "algorithm.ensemble.members=80"],
    },
];

const SEQUENCES: &[(&str, &[&str])] = &[
    ("hanging-rod-cycling, as shipped", &[]),
    ("inflation 1.05", &["algorithm.cycles.inflation=1.05"]),
    ("static part 0.02", &["algorithm.cycles.static_weight=0.02"]),
    (
        "both, drawn from the kernel without taper",
        &[
            "background.draw=\"kernel\"",
            "algorithm.cycles.inflation=1.05",
            "algorithm.cycles.static_weight=0.02",
        ],
    ),
];

/// Sums over the seeds of a study.
#[derive(Default)]
struct Scored {
    chi2: f64,
    reduced: [Vec<f64>; 2],
    inside: [Vec<f64>; 2],
    work: usize,
    seconds: f64,
}

impl Scored {
    fn of(study: &Study, seeds: u64) -> Result<Scored> {
        let mut sum = Scored::default();
        for seed in 0..seeds {
            let mut sets: Vec<String> = study.sets.iter().map(ToString::to_string).collect();
            sets.push(format!("seed={seed}"));
            let file = SceneFile::open(study.scene, &sets)?;
            let problem = Problem::from_scene(&file)?;
            let began = clock::process_seconds();
            let outcome = assimilate(&problem, &mut Listener::silent())?;
            sum.seconds += clock::process_seconds() - began;
            sum.add(&outcome)?;
        }
        Ok(sum)
    }

    fn add(&mut self, outcome: &Outcome) -> Result<()> {
        let (a, truth) = (&outcome.analysis, outcome.truth.as_ref().ok_or("a twin has a truth")?);
        self.chi2 += a.chi2;
        let counts = &outcome.counts;
        self.work += counts.model_steps + counts.tangent_steps + counts.adjoint_steps;
        for (group, (reduced, inside)) in
            outcome.experiment.state.groups.iter().zip(self.reduced.iter_mut().zip(&mut self.inside))
        {
            let range = group.range.clone();
            let rms = |of: &[f64]| {
                (range.clone().map(|i| (of[i] - truth[i]).powi(2)).sum::<f64>() / range.len() as f64).sqrt()
            };
            reduced.push(rms(&a.analysis) / rms(&a.background));
            let within = |i: &usize| (a.analysis[*i] - truth[*i]).abs() <= 1.96 * a.sigma_analysis[*i];
            inside.push(range.clone().filter(within).count() as f64 / range.len() as f64);
        }
        Ok(())
    }

    fn row(self, study: &Study, seeds: u64) -> Vec<super::Cell> {
        let n = seeds as f64;
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
        let [x, v] = &self.reduced;
        let deviation = (x.iter().map(|r| (r - mean(x)).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let [inside_x, inside_v] = &self.inside;
        let (chi2, work, seconds) = (self.chi2 / n, self.work / seeds as usize, self.seconds / n);
        let (v, inside_v) = (mean(v), mean(inside_v));
        cells![
            study.twin,
            study.method,
            seeds as usize,
            chi2,
            mean(x),
            deviation,
            v,
            mean(inside_x),
            inside_v,
            work,
            seconds
        ]
    }
}

/// A sequence of windows of the cycled rod, over seeds.
fn sequence(name: &str, sets: &[&str], seeds: u64) -> Result<Vec<super::Cell>> {
    let (mut rmse, mut spread, mut seconds) = ([0.0; 2], [0.0; 2], 0.0);
    for seed in 0..seeds {
        let mut sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
        sets.push(format!("seed={seed}"));
        let file = SceneFile::open("hanging-rod-cycling", &sets)?;
        let sequence = Sequence::from_scene(&file)?.ok_or("a scene without cycles")?;
        let outcome = sequence.run(sequence.start(), Vec::new(), &mut CycleListener::silent())?;
        for group in 0..2 {
            rmse[group] += outcome.means.rmse_start[group].ok_or("no error")? / seeds as f64;
            spread[group] += outcome.means.spread[group].ok_or("no spread")? / seeds as f64;
        }
        seconds += outcome.means.seconds.ok_or("no seconds")? / seeds as f64;
    }
    let ratio = |group: usize| rmse[group] / spread[group];
    Ok(cells![name, seeds as usize, rmse[0], ratio(0), rmse[1], ratio(1), 1e3 * seconds])
}
