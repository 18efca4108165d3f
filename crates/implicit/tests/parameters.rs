//! Parameters in the state: every equation of this crate, by explicit and implicit steps.

use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{
    ChosenParameters, Error, ImplicitModel, Law, Model, OneLeg, ParametricRhs, Rhs, RhsWithParameters, Rk4,
    Scheme, WithParameters, check,
};

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];

/// All checks of a model whose control is `z`, by each kind of step; one constant is carried.
fn checked<R: ParametricRhs + Clone + 'static>(rhs: R, z: &[f64], length: f64) -> Result<(), Error> {
    let z: Vec<f64> = z.iter().copied().chain([0.7]).collect();
    let scale = |model: &dyn Model| vec![0.1; model.dim()];
    let mut explicit = Rk4::new(RhsWithParameters::new(rhs.clone(), 1), 0, length);
    assert!(explicit.second_order().is_some());
    let scales = scale(&explicit);
    let report = check::model(&mut explicit, &z, 4, &scales, 1)?;
    assert!(report.passed(), "RK4: {report}");
    for scheme in SCHEMES {
        let step = WithParameters::new(OneLeg::new(rhs.clone(), scheme, 1e-12), 1);
        let mut implicit = ImplicitModel::new(step, 0, length);
        assert!(implicit.second_order().is_some());
        let scales = scale(&implicit);
        let report = check::model(&mut implicit, &z, 4, &scales, 1)?;
        assert!(report.passed(), "{scheme:?}: {report}");
    }
    Ok(())
}

#[test]
fn every_equation_with_its_parameters_in_the_state() -> Result<(), Error> {
    checked(Lorenz63::default(), &[1.0, 3.0, 20.0, 10.0, 28.0, 2.6], 0.01)?;
    let ring: Vec<f64> = (0..12).map(|i| 3.0 + 2.0 * (1.3 * i as f64).sin()).chain([8.0]).collect();
    checked(Lorenz96::new(12, 8.0), &ring, 0.02)?;
    let wave: Vec<f64> = (0..10).map(|i| 1.0 + 0.6 * (0.9 * i as f64).sin()).collect();
    let with = |p: [f64; 2]| wave.iter().copied().chain(p).collect::<Vec<f64>>();
    let circle = Line { points: 10, length: 1.0, ends: Ends::Periodic };
    let line = Line { ends: Ends::Fixed { left: 1.0, right: 0.5 }, ..circle };
    for line in [circle, line] {
        checked(Transport::advection_diffusion(line, 0.8, 0.02), &with([0.8, 0.02]), 0.02)?;
        checked(Transport::burgers(line, 0.05), &with([0.0, 0.05]), 0.02)?;
    }
    Ok(())
}

#[test]
fn chosen_parameters_by_their_laws() -> Result<(), Error> {
    let known = [10.0, 28.0, 8.0 / 3.0];
    let chosen = vec![(1, Law::Exponential), (2, Law::Linear)];
    let rhs = ChosenParameters::new(Lorenz63::default(), &known, chosen);
    checked(rhs, &[1.0, 3.0, 20.0, 0.05, -0.2], 0.01)
}

/// Parameters of a state give what the same constants give, bit for bit.
#[test]
fn parameters_in_the_state_are_constants() -> Result<(), Error> {
    let (rho, beta) = (26.5, 2.4);
    let mut plain = Rk4::new(Lorenz63 { rho, beta, ..Lorenz63::default() }, 0, 0.01);
    let mut with = Rk4::new(RhsWithParameters::new(Lorenz63::default(), 0), 0, 0.01);
    let (mut x, mut y) = (vec![1.0, 3.0, 20.0], vec![1.0, 3.0, 20.0, 10.0, rho, beta]);
    for k in 0..20 {
        let (before, then) = (x.clone(), y.clone());
        plain.step(k, &before, &mut x)?;
        with.step(k, &then, &mut y)?;
        assert_eq!(x[..], y[..3], "step {k}");
    }
    assert_eq!(y[3..], [10.0, rho, beta]);
    Ok(())
}

/// The checks see one wrong entry of ∂²(λᵀf)/∂x∂p, and of ∂²(λᵀf)/∂p².
#[test]
fn a_wrong_second_derivative_is_caught() -> Result<(), Error> {
    #[derive(Clone)]
    struct Wrong(ChosenParameters<Lorenz63>, [f64; 2]);
    impl Rhs for Wrong {
        fn dim(&self) -> usize {
            3
        }
        fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
            self.0.eval(t, x, f);
        }
        fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
            self.0.tangent(t, x, dx, df);
        }
        fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
            self.0.adjoint_add(t, x, lambda, dx);
        }
        fn has_second_derivatives(&self) -> bool {
            true
        }
        fn second_adjoint_add(&mut self, t: f64, x: &[f64], dx: &[f64], l: &[f64], out: &mut [f64]) {
            self.0.second_adjoint_add(t, x, dx, l, out);
        }
    }
    impl ParametricRhs for Wrong {
        fn parameters(&self) -> usize {
            self.0.parameters()
        }
        fn set_parameters(&mut self, p: &[f64]) {
            self.0.set_parameters(p);
        }
        fn parameter_jacobian(&mut self, t: f64, x: &[f64], columns: &mut [f64]) {
            self.0.parameter_jacobian(t, x, columns);
        }
        fn has_second_parameters(&self) -> bool {
            true
        }
        fn second_parameters(&mut self, t: f64, x: &[f64], l: &[f64], columns: &mut [f64], pp: &mut [f64]) {
            self.0.second_parameters(t, x, l, columns, pp);
            columns[0] *= self.1[0];
            pp[0] *= self.1[1];
        }
    }
    let rhs = ChosenParameters::new(Lorenz63::default(), &[10.0, 28.0, 2.6], vec![(1, Law::Exponential)]);
    let z = [1.0, 3.0, 20.0, 0.1];
    for (factors, right) in [([1.0, 1.0], true), ([1.001, 1.0], false), ([1.0, 1.001], false)] {
        let wrong = Wrong(rhs.clone(), factors);
        let mut explicit = Rk4::new(RhsWithParameters::new(wrong.clone(), 0), 0, 0.01);
        let step = WithParameters::new(OneLeg::new(wrong, Scheme::BackwardEuler, 1e-12), 0);
        let mut implicit = ImplicitModel::new(step, 0, 0.01);
        for model in [&mut explicit as &mut dyn Model, &mut implicit] {
            let report = check::model(model, &z, 4, &[0.1; 4], 1)?;
            assert_eq!(report.passed(), right, "{factors:?}: {report}");
        }
    }
    Ok(())
}

/// The checks see one wrong column of ∂f/∂p.
#[test]
fn a_wrong_column_is_caught() -> Result<(), Error> {
    #[derive(Clone)]
    struct Wrong(Lorenz63);
    impl Rhs for Wrong {
        fn dim(&self) -> usize {
            3
        }
        fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
            self.0.eval(t, x, f);
        }
        fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
            self.0.tangent(t, x, dx, df);
        }
        fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
            self.0.adjoint_add(t, x, lambda, dx);
        }
    }
    impl ParametricRhs for Wrong {
        fn parameters(&self) -> usize {
            3
        }
        fn set_parameters(&mut self, p: &[f64]) {
            self.0.set_parameters(p);
        }
        fn parameter_jacobian(&mut self, t: f64, x: &[f64], columns: &mut [f64]) {
            self.0.parameter_jacobian(t, x, columns);
            columns[4] *= 1.001;
        }
    }
    let z = [1.0, 3.0, 20.0, 10.0, 28.0, 2.6];
    let mut model = Rk4::new(RhsWithParameters::new(Wrong(Lorenz63::default()), 0), 0, 0.01);
    assert!(!check::model(&mut model, &z, 4, &[0.1; 6], 1)?.passed());
    Ok(())
}
