//! A stiff spring pendulum by backward Euler on positions, with its incremental potential: tangent and
//! adjoint through whole and halved steps.

use varda_implicit::{
    Equations, Error, ImplicitModel, ImplicitStep, Interval, Keep, Model, NewtonOptions, NewtonWork, Refusal,
    SolvedStep, StepEquations, Structure, Trajectory, check, solve,
};

/// A unit mass on a spring of unit length, hung at the origin; x = [X, Y, Ẋ, Ẏ], u = [X, Y].
struct Spring {
    stiffness: f64,
    /// Added to one entry of the Jacobian, to show that the checks see it.
    mutation: f64,
    /// The step refuses points further from the origin.
    reach: f64,
}

const SPRING: Spring = Spring { stiffness: 1e4, mutation: 0.0, reach: f64::INFINITY };
const SCALE: [f64; 4] = [0.1, 0.1, 1.0, 1.0];

/// The equations of one step.
struct SpringEquations<'a> {
    step: &'a mut Spring,
    at: Interval,
    x: &'a [f64],
}

impl Equations for SpringEquations<'_> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let at = &self.at;
        let x = self.x;
        let h = at.length;
        let r = u[0].hypot(u[1]);
        if r > self.step.reach {
            return Err(Refusal::new(format!("{r} m is out of reach")));
        }
        let (e, k) = ([u[0] / r, u[1] / r], self.step.stiffness);
        let mut phi = 0.5 * k * (r - 1.0).powi(2) + 9.81 * u[1];
        for i in 0..2 {
            let inertia = u[i] - x[i] - h * x[2 + i];
            phi += 0.5 * inertia * inertia / (h * h);
            g[i] = inertia / (h * h) + k * (r - 1.0) * e[i] + if i == 1 { 9.81 } else { 0.0 };
        }
        if let Some(j) = jacobian {
            let (along, across) = (k, k * (r - 1.0) / r);
            let entry = |a: usize, b: usize| {
                let same = if a == b { 1.0 } else { 0.0 };
                same / (h * h) + along * e[a] * e[b] + across * (same - e[a] * e[b])
            };
            j.copy_from_slice(&[0.0, entry(0, 0), entry(1, 0), entry(1, 1) + self.step.mutation]);
        }
        Ok(Some(phi))
    }
    fn converged_below(&self) -> f64 {
        1e-11
    }
}

impl StepEquations for SpringEquations<'_> {
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        let at = &self.at;
        let x = self.x;
        for i in 0..2 {
            u[i] = x[i] + at.length * x[2 + i];
        }
        Ok(())
    }
}

impl ImplicitStep for Spring {
    type Equations<'a> = SpringEquations<'a>;

    fn dim(&self) -> usize {
        4
    }
    fn unknowns(&self) -> usize {
        2
    }
    fn structure(&self) -> Structure {
        Structure::SymmetricBand { half_bandwidth: 1 }
    }
    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        for i in 0..2 {
            x_next[i] = u[i];
            x_next[2 + i] = (u[i] - x[i]) / at.length;
        }
    }
    fn recover(&mut self, _: &Interval, _: &[f64], x_next: &[f64], u: &mut [f64]) {
        u.copy_from_slice(&x_next[..2]);
    }
    fn previous(&mut self, of: &SolvedStep, dx: &[f64], dg: &mut [f64]) {
        let h = of.at.length;
        for i in 0..2 {
            dg[i] = -(dx[i] + h * dx[2 + i]) / (h * h);
        }
    }
    fn previous_transpose_add(&mut self, of: &SolvedStep, mu: &[f64], dx: &mut [f64]) {
        let h = of.at.length;
        for i in 0..2 {
            dx[i] -= mu[i] / (h * h);
            dx[2 + i] -= mu[i] / h;
        }
    }
    fn advance_tangent(&mut self, of: &SolvedStep, dx: &[f64], du: &[f64], dx_next: &mut [f64]) {
        for i in 0..2 {
            dx_next[i] = du[i];
            dx_next[2 + i] = (du[i] - dx[i]) / of.at.length;
        }
    }
    fn advance_adjoint(&mut self, of: &SolvedStep, lambda: &[f64], dx: &mut [f64], du: &mut [f64]) {
        dx.fill(0.0);
        for i in 0..2 {
            du[i] = lambda[i] + lambda[2 + i] / of.at.length;
            dx[i] = -lambda[2 + i] / of.at.length;
        }
    }
    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<Self::Equations<'a>, Refusal> {
        Ok(SpringEquations { step: self, at: *at, x })
    }
}

/// A model whose Newton iteration is cut so short that wild steps must be halved.
fn halving() -> ImplicitModel<Spring> {
    let options = NewtonOptions::default().with_max_iterations(3);
    ImplicitModel::new(SPRING, 3, 0.1).with_options(options)
}

const WILD: [f64; 4] = [0.8, -0.5, 12.0, 9.0];

#[test]
fn whole_steps_conform_and_their_window_is_adjoint() {
    let mut model = ImplicitModel::new(SPRING, 0, 0.02);
    let x0 = [0.8, -0.5, 0.3, 0.9];
    for outcome in check::conformance(&mut model, 2, &x0, &SCALE, 5).unwrap() {
        assert!(outcome.pass, "{outcome:?}");
    }
    let window = check::window(&mut model, &x0, 50, &SCALE, 5).unwrap();
    assert!(window.pass, "{window:?}");
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &x0, 50, Keep::Linearizations).unwrap();
    assert!(trajectory.log().warnings.is_empty(), "{:?}", trajectory.log().warnings);
}

#[test]
fn halved_steps_conform_too_and_say_so() {
    let mut model = halving();
    let mut next = [0.0; 4];
    let work = model.step(2, &WILD, &mut next).unwrap();
    assert!(work.substeps > 0, "the step was to be halved");
    assert_eq!(work.warnings.len(), 1);
    for outcome in check::conformance(&mut model, 2, &WILD, &[1e-3, 1e-3, 1e-2, 1e-2], 5).unwrap() {
        assert!(outcome.pass, "{outcome:?}");
    }
    let window = check::window(&mut model, &WILD, 10, &SCALE, 5).unwrap();
    assert!(window.pass, "{window:?}");
}

#[test]
fn a_halved_step_is_linearized_alike_on_record_and_from_its_states() {
    let (mut fresh, mut next, mut other) = (halving(), [0.0; 4], [0.0; 4]);
    assert!(fresh.step(2, &WILD, &mut next).unwrap().substeps > 0);
    fresh.linearize(2, 2, &WILD, &next).unwrap();
    let mut on_record = [1.0, -2.0, 0.5, 3.0];
    fresh.tangent(2, &mut on_record);
    // another step in between: the parts are forgotten and found again
    fresh.step(3, &next, &mut other).unwrap();
    fresh.linearize(2, 2, &WILD, &next).unwrap();
    let mut from_states = [1.0, -2.0, 0.5, 3.0];
    fresh.tangent(2, &mut from_states);
    assert_eq!(on_record, from_states);
    // a pair that is no step at all
    assert!(matches!(fresh.linearize(2, 2, &WILD, &WILD), Err(Error::NotAStep { step: 2 })));
}

#[test]
fn kept_memory_is_reused_and_reported() {
    let mut model = ImplicitModel::new(SPRING, 0, 0.02);
    model.reserve(20);
    let bytes = model.bytes();
    let mut trajectory = Trajectory::new();
    for _ in 0..2 {
        trajectory.run(&mut model, &[0.8, -0.5, 0.3, 0.9], 20, Keep::States).unwrap();
        trajectory.linearize(&mut model).unwrap();
    }
    assert!(bytes > 20 * 8 * (4 + 2 + 4));
    assert_eq!(model.bytes(), bytes);
    let counts = trajectory.log().counts;
    assert_eq!(counts.linearizations, 40);
    assert_eq!(counts.factorizations, counts.newton_iterations + 40);
}

#[test]
fn a_wrong_jacobian_entry_is_caught_by_taylor_and_not_by_the_dot_product() {
    let mut model = ImplicitModel::new(Spring { mutation: 30.0, ..SPRING }, 0, 0.02);
    let outcomes = check::conformance(&mut model, 0, &[0.8, -0.5, 0.3, 0.9], &SCALE, 5).unwrap();
    for outcome in &outcomes {
        assert_eq!(outcome.pass, !outcome.what.contains("Taylor"), "{outcome:?}");
    }
}

#[test]
fn a_step_that_cannot_be_taken_names_itself() {
    let mut model = ImplicitModel::new(Spring { reach: 0.5, ..SPRING }, 10, 0.02);
    let error = model.step(4, &[0.8, -0.5, 0.3, 0.9], &mut [0.0; 4]).unwrap_err();
    assert!(matches!(error, Error::Refused { step: 4, .. }), "{error}");
    assert!(error.to_string().contains("out of reach"), "{error}");
    assert!(std::error::Error::source(&error).is_none(), "printers of chains would say the reason twice");
    let options = NewtonOptions::default().with_max_iterations(1);
    let mut model = ImplicitModel::new(SPRING, 10, 0.02).with_options(options);
    let error = model.step(4, &WILD, &mut [0.0; 4]).unwrap_err();
    let Error::NewtonDiverged { step: 4, time, length, .. } = error else { panic!("{error}") };
    assert!((time - 0.28).abs() < 1e-15 && (length - 0.02 / 64.0).abs() < 1e-18);
    assert!(model.step(4, &[f64::NAN, 0.0, 0.0, 0.0], &mut [0.0; 4]).is_err());
}

#[test]
fn newton_leaves_a_saddle_for_the_minimum() {
    // at rest straight above the support: in balance, and unstable for a long step
    let mut step = Spring { stiffness: 100.0, ..SPRING };
    let at = Interval { index: 0, start: 0.0, length: 10.0, previous: None };
    let top = 1.0 - 9.81 / 100.0;
    let x = [0.0, top, 0.0, 0.0];
    let mut u = [0.0, top];
    let mut work = NewtonWork::new(2, &step.structure());
    let mut equations = step.equations(&at, &x).unwrap();
    let report = solve(&mut equations, &mut u, &mut work, &NewtonOptions::default()).unwrap();
    assert!(report.shifts > 0 && !report.at_rounding, "{report:?}");
    // inertia over ten seconds is next to nothing: it hangs below
    assert!(u[1] < -1.0, "{u:?}");
    let mut g = [0.0; 2];
    equations.assemble(&u, &mut g, None).unwrap();
    // converged to 1e-11 m times the stiffness of 100 N/m
    assert!(g[0].abs().max(g[1].abs()) <= 1e-9, "{g:?}");
}

#[test]
fn updates_that_stall_at_rounding_end_the_iteration_and_others_do_not() {
    /// u³ scaled and moved far from zero, with a tolerance below what u can resolve.
    struct Far {
        noise: f64,
        calls: usize,
    }
    impl Equations for Far {
        fn assemble(
            &mut self,
            u: &[f64],
            g: &mut [f64],
            jacobian: Option<&mut [f64]>,
        ) -> Result<Option<f64>, Refusal> {
            self.calls += 1;
            let sign = if self.calls.is_multiple_of(2) { 1.0 } else { -1.0 };
            g[0] = u[0] - 1e6 / 3.0 + sign * self.noise;
            if let Some(j) = jacobian {
                j[0] = 1.0;
            }
            Ok(None)
        }
        fn converged_below(&self) -> f64 {
            1e-14
        }
        fn trusted_below(&self) -> f64 {
            1.0
        }
    }
    // ε · 3e5 is 7e-11: the first noise is within rounding of u, the second is not
    for (noise, fine) in [(2e-10, true), (1e-6, false)] {
        let mut step = Far { noise, calls: 0 };
        let mut work = NewtonWork::new(1, &Structure::SymmetricBand { half_bandwidth: 0 });
        let result = solve(&mut step, &mut [333_333.0], &mut work, &NewtonOptions::default());
        assert_eq!(result.is_ok(), fine, "{result:?}");
        assert!(result.map_or(true, |report| report.at_rounding && report.iterations < 10));
    }
}
