//! A rod as the system of a problem: its truth, background, covariance and models.

use varda_covariance::Covariance;
use varda_implicit::{ImplicitStep, Model, ParametricStep, Structure};
use varda_rod::{Rest, RodStep};

use super::adaptive_steps::{AdaptiveSteps, rod_models};
use super::covariance::{self, Factored, Places, Sigmas, WithoutError};
use super::csv;
use super::ensemble::ComponentPositions;
use super::estimate::{Constant, Estimates};
use super::files::Files;
use super::rod_model::RodParts;
use super::runs::{MakeModel, state_after};
use crate::Error;
use crate::scene::{self, RodModel, SceneFile, TimeGrid};
use crate::state::{Geometry, StateLayout};

/// The column of a background with the angle of the end clamp.
pub(crate) const END_ANGLE: &str = "end_angle_rad";

/// A rod, read from a scene and its files.
pub struct RodSystem {
    /// The rod, its supports and loads.
    pub parts: RodParts,
    /// Arc lengths of its free and of its held vertices.
    pub places: Places,
    /// Length of a state.
    pub state: usize,
    /// Length of the control.
    pub control: usize,
    /// Numbers that the linearization of a step keeps.
    pub(crate) kept: usize,
    has_end_angle: bool,
    free: Vec<usize>,
    /// Edges whose angles and spins are in the control.
    free_edges: Vec<usize>,
    left_out: Vec<String>,
    grid: TimeGrid,
    spin_up: usize,
}

impl RodSystem {
    /// Reads the rod of a scene.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key, or the error of a file it names.
    pub(crate) fn read(files: &Files, model: &RodModel, grid: TimeGrid) -> Result<Self, Error> {
        let parts = RodParts::read(files, model)?;
        let dynamics = parts.dynamics()?;
        let (s, unknown) = (parts.rod.arc_lengths(), parts.estimates.len());
        let free = dynamics.free_vertices().to_vec();
        let spins = parts.spins_in_control;
        let free_edges = if spins { dynamics.free_angles().to_vec() } else { Vec::new() };
        let held_edges = (0..parts.rod.segments()).filter(|e| spins && !free_edges.contains(e));
        let places = Places {
            edges: free_edges.iter().map(|&e| middle(&parts, &s, e)).collect(),
            held_edges: held_edges.map(|e| middle(&parts, &s, e)).collect(),
            free: free.iter().map(|&v| s[v]).collect(),
            known: (0..s.len()).filter(|v| !free.contains(v)).map(|v| known(&parts, &s, v)).collect(),
        };
        Ok(RodSystem {
            places,
            state: parts.places()?.dim(),
            control: dynamics.control_len() + unknown,
            kept: kept(&dynamics) + parts.estimates.of_rod.len() * dynamics.unknowns(),
            has_end_angle: dynamics.end_angle(&vec![0.0; dynamics.dim()]).is_some(),
            left_out: dynamics.left_out().into_iter().chain(parts.remarks.iter().cloned()).collect(),
            free,
            free_edges,
            parts,
            grid,
            spin_up: files.scene.scene.time.spin_up,
        })
    }

    /// Length of the rod \[m\].
    pub fn length(&self) -> f64 {
        self.parts.rod.length()
    }

    /// What the dynamics do without.
    pub(crate) fn left_out(&self) -> &[String] {
        &self.left_out
    }

    /// Numbers of its control that are none of the constants.
    fn without_constants(&self) -> usize {
        self.control - self.parts.estimates.len()
    }

    /// The layout of its control.
    pub(crate) fn layout(&self) -> StateLayout {
        StateLayout::of_rod(Geometry {
            arc_lengths: self.parts.rod.arc_lengths(),
            free: self.free.clone(),
            free_edges: self.free_edges.clone(),
        })
        .with_constants(self.parts.estimates.constants.iter().map(Constant::of_control))
    }

    /// The rod with the constants that a state has, and that state of the rod's own step.
    ///
    /// # Errors
    /// Constants at which there is no rod.
    ///
    /// # Panics
    /// If `state` is shorter than a state.
    pub fn with_constants_of(&self, state: &[f64]) -> Result<(RodStep, Vec<f64>), Error> {
        let (mut rod, places) = (self.parts.dynamics()?, self.parts.places()?);
        let mut own = vec![0.0; places.own_dim()];
        places.gather(state, &mut own);
        let p = &state[places.parameters()][..self.parts.estimates.of_rod.len()];
        rod.set_parameters(p).map_err(|reason| varda_implicit::Error::refused(0, reason))?;
        Ok((rod, own))
    }

    /// Where the components of its control are.
    pub(crate) fn positions(&self) -> ComponentPositions {
        let vertices: Vec<f64> = self.places.free.iter().flat_map(|s| [*s; 3]).collect();
        let edges = &self.places.edges;
        ComponentPositions::Rod([&vertices[..], &vertices[..], &edges[..], &edges[..]].concat())
    }

    /// The first of the three components of the control nearest to an arc length.
    pub(crate) fn nearest_position(&self, s: f64) -> usize {
        let off = |i: &usize| (self.places.free[*i] - s).abs();
        3 * (0..self.places.free.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }

    /// The truth of a twin experiment: the state after the spin-up from rest.
    pub(crate) fn truth(&mut self) -> Result<Vec<f64>, Error> {
        let control = self.start_at_rest(0.0)?;
        let mut model = rod_models(&self.parts, 0, self.grid, None)(0);
        let failed = |reason| Error::Preparation { stage: "spin-up of the truth", reason };
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&control, &mut x).map_err(failed)?;
        state_after(model.as_mut(), &x, self.spin_up).map_err(failed)
    }

    /// The control of the rod at rest at the start of the window. Its runs start from the angles it has
    /// there.
    pub(crate) fn come_to_rest(&mut self) -> Result<Vec<f64>, Error> {
        self.start_at_rest(self.grid.start)
    }

    fn start_at_rest(&mut self, t: f64) -> Result<Vec<f64>, Error> {
        self.parts.first = None;
        let rest = self.parts.at_rest(t)?;
        let control = self.control_at_rest(&rest)?;
        self.parts.first = Some((rest, t));
        Ok(control)
    }

    /// The control of the rod at rest in a shape, constants as the scene has them.
    pub(crate) fn control_at_rest(&self, shape: &Rest) -> Result<Vec<f64>, Error> {
        let mut control = self.parts.dynamics()?.control_at_rest(shape);
        control.resize(self.control, 0.0);
        Ok(control)
    }

    /// The control in a CSV file with one row for each free vertex; where angles and spins are in it, of the
    /// edge after a vertex, a held vertex has a row with these alone. Where the file has a column
    /// `end_angle_rad`, runs start from that angle of the end clamp.
    pub(crate) fn read_background(&mut self, files: &Files, name: &str) -> Result<Vec<f64>, Error> {
        let (label, text) = files.text("background.file", name)?;
        let mut columns = vec!["vertex", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
        if self.parts.spins_in_control {
            columns.extend(["theta_rad", "spin_rad_s"]);
        }
        let last = columns.len();
        if csv::has_column(&text, END_ANGLE) {
            columns.push(END_ANGLE);
        }
        let (n, edges) = (self.free.len(), self.free_edges.len());
        let mut control: Vec<Option<f64>> = vec![None; 6 * n + 2 * edges];
        let mut seen = vec![false; self.parts.rod.segments() + 1];
        let mut end_angles = Vec::new();
        for (i, row) in csv::with_gaps(&label, &text, &columns)?.into_iter().enumerate() {
            let bad = |message: String| Error::Data { place: format!("{label}, row {}", i + 1), message };
            let needed = |c: usize| row[c].ok_or_else(|| bad(format!("`{}` is empty", columns[c])));
            let vertex = needed(0)?;
            let is = |v: &usize| *v as f64 == vertex;
            let (at, edge) = (self.free.iter().position(is), self.free_edges.iter().position(is));
            if at.is_none() && edge.is_none() {
                let (first, last) = (self.free[0], self.free[n - 1]);
                let message = format!("vertex {vertex} is not a free vertex of the rod ({first} to {last})");
                return Err(bad(message));
            }
            if std::mem::replace(&mut seen[vertex as usize], true) {
                return Err(bad(format!("vertex {vertex} is there twice")));
            }
            for i in 0..last - 1 {
                let target = match i {
                    0..6 => at.map(|at| 3 * (n * (i / 3) + at) + i % 3),
                    _ => edge.map(|edge| 6 * n + edges * (i - 6) + edge),
                };
                if let Some(target) = target {
                    control[target] = Some(needed(i + 1)?);
                }
            }
            if columns.len() > last {
                end_angles.push(needed(last)?);
            }
        }
        self.set_end_angle(&end_angles, &label)?;
        let layout = self.layout();
        let missing = |i: usize| match self.free.get(i % (3 * n) / 3).filter(|_| i < 6 * n) {
            Some(vertex) => format!("vertex {vertex} is missing"),
            None => format!("{} is missing", layout.names[i]),
        };
        let filled = control
            .into_iter()
            .enumerate()
            .map(|(i, value)| value.ok_or_else(|| Error::Data { place: label.clone(), message: missing(i) }));
        let mut control = filled.collect::<Result<Vec<f64>, Error>>()?;
        control.resize(self.control, 0.0);
        Ok(control)
    }

    /// The column of a file that has one angle.
    fn set_end_angle(&mut self, column: &[f64], label: &str) -> Result<(), Error> {
        let bad = |row: usize, message: String| Error::Data { place: format!("{label}, row {row}"), message };
        let Some(&angle) = column.first() else { return Ok(()) };
        if let Some(i) = column.iter().position(|other| *other != angle) {
            let message = format!("{END_ANGLE} = {} where row 1 has {angle}: it is one angle", column[i]);
            return Err(bad(i + 1, message));
        }
        if !self.has_end_angle() {
            let message = format!("no angle of an end clamp is part of the state: leave {END_ANGLE} out");
            return Err(bad(1, message));
        }
        self.parts.end_angle = Some((angle, self.grid.start));
        Ok(())
    }

    /// Whether the angle of the end clamp is part of the state.
    pub(crate) fn has_end_angle(&self) -> bool {
        self.has_end_angle
    }

    /// The angle of the end clamp in a state \[rad\], whole turns included, where it is part of the state.
    pub(crate) fn end_angle(&self, state: &[f64]) -> Result<Option<f64>, Error> {
        let (rod, own) = self.with_constants_of(state)?;
        Ok(rod.end_angle(&own))
    }

    /// Runs from the start of the window have the end clamp's angle of a state there.
    pub(crate) fn start_turned_as(&mut self, state: &[f64]) -> Result<(), Error> {
        self.parts.end_angle = self.end_angle(state)?.map(|angle| (angle, self.grid.start));
        Ok(())
    }

    /// A model whose step 0 is the given one of the window and whose runs start from this angle of the end
    /// clamp.
    pub(crate) fn model_turned(&self, first: usize, end_angle: f64) -> Box<dyn Model + Send> {
        let end_angle = Some((end_angle, self.grid.time(first)));
        let parts = RodParts { end_angle, ..self.parts.clone() };
        rod_models(&parts, self.spin_up, self.grid, None)(first)
    }

    /// The σ that the covariance at `path` names; `reference` is a control whose mean speed scales those of
    /// velocities.
    fn sigmas(
        &self,
        file: &SceneFile,
        path: &str,
        kernel: &scene::KernelCovariance,
        reference: &[f64],
    ) -> Result<Sigmas, Error> {
        let velocities = 3 * self.free.len()..6 * self.free.len();
        let sigmas = self.sigmas_at(file, path, kernel, mean_speed(&reference[velocities]))?;
        if sigmas.v > 0.0 {
            return Ok(sigmas);
        }
        Err(file.invalid(
            &format!("{path}.sigma_v_over_mean_speed"),
            "nothing moves at the start of the window, so this σ would be 0: give sigma_v [m/s]",
        ))
    }

    fn sigmas_at(
        &self,
        file: &SceneFile,
        path: &str,
        kernel: &scene::KernelCovariance,
        mean_speed: f64,
    ) -> Result<Sigmas, Error> {
        let [x, v] = file.checked(kernel.sigmas(path))?;
        let spins = file.checked(kernel.spin_sigmas(path))?;
        if spins.is_some() != self.parts.spins_in_control {
            let message =
                "sigma_theta and sigma_spin: give them here and in background.covariance, or in neither";
            return Err(file.invalid(path, message));
        }
        Ok(Sigmas { x: x.of(self.length()), v: v.of(mean_speed), spins })
    }

    /// The covariance that the key `path` describes.
    pub(crate) fn covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Factored, Error> {
        let Some(kernel) = file.checked(keys.of_rod(path))? else {
            return Ok(covariance::none(self.without_constants()));
        };
        let sigmas = self.sigmas(file, path, kernel, reference)?;
        covariance::localized(file, path, kernel, &self.places, sigmas)
    }

    /// Fails where the covariance that the key `path` describes has no root; that does not depend on how fast
    /// the rod moves, which only a run shows.
    pub(crate) fn check_covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
    ) -> Result<(), Error> {
        let Some(kernel) = file.checked(keys.of_rod(path))? else { return Ok(()) };
        let sigmas = self.sigmas_at(file, path, kernel, 1.0)?;
        covariance::localized(file, path, kernel, &self.places, sigmas)?;
        Ok(())
    }

    /// The covariance that the key `path` describes, without its taper.
    pub(crate) fn without_taper(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Box<dyn Covariance>, Error> {
        let Some(kernel) = file.checked(keys.of_rod(path))? else {
            return Ok(Box::new(WithoutError(self.without_constants())));
        };
        let sigmas = self.sigmas(file, path, kernel, reference)?;
        covariance::unlocalized(file, path, kernel, &self.places, sigmas)
    }

    /// Adaptive time steps along the run from a control.
    pub(crate) fn adaptive_steps(&self, tolerance: f64, control: &[f64]) -> Result<AdaptiveSteps, Error> {
        AdaptiveSteps::along(&self.parts, self.spin_up, self.grid, tolerance, control)
    }

    /// What is unknown beside the state.
    pub fn estimates(&self) -> &Estimates {
        &self.parts.estimates
    }

    /// Makes models with steps of the scene's length.
    pub(crate) fn models(&self) -> MakeModel {
        rod_models(&self.parts, self.spin_up, self.grid, None)
    }
}

/// Arc length of a held vertex; behind a clamp's face the held edge goes on as far as it stands out.
fn known(parts: &RodParts, s: &[f64], vertex: usize) -> f64 {
    let last = s.len() - 1;
    match parts.supports.faces() {
        [true, _] if vertex == 0 => -s[1],
        [_, true] if vertex == last => 2.0 * s[last] - s[last - 1],
        _ => s[vertex],
    }
}

/// Arc length of the middle of an edge; that of an edge held at a clamp's face is the face.
fn middle(parts: &RodParts, s: &[f64], edge: usize) -> f64 {
    0.5 * (known(parts, s, edge) + known(parts, s, edge + 1))
}

/// v̄: the mean speed of the free vertices [m/s], from their velocities.
pub fn mean_speed(velocities: &[f64]) -> f64 {
    let speed = |v: &[f64]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let speeds: Vec<f64> = velocities.chunks_exact(3).map(speed).collect();
    speeds.iter().sum::<f64>() / speeds.len().max(1) as f64
}

/// Numbers that the linearization of a step keeps.
fn kept(dynamics: &RodStep) -> usize {
    let band = match dynamics.structure() {
        Structure::SymmetricBand { half_bandwidth } => half_bandwidth + 1,
        Structure::Band { half_bandwidth } => 2 * half_bandwidth + 1,
        Structure::Dense | Structure::Sparse { .. } => dynamics.unknowns(),
    };
    dynamics.unknowns() * (band + 1) + dynamics.dim()
}
