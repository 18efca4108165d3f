//! Results as [`Dataset`]s.

use varda_rod::{Curvature, InternalForces};

use super::dataset::{Dataset, Values};
use crate::outcome::{
    CyclesOutcome, Estimated, Experiment, Members, ModelErrors, ObservedValue, Outcome, Shapes, Simulation,
    Trajectories,
};
use crate::state::{Geometry, StateGroup};

/// The version of the CF conventions whose names and units are used.
const CONVENTIONS: &str = "CF-1.11";
const AXES: [&str; 3] = ["x", "y", "z"];

/// Coordinates of what was observed.
const OF_OBSERVATIONS: &str = "obs_time obs_marker obs_axis";

impl Dataset {
    /// The result of a run of one window.
    ///
    /// ```
    /// use varda::report::Dataset;
    /// use varda::run::{Listener, assimilate};
    /// use varda::scene::SceneFile;
    /// use varda::setup::Problem;
    ///
    /// let problem = Problem::from_scene(&SceneFile::open("lorenz63", &[])?)?;
    /// let data = Dataset::of(&assimilate(&problem, &mut Listener::silent())?);
    /// let state = data.arrays.iter().find(|array| array.name == "state").expect("the analysis");
    /// assert_eq!(state.dimensions, ["time", "component"]);
    /// assert_eq!(state.shape, [problem.experiment.grid.last_step() + 1, 3]);
    /// # Ok::<(), varda::Error>(())
    /// ```
    pub fn of(outcome: &Outcome) -> Dataset {
        let experiment = &outcome.experiment;
        let mut data = Dataset::about(experiment, "analysis");
        let algorithm = &experiment.scene.algorithm;
        data.attributes.extend([
            ("method", algorithm.method.name().to_string()),
            ("minimizer", algorithm.solver_name().to_string()),
            ("status", outcome.status.name().to_string()),
            ("verdict", outcome.judgement.verdict.heading().to_string()),
            ("verdict_text", outcome.judgement.text.clone()),
        ]);
        let shapes = outcome.shapes.as_ref();
        data.runs(experiment, &outcome.trajectories, &outcome.sigma_states, shapes, "analysis");
        if let (Some(shapes), Some(geometry)) = (shapes, &experiment.state.geometry) {
            data.forces("", "", &shapes.forces, geometry, experiment.grid.last_step());
            data.curvature(&shapes.curvature, geometry, experiment.grid.last_step());
            data.forces("_sigma", "sigma of ", &shapes.sigma_forces, geometry, experiment.grid.last_step());
        }
        data.control(outcome);
        data.constants(&outcome.estimates);
        if let Some(errors) = &outcome.model_errors {
            data.model_errors(experiment, errors);
        }
        data.observations(&outcome.observed);
        if let Some(members) = &outcome.members {
            data.members(experiment, members, shapes);
        }
        data
    }

    /// A forward run.
    pub fn of_simulation(simulation: &Simulation) -> Dataset {
        let experiment = &simulation.experiment;
        let of = format!("run of the {}", simulation.of);
        let mut data = Dataset::about(experiment, &of);
        let shapes = simulation.shapes.as_ref();
        data.runs(experiment, &simulation.trajectories, &[], shapes, &of);
        if let (Some(shapes), Some(geometry)) = (shapes, &experiment.state.geometry) {
            data.forces("", "", &shapes.forces, geometry, experiment.grid.last_step());
            data.curvature(&shapes.curvature, geometry, experiment.grid.last_step());
        }
        data
    }

    /// Window after window: analysis and truth over all steps.
    pub fn of_cycles(outcome: &CyclesOutcome) -> Dataset {
        let experiment = &outcome.experiment;
        let mut data = Dataset::about(experiment, "analysis of each window up to the start of the next");
        data.attributes.push(("status", outcome.status.name().to_string()));
        data.attributes.push(("verdict", outcome.judgement.verdict.heading().to_string()));
        let sigma = &outcome.sigma_states;
        data.runs(experiment, &outcome.trajectories, sigma, outcome.shapes.as_ref(), "analysis");
        data.observations(&outcome.observed);
        if let Some(members) = &outcome.members {
            data.members(experiment, members, outcome.shapes.as_ref());
        }
        let windows = [("window", outcome.cycles.len())];
        let times = outcome.cycles.iter().map(|cycle| cycle.time).collect();
        data.put("window", &windows, times, "s", "model time at the start of a window");
        let chi2 = outcome.cycles.iter().map(|cycle| cycle.chi2).collect();
        data.put("chi2", &windows, chi2, "1", "2J/m of a window");
        data
    }

    /// What is said of every result, and its coordinates.
    fn about(experiment: &Experiment, of: &str) -> Dataset {
        let mut data = Dataset::default();
        let scene = &experiment.scene;
        let title = if scene.title.is_empty() { &experiment.name } else { &scene.title };
        let version = env!("CARGO_PKG_VERSION");
        data.attributes.extend([
            ("Conventions", CONVENTIONS.to_string()),
            ("title", title.clone()),
            ("source", format!("Varda {version}")),
            ("version", version.to_string()),
            ("scene", experiment.name.clone()),
            ("seed", scene.seed.to_string()),
            ("run", of.to_string()),
            ("scene_toml", toml::to_string(scene).unwrap_or_default()),
        ]);
        let times = experiment.grid.times();
        data.put("time", &[("time", times.len())], times, "s", "model time");
        match &experiment.state.geometry {
            Some(geometry) => {
                let s = &geometry.arc_lengths;
                let middles: Vec<f64> = s.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
                let inner = s.get(1..s.len() - 1).unwrap_or_default().to_vec();
                data.put("s", &[("s", s.len())], s.clone(), "m", "arc length of vertices");
                data.put(
                    "s_edge",
                    &[("s_edge", middles.len())],
                    middles,
                    "m",
                    "arc length of middles of edges",
                );
                let what = "arc length of vertices between two edges";
                data.put("s_inner", &[("s_inner", inner.len())], inner, "m", what);
                data.texts("component", &[("component", 3)], AXES.iter(), "axis");
            }
            None => {
                let names = &experiment.state.names;
                let dimension = [("component", names.len())];
                data.texts("component", &dimension, names.iter(), "component of the state");
                if let Some(line) = scene.model.line().filter(|line| line.points == names.len()) {
                    let places = (0..names.len()).map(|i| line.position(i)).collect();
                    data.put("s", &dimension, places, "m", "place on the line");
                }
            }
        }
        data
    }

    /// The states of runs, and σ of those of the first.
    fn runs(
        &mut self,
        experiment: &Experiment,
        runs: &Trajectories,
        sigma: &[f64],
        shapes: Option<&Shapes>,
        of: &str,
    ) {
        let steps = experiment.grid.last_step() + 1;
        let states = [
            ("", of, runs.analysis.as_slice()),
            ("_background", "background", &runs.background),
            ("_truth", "truth", &runs.truth),
            ("_sigma", "", sigma),
        ];
        let known = || states.iter().filter(|(_, _, states)| !states.is_empty());
        let Some((shapes, geometry)) = shapes.zip(experiment.state.geometry.as_ref()) else {
            let names = experiment.state.names.len();
            for (suffix, of, states) in known() {
                let row = |k| runs.state(states, k).map(|x| x[..names].to_vec());
                let what = if of.is_empty() {
                    "standard deviation of the state".into()
                } else {
                    format!("state, {of}")
                };
                let dimensions = [("time", steps), ("component", names)];
                self.put(format!("state{suffix}"), &dimensions, rows(steps, names, row), "1", what);
            }
            self.locate("component", "s");
            return;
        };
        let in_space = [("time", steps), ("s", geometry.arc_lengths.len()), ("component", 3)];
        let places = [
            ("", of, &shapes.analysis),
            ("_background", "background", &shapes.background),
            ("_truth", "truth", &shapes.truth),
        ];
        for (suffix, of, run) in places.into_iter().filter(|(_, _, run)| !run.is_empty()) {
            let step = |k: usize| run.get(k).map(|shape| shape.as_flattened().to_vec());
            let values = rows(steps, 3 * geometry.arc_lengths.len(), step);
            let what = format!("position of vertices, {of}");
            self.put(format!("position{suffix}"), &in_space, values, "m", what);
        }
        for group in &experiment.state.groups {
            for (suffix, of, states) in known() {
                let is_sigma = of.is_empty();
                if group.name == "position" && !is_sigma {
                    continue;
                }
                // a held vertex is known
                let held = if group.name == "position" { 0.0 } else { f64::NAN };
                let along_edges = [("time", steps), ("s_edge", geometry.arc_lengths.len() - 1)];
                let dimensions = if group.width == 3 { &in_space[..] } else { &along_edges };
                let step = |k| runs.state(states, k).map(|state| spread(state, group, geometry, held));
                let values = rows(steps, dimensions[1..].iter().map(|(_, n)| n).product(), step);
                let what = if is_sigma {
                    format!("standard deviation of {}", group.name)
                } else {
                    format!("{}, {of}", group.name)
                };
                self.put(format!("{}{suffix}", group.name), dimensions, values, unit(group.unit), what);
            }
        }
    }

    /// Members of the analysis; what is held of a rod is where the analysis has it.
    fn members(&mut self, experiment: &Experiment, members: &Members, shapes: Option<&Shapes>) {
        let Members { count, steps, states } = members;
        let (all, times) = (("member", *count), ("member_time", steps.len()));
        let numbers = (0..*count as i32).collect();
        self.add("member", &[all], Values::Integers(numbers), "1", "member of the ensemble of analyses");
        let at = steps.iter().map(|k| experiment.grid.time(*k)).collect();
        self.put("member_time", &[times], at, "s", "model time at which members are kept");
        let n = states.len() / (count * steps.len()).max(1);
        let Some((shapes, geometry)) = shapes.zip(experiment.state.geometry.as_ref()) else {
            let names = experiment.state.names.len();
            let values = states.chunks_exact(n.max(1)).flat_map(|x| &x[..names]).copied().collect();
            let dimensions = [all, times, ("component", names)];
            self.put("state_members", &dimensions, values, "1", "state, members of the analysis");
            return;
        };
        let vertices = geometry.arc_lengths.len();
        for group in &experiment.state.groups {
            let of_state = |(i, state): (usize, &[f64])| {
                let mut values = spread(state, group, geometry, f64::NAN);
                let analysis = shapes.analysis.get(steps[i % steps.len()]);
                if let Some(shape) = analysis.filter(|_| group.name == "position") {
                    let held = (0..vertices).filter(|v| geometry.free.binary_search(v).is_err());
                    held.for_each(|v| values[3 * v..3 * v + 3].copy_from_slice(&shape[v]));
                }
                values
            };
            let values = states.chunks_exact(n.max(1)).enumerate().flat_map(of_state).collect();
            let place = match group.width {
                3 => vec![("s", vertices), ("component", 3)],
                _ => vec![("s_edge", vertices - 1)],
            };
            let what = format!("{}, members of the analysis", group.name);
            let dimensions = [&[all, times][..], &place].concat();
            self.put(format!("{}_members", group.name), &dimensions, values, unit(group.unit), what);
        }
    }

    /// Curvature and rate of twist of a rod, vertex by vertex between two edges.
    fn curvature(&mut self, steps: &[Option<Curvature>], geometry: &Geometry, last_step: usize) {
        let inner = geometry.arc_lengths.len().saturating_sub(2);
        let twists = steps.iter().flatten().any(|of| !of.twist_rate.is_empty());
        if inner == 0 || steps.iter().all(Option::is_none) {
            return;
        }
        let mut put = |name: &str, unit, what: &str, values: &dyn Fn(&Curvature) -> Vec<f64>| {
            let count = last_step + 1;
            let values = rows(count, inner, |k| steps.get(k)?.as_ref().map(values));
            self.put(name, &[("time", count), ("s_inner", inner)], values, unit, what);
        };
        put("curvature", "m-1", "curvature, 2 tan(φ/2) over the length of the vertex", &|of| {
            of.curvature.clone()
        });
        if twists {
            put("twist_rate", "rad m-1", "rate of twist", &|of| of.twist_rate.clone());
        }
    }

    /// Forces and moments from step 1 on: rates are those over a step, so there are none at step 0.
    fn forces(
        &mut self,
        suffix: &str,
        of: &str,
        steps: &[InternalForces],
        geometry: &Geometry,
        last_step: usize,
    ) {
        let Some(first) = steps.first() else { return };
        let vertices = geometry.arc_lengths.len();
        let time = ("time", last_step + 1);
        let (edges, inner, across) =
            (("s_edge", vertices - 1), ("s_inner", vertices.saturating_sub(2)), ("director", 2));
        let mut series = |name: &str,
                          dimensions: &[(&'static str, usize)],
                          unit,
                          what: &str,
                          values: &dyn Fn(&InternalForces) -> Vec<f64>| {
            let length: usize = dimensions[1..].iter().map(|(_, n)| n).product();
            let step = |k: usize| Some(values(steps.get(k.checked_sub(1)?)?));
            let values = rows(last_step + 1, length, step);
            self.put(format!("{name}{suffix}"), dimensions, values, unit, format!("{of}{what}"));
        };
        series("tension", &[time, edges], "N", "tension", &|f| f.tension.clone());
        series("shear", &[time, edges, across], "N", "shear force along the directors", &|f| {
            f.shear.as_flattened().to_vec()
        });
        if !first.twisting.is_empty() {
            series(
                "bending_moment",
                &[time, inner, across],
                "N m",
                "bending moment about the directors",
                &|f| f.bending.as_flattened().to_vec(),
            );
            series("twisting_moment", &[time, inner], "N m", "twisting moment", &|f| f.twisting.clone());
        }
        let supports = ("support", first.reactions.len());
        let in_space = [time, supports, ("component", 3)];
        series("reaction_force", &in_space, "N", "force of supports on the rod", &|f| {
            f.reactions.iter().flat_map(|r| [r.force.x, r.force.y, r.force.z]).collect()
        });
        series("reaction_moment", &in_space, "N m", "moment of supports on the rod", &|f| {
            f.reactions.iter().flat_map(|r| [r.moment.x, r.moment.y, r.moment.z]).collect()
        });
        if suffix.is_empty() {
            let at = first.reactions.iter().map(|r| r.vertex as i32).collect();
            self.add("support", &[supports], Values::Integers(at), "1", "vertex of a support");
        }
    }

    /// x_b, x_a and their σ: what analysis.csv has.
    fn control(&mut self, outcome: &Outcome) {
        let (a, state) = (&outcome.analysis, &outcome.experiment.state);
        let dimension = [("control", state.len())];
        let (names, units): (Vec<&str>, Vec<&str>) = state.components().unzip();
        self.texts("control", &dimension, names.iter(), "what is estimated at the start of the window");
        self.texts("control_unit", &dimension, units.iter(), "unit of what is estimated");
        let mut put = |name: &str, values: &[f64], what: &str| {
            self.put(format!("control_{name}"), &dimension, values.to_vec(), "", what);
        };
        put("background", &a.background, "background");
        put("analysis", &a.analysis, "analysis");
        put("sigma_background", &a.sigma_background, "standard deviation of the background");
        if outcome.has_posterior {
            put("sigma_analysis", &a.sigma_analysis, "standard deviation of the analysis");
        }
        if let Some(truth) = &outcome.truth {
            put("truth", truth, "truth");
        }
        self.locate("control", "control_unit");
    }

    /// Estimated constants: what estimates.csv has.
    fn constants(&mut self, all: &[Estimated]) {
        let dimension = [("constant", all.len())];
        self.texts("constant", &dimension, all.iter().map(|e| &e.name), "estimated constant");
        self.texts("constant_unit", &dimension, all.iter().map(|e| e.unit), "unit of a constant");
        let mut put = |name: &str, value: &dyn Fn(&Estimated) -> Option<f64>, what: &str| {
            let values: Vec<f64> = all.iter().map(|e| value(e).unwrap_or(f64::NAN)).collect();
            if values.iter().any(|value| value.is_finite()) {
                self.put(format!("constant_{name}"), &dimension, values, "", what);
            }
        };
        put("prior", &|e| Some(e.prior), "value before the observations");
        put("prior_sigma", &|e| Some(e.prior_sigma), "its standard deviation");
        put("value", &|e| Some(e.value), "value of the analysis");
        put("sigma", &|e| e.sigma, "its standard deviation, the mesh allowed for");
        put("low_95", &|e| e.interval.map(|i| i[0]), "lower end of its 95 % interval");
        put("high_95", &|e| e.interval.map(|i| i[1]), "upper end of its 95 % interval");
        put("truth", &|e| e.truth, "truth");
        self.locate("constant", "constant_unit");
    }

    /// Errors η of the model: what model_error.csv has.
    fn model_errors(&mut self, experiment: &Experiment, errors: &ModelErrors) {
        let (count, n) = (errors.steps.len(), errors.sigma_prior.len());
        let names: Vec<&str> = experiment.state.components().take(n).map(|(name, _)| name).collect();
        let times = errors.steps.iter().map(|[_, last]| experiment.grid.time(*last)).collect();
        let (error, of) = (("error", count), ("error_of", n));
        self.put("error", &[error], times, "s", "model time at which an error of the model is added last");
        self.texts("error_of", &[of], names.iter(), "what an error is of");
        self.put("model_error", &[error, of], errors.values.clone(), "", "error of the model");
        if !errors.sigma.is_empty() {
            let what = "standard deviation of an error of the model";
            self.put("model_error_sigma", &[error, of], errors.sigma.clone(), "", what);
        }
        let what = "standard deviation of an error before anything was observed";
        self.put("model_error_sigma_prior", &[of], errors.sigma_prior.clone(), "", what);
    }

    /// Everything that was seen: what observations.csv has.
    fn observations(&mut self, seen: &[ObservedValue]) {
        let dimension = [("obs", seen.len())];
        let first = seen.first().map_or("", |v| v.unit);
        let alike = !first.is_empty() && seen.iter().all(|v| v.unit == first);
        let unit = if alike { first } else { "1" };
        self.put("obs_time", &dimension, seen.iter().map(|v| v.time).collect(), "s", "model time");
        self.texts("obs_marker", &dimension, seen.iter().map(|v| &v.label), "marker, place or component");
        self.texts("obs_unit", &dimension, seen.iter().map(|v| v.unit), "unit of the value");
        self.texts("obs_axis", &dimension, seen.iter().map(|v| v.axis), "axis");
        let mut put = |name: &str, value: &dyn Fn(&ObservedValue) -> f64, what: &str| {
            self.put(format!("obs_{name}"), &dimension, seen.iter().map(value).collect(), unit, what);
        };
        put("value", &|v| v.value, "observed value");
        put("background", &|v| v.background, "the same of the background");
        put("analysis", &|v| v.analysis, "the same of the analysis");
        put("sigma", &|v| v.sigma, "assumed standard deviation of the observed value");
        if seen.iter().any(|v| v.sigma_analysis.is_some()) {
            let what = "standard deviation of that of the analysis";
            put("sigma_analysis", &|v| v.sigma_analysis.unwrap_or(f64::NAN), what);
        }
        let used = seen.iter().map(|v| i32::from(v.used)).collect();
        self.add("obs_used", &dimension, Values::Integers(used), "1", "1 where it was assimilated");
        self.texts("obs_reason", &dimension, seen.iter().map(|v| v.reason), "why it was not assimilated");
        self.locate("obs", OF_OBSERVATIONS);
    }

    fn texts(
        &mut self,
        name: &str,
        dimensions: &[(&'static str, usize)],
        texts: impl Iterator<Item = impl ToString>,
        what: &str,
    ) {
        self.add(name, dimensions, Values::Texts(texts.map(|text| text.to_string()).collect()), "", what);
    }
}

/// So many rows of so many numbers, one after the other; NaN in those that are not known.
fn rows(count: usize, length: usize, row: impl Fn(usize) -> Option<Vec<f64>>) -> Vec<f64> {
    let mut all = Vec::with_capacity(count * length);
    for k in 0..count {
        match row(k) {
            Some(row) => all.extend(row),
            None => all.extend(std::iter::repeat_n(f64::NAN, length)),
        }
    }
    all
}

/// The vectors of a group at all vertices, or its numbers at all edges; `held` where they are not free.
fn spread(state: &[f64], group: &StateGroup, geometry: &Geometry, held: f64) -> Vec<f64> {
    let vertices = geometry.arc_lengths.len();
    let (places, free) = match group.width {
        3 => (vertices, &geometry.free),
        _ => (vertices - 1, &geometry.free_edges),
    };
    let mut all = vec![held; group.width * places];
    for (value, place) in state[group.range.clone()].chunks(group.width).zip(free) {
        all[group.width * place..][..group.width].copy_from_slice(value);
    }
    all
}

/// A unit as UDUNITS has it.
fn unit(of: &'static str) -> &'static str {
    match of {
        "m/s" => "m s-1",
        "rad/s" => "rad s-1",
        other => other,
    }
}
