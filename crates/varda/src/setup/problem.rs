//! From a scene to everything an assimilation needs: model, B, x_b, observations, and the truth where there is one.

use std::f64::consts::TAU;

use varda_assimilation::{Observation, ObservationOperator, ObservationSet, Selection};
use varda_covariance::{Ensemble, sample};
use varda_implicit::Model;
use varda_rod::{Marker, RodStep};

use crate::Error;
use crate::scene::{
    self, Covariance as CovarianceKey, KernelCovariance, Observations, Origin, RodModel, Scene, SceneFile,
    Synthetic, Use,
};
use crate::setup::adaptive_steps::{DividedSteps, rod_models};
use crate::setup::component_model;
use crate::setup::covariance::{self, Factored, Places};
use crate::setup::ensemble::{self, Geometry};
use crate::setup::memory::{Memory, Sizes};
use crate::setup::random::{Stream, normal, stream};
use crate::setup::rod_model::RodParts;
use crate::setup::rod_observations::{RodObservation, Sighting, Sightings, Site, Window};
use crate::setup::{climatology, csv};

/// Everything an assimilation needs. Plain data but for the operators.
pub struct Problem {
    /// Name of the scene.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// The window and its grid of steps.
    pub window: Window,
    /// The model; its step k is that of the window.
    pub model: Box<dyn Model>,
    /// Makes it anew, for runs beside one another.
    pub make_model: MakeModel,
    /// Makes the model that runs the truth, where that is another: its steps are divided along itself.
    pub make_truth: Option<MakeModel>,
    /// The steps of `model`, where they are divided by their error.
    pub(crate) divided: Option<DividedSteps>,
    /// What the numbers of a state mean.
    pub view: View,
    /// B.
    pub covariance: Factored,
    /// Q, for the weak-constraint methods.
    pub model_error: Option<Factored>,
    /// The members, for the ensemble methods.
    pub ensemble: Option<Ensemble>,
    /// The component of the control at whose place a row of the observation operator measures.
    pub anchors: Vec<usize>,
    /// x_b, in the control.
    pub background: Vec<f64>,
    /// The state of the truth at the start of the window, in a twin experiment.
    pub truth: Option<Vec<f64>>,
    /// What is assimilated.
    pub observations: ObservationSet,
    /// Most bytes for the states and linearizations of a window: what `[limits] memory` leaves.
    pub memory: usize,
    /// What the scene does not need and the run does not touch.
    pub left_out: Vec<String>,
}

/// Makes the model of a problem, its step 0 being the given step of the window.
pub type MakeModel = Box<dyn Fn(usize) -> Box<dyn Model + Send>>;

/// What the numbers of a state mean.
pub enum View {
    /// A rod: [X, V, θ].
    Rod(Box<RodView>),
    /// Named components of one kind.
    Components(Vec<String>),
}

/// A rod behind a state.
pub struct RodView {
    /// The rod, its supports and loads.
    pub parts: RodParts,
    /// Its dynamics: numbering, places of vertices.
    pub dynamics: RodStep,
    /// All that was seen, withheld and later rows included.
    pub sightings: Sightings,
    /// Where the sites are.
    pub sites: RodObservation,
}

impl RodView {
    /// Places of all vertices at step k \[m\].
    ///
    /// # Errors
    /// [`Error::Rod`].
    pub fn vertices(&mut self, window: &Window, k: usize, state: &[f64]) -> Result<Vec<[f64; 3]>, Error> {
        Ok(self.dynamics.vertices(window.time(k), state)?)
    }
}

impl Problem {
    /// The problem a scene describes. Runs the truth up to the end of the window where there is one.
    ///
    /// # Errors
    /// [`Error`] naming the key, the file's line, or the step.
    pub fn from_scene(file: &SceneFile) -> Result<Problem, Error> {
        let memory = Memory::within_limit(file, &Sizes::of(file)?)?;
        Problem::build(file, memory.for_window)
    }

    /// The problem, whose memory has been counted and leaves so many bytes for a window.
    pub(crate) fn build(file: &SceneFile, memory: usize) -> Result<Problem, Error> {
        match &file.scene.model {
            scene::Model::Rod(rod) => rod_problem(file, rod, memory),
            _ => component_problem(file, memory),
        }
    }

    /// Length of the control.
    pub fn control_dim(&self) -> usize {
        self.background.len()
    }
}

/// The grid of the window a scene describes.
pub fn window(scene: &Scene) -> Window {
    let frequency = match &scene.model {
        scene::Model::Rod(rod) => rod.drive_frequency(),
        _ => None,
    };
    // Validation has seen to it that one of the two is there, and a period for the second.
    let step = match (scene.time.step, scene.time.steps_per_period, frequency) {
        (Some(step), _, _) => step,
        (None, Some(n), Some(omega)) => TAU / (omega * n as f64),
        _ => f64::NAN,
    };
    Window {
        start: scene.time.spin_up as f64 * step,
        step,
        steps: scene.time.window,
        forecast: (scene.report.forecast / step).round() as usize,
    }
}

/// The arc lengths B is about.
pub fn places(parts: &RodParts, dynamics: &RodStep) -> Places {
    let s = parts.rod.arc_lengths();
    let free = dynamics.free_vertices();
    Places {
        free: free.iter().map(|&v| s[v]).collect(),
        known: (0..s.len()).filter(|v| !free.contains(v)).map(|v| s[v]).collect(),
    }
}

/// What a recording or the scene's list of places looks at; synthetic values are not yet drawn.
pub fn sightings(file: &SceneFile, length: f64, window: &Window) -> Result<Sightings, Error> {
    match &file.scene.observations {
        Observations::File(recording) => Sightings::from_recording(file, recording, length, window),
        Observations::Synthetic(synthetic) => {
            let site = |s: &f64| Site {
                label: format!("s = {s} m"),
                marker: Marker { s: *s, offset: [0.0; 3] },
                used: Use::Assimilate,
            };
            Ok(Sightings {
                sites: synthetic.places.iter().map(site).collect(),
                seen: Vec::new(),
                rotation: scene::Frame::default().rotation_rows(),
                left_out: Vec::new(),
            })
        }
    }
}

/// The steps at which a synthetic scene is observed.
pub fn observed_steps(synthetic: &Synthetic, window: &Window) -> Vec<usize> {
    match (&synthetic.steps, synthetic.every) {
        (Some(steps), _) => steps.clone(),
        (None, Some(every)) => (1..=window.steps / every).map(|i| i * every).collect(),
        (None, None) => Vec::new(),
    }
}

/// Standard deviations σ_x and σ_v, given v̄.
pub fn sigmas(k: &KernelCovariance, length: f64, mean_speed: f64) -> (f64, f64) {
    let x = k.sigma_x.unwrap_or_else(|| k.sigma_x_over_length.unwrap_or(f64::NAN) * length);
    let v = k.sigma_v.unwrap_or_else(|| k.sigma_v_over_mean_speed.unwrap_or(f64::NAN) * mean_speed);
    (x, v)
}

/// All states of a run of `steps` steps from `x0`, one after the other.
///
/// # Errors
/// [`Error::Model`] naming the step.
pub fn run_states(model: &mut dyn Model, x0: &[f64], steps: usize) -> Result<Vec<f64>, Error> {
    let n = model.dim();
    let mut states = vec![0.0; (steps + 1) * n];
    states[..n].copy_from_slice(x0);
    for k in 0..steps {
        let (x, next) = states[k * n..].split_at_mut(n);
        model.step(k, x, &mut next[..n])?;
    }
    Ok(states)
}

fn rod_problem(file: &SceneFile, rod: &RodModel, memory: usize) -> Result<Problem, Error> {
    let scene = &file.scene;
    let window = window(scene);
    let parts = RodParts::from_scene(file, rod)?;
    let dynamics = parts.dynamics()?;
    let length = parts.rod.length();
    let mut sightings = sightings(file, length, &window)?;
    let CovarianceKey::Kernel(kernel) = &scene.background.covariance else {
        return Err(file.invalid("background.covariance.kind", "rods take kind = \"kernel\""));
    };
    let n = dynamics.control_len();
    let places = places(&parts, &dynamics);

    let truth = match scene.background.from {
        Origin::TruthPlusDraw => Some(spun_up(&parts, &window, scene.time.spin_up)?),
        Origin::File | Origin::StaticEquilibrium => None,
    };
    let known_background = match scene.background.from {
        Origin::TruthPlusDraw => None,
        Origin::StaticEquilibrium => Some(parts.at_rest(window.start)?),
        Origin::File => Some(read_rod_background(file, &dynamics)?),
    };
    let reference = truth.as_ref().or(known_background.as_ref()).map_or(&[][..], |z| &z[..n]);
    let speed = mean_speed(reference);
    let (sigma_x, sigma_v) = sigmas(kernel, length, speed);
    if !(sigma_v > 0.0) {
        return Err(file.invalid(
            "background.covariance.sigma_v_over_mean_speed",
            "nothing moves at the start of the window, so this σ would be 0: give sigma_v [m/s]",
        ));
    }
    let path = "background.covariance";
    let covariance = covariance::localized(file, path, kernel, &places, (sigma_x, sigma_v))?;
    let background = match (known_background, &truth) {
        (Some(background), _) => background,
        (None, truth) => {
            let drawn_from = covariance::unlocalized(file, path, kernel, &places, (sigma_x, sigma_v))?;
            let error = sample(&drawn_from, &mut stream(scene.seed, Stream::Background));
            truth.iter().flat_map(|x| x[..n].iter()).zip(&error).map(|(x, e)| x + e).collect()
        }
    };

    let model_error = match &scene.algorithm.model_error {
        Some(error) => {
            let path = "algorithm.model_error.covariance";
            let CovarianceKey::Kernel(kernel) = &error.covariance else {
                return Err(file.invalid(&format!("{path}.kind"), "rods take kind = \"kernel\""));
            };
            let sigmas = sigmas(kernel, length, speed);
            if !(sigmas.1 > 0.0) {
                return Err(file.invalid(
                    &format!("{path}.sigma_v_over_mean_speed"),
                    "nothing moves at the start of the window, so this σ would be 0: give sigma_v [m/s]",
                ));
            }
            Some(covariance::localized(file, path, kernel, &places, sigmas)?)
        }
        None => None,
    };
    let geometry = Geometry::Rod(places.free.clone());
    let members = scene.algorithm.members();
    let members =
        members.map(|e| ensemble::draw(file, &e, &background, covariance.as_ref(), &geometry)).transpose()?;

    let spin_up = scene.time.spin_up;
    let divided = |control: &[f64]| {
        let along = |tolerance| DividedSteps::along(&parts, spin_up, window, tolerance, control);
        scene.time.tolerance.map(along).transpose()
    };
    // The truth has steps of its own; nothing of it depends on the background.
    let make_truth = match &truth {
        Some(truth) => divided(&truth[..n])?.map(|steps| steps.factory()),
        None => None,
    };
    let divided = divided(&background)?;
    let make_model = match &divided {
        Some(steps) => steps.factory(),
        None => rod_models(&parts, spin_up, window, None),
    };
    let mut sites = RodObservation::new(&dynamics, &sightings, window)?;
    if let (Observations::Synthetic(synthetic), Some(truth)) = (&scene.observations, &truth) {
        let mut model = make_truth.as_ref().unwrap_or(&make_model)(0);
        let steps = observed_steps(synthetic, &window);
        let sigma =
            synthetic.sigma.unwrap_or_else(|| synthetic.sigma_over_length.unwrap_or(f64::NAN) * length);
        let states = run_states(model.as_mut(), truth, steps.iter().copied().max().unwrap_or(0))?;
        let mut rng = stream(scene.seed, Stream::Observations);
        let mut seen = vec![0.0; sites.dim()];
        for &k in &steps {
            let state = &states[k * model.dim()..(k + 1) * model.dim()];
            sites.observe(k, state, &mut seen).map_err(|reason| varda_assimilation::Error::Observe {
                operator: 0,
                step: k,
                reason,
            })?;
            for (site, y) in seen.chunks_exact(3).enumerate() {
                let values = [0, 1, 2].map(|c| Some(y[c] + normal(&mut rng, sigma)));
                sightings.seen.push(Sighting { site, step: k, weight: 0.0, values, sigma });
            }
        }
    }
    let anchors = sightings
        .sites
        .iter()
        .flat_map(|site| [0, 1, 2].map(|c| geometry.nearest(site.marker.s) + c))
        .collect();
    let operator = RodObservation::new(&dynamics, &sightings, window)?;
    let observations =
        ObservationSet::new(window.steps, vec![Box::new(operator)], sightings.assimilated(&window))?;
    let method = scene.algorithm.method;
    if let (true, Some(last @ 1..)) = (method.is_of_one_instant(), observations.last_step()) {
        let message = format!(
            "method {:?} takes observations at step 0 only; these go on to step {last}",
            method.name()
        );
        return Err(file.invalid("algorithm.method", message));
    }
    let mut left_out = dynamics.left_out();
    left_out.extend(sightings.left_out.iter().cloned());
    left_out.extend(no_derivatives(scene));
    Ok(Problem {
        name: file.name.clone(),
        scene: scene.clone(),
        window,
        model: make_model(0),
        make_model,
        make_truth,
        divided,
        view: View::Rod(Box::new(RodView { parts, dynamics, sightings, sites })),
        covariance,
        model_error,
        ensemble: members,
        anchors,
        background,
        truth,
        observations,
        memory,
        left_out,
    })
}

/// The state after the spin-up from rest.
fn spun_up(parts: &RodParts, window: &Window, steps: usize) -> Result<Vec<f64>, Error> {
    let mut model = parts.dynamics()?.model(0, window.step);
    let failed = |reason| Error::Preparation { stage: "spin-up of the truth", reason };
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&parts.at_rest(0.0)?, &mut x).map_err(failed)?;
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next).map_err(failed)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// v̄: the mean speed of the free vertices in a control [X, V] [m/s].
pub fn mean_speed(control: &[f64]) -> f64 {
    let v = &control[control.len() / 2..];
    let speeds: Vec<f64> = v.chunks_exact(3).map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()).collect();
    speeds.iter().sum::<f64>() / speeds.len().max(1) as f64
}

fn read_rod_background(file: &SceneFile, dynamics: &RodStep) -> Result<Vec<f64>, Error> {
    let name = file.scene.background.file.as_deref().unwrap_or("");
    let (label, text) = file.read("background.file", name)?;
    let columns = ["vertex", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
    let rows = csv::numbers(&label, &text, columns)?;
    let free = dynamics.free_vertices();
    let n = free.len();
    let mut control = vec![f64::NAN; 6 * n];
    for (i, row) in rows.iter().enumerate() {
        let bad = |message: String| Error::Data { place: format!("{label}, row {}", i + 1), message };
        let Some(at) = free.iter().position(|&v| v as f64 == row[0]) else {
            return Err(bad(format!(
                "vertex {} is not a free vertex of the rod ({} to {})",
                row[0],
                free[0],
                free[n - 1]
            )));
        };
        if !control[3 * at].is_nan() {
            return Err(bad(format!("vertex {} is there twice", row[0])));
        }
        control[3 * at..3 * at + 3].copy_from_slice(&row[1..4]);
        control[3 * (n + at)..3 * (n + at) + 3].copy_from_slice(&row[4..7]);
    }
    match free.iter().enumerate().find(|(at, _)| control[3 * at].is_nan()) {
        Some((_, vertex)) => {
            Err(Error::Data { place: label, message: format!("vertex {vertex} is missing") })
        }
        None => Ok(control),
    }
}

fn component_problem(file: &SceneFile, memory: usize) -> Result<Problem, Error> {
    let scene = &file.scene;
    let window = window(scene);
    let first = scene.time.spin_up;
    let start = component_model::start(scene);
    let make = component_model::factory(scene, &start, window.step);
    let mut model = make(0);
    let n = model.dim();
    let line = scene.model.line();
    let of = |path: &str, c: &CovarianceKey| match c {
        CovarianceKey::Climatology(c) => {
            let matrix = climatology::covariance(make(0).as_mut(), &start, first, c.steps)?;
            covariance::scaled(file, path, n, c.scale, &matrix)
        }
        c => covariance::of_components(file, path, c, n, line.as_ref()),
    };
    let covariance = of("background.covariance", &scene.background.covariance)?;
    let model_error = match &scene.algorithm.model_error {
        Some(error) => Some(of("algorithm.model_error.covariance", &error.covariance)?),
        None => None,
    };
    let (truth, background) = match scene.background.from {
        Origin::TruthPlusDraw => {
            let spun = run_states(model.as_mut(), &start, first)?;
            let truth = spun[first * n..].to_vec();
            let error = sample(covariance.as_ref(), &mut stream(scene.seed, Stream::Background));
            let background = truth.iter().zip(&error).map(|(x, e)| x + e).collect();
            (Some(truth), background)
        }
        _ => (None, read_component_background(file, n)?),
    };
    let Observations::Synthetic(synthetic) = &scene.observations else {
        return Err(file.invalid("observations.kind", "observations are read from a file for rods only"));
    };
    let components: Vec<usize> =
        if synthetic.components.is_empty() { (0..n).collect() } else { synthetic.components.clone() };
    let names: Vec<String> = match &scene.model {
        scene::Model::Lorenz63(_) => ["x", "y", "z"].map(String::from).to_vec(),
        scene::Model::LinearAdvection(_) | scene::Model::Burgers(_) => {
            (0..n).map(|i| format!("u{i}")).collect()
        }
        _ => (0..n).map(|i| format!("x{i}")).collect(),
    };
    let mut seen = Vec::new();
    if let Some(truth) = &truth {
        let steps = observed_steps(synthetic, &window);
        let sigma = synthetic.sigma.unwrap_or(f64::NAN);
        let mut model = make(first);
        let states = run_states(model.as_mut(), truth, steps.iter().copied().max().unwrap_or(0))?;
        let mut rng = stream(scene.seed, Stream::Observations);
        for &step in &steps {
            for (row, &c) in components.iter().enumerate() {
                seen.push(Observation {
                    operator: 0,
                    rows: vec![row],
                    step,
                    weight: 0.0,
                    values: vec![states[step * n + c] + normal(&mut rng, sigma)],
                    sigma: vec![sigma],
                    label: names[c].clone(),
                });
            }
        }
    }
    let geometry = match (&scene.model, line) {
        (_, Some(line)) => Geometry::Line(line),
        (scene::Model::Lorenz96(_), None) => Geometry::Ring(n),
        _ => Geometry::Nowhere,
    };
    let members = scene.algorithm.members();
    let members =
        members.map(|e| ensemble::draw(file, &e, &background, covariance.as_ref(), &geometry)).transpose()?;
    let operator: Box<dyn ObservationOperator> = Box::new(Selection::new(components.clone(), n)?);
    let mut left_out = Vec::new();
    if scene.time.integrator == scene::Integrator::Rk4 {
        left_out.push("factorizations: the steps are explicit".to_string());
    }
    left_out.extend(no_derivatives(scene));
    Ok(Problem {
        name: file.name.clone(),
        scene: scene.clone(),
        window,
        model: make(first),
        make_model: Box::new(move |k| make(first + k)),
        make_truth: None,
        divided: None,
        view: View::Components(names),
        covariance,
        model_error,
        ensemble: members,
        anchors: components,
        background,
        truth,
        observations: ObservationSet::new(window.steps, vec![operator], seen)?,
        memory,
        left_out,
    })
}

/// What an ensemble leaves out.
pub(crate) fn no_derivatives(scene: &Scene) -> Option<String> {
    let line = "tangent and adjoint: an ensemble of forward runs takes their place";
    scene.algorithm.method.is_ensemble().then(|| line.to_string())
}

fn read_component_background(file: &SceneFile, n: usize) -> Result<Vec<f64>, Error> {
    let name = file.scene.background.file.as_deref().unwrap_or("");
    let (label, text) = file.read("background.file", name)?;
    let rows = csv::numbers(&label, &text, ["component", "value"])?;
    let in_order = rows.iter().enumerate().all(|(i, r)| r[0] == i as f64);
    if rows.len() != n || !in_order {
        return Err(Error::Data {
            place: label,
            message: format!("expected one row for each component 0 to {}, in order", n - 1),
        });
    }
    Ok(rows.iter().map(|r| r[1]).collect())
}
