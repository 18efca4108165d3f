//! From `[consider]` to a model that knows the derivatives by these constants.

use varda_covariance::Covariance;
use varda_implicit::Model;

use super::adaptive_steps::rod_models;
use super::constant::Constant;
use super::inputs::Inputs;
use super::observations::MakeOperator;
use super::rod_model::RodParts;
use super::system::System;
use crate::Error;
use crate::scene::{BackgroundSource, Hessian, Model as SceneModel, SceneFile, TimeGrid};

/// What is modelled and observed, with the constants of `[consider]` behind the state as those of
/// `[estimate]` are: a longer control, all numbers of the problem's own in it.
pub(crate) struct Considered {
    /// What is modelled.
    pub(crate) system: System,
    /// Makes H of its states.
    pub(crate) make_operator: MakeOperator,
    /// For each number of the longer control its place in the problem's own; `None` for those considered.
    pub(crate) own: Vec<Option<usize>>,
    /// Constants of the longer control, its last numbers.
    pub(crate) constants: Vec<Constant>,
    /// The rod at rest, whose background follows from the constants.
    at_rest: Option<(RodParts, usize, TimeGrid)>,
}

impl Considered {
    /// Reads a scene again with these constants; `None` where it considers none. `own` is the problem's
    /// system, ready to run.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at the key.
    pub(crate) fn read(file: &SceneFile, own: &System) -> Result<Option<Considered>, Error> {
        let Some(longer) = file.with_considered() else { return Ok(None) };
        let Inputs { mut system, observed, grid, .. } = Inputs::read(&longer)?;
        let mut at_rest = None;
        if let (System::Rod(rod), System::Rod(own), SceneModel::Rod(_)) =
            (&mut system, own, &file.scene.model)
        {
            (rod.parts.first, rod.parts.end_angle) = (own.parts.first.clone(), own.parts.end_angle);
            if let BackgroundSource::StaticEquilibrium = file.checked(file.scene.background.source())? {
                let parts = RodParts { at_rest_always: true, ..rod.parts.clone() };
                let refuse = |why: &str| {
                    let message =
                        format!("background.from = \"static-equilibrium\" would move with them, and {why}");
                    file.invalid("consider", message)
                };
                if parts.spins_in_control {
                    return Err(refuse("angles and spins at the start (sigma_theta) do not say how"));
                }
                parts.dynamics().map_err(|reason| refuse(&reason.to_string()))?;
                at_rest = Some((parts, file.scene.time.spin_up, grid));
            }
        }
        let known = &own.estimates().constants;
        let constants = system.estimates().constants.clone();
        let state = own.layout().len() - known.len();
        let of_constant = |c: &Constant| known.iter().position(|k| k.name == c.name).map(|j| state + j);
        let own = (0..state).map(Some).chain(constants.iter().map(of_constant)).collect();
        let make_operator = observed.make_operator;
        let considered = Considered { system, make_operator, own, constants, at_rest };
        if file.scene.algorithm.hessian == Hessian::Exact && considered.model().second_order().is_none() {
            let message = "algorithm.hessian \"exact\" needs second derivatives, which this model has not";
            return Err(file.invalid("consider", message));
        }
        Ok(Some(considered))
    }

    /// A model of the window.
    pub(crate) fn model(&self) -> Box<dyn Model + Send> {
        self.system.models()(0)
    }

    /// The control of a problem, what is considered at its value.
    pub(crate) fn control(&self, own: &[f64]) -> Vec<f64> {
        self.own.iter().map(|place| place.map_or(0.0, |i| own[i])).collect()
    }

    /// Places of what is considered in the longer control.
    pub(crate) fn places(&self) -> Vec<usize> {
        (0..self.own.len()).filter(|i| self.own[*i].is_none()).collect()
    }

    /// ∂z_b/∂p of each constant that is considered, in the longer control: that of the rod at rest,
    /// zero of other backgrounds; one in its own place.
    ///
    /// # Errors
    /// [`Error::Model`] where no equilibrium is found.
    pub(crate) fn background(&self, background: &[f64]) -> Result<Vec<Vec<f64>>, Error> {
        let (n, places) = (self.own.len(), self.places());
        let unit = |i: usize| (0..n).map(|j| f64::from(i == j)).collect::<Vec<f64>>();
        let mut columns: Vec<Vec<f64>> = places.into_iter().map(unit).collect();
        let Some((parts, spin_up, grid)) = &self.at_rest else { return Ok(columns) };
        let mut model = rod_models(parts, *spin_up, *grid, None)(0);
        let (mut x, mut dx) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&self.control(background), &mut x)?;
        let positions = 0..3 * parts.dynamics()?.free_vertices().len();
        for column in &mut columns {
            model.initial_tangent(column, &mut dx);
            column[positions.clone()].copy_from_slice(&dx[positions.clone()]);
        }
        Ok(columns)
    }
}

/// B of the longer control, whitened: the problem's own root, and a column for each constant that is
/// considered, which moves the background.
pub(crate) struct Lengthened<'a> {
    /// B.
    pub(crate) covariance: &'a dyn Covariance,
    /// For each number of the longer control its place in B.
    pub(crate) own: &'a [Option<usize>],
    /// Columns of the longer control.
    pub(crate) columns: &'a [Vec<f64>],
}

impl Covariance for Lengthened<'_> {
    fn dim(&self) -> usize {
        self.own.len()
    }

    fn root_dim(&self) -> usize {
        self.covariance.root_dim() + self.columns.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let mut v = vec![0.0; self.root_dim()];
        self.root_transpose(x, &mut v);
        self.root(&v, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        let (v, held) = v.split_at(self.covariance.root_dim());
        let mut own = vec![0.0; self.covariance.dim()];
        self.covariance.root(v, &mut own);
        for (i, x) in x.iter_mut().enumerate() {
            let of_columns: f64 = self.columns.iter().zip(held).map(|(c, v)| c[i] * v).sum();
            *x = self.own[i].map_or(0.0, |place| own[place]) + of_columns;
        }
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        let (v, held) = v.split_at_mut(self.covariance.root_dim());
        let mut own = vec![0.0; self.covariance.dim()];
        for (x, place) in x.iter().zip(self.own) {
            if let Some(place) = place {
                own[*place] = *x;
            }
        }
        self.covariance.root_transpose(&own, v);
        for (column, held) in self.columns.iter().zip(held) {
            *held = column.iter().zip(x).map(|(c, x)| c * x).sum();
        }
    }

    fn variance(&self, variance: &mut [f64]) {
        let mut own = vec![0.0; self.covariance.dim()];
        self.covariance.variance(&mut own);
        for (i, variance) in variance.iter_mut().enumerate() {
            let of_columns: f64 = self.columns.iter().map(|c| c[i] * c[i]).sum();
            *variance = self.own[i].map_or(0.0, |place| own[place]) + of_columns;
        }
    }
}
