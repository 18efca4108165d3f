//! Error against seconds where constants are estimated.

use super::clock;
use super::{Cell, Options, Page, Result, Table};
use crate::cells;
use problems::recordings::{CABLE_CONSTANTS, CABLE_PRIORS, Wire, gripped_cable, gripped_cable_folder};
use std::path::PathBuf;
use varda::outcome::{Estimated, Outcome};
use varda::report::chart::{Corner, Panel, Series, Style};
use varda::run::{Listener, assimilate};
use varda::scene::{STARTER, SceneFile};
use varda::setup::Problem;

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut runs = Table::new("runs", "One recording", RUNS);
    let mut constants = Table::new("constants", "The constants", CONSTANTS);
    for recording in recordings().iter().take(if options.quick { 1 } else { usize::MAX }) {
        let one = Run::of(recording, &[])?;
        let with_mesh = if recording.mesh { Some(Run::of(recording, &["report.mesh=true"])?) } else { None };
        runs.push(one.row(recording, with_mesh.as_ref()));
        for (name, reference) in &recording.references {
            constants.push(constant(recording, (name, *reference), &one, with_mesh.as_ref())?);
        }
    }
    let mut meshes = Table::new("meshes", "The hose: segments, steps and minimizers", MESHES);
    let panel = hose_by_cost(&mut meshes, options)?;
    let mut twins = Table::new("twins", "Twins over seeds", TWINS);
    for twin in twins_of() {
        twin.push(&mut twins, if options.quick { 2 } else { twin.seeds })?;
    }
    Ok(Page {
        title: "Estimating constants: error against seconds",
        text: TEXT.into(),
        tables: vec![runs, constants, meshes, twins],
        panels: vec![panel],
        remarks: REMARKS.into(),
    })
}

const RUNS: &[&str] = &[
    "recording",
    "unknown beside the state",
    "unknowns",
    "values",
    "status",
    "2J/m",
    "worst error (σ)",
    "with the mesh's",
    "kept back, rms (mm)",
    "forecast, rms (mm)",
    "iterations",
    "model runs",
    "products, runs",
    "CPU s",
    "with the mesh's",
];

const CONSTANTS: &[&str] = &[
    "recording",
    "constant",
    "unit",
    "prior",
    "reference",
    "estimate",
    "σ",
    "error (σ)",
    "σ with the mesh's",
    "error (σ with the mesh's)",
];

const MESHES: &[&str] = &[
    "segments",
    "step (s)",
    "method",
    "minimizer",
    "2J/m",
    "rms error of five constants (σ)",
    "EI off (%)",
    "damping off (%)",
    "forecast, rms (mm)",
    "CPU s",
];

const TWINS: &[&str] =
    &["twin", "of", "seeds", "RMSE before", "RMSE after", "rms of error/σ", "inside 95 %", "CPU s a seed"];

const TEXT: &str = "\
State and constants are estimated together by 4D-Var from priors that are off, minimizer `auto`, with σ of \
everything. *Reference*: the constants of the program that made the recording (hose, gripped cable), those \
that the makers list for theirs (beam, wires). *Worst error*: of the constants, in σ of the observations \
alone, and in σ with the allowance for the mesh, which is the same estimate with twice the segments and \
half the step. *Kept back* and *forecast*: distance of markers that were not assimilated, and of all markers \
after the window, root mean square. *Model runs*: steps of the model in windows; *products*: steps \
of tangents and adjoints in windows. *CPU s*: of the whole run with posterior and diagnostics, without and \
with the finer mesh.

Other programs: MuJoCo's toolbox of system identification (least squares by finite differences, no state \
with a prior, no σ of an observation) took on the recording of scene `hose`, in the plane, on a machine of \
the same kind, 1.3 to 1.6 CPU s for EI and damping (18 rollouts), 2.4 to 2.6 for four constants and 5 to 6.5 \
with ten numbers of the state.";

const REMARKS: &str = "\
Twins: background and observations are drawn around the truth with the priors and σ that the estimate \
assumes; *rms of error/σ* in the number whose prior is normal (of a log-normal constant its logarithm), \
where 1 is right.

The hose was made with 60 links, 24 segments move EI by more than its σ, and the allowance says so. What \
σ does not know is what the model leaves out: the beam errs by 0.3 mm, which is what its σ stands for, and \
its modulus is by the frequency of the same rows 5 % above what its makers list (guide page estimates). The \
wires' listed EI have no σ; points were picked by hand. Red 0 ends at an edge where the wire snaps into \
another shape, and says so: its row is no answer.";

/// A recording, and what is known of the constants that it was made with.
struct Recording {
    name: String,
    unknown: &'static str,
    scene: Source,
    sets: Vec<String>,
    references: Vec<(&'static str, f64)>,
    /// Whether the allowance for the mesh is measured too.
    mesh: bool,
}

#[derive(Clone)]
enum Source {
    Shipped(&'static str),
    Starter,
    /// Text, and the folder of its files.
    Text(String, PathBuf),
}

impl Source {
    fn open(&self, sets: &[String]) -> Result<SceneFile> {
        Ok(match self {
            Source::Shipped(name) => SceneFile::open(name, sets)?,
            Source::Starter => SceneFile::parse("starter", "starter.toml", STARTER, None, sets)?,
            Source::Text(text, folder) => SceneFile::parse("scene", "scene.toml", text, Some(folder), sets)?,
        })
    }
}

const HOSE_TWO: [&str; 4] = [
    "model.section.ei=[0.25,0.25]",
    "model.damping.stiffness=0.012",
    "estimate.ei={sigma=\"30%\",together=true}",
    "estimate.damping_stiffness={sigma=\"50%\"}",
];
const HOSE_MORE: [&str; 4] = [
    "model.natural_curvature=[1.3,0.0]",
    "model.point_masses.0.mass=0.065",
    "estimate.natural_curvature={sigma=0.5}",
    "estimate.point_mass={sigma=\"30%\"}",
];
const HOSE: [(&str, f64); 5] = [
    ("ei", 0.30),
    ("damping_stiffness", 0.008),
    ("natural_curvature[0]", 1.0),
    ("natural_curvature[1]", 0.0),
    ("point_mass[0]", 0.05),
];
const BEAM: [&str; 7] = [
    "model.material.youngs_modulus=342971",
    "model.damping.stiffness=0.00154",
    "estimate.youngs_modulus={sigma=\"30%\"}",
    "estimate.damping_stiffness={sigma=\"50%\"}",
    "estimate.clamp_direction={sigma=0.03}",
    "estimate.marker_offset={sigma=0.002}",
    "observations.sigma=0.0003",
];

fn owned(sets: &[&[&str]]) -> Vec<String> {
    sets.iter().flat_map(|sets| sets.iter()).map(ToString::to_string).collect()
}

fn recordings() -> Vec<Recording> {
    let hose = |unknown, sets: Vec<String>, references: &[(&'static str, f64)]| Recording {
        name: "hose".into(),
        unknown,
        scene: Source::Shipped("hose"),
        sets,
        references: references.to_vec(),
        mesh: true,
    };
    let mut all = vec![
        hose("EI, damping", owned(&[&HOSE_TWO]), &HOSE[..2]),
        hose("EI, damping, curvature, tip mass", owned(&[&HOSE_TWO, &HOSE_MORE]), &HOSE),
        Recording {
            name: "gripped cable".into(),
            unknown: "EI, GJ, both dampings, curvature",
            scene: Source::Text(gripped_cable(0.0), gripped_cable_folder()),
            sets: owned(&[&CABLE_PRIORS]),
            references: CABLE_CONSTANTS.to_vec(),
            mesh: true,
        },
        Recording {
            name: "silicone beam".into(),
            unknown: "modulus, damping, clamp, places of markers",
            scene: Source::Shipped("beam-release"),
            sets: owned(&[&BEAM]),
            references: vec![("youngs_modulus", 263_824.0), ("damping_stiffness", 0.0022)],
            mesh: true,
        },
    ];
    for pose in ["black 0", "black 2", "red 0", "red 2", "white 0", "white 2"] {
        if let Some((wire, folder)) = Wire::of(pose).zip(wire_folder(pose)) {
            all.push(Recording {
                name: format!("wire {pose}"),
                unknown: "EI, clamps",
                scene: Source::Text(wire.scene, folder),
                sets: Vec::new(),
                references: vec![("ei", wire.ei)],
                mesh: false,
            });
        }
    }
    all
}

/// A folder with the shape that a wire's scene reads.
fn wire_folder(pose: &str) -> Option<PathBuf> {
    let name = format!("varda-bench-{}-{}", std::process::id(), pose.replace(' ', "-"));
    let folder = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&folder).ok()?;
    std::fs::write(folder.join("seen.csv"), Wire::of(pose)?.csv).ok()?;
    Some(folder)
}

/// One estimate, and what it took.
struct Run {
    outcome: Outcome,
    seconds: f64,
}

impl Run {
    fn of(recording: &Recording, more: &[&str]) -> Result<Run> {
        let sets = [vec!["report.mesh=false".into()], recording.sets.clone(), owned(&[more])].concat();
        Self::from(&recording.scene.open(&sets)?)
    }

    fn from(file: &SceneFile) -> Result<Run> {
        let began = clock::process_seconds();
        let outcome = assimilate(&Problem::from_scene(file)?, &mut Listener::silent())?;
        Ok(Run { outcome, seconds: clock::process_seconds() - began })
    }

    fn named(&self, name: &str) -> Result<&Estimated> {
        Ok(self.outcome.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))?)
    }

    /// The largest error of constants in σ.
    fn worst(&self, references: &[(&str, f64)]) -> Option<f64> {
        let errors: Option<Vec<f64>> = references
            .iter()
            .map(|(name, reference)| {
                let e = self.named(name).ok()?;
                Some((e.value - reference).abs() / e.sigma?)
            })
            .collect();
        errors.map(|errors| errors.into_iter().fold(0.0, f64::max))
    }

    fn row(&self, recording: &Recording, mesh: Option<&Run>) -> Vec<Cell> {
        let o = &self.outcome;
        // a shape at rest has no steps
        let steps = if o.experiment.grid.steps == 0 { f64::NAN } else { o.experiment.grid.steps as f64 };
        let products = (o.counts.tangent_steps + o.counts.adjoint_steps) as f64 / steps;
        cells![
            recording.name.as_str(),
            recording.unknown,
            o.experiment.n_unknown(),
            o.analysis.observations,
            o.status.name(),
            o.analysis.chi2,
            self.worst(&recording.references),
            mesh.and_then(|mesh| mesh.worst(&recording.references)),
            1e3 * mean_square(o.withheld.iter().map(|w| (w.count, w.rms_analysis))),
            self.forecast(),
            o.iterations[0],
            o.counts.model_steps as f64 / steps,
            products,
            self.seconds,
            mesh.map(|mesh| mesh.seconds)
        ]
    }

    fn forecast(&self) -> f64 {
        1e3 * mean_square(self.outcome.forecast.iter().map(|f| (f.count, f.analysis)))
    }
}

/// The root mean square of several, each of so many values; NaN of none.
fn mean_square(of: impl Iterator<Item = (usize, f64)>) -> f64 {
    let (count, sum) =
        of.fold((0, 0.0), |(n, sum), (count, rms)| (n + count, sum + count as f64 * rms * rms));
    (sum / count as f64).sqrt()
}

fn constant(
    recording: &Recording,
    (name, reference): (&str, f64),
    run: &Run,
    mesh: Option<&Run>,
) -> Result<Vec<Cell>> {
    let e = run.named(name)?;
    let on_mesh = mesh.and_then(|mesh| mesh.named(name).ok());
    let error = |e: &Estimated| e.sigma.map(|sigma| (e.value - reference) / sigma);
    Ok(cells![
        format!("{}: {}", recording.name, recording.unknown),
        name,
        e.unit,
        e.prior,
        reference,
        e.value,
        e.sigma,
        error(e),
        on_mesh.and_then(|e| e.sigma),
        on_mesh.and_then(error)
    ])
}

/// The five constants of the hose by what they cost; returns the figure.
fn hose_by_cost(table: &mut Table, options: &Options) -> Result<Panel> {
    let base = owned(&[&HOSE_TWO, &HOSE_MORE, &["report.mesh=false"]]);
    let mut series = Vec::new();
    let segments: &[usize] = if options.quick { &[12] } else { &[12, 24, 48, 96] };
    let ways = [("4dvar", "auto"), ("4dvar-incremental", "")];
    for (i, (method, minimizer)) in ways.into_iter().enumerate() {
        let mut points = Vec::new();
        for &n in segments {
            let mut sets = base.clone();
            sets.push(format!("model.segments={n}"));
            sets.push(format!("algorithm.method={method}"));
            if !minimizer.is_empty() {
                sets.push(format!("algorithm.minimizer={minimizer}"));
            }
            let run = Run::from(&SceneFile::open("hose", &sets)?)?;
            let off = |name: &str, truth: f64| {
                Ok::<f64, Box<dyn std::error::Error>>(run.named(name)?.value / truth - 1.0)
            };
            let mut squares = 0.0;
            for (name, truth) in HOSE {
                let e = run.named(name)?;
                squares += ((e.value - truth) / e.sigma.ok_or("no σ")?).powi(2) / HOSE.len() as f64;
            }
            let (ei, damping) = (off("ei", 0.30)?, off("damping_stiffness", 0.008)?);
            points.push((run.seconds, 100.0 * ei.abs()));
            table.push(cells![
                n,
                run.outcome.experiment.grid.step,
                method,
                if minimizer.is_empty() { "–" } else { minimizer },
                run.outcome.analysis.chi2,
                squares.sqrt(),
                100.0 * ei,
                100.0 * damping,
                run.forecast(),
                run.seconds
            ]);
        }
        let label = if minimizer.is_empty() { method.to_string() } else { format!("{method}, {minimizer}") };
        series.push(Series { label, style: Style::Marked(i), points });
    }
    Ok(Panel {
        title: "Hose, five constants: 12, 24, 48 and 96 segments".into(),
        x_label: "CPU seconds of the run".into(),
        y_label: "EI off what it was made with (%)".into(),
        log_x: true,
        log_y: true,
        legend: Some(Corner::Top),
        series,
        ..Panel::default()
    })
}

/// A model with constants that are drawn from their priors.
struct Twin {
    name: &'static str,
    scene: Source,
    seeds: u64,
    sets: Vec<String>,
}

fn twins_of() -> Vec<Twin> {
    let twin = |name, scene, seeds, sets: &[&str]| Twin { name, scene, seeds, sets: owned(&[sets]) };
    let mut cable = gripped_cable(0.0).replace("from = \"static-equilibrium\"", "from = \"truth-plus-draw\"");
    if let Some((head, rest)) = cable.split_once("[observations]") {
        let report = rest.split_once("[report]").map_or("", |(_, report)| report);
        cable = format!("{head}[observations]\n{CABLE_SEEN}\n[report]{report}");
    }
    let cable = Source::Text(cable, gripped_cable_folder());
    let cable_sets = owned(&[&CABLE_KNOWN, &CABLE_PRIORS[1..]]);
    vec![
        twin("Lorenz-63, 50 steps", Source::Shipped("lorenz63"), 40, &LORENZ63),
        twin(
            "Lorenz-63, 100 steps",
            Source::Shipped("lorenz63"),
            40,
            &[&LORENZ63[..], &["time.window=100"]].concat(),
        ),
        twin(
            "Lorenz-96",
            Source::Shipped("lorenz96"),
            40,
            &["estimate.forcing={sigma=\"5%\"}", "background.covariance.sigma=0.3"],
        ),
        twin("driven rod", Source::Starter, 40, &ROD),
        Twin { name: "gripped cable", scene: cable, seeds: 20, sets: cable_sets },
    ]
}

const LORENZ63: [&str; 4] = [
    "estimate.sigma={sigma=\"10%\"}",
    "estimate.rho={sigma=\"10%\"}",
    "estimate.beta={sigma=\"10%\"}",
    "background.covariance.sigma=0.3",
];
const ROD: [&str; 5] = [
    "model.damping.stiffness=0.01",
    "model.damping.mass=0.5",
    "estimate.youngs_modulus={sigma=\"15%\"}",
    "estimate.damping_stiffness={sigma=\"30%\"}",
    "estimate.natural_curvature={sigma=0.2}",
];
/// A start that is known better than to let the cable stretch by per cents within its σ.
const CABLE_KNOWN: [&str; 3] =
    ["time.window=100", "background.covariance.sigma_x=0.005", "background.covariance.sigma_v=0.1"];
/// Every second of the markers of the recording.
const CABLE_SEEN: &str = "kind = \"synthetic\"\nevery = 1\nsigma = 1e-3\n\
     places = [0.083333, 0.25, 0.416667, 0.583333, 0.75, 0.916667]";

/// One constant, or one group of the state, over seeds.
struct Errors {
    name: String,
    before: f64,
    after: f64,
    over_sigma: f64,
    inside: f64,
}

impl Twin {
    fn push(&self, table: &mut Table, seeds: u64) -> Result<()> {
        let mut all: Vec<Errors> = Vec::new();
        let mut seconds = 0.0;
        for seed in 0..seeds {
            let sets = [self.sets.clone(), vec![format!("seed={seed}")]].concat();
            let run = Run::from(&self.scene.open(&sets)?)?;
            seconds += run.seconds / seeds as f64;
            let o = &run.outcome;
            let mut add = |name: &str, values: [f64; 4]| {
                let i = all.iter().position(|e| e.name == name).unwrap_or_else(|| {
                    all.push(Errors {
                        name: name.into(),
                        before: 0.0,
                        after: 0.0,
                        over_sigma: 0.0,
                        inside: 0.0,
                    });
                    all.len() - 1
                });
                let [before, after, over_sigma, inside] = values;
                all[i].before += before;
                all[i].after += after;
                all[i].over_sigma += over_sigma;
                all[i].inside += inside;
            };
            for e in &o.estimates {
                let (truth, [low, high]) = (e.truth.ok_or("no truth")?, e.interval.ok_or("no σ")?);
                let inside = f64::from(u8::from((low..=high).contains(&truth)));
                let error = e.value - truth;
                // in the number that is normal under the prior
                let over = match (low * high / (e.value * e.value) - 1.0).abs() < 1e-9 {
                    true => (truth / e.value).ln() / ((high / low).ln() / (2.0 * 1.96)),
                    false => error / e.sigma.ok_or("no σ")?,
                };
                add(&e.name, [(e.prior - truth).powi(2), error * error, over * over, inside]);
            }
            // the state at the end of the window, half of whose places were never seen
            let (runs, k) = (&o.trajectories, o.experiment.grid.steps);
            let states =
                [&runs.truth, &runs.analysis, &runs.background, &o.sigma_states].map(|s| runs.state(s, k));
            let [Some(truth), Some(analysis), Some(background), Some(sigma)] = states else {
                return Err(format!("{}, seed {seed}: no state at the end", self.name).into());
            };
            for group in &o.experiment.state.groups {
                let mut sums = [0.0; 4];
                for c in group.range.clone() {
                    let error = analysis[c] - truth[c];
                    let within = f64::from(u8::from(error.abs() <= 1.96 * sigma[c]));
                    let of = [
                        (background[c] - truth[c]).powi(2),
                        error * error,
                        (error / sigma[c]).powi(2),
                        within,
                    ];
                    sums.iter_mut().zip(of).for_each(|(sum, of)| *sum += of / group.range.len() as f64);
                }
                add(&format!("{} at the end", group.name), sums);
            }
        }
        let n = seeds as f64;
        for e in all {
            let [before, after, over] = [e.before, e.after, e.over_sigma].map(|s| (s / n).sqrt());
            table.push(cells![self.name, e.name, seeds as usize, before, after, over, e.inside / n, seconds]);
        }
        Ok(())
    }
}
