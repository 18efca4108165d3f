//! No steps, one unknown, no rows, no observations: an answer that is right, or a typed error.

use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{
    Adaptive, At, Footprint, ImplicitModel, Keep, Model, ObservationOperator, OneLeg, Rate, Refusal, Rhs,
    Rk4, Scheme, Storage, Structure, Substepped, Trajectory, VelocityRate, accepted_times, check,
};

/// ẋ = −x, one unknown, in every structure.
#[derive(Clone)]
struct Decay(Structure);

impl Rhs for Decay {
    fn dim(&self) -> usize {
        1
    }
    fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) {
        f[0] = -x[0];
    }
    fn tangent(&mut self, _: f64, _: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = -dx[0];
    }
    fn adjoint_add(&mut self, _: f64, _: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= lambda[0];
    }
    fn structure(&self) -> Structure {
        self.0.clone()
    }
}

fn structures() -> [Structure; 4] {
    let sparse = Structure::from_pairs(1, [(0, 0)]).unwrap();
    [Structure::Dense, Structure::Band { half_bandwidth: 0 }, Structure::tridiagonal(), sparse]
}

/// Every model of one unknown, and what a step multiplies x by.
fn models() -> Vec<(Box<dyn Model>, f64)> {
    let h: f64 = 0.1;
    let by_rk4 = 1.0 - h + h * h / 2.0 - h.powi(3) / 6.0 + h.powi(4) / 24.0;
    let mut all: Vec<(Box<dyn Model>, f64)> = vec![
        (Box::new(Rk4::new(Decay(Structure::Dense), 0, h)), by_rk4),
        (Box::new(Substepped::new(Rk4::new(Decay(Structure::Dense), 0, h), vec![0, 1, 2, 3])), by_rk4),
    ];
    for structure in structures() {
        let euler = OneLeg::implicit_euler(Decay(structure.clone()), 1e-13);
        all.push((Box::new(ImplicitModel::new(euler, 0, h)), 1.0 / (1.0 + h)));
        let midpoint = OneLeg::implicit_midpoint(Decay(structure), 1e-13);
        all.push((Box::new(ImplicitModel::new(midpoint, 0, h)), (1.0 - h / 2.0) / (1.0 + h / 2.0)));
    }
    all
}

#[test]
fn one_unknown_in_every_structure() {
    for (i, (mut model, factor)) in models().into_iter().enumerate() {
        let mut next = [0.0];
        model.step(0, &[2.0], &mut next).unwrap();
        // Newton's tolerance, and a few roundings
        assert!((next[0] - 2.0 * factor).abs() <= 1e-12, "{i}: {} {factor}", next[0]);
        model.linearize(0, 0, &[2.0], &next).unwrap();
        let (mut dx, mut lambda) = ([1.0], [1.0]);
        model.tangent(0, &mut dx);
        model.adjoint(0, &mut lambda);
        assert!((dx[0] - factor).abs() <= 1e-12 && (lambda[0] - factor).abs() <= 1e-12, "{i}");
        // no columns at all
        model.tangent(0, &mut []);
        model.adjoint(0, &mut []);
        let report = check::model(model.as_mut(), &[2.0], 2, &[1.0], 1).unwrap();
        assert!(report.passed(), "{i}: {report}");
    }
}

/// A window of no steps is its initial state, under every storage; its derivatives are the identity.
#[test]
fn no_steps() {
    for storage in [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 1 }] {
        for (mut model, _) in models() {
            for keep in [Keep::States, Keep::Linearizations] {
                let mut trajectory = Trajectory::with_storage(storage);
                trajectory.run(model.as_mut(), &[2.0], 0, keep).unwrap();
                assert_eq!(trajectory.state(0), [2.0]);
                assert_eq!(trajectory.log().counts.model_steps, 0);
                let (mut dx, mut lambda, mut seen) = ([3.0], [0.0], 0);
                trajectory.tangent(model.as_mut(), &mut dx, &mut |_, _, _| seen += 1).unwrap();
                trajectory.adjoint(model.as_mut(), &mut lambda, &mut |_, _, l| l[0] += 5.0).unwrap();
                assert_eq!((dx, lambda, seen), ([3.0], [5.0], 1));
            }
            assert!(check::model(model.as_mut(), &[2.0], 0, &[1.0], 1).is_err(), "nothing was compared");
            let draw = &mut || 1.0;
            if let Ok(found) = check::amplification(model.as_mut(), &[2.0], &[1.0], &[2.0], draw) {
                assert!(found.warning().is_none());
            }
        }
    }
    let nothing = Footprint { steps: 0, runs: 2, state: 8, linearization: 100, always: 0 };
    assert_eq!(nothing.within(16).unwrap(), Storage::KeepAll);
    assert!(nothing.within(15).is_err());
    assert_eq!(Storage::Checkpoints { states: 1 }.executed_steps(0), 0);
}

/// Steps through one time only are none.
#[test]
fn no_time_to_step_through() {
    let mut step = OneLeg::implicit_euler(Decay(Structure::Dense), 1e-13);
    let options = Adaptive { tolerance: 1e-3, first: 0.1, shortest: 1e-6, longest: 1.0 };
    let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        accepted_times(&mut step, Scheme::BackwardEuler, &[1.0], &[1.0], &[0.0], &options)
    }));
    // a documented panic, an error or the one time: not a grid that was not asked for
    if let Ok(Ok(times)) = found {
        assert_eq!(times, [0.0]);
    }
}

#[test]
fn structures_of_nothing_and_of_one() {
    for n in [0, 1] {
        let sparse = Structure::from_pairs(n, (0..n).map(|i| (i, i))).unwrap();
        for structure in [Structure::Dense, Structure::Band { half_bandwidth: 0 }, sparse] {
            structure.check(n).unwrap();
            let values = structure.values(n, |_, _| 2.0);
            assert_eq!(values.len(), structure.values_len(n));
            let mut y = vec![f64::NAN; n];
            structure.product(&values, &vec![3.0; n], &mut y);
            assert_eq!(y, vec![6.0; n]);
            assert_eq!(structure.colouring(n).iter().map(Vec::len).sum::<usize>(), n);
        }
    }
    assert!(Structure::from_pairs(0, [(0, 0)]).is_err());
}

/// An operator without rows, or of no state.
struct Rows(usize, usize);

impl ObservationOperator for Rows {
    fn dim(&self) -> usize {
        self.0
    }
    fn state_dim(&self) -> usize {
        self.1
    }
    fn observe(&mut self, _: At, _: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        y.fill(0.0);
        Ok(())
    }
    fn tangent(&mut self, _: At, _: &[f64], _: &[f64], dy: &mut [f64]) {
        dy.fill(0.0);
    }
    fn adjoint_add(&mut self, _: At, _: &[f64], _: &[f64], _: &mut [f64]) {}
}

#[test]
fn operators_of_nothing_prove_nothing() {
    let at = At { step: 0, time: 0.0 };
    for (rows, n) in [(0, 2), (2, 0), (0, 0)] {
        let checked = check::operator(&mut Rows(rows, n), at, &vec![1.0; n], &vec![1.0; n], 1);
        assert!(!checked.is_ok_and(|report| report.passed()), "{rows} {n}");
    }
}

/// A rate of no components leaves every product as it is.
#[test]
fn rates_of_nothing() {
    let mut rate = VelocityRate::new(0..0, 0, |_| 0.1);
    let mut dx = [1.0, 2.0];
    rate.eval(0, &[3.0, 4.0], &mut []);
    rate.tangent(0, &[3.0, 4.0], &dx.clone(), &mut []);
    rate.adjoint_add(0, &[3.0, 4.0], &[], &mut dx);
    assert_eq!((rate.components().len(), dx), (0, [1.0, 2.0]));
    // a model's rate is that of its right-hand side
    let model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let (mut found, mut right) = ([0.0; 3], [0.0; 3]);
    let mut rate = model.rate().unwrap();
    rate.eval(0, &[1.0, 3.0, 20.0], &mut found);
    Lorenz63::default().eval(0.0, &[1.0, 3.0, 20.0], &mut right);
    assert_eq!((found, rate.length(5)), (right, 0.01));
    // fields by implicit steps have none
    let line = Line { points: 3, length: 1.0, ends: Ends::Periodic };
    let field = Transport::burgers(line, 0.1).implicit(Scheme::BackwardEuler, 1e-12, 0, 0.1);
    assert!(field.rate().is_none());
}
