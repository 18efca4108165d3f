//! What constants that are taken for known do to the numbers of a run. With p such a constant, z the control
//! and J its cost,
//!
//! ```text
//!     dz_a/dp = ∂z_b/∂p + U δv,   A δv = −∂(∇J)/∂p,   ds/dp = ∂s/∂p + ∂s/∂z dz_a/dp
//! ```
//!
//! (implicit function theorem): one solve with the Hessian A of the analysis, and one column carried along
//! its run. A is that of the scene, of Gauss and Newton or exact. Values that were observed, and a background
//! from a file or a draw, stay as they are; one at rest follows the constant.

use varda_assimilation::{
    Carried, ControlTransform, CostFunction, Hessian, LeastSquares, StrongConstraint, propagate_root,
    with_held,
};
use varda_rod::InternalForces;

use super::sources::least_known;
use super::spread::ForceSpread;
use crate::Error;
use crate::outcome::{ByConstant, Considered, Estimated};
use crate::scene;
use crate::setup::Problem;
use crate::setup::considered::Lengthened;
use crate::setup::constant::Constant;
use crate::setup::runs::run_states;

/// What is known of the run already: z_a, rows that were refused, σ of all states and of the forces, and the
/// estimates.
pub(super) struct Known<'a> {
    pub(super) control: &'a [f64],
    pub(super) rejected: &'a [usize],
    pub(super) sigma_states: &'a [f64],
    pub(super) sigma_forces: &'a [InternalForces],
    pub(super) estimates: &'a [Estimated],
}

/// Of the place or component that is known least at the end of the window (without a posterior, that moves
/// most), the largest tension there, and every constant that was estimated.
pub(super) fn considered(problem: &Problem, known: &Known) -> Result<Vec<Considered>, Error> {
    let Some(considered) = &problem.considered else { return Ok(Vec::new()) };
    let (experiment, grid) = (&problem.experiment, problem.experiment.grid);
    let scene = &experiment.scene;
    let control = considered.control(known.control);
    let places = considered.places();
    let columns = considered.background(&problem.background)?;
    let covariance =
        Lengthened { covariance: problem.covariance.as_ref(), own: &considered.own, columns: &columns };
    let transform = ControlTransform::new(control.clone(), &covariance)?;
    let mut model = considered.model();
    let operator = (considered.make_operator)()?;
    let mut observations = problem.observed.set_with(operator, &grid)?.without(known.rejected)?;
    let mut moved: Vec<f64> = Vec::new();
    {
        let mut cost = StrongConstraint::new(model.as_mut(), transform.clone(), &mut observations)?;
        if let Some(delta) = scene.algorithm.robust {
            cost.set_huber(delta)?;
        }
        cost.set_memory(problem.memory)?;
        let n = cost.dim();
        cost.linearize(&vec![0.0; n], &mut vec![0.0; n])?;
        let hessian = match scene.algorithm.hessian {
            scene::Hessian::GaussNewton => Hessian::GaussNewton,
            scene::Hessian::Exact => Hessian::Exact,
        };
        let mut dz = vec![0.0; control.len()];
        for j in 0..places.len() {
            let first = n - places.len();
            let held: Vec<(usize, f64)> = (0..places.len()).map(|i| (first + i, f64::from(i == j))).collect();
            let dv = with_held(&mut cost, hessian, &held)?;
            transform.tangent(&dv, &mut dz);
            moved.extend_from_slice(&dz);
        }
    }
    let mut x0 = vec![0.0; model.dim()];
    model.initial_state(&control, &mut x0)?;
    let states = run_states(model.as_mut(), &x0, grid.steps)?;
    let dim = x0.len();
    let (mut before, mut now) = (Vec::new(), Vec::new());
    propagate_root(model.as_mut(), &control, &moved, &states, &mut |_, w| {
        before = std::mem::replace(&mut now, w.to_vec());
        Ok(())
    })?;

    let constants: Vec<&Constant> = places
        .iter()
        .map(|i| &considered.constants[i - (control.len() - considered.constants.len())])
        .collect();
    let mut all = Vec::new();
    let mut add = |of: String, unit, sigma: Option<f64>, row: &[f64]| {
        all.push(result(of, unit, sigma, row, &constants));
    };
    // The end of the window.
    let layout = &experiment.state;
    let of_state = experiment.n_state;
    let at_end = known.sigma_states.get(grid.steps * of_state..(grid.steps + 1) * of_state);
    let size = |i: usize| match at_end {
        Some(sigma) => sigma[i] * sigma[i],
        None => now.chunks_exact(dim).map(|w| w[i] * w[i]).sum(),
    };
    for (i, name, unit) in least_known(layout, &grid, size) {
        let row: Vec<f64> = now.chunks_exact(dim).map(|w| w[i]).collect();
        add(name, unit, at_end.map(|sigma| sigma[i]), &row);
    }
    if let (Some(rod), Some(k)) = (considered.system.rod(), grid.steps.checked_sub(1)) {
        let at = Carried { step: grid.steps, dim, before: &before, now: &now, less: 0 };
        let [x_before, x] = [k, k + 1].map(|k| &states[k * dim..(k + 1) * dim]);
        let mut forces = ForceSpread::of(rod, &states[..dim])?;
        let (edge, row) = forces.tightest(&grid, &at, x_before, x)?;
        let when = grid.time(grid.steps);
        let sigma = known.sigma_forces.get(k).map(|forces| forces.tension[edge]);
        add(format!("tension of segment {edge}, t = {when:.4} s"), "N", sigma, &row);
    }
    // What was estimated.
    let first = problem.control_dim() - known.estimates.len();
    for (j, (estimate, constant)) in
        known.estimates.iter().zip(&problem.system.estimates().constants).enumerate()
    {
        let Some(at) = considered.own.iter().position(|own| *own == Some(first + j)) else { continue };
        let by_p = constant.slope_at(known.control[first + j]);
        let row: Vec<f64> = moved.chunks_exact(control.len()).map(|dz| by_p * dz[at]).collect();
        add(estimate.name.clone(), estimate.unit, estimate.sigma_on_mesh, &row);
    }
    Ok(all)
}

/// A number of the result whose derivatives by the numbers p of these constants are `row`.
fn result(
    of: String,
    unit: &'static str,
    sigma: Option<f64>,
    row: &[f64],
    constants: &[&Constant],
) -> Considered {
    let by = |(constant, by_p): (&&Constant, &f64)| ByConstant {
        name: constant.name.clone(),
        unit: constant.unit,
        value: constant.value,
        sigma: constant.sigma_at(0.0, constant.sigma),
        derivative: by_p / constant.slope_at(0.0),
        moves: by_p * constant.sigma,
    };
    let by: Vec<ByConstant> = constants.iter().zip(row).map(by).collect();
    let squares: f64 = by.iter().map(|c| c.moves * c.moves).sum();
    Considered { of, unit, sigma, sigma_with_considered: sigma.map(|s| s.hypot(squares.sqrt())), by }
}
