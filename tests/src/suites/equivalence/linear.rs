//! Closed form, 3D-Var, incremental, dual, strong 4D-Var, the Kalman filter and the smoother.

use super::common::{gap, go_on, tight};
use crate::row::{Case, Outcome, Rows};
use nalgebra::{DMatrix, DVector};
use problems::small_problems::{self, LINEAR_STEPS, Thin, coupled, difference, dot, normals, observation};
use std::error::Error;
use varda_assimilation::{
    Blue, ControlTransform, CostFunction, Dual, Forcing, Gain, InnerCost, InnerLimits, InnerSolver,
    LeastSquares, LinearObservation, NewtonCgOptions, NewtonOptions, ObservationSet, Status,
    StrongConstraint, TrustRegionOptions, WeakForcing, conjugate_gradients, newton, newton_cg,
    restricted_conjugate_gradients, trust_region,
};
use varda_covariance::Covariance;
use varda_implicit::{ControlMap, Model, Work};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

pub(super) fn rows(rows: &mut Rows) {
    rows.case("linear 3dvar, dense B", |case| static_methods(case, &coupled(5, 0.8)?));
    rows.case("linear 3dvar, B of rank 3 without inverse", |case| static_methods(case, &Thin));
    rows.case("linear 3dvar", |case| {
        let (background, mut set) = linear_3dvar()?;
        let b = coupled(5, 0.8)?;
        let transform = ControlTransform::new(background, &b)?;
        iterates(case, &mut StrongConstraint::without_model(transform, &mut set)?, 43)
    });
    rows.case("lorenz96, 6 variables, curved H", |case| {
        let (mut model, background, mut set) = small_problems::curved()?;
        let b = coupled(6, 0.5)?;
        let transform = ControlTransform::new(background, &b)?;
        iterates(case, &mut StrongConstraint::new(&mut model, transform, &mut set)?, 7)
    });
    rows.case("lorenz96, 30 variables", |case| {
        let (mut model, background, mut set) = small_problems::wide()?;
        let b = coupled(30, 1.0)?;
        let transform = ControlTransform::new(background, &b)?;
        iterates(case, &mut StrongConstraint::new(&mut model, transform, &mut set)?, 44)
    });
    rows.case("lorenz96, 30 variables, model error, many iterations", |case| {
        let (mut model, background, _) = small_problems::wide()?;
        let values = normals(55, 120);
        let whole: Vec<usize> = (0..30).collect();
        let seen = (0..4).map(|j| observation(&whole, 2 * j, 0.0, &values[30 * j..30 * j + 30], 0.01));
        let mut set = ObservationSet::new(6, vec![small_problems::all_of(30)?], seen.collect())?;
        let (b, q) = (coupled(30, 1.0)?, coupled(30, 0.3)?);
        let transform = ControlTransform::new(background, &b)?;
        iterates(
            case,
            &mut WeakForcing::new(&mut model, transform, &q, Forcing::every_step(30), &mut set)?,
            56,
        )
    });
    rows.case("lorenz96, 6 variables, curved H", wrong_adjoint);
    rows.case("linear window", filter_and_smoother);
    rows.case("linear window", one_outer_loop);
    rows.case("lorenz96, 30 variables", one_minimum);
}

/// Reason of the bounds of what ends by [`tight`].
pub(super) const TIGHT: &str =
    "both end at a gradient of 1e-11 of the first, and A ≥ I: a hundred times that";

/// y = H x with a full H of 4 rows, for a state of 5.
pub(in crate::suites) fn linear_3dvar() -> Result<(Vec<f64>, ObservationSet)> {
    let h: Vec<_> = normals(40, 20).iter().enumerate().map(|(i, &h)| (i / 5, i % 5, h)).collect();
    let h = LinearObservation::new(4, 5, &h)?;
    let mut seen = observation(&[0, 1, 2, 3], 0, 0.0, &normals(41, 4), 0.5);
    seen.sigma[2] = 0.1;
    Ok((normals(42, 5), ObservationSet::new(0, vec![Box::new(h)], vec![seen])?))
}

/// x_a and J of [`linear_3dvar`] by the paper's (2.2), densely, apart from the code under test.
pub(in crate::suites) fn closed_form(b: &dyn Covariance) -> Result<(Vec<f64>, f64)> {
    let (background, mut set) = linear_3dvar()?;
    let column = |f: &mut dyn FnMut(&[f64], &mut [f64]), rows: usize, j: usize| {
        let (mut unit, mut column) = ([0.0; 5], vec![0.0; rows]);
        unit[j] = 1.0;
        f(&unit, &mut column);
        DVector::from_vec(column)
    };
    let mut observe = |x: &[f64], y: &mut [f64]| {
        let mut seen = set.prediction();
        set.observe_add(0, x, &mut seen).expect("a linear operator refuses nothing");
        y.copy_from_slice(seen.values());
    };
    let h = DMatrix::from_columns(&[0, 1, 2, 3, 4].map(|j| column(&mut observe, 4, j)));
    let dense = DMatrix::from_columns(&[0, 1, 2, 3, 4].map(|j| column(&mut |x, y| b.apply(x, y), 5, j)));
    let r = DMatrix::from_diagonal(&DVector::from_iterator(4, set.sigma().iter().map(|s| s * s)));
    let bht = &dense * h.transpose();
    let d = DVector::from_column_slice(set.values()) - &h * DVector::from_column_slice(&background);
    let weights = (&h * &bht + r).lu().solve(&d).ok_or("a singular H B Hᵀ + R")?;
    let analysis = DVector::from_column_slice(&background) + bht * &weights;
    Ok((analysis.as_slice().to_vec(), 0.5 * d.dot(&weights)))
}

/// Every way to one analysis.
fn static_methods(case: &mut Case, b: &dyn Covariance) -> Outcome {
    let (expected, value) = closed_form(b)?;
    let (background, mut set) = linear_3dvar()?;
    let transform = ControlTransform::new(background, b)?;
    let n = transform.dim();
    let mut found = Vec::new();
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set)?;
    for (name, gain) in
        [("blue, gain of observations", Gain::Observation), ("blue, gain of information", Gain::Information)]
    {
        let blue = Blue::new(&mut cost, &vec![0.0; n], gain)?;
        found.push((name, blue.analysis(&transform), blue.value));
    }
    let control = |v: &[f64]| {
        let mut z = vec![0.0; 5];
        transform.control(v, &mut z);
        z
    };
    let mut v = vec![0.0; n];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13);
    let minimum = trust_region(&mut cost, &mut v, &options, &mut go_on)?;
    found.push(("3dvar", control(&v), minimum.value));
    for (name, inner) in
        [("incremental", InnerSolver::Primal), ("psas", InnerSolver::Dual), ("direct", InnerSolver::Direct)]
    {
        v.fill(0.0);
        let minimum = tight(&mut cost, &mut v, inner)?;
        found.push((name, control(&v), minimum.value));
    }
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n]))?;
    let mut dual = Dual::new(&mut cost)?;
    let mut w = vec![0.0; 4];
    let options = NewtonCgOptions::default().with_gradient_tolerance(1e-13);
    let minimum = newton_cg(&mut dual, &mut w, &options, &mut go_on)?;
    dual.increment(&w, &mut v)?;
    found.push(("dual cost (2.12)", control(&v), -minimum.value));
    case.reason("small dense problems of condition up to 1e4, in either direction: 100 times their rounding");
    for (name, z, j) in found {
        case.at_most(&format!("{name}: analysis"), difference(&z, &expected), 1e-10, "-");
        case.at_most(&format!("{name}: J"), gap(j, value), 1e-10, "-").computed(j);
    }
    Ok(())
}

/// Both inner solvers at two outer iterates.
fn iterates(case: &mut Case, problem: &mut dyn LeastSquares, seed: u64) -> Outcome {
    let n = problem.dim();
    let there: Vec<f64> = normals(seed, n).iter().map(|v| 0.3 * v).collect();
    for (name, v) in [("background", vec![0.0; n]), ("second iterate", there)] {
        let (iterations, worst) = compare_iterates(problem, &v)?;
        case.at_most(&format!("primal = dual iterates, {name}"), worst, 1e-9, "-")
            .because(
                "iterates agree to the orthogonality that is kept: the residual asked for, 1e-10, ten times",
            )
            .note(format!("{iterations} iterations"));
    }
    Ok(())
}

/// Iterate for iterate until |r| ≤ 1e-10 |r₀|: how many, and the largest relative difference.
fn compare_iterates(problem: &mut dyn LeastSquares, v: &[f64]) -> Result<(usize, f64)> {
    let n = problem.dim();
    let (mut g, mut primal, mut dual) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    problem.linearize(v, &mut g)?;
    let mut worst = 0.0f64;
    for iterations in 1..=2 * n {
        let limits = InnerLimits { residual: 1e-10, iterations };
        let one = conjugate_gradients(problem, &g, &limits, &mut primal)?;
        let two = restricted_conjugate_gradients(problem, &limits, &mut dual)?;
        let apart = difference(&dual, &primal);
        if !apart.is_finite() {
            return Err("iterates that are not finite".into());
        }
        worst = worst.max(apart).max((one.residual - two.residual).abs());
        if one.iterations < iterations || one.residual <= 1e-10 {
            return Ok((one.iterations, worst));
        }
    }
    Err("conjugate gradients did not end".into())
}

/// A model whose adjoint is wrong by a thousandth in one entry of its first step.
struct WrongAdjoint<M>(M);

impl<M: Model> Model for WrongAdjoint<M> {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn step(
        &mut self,
        k: usize,
        x: &[f64],
        x_next: &mut [f64],
    ) -> std::result::Result<Work, varda_implicit::Error> {
        self.0.step(k, x, x_next)
    }
    fn linearize(
        &mut self,
        slot: usize,
        k: usize,
        x: &[f64],
        x_next: &[f64],
    ) -> std::result::Result<Work, varda_implicit::Error> {
        self.0.linearize(slot, k, x, x_next)
    }
    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.0.tangent(slot, dx);
    }
    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.0.adjoint(slot, lambda);
        lambda[0] *= if slot == 0 { 1.001 } else { 1.0 };
    }
    fn release(&mut self, from_slot: usize) {
        self.0.release(from_slot);
    }
    fn slot_bytes(&self) -> usize {
        self.0.slot_bytes()
    }
    fn bytes(&self) -> usize {
        self.0.bytes()
    }
    fn rate(&self) -> Option<Box<dyn varda_implicit::Rate>> {
        self.0.rate()
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        self.0.control_map()
    }
}

fn wrong_adjoint(case: &mut Case) -> Outcome {
    let (model, background, mut set) = small_problems::curved()?;
    let mut model = WrongAdjoint(model);
    let b = coupled(6, 0.5)?;
    let transform = ControlTransform::new(background, &b)?;
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set)?;
    let (_, worst) = compare_iterates(&mut cost, &normals(7, 6))?;
    case.at_most("guard: 1e-6 / |primal − dual| with a wrong adjoint", 1e-6 / worst, 1.0, "-")
        .computed(worst)
        .because("an adjoint wrong by 1e-3 must show a thousand times above the bound of the iterates");
    Ok(())
}

/// A mean and its covariance.
type Estimate = (DVector<f64>, DMatrix<f64>);

/// Filtered at every step, and smoothed over the window by Rauch, Tung and Striebel (1965), from whole states
/// seen at whole steps.
pub(super) fn kalman(
    step: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    background: &[f64],
    set: &ObservationSet,
) -> Result<(Vec<Estimate>, Vec<Estimate>)> {
    let n = background.len();
    let (mut x, mut p) = (DVector::from_column_slice(background), b.clone());
    let (mut forecasts, mut filtered): (Vec<Estimate>, Vec<Estimate>) = (Vec::new(), Vec::new());
    for k in 0..=LINEAR_STEPS {
        if k > 0 {
            x = step * x;
            p = step * p * step.transpose() + q;
        }
        forecasts.push((x.clone(), p.clone()));
        for o in set.observations().iter().filter(|o| o.step == k) {
            let h = DMatrix::from_fn(o.rows.len(), n, |i, j| f64::from(u8::from(o.rows[i] == j)));
            let r =
                DMatrix::from_diagonal(&DVector::from_iterator(o.rows.len(), o.sigma.iter().map(|s| s * s)));
            let hp = &h * &p;
            let gain = (&hp * h.transpose() + r).lu().solve(&hp).ok_or("singular S")?.transpose();
            x += &gain * (DVector::from_column_slice(&o.values) - &h * &x);
            p -= gain * hp;
        }
        filtered.push((x.clone(), p.clone()));
    }
    let mut smoothed = vec![filtered[LINEAR_STEPS].clone()];
    for k in (0..LINEAR_STEPS).rev() {
        let (x, p) = &filtered[k];
        let (forecast, p_forecast) = &forecasts[k + 1];
        let (later, p_later) = &smoothed[0];
        let c =
            p_forecast.clone().lu().solve(&(step * p)).ok_or("a singular forecast covariance")?.transpose();
        let estimate = (x + &c * (later - forecast), p + &c * (p_later - p_forecast) * c.transpose());
        smoothed.insert(0, estimate);
    }
    Ok((filtered, smoothed))
}

/// B as a matrix.
pub(super) fn dense(b: &dyn Covariance) -> DMatrix<f64> {
    let n = b.dim();
    let (mut unit, mut matrix) = (vec![0.0; n], vec![0.0; n * n]);
    for (j, column) in matrix.chunks_exact_mut(n).enumerate() {
        unit[j] = 1.0;
        b.apply(&unit, column);
        unit[j] = 0.0;
    }
    DMatrix::from_vec(n, n, matrix)
}

/// M of a linear model.
pub(super) fn step_matrix(model: &mut dyn Model) -> Result<DMatrix<f64>> {
    let n = model.dim();
    let (mut unit, mut matrix) = (vec![0.0; n], vec![0.0; n * n]);
    for (j, column) in matrix.chunks_exact_mut(n).enumerate() {
        unit[j] = 1.0;
        model.step(0, &unit, column)?;
        unit[j] = 0.0;
    }
    Ok(DMatrix::from_vec(n, n, matrix))
}

fn filter_and_smoother(case: &mut Case) -> Outcome {
    let (mut model, background, mut set) = small_problems::linear()?;
    let b = coupled(4, 0.8)?;
    let step = step_matrix(&mut model)?;
    let (filtered, smoothed) = kalman(&step, &dense(&b), &DMatrix::zeros(4, 4), &background, &set)?;
    let transform = ControlTransform::new(background, &b)?;
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
    case.reason(TIGHT);
    for (name, inner) in [("4dvar", InnerSolver::Primal), ("4d-psas", InnerSolver::Dual)] {
        tight(&mut cost, &mut [0.0; 4], inner)?;
        let end = difference(cost.state(LINEAR_STEPS), filtered[LINEAR_STEPS].0.as_slice());
        case.at_most(&format!("{name} = kalman filter at the end"), end, 1e-9, "-");
        let start = difference(cost.state(0), smoothed[0].0.as_slice());
        case.at_most(&format!("{name} = rts smoother at the start"), start, 1e-9, "-");
    }
    let blue = Blue::new(&mut cost, &[0.0; 4], Gain::Observation)?;
    let covariance = difference(&blue.control_covariance(&transform), smoothed[0].1.as_slice());
    case.at_most("posterior covariance = rts smoother's", covariance, 1e-9, "-");
    let apart = difference(filtered[0].0.as_slice(), smoothed[0].0.as_slice());
    case.at_most("guard: 1e-3 / |filter − smoother| at the start", 1e-3 / apart, 1.0, "-").because(
        "the filter at the start has not seen what comes later: an analysis that agreed with it \
            would be wrong",
    );
    Ok(())
}

/// On a linear problem the inner cost is J, and one outer iteration is all.
fn one_outer_loop(case: &mut Case) -> Outcome {
    let (mut model, background, mut set) = small_problems::linear()?;
    let b = coupled(4, 0.8)?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(background, &b)?, &mut set)?;
    let mut full = [0.0; 4];
    let options = NewtonOptions::default().with_gradient_tolerance(1e-13);
    newton(&mut cost, &mut full, &options, &mut go_on)?;
    let mut one = [0.0; 4];
    let minimum = tight(&mut cost, &mut one, InnerSolver::Primal)?;
    case.count("outer loops of incremental 4dvar", minimum.outer_iterations, 1);
    case.at_most("incremental, one outer loop = full 4dvar", difference(&one, &full), 1e-10, "-")
        .because("gradients of 1e-13 and 1e-11 of the first at the two ends, and A ≥ I");
    let (v, p) = (normals(50, 4), normals(51, 4));
    cost.linearize(&v, &mut [0.0; 4])?;
    let inner = InnerCost::new(&mut cost).evaluate(&p, None)?;
    let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + p).collect();
    let value = cost.evaluate(&moved, None)?;
    case.at_most("inner cost = J", gap(inner, value), 1e-12, "-")
        .computed(value)
        .because("the same sum of some tens of squares in another order: a thousand times its rounding");
    Ok(())
}

/// A curved J: 4D-Var, incremental 4D-Var and 4D-PSAS end at one point.
fn one_minimum(case: &mut Case) -> Outcome {
    let (mut model, background, mut set) = small_problems::wide()?;
    let b = coupled(30, 0.5)?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(background, &b)?, &mut set)?;
    let mut full = vec![0.0; 30];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-11);
    let minimum = trust_region(&mut cost, &mut full, &options, &mut go_on)?;
    for (name, inner) in [("incremental", InnerSolver::Primal), ("4d-psas", InnerSolver::Dual)] {
        let mut v = vec![0.0; 30];
        let found = tight(&mut cost, &mut v, inner)?;
        case.count(&format!("{name}: converged"), usize::from(found.status == Status::Converged), 1);
        case.at_most(&format!("{name} = 4dvar: J"), gap(found.value, minimum.value), 1e-10, "-")
            .computed(found.value)
            .because(
                "J is flat to the square of the gradient that is left, 1e-11 of the first: rounding, a \
                thousand times",
            );
        let apart: Vec<f64> = v.iter().zip(&full).map(|(a, b)| a - b).collect();
        let bound = 2e-11 * minimum.gradient_norm_first;
        case.at_most(&format!("{name} = 4dvar: |Δv|"), dot(&apart, &apart).sqrt(), bound, "-")
            .because("A ≥ I, so that v is as near as the gradients are small");
    }
    Ok(())
}
