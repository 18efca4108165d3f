//! A rod as the system of a problem: its truth, background, covariance and models.

use varda_covariance::Covariance;
use varda_implicit::{ImplicitStep, Model, Structure};
use varda_rod::RodStep;

use super::adaptive_steps::{AdaptiveSteps, rod_models};
use super::covariance::{self, Factored, Places};
use super::csv;
use super::ensemble::ComponentPositions;
use super::files::Files;
use super::rod_model::RodParts;
use super::runs::MakeModel;
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
        let s = parts.rod.arc_lengths();
        let free = dynamics.free_vertices().to_vec();
        let places = Places {
            free: free.iter().map(|&v| s[v]).collect(),
            known: (0..s.len()).filter(|v| !free.contains(v)).map(|v| known(&parts, &s, v)).collect(),
        };
        Ok(RodSystem {
            places,
            state: dynamics.dim(),
            control: dynamics.control_len(),
            kept: kept(&dynamics),
            has_end_angle: dynamics.end_angle(&vec![0.0; dynamics.dim()]).is_some(),
            left_out: dynamics.left_out().into_iter().chain(parts.remarks.iter().cloned()).collect(),
            free,
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

    /// The layout of its control.
    pub(crate) fn layout(&self) -> StateLayout {
        StateLayout::of_rod(Geometry { arc_lengths: self.parts.rod.arc_lengths(), free: self.free.clone() })
    }

    /// Where the components of its control are.
    pub(crate) fn positions(&self) -> ComponentPositions {
        ComponentPositions::Rod(self.places.free.clone())
    }

    /// The first of the three components of the control nearest to an arc length.
    pub(crate) fn nearest_position(&self, s: f64) -> usize {
        let off = |i: &usize| (self.places.free[*i] - s).abs();
        3 * (0..self.places.free.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }

    /// The truth of a twin experiment: the state after the spin-up from rest.
    pub(crate) fn truth(&mut self) -> Result<Vec<f64>, Error> {
        let control = self.start_at_rest(0.0)?;
        let mut model = self.parts.dynamics()?.model(0, self.grid.step);
        let failed = |reason| Error::Preparation { stage: "spin-up of the truth", reason };
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&control, &mut x).map_err(failed)?;
        let mut next = x.clone();
        for k in 0..self.spin_up {
            model.step(k, &x, &mut next).map_err(failed)?;
            std::mem::swap(&mut x, &mut next);
        }
        Ok(x)
    }

    /// The control of the rod at rest at the start of the window. Its runs start from the angles it has
    /// there.
    pub(crate) fn come_to_rest(&mut self) -> Result<Vec<f64>, Error> {
        self.start_at_rest(self.grid.start)
    }

    fn start_at_rest(&mut self, t: f64) -> Result<Vec<f64>, Error> {
        self.parts.first = None;
        let rest = self.parts.at_rest(t)?;
        let control = self.parts.dynamics()?.control_at_rest(&rest);
        self.parts.first = Some((rest, t));
        Ok(control)
    }

    /// The control in a CSV file with one row for each free vertex. Where the file has a column
    /// `end_angle_rad`, runs start from that angle of the end clamp.
    pub(crate) fn read_background(&mut self, files: &Files, name: &str) -> Result<Vec<f64>, Error> {
        let (label, text) = files.text("background.file", name)?;
        let columns = ["vertex", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
        let rows = if csv::has_column(&text, END_ANGLE) {
            let [a, b, c, d, e, f, g] = columns;
            let rows = csv::numbers(&label, &text, [a, b, c, d, e, f, g, END_ANGLE])?;
            self.set_end_angle(&rows.iter().map(|r| r[7]).collect::<Vec<_>>(), &label)?;
            rows.into_iter().map(|[a, b, c, d, e, f, g, _]| [a, b, c, d, e, f, g]).collect()
        } else {
            csv::numbers(&label, &text, columns)?
        };
        let n = self.free.len();
        let mut found: Vec<Option<[f64; 6]>> = vec![None; n];
        for (i, row) in rows.iter().enumerate() {
            let bad = |message: String| Error::Data { place: format!("{label}, row {}", i + 1), message };
            let [vertex, values @ ..] = row;
            let Some(at) = self.free.iter().position(|&v| v as f64 == *vertex) else {
                let (first, last) = (self.free[0], self.free[n - 1]);
                let message = format!("vertex {vertex} is not a free vertex of the rod ({first} to {last})");
                return Err(bad(message));
            };
            if found[at].replace(*values).is_some() {
                return Err(bad(format!("vertex {vertex} is there twice")));
            }
        }
        let mut control = vec![0.0; 6 * n];
        for (at, (vertex, values)) in self.free.iter().zip(found).enumerate() {
            let Some(values) = values else {
                return Err(Error::Data { place: label, message: format!("vertex {vertex} is missing") });
            };
            control[3 * at..3 * at + 3].copy_from_slice(&values[..3]);
            control[3 * (n + at)..3 * (n + at) + 3].copy_from_slice(&values[3..]);
        }
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
        Ok(self.parts.dynamics()?.end_angle(state))
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

    /// σ of positions and velocities that the covariance at `path` names; `reference` is a control whose
    /// mean speed scales those of velocities.
    fn sigmas(
        &self,
        file: &SceneFile,
        path: &str,
        kernel: &scene::KernelCovariance,
        reference: &[f64],
    ) -> Result<[f64; 2], Error> {
        let [x, v] = file.checked(kernel.sigmas(path))?;
        let sigmas = [x.of(self.length()), v.of(mean_speed(reference))];
        if sigmas[1] > 0.0 {
            return Ok(sigmas);
        }
        Err(file.invalid(
            &format!("{path}.sigma_v_over_mean_speed"),
            "nothing moves at the start of the window, so this σ would be 0: give sigma_v [m/s]",
        ))
    }

    /// The covariance that the key `path` describes.
    pub(crate) fn covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Factored, Error> {
        let kernel = file.checked(keys.of_rod(path))?;
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
        let kernel = file.checked(keys.of_rod(path))?;
        let [x, v] = file.checked(kernel.sigmas(path))?;
        covariance::localized(file, path, kernel, &self.places, [x.of(self.length()), v.of(1.0)])?;
        Ok(())
    }

    /// The covariance from which the error of the background is drawn.
    pub(crate) fn drawn_from(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Box<dyn Covariance>, Error> {
        let kernel = file.checked(keys.of_rod(path))?;
        let sigmas = self.sigmas(file, path, kernel, reference)?;
        covariance::unlocalized(file, path, kernel, &self.places, sigmas)
    }

    /// Adaptive time steps along the run from a control.
    pub(crate) fn adaptive_steps(&self, tolerance: f64, control: &[f64]) -> Result<AdaptiveSteps, Error> {
        AdaptiveSteps::along(&self.parts, self.spin_up, self.grid, tolerance, control)
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

/// v̄: the mean speed of the free vertices in a control [X, V] [m/s].
pub fn mean_speed(control: &[f64]) -> f64 {
    let v = &control[control.len() / 2..];
    let speeds: Vec<f64> = v.chunks_exact(3).map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()).collect();
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
