//! One assembled cost for every kind of model and observation.

use crate::rods::{DT, FIRST, HangingRod, loaded_rods, rod_scale, rods, wave};
use std::error::Error;
use varda_assimilation::{
    ControlTransform, LeastSquares, Observation, ObservationOperator, ObservationSet, Selection,
    StrongConstraint,
};
use varda_covariance::{Covariance, Dense, Diagonal};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{At, ImplicitModel, Model, OneLeg, RhsWithParameters, Rk4, Scheme, WithParameters};
use varda_rod::{Marker, Markers, Vector3};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// What is done with each cost: its name, and the cost.
pub type Visit<'v> = dyn FnMut(&str, &mut dyn LeastSquares) -> Result<()> + 'v;

/// Makes one cost after the other and hands it to `visit`: the flagship's window, rods of every kind seen by
/// markers, some of them between two steps, Lorenz 1963 and 1996, explicit and implicit, 3D-Var with and
/// without a model.
///
/// # Errors
/// A problem that cannot be set up, or what `visit` returns.
pub fn for_each_cost(visit: &mut Visit) -> Result<()> {
    flagship(visit)?;
    let places: [(&str, &[Marker]); 2] = [("centreline", &CENTRELINE), ("markers", &OFF_CENTRELINE)];
    for (seen, markers) in places {
        // rods with loads of the motion are seen by markers off the centreline alone
        let loaded = if seen == "markers" { loaded_rods()? } else { Vec::new() };
        for mut case in rods()?.into_iter().chain(loaded) {
            let markers = Markers::new(case.model.step_ref(), markers)?;
            // At the very start, between steps, on a step.
            let when = [(0, 0.0), (3, 0.25), (5, 0.0), (7, 0.6)];
            let mut sigma = rod_scale(case.model.step_ref());
            sigma.truncate(case.control.len());
            let b = Diagonal::new(sigma)?;
            let name = format!("{}, {seen}", case.name);
            problem(&name, &mut case.model, &case.control, &b, Box::new(markers), 0.01, &when, visit)?;
        }
    }
    let x63 = [1.2, -0.7, 10.3];
    let b = Dense::new(3, &[1.0, 0.5, 0.0, 0.5, 1.0, 0.2, 0.0, 0.2, 2.0])?;
    let when = [(4, 0.0), (9, 0.5), (20, 0.0)];
    let all = |n: usize, step: usize| {
        Ok::<_, Box<dyn Error>>(Box::new(Selection::new((0..n).step_by(step).collect(), n)?))
    };
    let mut rk4 = Rk4::new(Lorenz63::default(), 0, 0.01);
    problem("lorenz63 rk4", &mut rk4, &x63, &b, all(3, 2)?, 1.0, &when, visit)?;
    // σ, ρ, β unknown too
    let with: Vec<f64> = x63.into_iter().chain([10.0, 28.0, 8.0 / 3.0]).collect();
    let of_constants = Diagonal::new(vec![1.0, 1.0, 1.4, 0.5, 1.0, 0.1])?;
    let mut rk4 = Rk4::new(RhsWithParameters::new(Lorenz63::default(), 0), 0, 0.01);
    let seen: Box<dyn ObservationOperator> = Box::new(Selection::new(vec![0, 2], 6)?);
    problem("lorenz63 rk4 with its constants", &mut rk4, &with, &of_constants, seen, 1.0, &when, visit)?;
    let step = OneLeg::new(Lorenz63::default(), Scheme::Bdf2, 1e-13);
    let mut bdf2 = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
    let seen: Box<dyn ObservationOperator> = Box::new(Selection::new(vec![0, 2], bdf2.dim())?);
    problem("lorenz63 bdf2 with its constants", &mut bdf2, &with, &of_constants, seen, 1.0, &when, visit)?;
    let mut euler = ImplicitModel::new(OneLeg::implicit_euler(Lorenz63::default(), 1e-13), 0, 0.01);
    problem("lorenz63 implicit euler", &mut euler, &x63, &b, all(3, 1)?, 1.0, &when, visit)?;
    let x96: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    let b = Diagonal::uniform(40, 0.5)?;
    let mut rk4 = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125);
    problem("lorenz96 rk4", &mut rk4, &x96, &b, all(40, 2)?, 1.0, &when, visit)?;
    let mut midpoint =
        ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(40, 8.0), 1e-13), 0, 0.0125);
    problem("lorenz96 implicit midpoint", &mut midpoint, &x96, &b, all(40, 1)?, 1.0, &when, visit)?;
    let mut unused = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125);
    problem("3D-Var", &mut unused, &x96, &b, all(40, 3)?, 0.4, &[(0, 0.0)], visit)
}

const CENTRELINE: [Marker; 3] = [
    Marker { s: 0.31, offset: Vector3::new(0.0, 0.0, 0.0) },
    Marker { s: 0.62, offset: Vector3::new(0.0, 0.0, 0.0) },
    Marker { s: 0.88, offset: Vector3::new(0.0, 0.0, 0.0) },
];

/// Beside the rod in every direction; the first sits on a segment that a clamp may hold.
const OFF_CENTRELINE: [Marker; 3] = [
    Marker { s: 0.15, offset: Vector3::new(0.02, -0.01, 0.0) },
    Marker { s: 0.55, offset: Vector3::new(-0.015, 0.025, 0.01) },
    Marker { s: 0.85, offset: Vector3::new(0.0, 0.03, -0.02) },
];

/// The window of case 2 with the prior conditioned on the clamp.
fn flagship(visit: &mut Visit) -> Result<()> {
    let (rod, truth) = HangingRod::flagship(2, true)?;
    let observations = rod.observe_with_waves(&truth)?;
    let mut model = rod.model(rod.first_step)?;
    let mut set = rod.observation_set(model.dim(), observations)?;
    let b = rod.background_covariance()?;
    let transform = ControlTransform::new(truth, &b)?;
    visit("flagship case 2", &mut StrongConstraint::new(&mut model, transform, &mut set)?)
}

/// The same test problem around any model: background `z`, values seen from it and moved by a few σ, on the
/// grid of time of the rods.
fn problem(
    name: &str,
    model: &mut dyn Model,
    z: &[f64],
    b: &dyn Covariance,
    mut operator: Box<dyn ObservationOperator>,
    sigma: f64,
    when: &[(usize, f64)],
    visit: &mut Visit,
) -> Result<()> {
    let rows = operator.dim();
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x)?;
    let mut y = vec![0.0; rows];
    operator.observe(At { step: 0, time: FIRST as f64 * DT }, &x, &mut y).map_err(|e| e.to_string())?;
    let observation = |(i, &(step, weight)): (usize, &(usize, f64))| {
        // every second observation lacks a row
        let seen: Vec<usize> = (0..rows).filter(|r| i % 2 == 0 || *r != 1).collect();
        let values = seen.iter().map(|&r| y[r] + 3.0 * sigma * wave(r, i)).collect();
        let sigmas = seen.iter().map(|&r| sigma * (1.0 + 0.5 * wave(r, 7))).collect();
        Observation::new(step, seen, values, sigma).between(weight).sigmas(sigmas)
    };
    let observations = when.iter().enumerate().map(observation).collect();
    let last = when.last().map_or(0, |w| w.0 + usize::from(w.1 > 0.0));
    // markers see supports that move with time; every other model here does not
    let times = (0..=last).map(|k| (FIRST + k) as f64 * DT).collect();
    let mut set = ObservationSet::on_times(times, vec![operator], observations)?;
    visit(name, &mut StrongConstraint::new(model, ControlTransform::new(z.to_vec(), b)?, &mut set)?)
}
