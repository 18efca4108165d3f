//! How an analysis depends on values, errors, background and constants that are held: against differences of
//! two analyses with one of these changed.

use crate::cost::coupled;
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense, Diagonal};
use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{Model, RhsWithParameters, Rk4};

/// Three numbers, two of them seen twice, all coupled.
struct Line {
    background: Vec<f64>,
    sigma_b: f64,
    values: [f64; 4],
    sigma: [f64; 2],
}

impl Line {
    fn b(&self) -> Dense {
        coupled(3, self.sigma_b)
    }

    fn set(&self) -> ObservationSet {
        let [a, b] = self.sigma;
        let rows = LinearObservation::new(2, 3, &[(0, 0, 1.0), (0, 1, -0.5), (1, 2, 2.0)]).unwrap();
        let seen = [(0, a), (1, b)]
            .map(|(i, sigma)| Observation::new(0, vec![0, 1], self.values[2 * i..2 * i + 2].to_vec(), sigma));
        ObservationSet::new(0, vec![Box::new(rows)], seen.to_vec()).unwrap()
    }

    /// The analysed third number plus twice the first.
    fn scalar(&self) -> f64 {
        let (b, mut set) = (self.b(), self.set());
        let transform = ControlTransform::new(self.background.clone(), &b).unwrap();
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
        let blue = Blue::new(&mut cost, &[0.0; 3], Gain::Information).unwrap();
        let mut z = [0.0; 3];
        transform.control(&blue.control_variable, &mut z);
        z[2] + 2.0 * z[0]
    }
}

fn line() -> Line {
    Line { background: vec![1.0, -0.4, 0.3], sigma_b: 0.8, values: [2.0, 0.1, 1.2, 1.7], sigma: [0.5, 0.9] }
}

/// Central differences, extrapolated twice: h⁶.
fn slope(of: impl Fn(f64) -> f64) -> f64 {
    let central = |h: f64| (of(h) - of(-h)) / (2.0 * h);
    let [a, b, c] = [0.08, 0.04, 0.02].map(central);
    let [ab, bc] = [(4.0 * b - a) / 3.0, (4.0 * c - b) / 3.0];
    (16.0 * bc - ab) / 15.0
}

#[test]
fn of_a_linear_problem_they_are_those_of_two_analyses() {
    let at = line();
    let (b, mut set) = (at.b(), at.set());
    let transform = ControlTransform::new(at.background.clone(), &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    let v = Blue::new(&mut cost, &[0.0; 3], Gain::Information).unwrap().control_variable;
    cost.linearize(&v, &mut [0.0; 3]).unwrap();
    let mut by_v = [0.0; 3];
    b.root_transpose(&[2.0, 0.0, 1.0], &mut by_v);
    let s = ScalarSensitivity::new(&mut cost, Hessian::GaussNewton, &by_v).unwrap();

    // Differences of h⁶ and of rounding over h: 1e-8.
    let check = |what: &str, found: f64, changed: &dyn Fn(&mut Line, f64)| {
        let expected = slope(|h| {
            let mut line = line();
            changed(&mut line, h);
            line.scalar()
        });
        assert!((found - expected).abs() <= 1e-8, "{what}: {found} {expected}");
        assert!(expected.abs() > 1e-3, "{what} says nothing");
    };
    for i in 0..4 {
        let by_value = s.by_whitened_values()[i] / at.sigma[i / 2];
        check("a value", by_value, &|line, h| line.values[i] += h);
    }
    let by_log_sigma = s.by_log_sigma();
    for i in 0..2 {
        let both: f64 = by_log_sigma[2 * i..2 * i + 2].iter().sum();
        check("σ of two values", both, &|line, h| line.sigma[i] *= h.exp());
    }
    let of_background: f64 = s.by_log_root().iter().sum();
    check("σ of the background", of_background, &|line, h| line.sigma_b *= h.exp());
    for (j, by_column) in s.by_whitened_background().iter().enumerate() {
        let mut column = [0.0; 3];
        let unit: Vec<f64> = (0..3).map(|i| f64::from(i == j)).collect();
        b.root(&unit, &mut column);
        check("the background", *by_column, &|line, h| {
            line.background.iter_mut().zip(column).for_each(|(b, c)| *b += h * c);
        });
    }
    let all: f64 = by_log_sigma.iter().sum::<f64>() + of_background;
    assert!(all.abs() <= 1e-13, "the unit of all errors: {all:e}");
}

const STEPS: usize = 60;
const START: [f64; 3] = [-4.3, -5.0, 20.0];
/// σ of the values: those of another ρ, so that residuals are large and second derivatives count.
const SIGMA: f64 = 0.5;

fn seen(ln_sigma: f64, moved: f64) -> Vec<Observation> {
    let mut truth = Rk4::new(Lorenz63 { rho: 31.0, ..Lorenz63::default() }, 0, 0.01);
    let states = run(&mut truth, &START, STEPS);
    let noise = normals(3, 12);
    let at = |i: usize| {
        let step = 15 * (i + 1);
        let values = vec![states[step][0] + noise[2 * i], states[step][2] + noise[2 * i + 1]];
        Observation::new(step, vec![0, 2], values, SIGMA)
    };
    let mut all: Vec<Observation> = (0..4).map(at).collect();
    all[1].sigma.iter_mut().for_each(|s| *s *= ln_sigma.exp());
    all[2].values[0] += moved;
    all
}

/// y at the end of the window, of the analysis with these constants; and its control.
fn analysed(constants: Lorenz63, seen: Vec<Observation>) -> (f64, Vec<f64>) {
    let mut model = Rk4::new(constants, 0, 0.01);
    let b = Diagonal::uniform(3, 0.7).unwrap();
    let mut set = ObservationSet::new(STEPS, vec![all_of(3)], seen).unwrap();
    let transform = ControlTransform::new(START.to_vec(), &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    let mut v = vec![0.0; 3];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13);
    let options = options.with_hessian(Hessian::Exact);
    let end = Minimizer::TrustRegion(options)
        .minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))
        .unwrap();
    assert!(matches!(end.status, Status::Converged | Status::Stalled), "{end:?}");
    let mut z = vec![0.0; 3];
    transform.control(&v, &mut z);
    (run(&mut model, &z, STEPS)[STEPS][1], z)
}

/// ∂s/∂(ln σ of the second observation), ∂s/∂y of a value, ∂s/∂ρ.
fn found(hessian: Hessian) -> [f64; 3] {
    let (_, z) = analysed(Lorenz63::default(), seen(0.0, 0.0));
    let p = Lorenz63::default();
    let control = [&z[..], &[p.sigma, p.rho, p.beta]].concat();
    let mut model = Rk4::new(RhsWithParameters::new(Lorenz63::default(), 0), 0, 0.01);
    let states: Vec<f64> = run(&mut model, &control, STEPS).concat();
    let b = Diagonal::new(vec![0.7, 0.7, 0.7, 1.0, 1.0, 1.0]).unwrap();
    let mut background = control.clone();
    background[..3].copy_from_slice(&START);
    let mut v: Vec<f64> = control.iter().zip(&background).map(|(z, b)| (z - b) / 0.7).collect();
    v[3..].fill(0.0);
    let transform = ControlTransform::new(background, &b).unwrap();
    let at_end = |model: &mut dyn Model, dz: &[f64]| {
        let mut last = 0.0;
        propagate_root(model, &control, dz, &states, &mut |k, w| {
            last = if k == STEPS { w[1] } else { 0.0 };
            Ok(())
        })
        .unwrap();
        last
    };
    let by_v: Vec<f64> = (0..3)
        .map(|i| at_end(&mut model, &(0..6).map(|j| f64::from(i == j) * 0.7).collect::<Vec<_>>()))
        .collect();
    let mut set = ObservationSet::new(STEPS, vec![all_of(6)], seen(0.0, 0.0)).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    cost.linearize(&v, &mut [0.0; 6]).unwrap();
    let held = [(3, 0.0), (4, 1.0), (5, 0.0)];
    let dv = with_held(&mut cost, hessian, &held).unwrap();
    drop(cost);
    let mut dz = vec![0.0; 6];
    transform.tangent(&dv, &mut dz);
    let by_rho = at_end(&mut model, &dz);

    // values and σ, without the constants
    let b = Diagonal::uniform(3, 0.7).unwrap();
    let mut set = ObservationSet::new(STEPS, vec![all_of(3)], seen(0.0, 0.0)).unwrap();
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let transform = ControlTransform::new(START.to_vec(), &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    cost.linearize(&v[..3], &mut [0.0; 3]).unwrap();
    let s = ScalarSensitivity::new(&mut cost, hessian, &by_v).unwrap();
    let all: f64 = s.by_log_sigma().iter().chain(&s.by_log_root()).sum();
    assert!(hessian == Hessian::GaussNewton || all.abs() < 1e-9, "the unit of all errors: {all:e}");
    [s.by_log_sigma()[2..4].iter().sum(), s.by_whitened_values()[4] / SIGMA, by_rho]
}

#[test]
fn of_a_nonlinear_window_the_exact_hessian_has_those_of_two_analyses() {
    let p = Lorenz63::default();
    let expected = [
        slope(|h| analysed(p, seen(h, 0.0)).0),
        slope(|h| analysed(p, seen(0.0, h)).0),
        slope(|h| analysed(Lorenz63 { rho: p.rho + h, ..p }, seen(0.0, 0.0)).0),
    ];
    let [exact, gauss_newton] = [Hessian::Exact, Hessian::GaussNewton].map(found);
    for ((exact, other), expected) in exact.iter().zip(&gauss_newton).zip(&expected) {
        // differences of h⁶, of minima found to 1e-13 of the first gradient
        assert!((exact - expected).abs() <= 1e-6 * expected.abs(), "{exact} {expected}");
        // what second derivatives are for
        assert!((other - expected).abs() > 1e-4 * expected.abs(), "{other} {expected}");
    }
}

#[test]
fn a_hessian_that_is_not_positive_definite_is_an_error() {
    let mut cost = Saddle;
    let error = ScalarSensitivity::new(&mut cost, Hessian::Exact, &[1.0]).unwrap_err();
    assert!(matches!(error, Error::NotPositiveDefinite { smallest } if smallest == -2.0), "{error}");
    assert!(ScalarSensitivity::new(&mut cost, Hessian::GaussNewton, &[1.0]).is_ok());
}

/// One number whose exact Hessian is −2.
struct Saddle;

impl CostFunction for Saddle {
    fn dim(&self) -> usize {
        1
    }
    fn evaluate(&mut self, _: &[f64], _: Option<&mut [f64]>) -> Result<f64, Error> {
        Ok(0.0)
    }
    fn terms(&self) -> CostTerms {
        CostTerms::default()
    }
    fn set_observation_scale(&mut self, _: f64) {}
    fn counts(&self) -> Counts {
        Counts::default()
    }
}

impl LeastSquares for Saddle {
    fn background_dim(&self) -> usize {
        1
    }
    fn observation_dim(&self) -> usize {
        1
    }
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        (b[0], d[0]) = (0.0, 0.0);
    }
    fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        dy[0] = p[0];
        Ok(())
    }
    fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
        p[0] = dy[0];
        Ok(())
    }
    fn exact_hessian_apply(&mut self, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        out[0] = -2.0 * p[0];
        Ok(())
    }
}
