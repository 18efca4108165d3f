//! Priors for rods: what the choice of kernel, taper and root costs, and whether σ_a can be believed.

use super::{Options, Page, Result, Table};
use crate::cells;
use varda::outcome::Outcome;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut table = Table::new("rods", "", COLUMNS);
    let lengths: &[f64] = if options.quick { &[0.5] } else { &[0.25, 0.5] };
    for rod in RODS {
        for &length in lengths {
            for prior in PRIORS {
                let scored = Scored::of(rod, prior, length)?;
                let row = scored.row(rod, prior, length);
                table.push(row);
            }
        }
    }
    Ok(Page {
        title: "Priors for rods",
        text: TEXT.into(),
        tables: vec![table],
        remarks: REMARKS.into(),
        ..Page::default()
    })
}

const COLUMNS: &[&str] = &[
    "rod",
    "prior",
    "correlation length / L",
    "status",
    "2J/m",
    "error of places, analysis / background",
    "of velocities",
    "rms of error/σ_a, places",
    "of velocities",
    "factorizations",
];

const TEXT: &str = "\
The truth is a rod in motion, the background the same rod with a physical constant that is wrong (named \
below), observations are drawn around the truth with σ = 2 mm. So the errors of the background are drawn \
from none of the priors; σ_x and σ_v are the root mean square of these errors. Minimizer `auto`, BDF2, \
clamps at their faces, mean over three seeds of the observations (the sum of factorizations, which is what a \
rod costs). *Error*: RMSE at the start of the window over all free vertices. *rms of error/σ_a*: 1 where \
σ_a is right, below where it is too large. Wrong: hanging rod, stiffness × 0.7; thin rod, stiffness × \
0.5; tether, speed of the current 0.2 instead of 0.25 m/s; cable, mass × 0.9.";

const REMARKS: &str = "\
What a scene without `taper`, `localization_length` and `root` gets is the first row of each group.";

/// A prior of a table.
struct Prior {
    name: &'static str,
    /// Keys of `background.covariance`; `{L}` stands for the length of the rod.
    keys: &'static [&'static str],
}

const PRIORS: &[Prior] = &[
    Prior { name: "Matérn 5/2 (default)", keys: &[] },
    Prior { name: "Matérn 3/2", keys: &["kernel=\"matern-3/2\""] },
    Prior { name: "Gaussian, truncated root", keys: &["kernel=\"gaussian\"", "root=\"truncated\""] },
    Prior {
        name: "Gaussian, Gaspari–Cohn taper of L",
        keys: &["kernel=\"gaussian\"", "taper=\"gaspari-cohn\"", "localization_length={L}"],
    },
    Prior {
        name: "Gaussian, triangle taper of L",
        keys: &["kernel=\"gaussian\"", "taper=\"triangle\"", "localization_length={L}"],
    },
];

/// A rod of the table.
struct Rod {
    name: &'static str,
    length: f64,
    scene: &'static str,
    /// What the background's run has otherwise.
    wrong: &'static str,
}

const RODS: &[Rod] = &[
    Rod {
        name: "hanging rod",
        length: 1.0,
        scene: "length = 1.0\nsegments = 25\nsection = { kind = \"circle\", radius = 0.01 }\n\
                material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }\n\
                start = { position = [0.0, 0.0, 0.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, \
                0.0], motion = { kind = \"ellipse\", radii = [0.10, 0.06], omega = 12.0, ramp_periods = 1.0 \
                } }\n[time]\nintegrator = \"bdf2\"\nstep = 0.01\nspin_up = 150\nwindow = 100\n\
                [observations]\nkind = \"synthetic\"\nplaces = [0.25, 0.5, 0.75, 1.0]\nevery = 10\n",
        wrong: "model.material.youngs_modulus=0.7e6",
    },
    Rod {
        name: "thin rod",
        length: 0.5,
        scene: "length = 0.5\nsegments = 20\nsection = { kind = \"circle\", radius = 0.005 }\n\
                material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }\n\
                start = { position = [0.0, 0.0, 0.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, \
                0.0], motion = { kind = \"ellipse\", radii = [0.05, 0.03], omega = 9.0, ramp_periods = 1.0 } \
                }\n[time]\nintegrator = \"bdf2\"\nstep = 0.01\nspin_up = 100\nwindow = 60\n\
                [observations]\nkind = \"synthetic\"\nplaces = [0.25, 0.5]\nevery = 5\n",
        wrong: "model.material.youngs_modulus=0.5e6",
    },
    Rod {
        name: "tether in a current",
        length: 2.0,
        scene: "length = 2.0\nsegments = 20\ngravity = [0.0, 0.0, -0.892]\n\
                section = { kind = \"circle\", radius = 0.004 }\n\
                material = { youngs_modulus = 2e6, poisson_ratio = 0.5, density = 1100.0 }\n\
                drag = { fluid_density = 1000.0, diameter = 0.008, flow = [0.25, 0.0, 0.0] }\n\
                start = { position = [0.0, 0.0, 0.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, \
                0.0], motion = { kind = \"ellipse\", radii = [0.10, 0.10], omega = 2.0, ramp_periods = 1.0 } \
                }\n[time]\nintegrator = \"bdf2\"\nstep = 0.02\nspin_up = 200\nwindow = 60\n\
                [observations]\nkind = \"synthetic\"\nplaces = [0.5, 1.0, 1.5, 2.0]\nevery = 5\n",
        wrong: "model.drag.flow=[0.2,0.0,0.0]",
    },
    Rod {
        name: "cable between hooks",
        length: 1.3,
        scene: "length = 1.3\nsegments = 26\n\
                section = { kind = \"stiffness\", ea = 5e3, ei = [2e-3, 2e-3], gj = 2e-3, \
                mass_per_length = 0.1 }\ndamping = { mass = 0.3 }\n\
                prescribed = [{ vertex = 0, position = [0.0, 0.0, 0.0], motion = { kind = \"ellipse\", \
                radii = [0.05, 0.05], omega = 6.0, ramp_periods = 1.0 } }, { vertex = 26, position = \
                [1.0, 0.0, 0.1] }]\n\
                [time]\nintegrator = \"bdf2\"\nstep = 0.01\nspin_up = 150\nwindow = 80\n\
                [observations]\nkind = \"synthetic\"\nplaces = [0.3, 0.65, 1.0]\nevery = 8\n",
        wrong: "model.section.mass_per_length=0.09",
    },
];

/// Numbers of one row.
#[derive(Default)]
struct Scored {
    status: String,
    chi2: f64,
    reduction: [f64; 2],
    credible: [f64; 2],
    factorizations: usize,
}

impl Scored {
    fn of(rod: &Rod, prior: &Prior, length: f64) -> Result<Scored> {
        const SEEDS: u64 = 3;
        let mut sum = Scored::default();
        let guess = truth(&scene(rod, &[rod.wrong.to_string()])?)?;
        let real = truth(&scene(rod, &[])?)?;
        let n = guess.len() / 2;
        let [sigma_x, sigma_v] = [0, n].map(|at| {
            let squares = (at..at + n).map(|i| (guess[i] - real[i]).powi(2));
            (squares.sum::<f64>() / n as f64).sqrt()
        });
        for seed in 0..SEEDS {
            let mut sets = vec![format!("seed={seed}")];
            let covariance = |key: &str| format!("background.covariance.{key}");
            sets.push(covariance(&format!("sigma_x={sigma_x:e}")));
            sets.push(covariance(&format!("sigma_v={sigma_v:e}")));
            let correlation = length * rod.length;
            sets.extend(["x", "v"].map(|of| covariance(&format!("correlation_length_{of}={correlation:?}"))));
            sets.extend(
                prior.keys.iter().map(|key| covariance(&key.replace("{L}", &format!("{:?}", rod.length)))),
            );
            let mut problem = Problem::from_scene(&scene(rod, &sets)?)?;
            problem.background.clone_from(&guess);
            let outcome = assimilate(&problem, &mut Listener::silent())?;
            sum.add(&outcome, &real, SEEDS as f64);
        }
        Ok(sum)
    }

    fn add(&mut self, outcome: &Outcome, truth: &[f64], seeds: f64) {
        let (a, n) = (&outcome.analysis, truth.len() / 2);
        let rms = |f: &dyn Fn(usize) -> f64, at: usize| {
            ((at..at + n).map(|i| f(i).powi(2)).sum::<f64>() / n as f64).sqrt()
        };
        for (group, at) in [0, n].into_iter().enumerate() {
            let before = rms(&|i| a.background[i] - truth[i], at);
            let after = rms(&|i| a.analysis[i] - truth[i], at);
            self.reduction[group] += after / before / seeds;
            self.credible[group] += rms(&|i| (a.analysis[i] - truth[i]) / a.sigma_analysis[i], at) / seeds;
        }
        let status = outcome.status.name();
        if !self.status.contains(status) {
            let between = if self.status.is_empty() { "" } else { ", " };
            self.status = format!("{}{between}{status}", self.status);
        }
        self.chi2 += a.chi2 / seeds;
        self.factorizations += outcome.counts.factorizations;
    }

    fn row(self, rod: &Rod, prior: &Prior, length: f64) -> Vec<super::Cell> {
        let ([x, v], [of_x, of_v]) = (self.reduction, self.credible);
        cells![rod.name, prior.name, length, self.status, self.chi2, x, v, of_x, of_v, self.factorizations]
    }
}

/// A scene of a rod; `sets` change keys of it.
fn scene(rod: &Rod, sets: &[String]) -> Result<SceneFile> {
    let text = format!(
        "title = \"\"\nseed = 0\n[background]\nfrom = \"truth-plus-draw\"\ncovariance = {{ kind = \
         \"kernel\", sigma_x = 0.01, sigma_v = 0.1, correlation_length_x = 0.5, correlation_length_v = 0.5 \
         }}\n[model]\nkind = \"rod\"\n{}sigma = 0.002\n",
        rod.scene
    );
    Ok(SceneFile::parse(rod.name, rod.name, &text, None, sets)?)
}

/// The true control of a scene.
fn truth(file: &SceneFile) -> Result<Vec<f64>> {
    let problem = Problem::from_scene(file)?;
    let n = problem.background.len();
    Ok(problem.truth.as_ref().ok_or("no truth")?[..n].to_vec())
}
