//! A linear model with an unknown forcing, against the Kalman filter of the augmented state.

use nalgebra::{DMatrix, DVector};
use varda_assimilation::{
    ControlTransform, Observation, ObservationSet, Posterior, Selection, StrongConstraint,
    TrustRegionOptions, propagate_root, trust_region,
};
use varda_covariance::{BlockDiagonal, Diagonal};
use varda_implicit::{
    ImplicitModel, Model, OneLeg, ParametricRhs, Rhs, RhsWithParameters, Rk4, Scheme, WithParameters,
};

use crate::row::{Case, Outcome, Rows};

/// Three coupled oscillators without a name, pushed by F (1, −½, 0, …).
#[derive(Clone, Default)]
pub(super) struct Pushed {
    forcing: f64,
}

pub(super) const N: usize = 6;
const STEPS: usize = 24;
const SIGMA: f64 = 0.1;

/// ẋ = A x + F d.
fn rate(i: usize, x: &[f64]) -> f64 {
    let (position, half) = (i < N / 2, N / 2);
    if position {
        return x[i + half];
    }
    let at = |j: usize| x[j % half];
    let j = i - half;
    at(j + 1) - 2.3 * at(j) + 0.4 * at(j + 2) - 0.15 * x[i]
}

fn push(i: usize) -> f64 {
    [0.0, 0.0, 0.0, 1.0, -0.5, 0.0][i]
}

impl Rhs for Pushed {
    fn dim(&self) -> usize {
        N
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f.iter_mut().enumerate().for_each(|(i, f)| *f = rate(i, x) + self.forcing * push(i));
    }
    fn tangent(&mut self, _t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        df.iter_mut().enumerate().for_each(|(i, df)| *df = rate(i, dx));
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        let mut unit = [0.0; N];
        for (j, dx) in dx.iter_mut().enumerate() {
            unit[j] = 1.0;
            *dx += (0..N).map(|i| lambda[i] * rate(i, &unit)).sum::<f64>();
            unit[j] = 0.0;
        }
    }
}

impl ParametricRhs for Pushed {
    fn parameters(&self) -> usize {
        1
    }
    fn set_parameters(&mut self, p: &[f64]) {
        self.forcing = p[0];
    }
    fn parameter_jacobian(&mut self, _t: f64, _x: &[f64], columns: &mut [f64]) {
        columns.iter_mut().enumerate().for_each(|(i, c)| *c = push(i));
    }
}

pub(super) fn run(rows: &mut Rows) {
    rows.area("Kalman filter of the augmented state");
    let rhs = Pushed::default;
    rows.case("RK4", |case| filtered(case, &mut Rk4::new(RhsWithParameters::new(rhs(), 0), 0, 0.1)));
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        rows.case(&format!("{scheme:?}"), |case| {
            let step = WithParameters::new(OneLeg::new(rhs(), scheme, 1e-14), 0);
            filtered(case, &mut ImplicitModel::new(step, 0, 0.1))
        });
    }
}

fn filtered(case: &mut Case, model: &mut dyn Model) -> Outcome {
    let (n, control) = (model.dim(), model.control_dim());
    let background: Vec<f64> = (0..control).map(|i| 0.3 * (1.0 + 2.1 * i as f64).cos()).collect();
    let seen: Vec<(usize, Vec<f64>)> = (1..=STEPS / 2)
        .map(|k| (2 * k, (0..2).map(|c| (0.7 * k as f64 + c as f64).sin()).collect()))
        .collect();
    let (rows, sigma_state, sigma_forcing) = ([0, 2], 0.5, 0.8);

    // the filter: matrices of the steps, by columns of their tangents
    let mut x = vec![0.0; n];
    model.initial_state(&background, &mut x)?;
    let mut start = DMatrix::zeros(n, control);
    for j in 0..control {
        let (mut dz, mut dx) = (vec![0.0; control], vec![0.0; n]);
        dz[j] = if j < N { sigma_state } else { sigma_forcing };
        model.initial_tangent(&dz, &mut dx);
        start.set_column(j, &DVector::from_vec(dx));
    }
    let (mut mean, mut p) = (DVector::from_vec(x.clone()), &start * start.transpose());
    let h = DMatrix::from_fn(2, n, |r, c| if c == rows[r] { 1.0 } else { 0.0 });
    let mut next = vec![0.0; n];
    for k in 0..STEPS {
        model.step(k, mean.as_slice(), &mut next)?;
        model.linearize(0, k, mean.as_slice(), &next)?;
        let mut m = DMatrix::zeros(n, n);
        for j in 0..n {
            let mut dx = vec![0.0; n];
            dx[j] = 1.0;
            model.tangent(0, &mut dx);
            m.set_column(j, &DVector::from_vec(dx));
        }
        (mean, p) = (DVector::from_vec(next.clone()), &m * p * m.transpose());
        if let Some((_, y)) = seen.iter().find(|(step, _)| *step == k + 1) {
            let s = &h * &p * h.transpose() + DMatrix::identity(2, 2) * SIGMA * SIGMA;
            let gain = &p * h.transpose() * s.try_inverse().ok_or("the filter's S has no inverse")?;
            mean = &mean + &gain * (DVector::from_column_slice(y) - &h * &mean);
            p = (DMatrix::identity(n, n) - gain * &h) * p;
        }
    }

    // 4D-Var over the window, run to its end
    let b =
        BlockDiagonal::new(vec![Diagonal::uniform(N, sigma_state)?, Diagonal::uniform(1, sigma_forcing)?]);
    let transform = ControlTransform::new(background, &b)?;
    let list = seen.iter().map(|(k, y)| Observation::new(*k, vec![0, 1], y.clone(), SIGMA)).collect();
    let mut set = ObservationSet::new(STEPS, vec![Box::new(Selection::new(rows.to_vec(), n)?)], list)?;
    let mut cost = StrongConstraint::new(model, transform.clone(), &mut set)?;
    let mut v = vec![0.0; control];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13);
    trust_region(&mut cost, &mut v, &options, &mut |_| std::ops::ControlFlow::Continue(()))?;
    let root = Posterior::new(&mut cost)?.control_root(&transform);
    let states: Vec<f64> = (0..=STEPS).flat_map(|k| cost.state(k).to_vec()).collect();
    let mut z = vec![0.0; control];
    transform.control(&v, &mut z);
    drop(cost);
    let mut last = Vec::new();
    propagate_root(model, &z, &root, &states, &mut |_, w| {
        last = w.to_vec();
        Ok(())
    })?;
    let w = DMatrix::from_vec(n, last.len() / n, last);
    let analysis = DVector::from_column_slice(&states[STEPS * n..]);
    let scale = mean.amax();
    case.at_most("mean at the end off the filter's", (&analysis - &mean).amax() / scale, 1e-10, "-")
        .because("two ways to one linear answer, and a gradient of 1e-13")
        .computed(analysis[N]);
    case.at_most(
        "covariance at the end off the filter's",
        (&w * w.transpose() - &p).amax() / p.amax(),
        1e-10,
        "-",
    )
    .because("rounding of the filter's P over the window");
    Ok(())
}
