//! Constants of a rod as parameters: ∂G/∂p in tangent and adjoint, against differences of whole steps.

mod common;

use std::f64::consts::PI;

use common::rods_with_parameters::{
    Case, DOWN, LOST, PLAIN, SEGMENTS, cases, control, loads, moves, rod, step, supports, unknowns,
};
use common::{assert_close, noise, products};
use varda_implicit::{
    At, Error, ImplicitModel, ImplicitStep, Model, ObservationOperator, ParametricStep, Scheme, SolvedStep,
    WithParameters,
};
use varda_rod::{Change, Damping, Law, Marker, Markers, Parameter, RodStep, TwistUnknowns, Vector3};

#[test]
fn tangent_and_adjoint_of_every_parameter() {
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        for case in cases() {
            let name = format!("{}, {scheme:?}", case.name);
            let step = step(case, scheme);
            let z = control(&step);
            let mut model = ImplicitModel::new(WithParameters::new(step, 1), 0, 0.01);
            let z: Vec<f64> = z.into_iter().chain([3.0]).collect();
            for product in products(&mut model, &z) {
                assert_eq!(product.substeps, 0, "{name}");
                // differences of a solve to 1e-11 m over 1e-4
                assert_close(&name, &product.tangent, &product.by_difference, 3e-6);
                assert!(product.gap <= 1e-12, "{name}: the transposes differ by {:e}", product.gap);
            }
        }
    }
}

/// One column of ∂G/∂p alone, so that no other term hides it.
#[test]
fn each_parameter_alone_moves_the_state_as_differences_say() {
    for scheme in [Scheme::BackwardEuler, Scheme::Bdf2] {
        for case in cases() {
            let step = step(case, scheme);
            let (z, parameters) = (control(&step), step.parameters());
            let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
            let run = |model: &mut ImplicitModel<_>, z: &[f64]| {
                let mut states = vec![vec![0.0; Model::dim(model)]; 4];
                model.initial_state(z, &mut states[0]).unwrap();
                for k in 0..3 {
                    let (past, next) = states.split_at_mut(k + 1);
                    model.step(k, &past[k], &mut next[0]).unwrap();
                }
                states
            };
            for p in z.len() - parameters..z.len() {
                let states = run(&mut model, &z);
                let mut dz = vec![0.0; z.len()];
                dz[p] = 1.0;
                let mut dx = vec![0.0; Model::dim(&model)];
                model.initial_tangent(&dz, &mut dx);
                for k in 0..3 {
                    model.linearize(0, k, &states[k], &states[k + 1]).unwrap();
                    model.tangent(0, &mut dx);
                }
                let differences = common::difference(&z, &dz, 1e-3, |z| run(&mut model, z).remove(3));
                let name = format!("{}, {scheme:?}, parameter {}", case.name, p + parameters - z.len());
                assert_close(&name, &dx, &differences, 1e-5);
            }
        }
    }
}

/// What parameters do to the forces within the rod, at fixed states.
#[test]
fn forces_move_with_the_parameters_as_differences_say() {
    for case in cases() {
        let step = step(case, Scheme::Bdf2);
        let z = control(&step);
        let parameters = step.parameters();
        let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
        let mut states = [vec![0.0; Model::dim(&model)], vec![0.0; Model::dim(&model)]];
        model.initial_state(&z, &mut states[0]).unwrap();
        let [before, now] = &mut states;
        model.step(0, before, now).unwrap();
        let own = |model: &mut ImplicitModel<WithParameters<RodStep>>, x: &[f64]| {
            model.step_mut().at(x).unwrap().1.to_vec()
        };
        let (before, now) = (own(&mut model, before), own(&mut model, now));
        let mut step = model.into_inner().into_step();
        let (t, then) = (0.01, 0.0);
        let p = z[z.len() - parameters..].to_vec();
        for i in 0..parameters {
            let mut dp = vec![0.0; parameters];
            dp[i] = 1.0;
            let by_difference = common::difference(&p, &dp, 1e-3, |p| {
                step.set_parameters(p).unwrap();
                let mut forces = step.internal_forces(t, &now, (then, &before)).unwrap();
                forces.numbers().map(|v| *v).collect()
            });
            step.set_parameters(&p).unwrap();
            let zero = vec![0.0; now.len()];
            let mut tangent = Vec::new();
            step.internal_forces_tangent(t, &now, (then, &before), [&zero, &zero, &dp], &mut |f| {
                tangent.extend(f.numbers().map(|v| *v));
            })
            .unwrap();
            // GJ of a rod without twist and the like move nothing
            let (error, size) = common::off(&tangent, &by_difference);
            // rounding of 1e3 N over 1e-3
            assert!(error <= 1e-8 * size.max(1e-2), "{}, {i}: off by {error:e} of {size:e}", case.name);
        }
    }
}

/// Places of markers at a fixed state, off the centreline too.
#[test]
fn markers_move_with_the_supports_as_differences_say() {
    for case in cases().into_iter().filter(|case| case.moved) {
        let step = step(case, Scheme::BackwardEuler);
        let z = control(&step);
        let p = z[z.len() - step.parameters()..].to_vec();
        let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
        let mut x = vec![0.0; Model::dim(&model)];
        model.initial_state(&z, &mut x).unwrap();
        let x = model.step_mut().at(&x).unwrap().1.to_vec();
        let step = model.into_inner().into_step();
        let places = [0.02, 0.09, 0.31, 0.55, 0.97].map(|s| Marker { s, offset: [0.01, -0.02, 0.03].into() });
        let mut markers = Markers::new(&step, &places).unwrap();
        let (at, moving) = (At { step: 0, time: 0.0 }, markers.moving_parameters().to_vec());
        let mut columns = vec![0.0; 15 * moving.len()];
        markers.set_parameters(&p);
        markers.by_parameters(at, &x, &mut columns).unwrap();
        assert_eq!(moving.len(), moves(case).len());
        for (&i, column) in moving.iter().zip(columns.chunks_exact(15)) {
            let mut dp = vec![0.0; p.len()];
            dp[i] = 1.0;
            let by_difference = common::difference(&p, &dp, 1e-3, |p| {
                let mut y = vec![0.0; 15];
                markers.set_parameters(p);
                markers.observe(at, &x, &mut y).unwrap();
                y
            });
            markers.set_parameters(&p);
            // rounding of 1 m over 1e-3; a vertex far from the markers moves none
            let (error, size) = common::off(column, &by_difference);
            assert!(error <= 1e-10 * size.max(1.0), "{}, {i}: off by {error:e} of {size:e}", case.name);
        }
    }
}

/// With all parameters zero the rod is the one described: the same states, bit for bit.
#[test]
fn parameters_of_zero_change_nothing() {
    let case = Case { curved: true, damping: LOST, ..PLAIN };
    let with = step(case, Scheme::Bdf2);
    let mut z = control(&with);
    let n = z.len() - with.parameters();
    z[n..].fill(0.0);
    let plain = RodStep::with_twist(rod(case), supports(case), DOWN, LOST, TwistUnknowns::Always).unwrap();
    let mut plain = ImplicitModel::new(plain.with_scheme(Scheme::Bdf2), 0, 0.01);
    let mut with = ImplicitModel::new(WithParameters::new(with, 0), 0, 0.01);
    let (mut x, mut y) = (vec![0.0; plain.dim()], vec![0.0; with.dim()]);
    plain.initial_state(&z[..n], &mut x).unwrap();
    with.initial_state(&z, &mut y).unwrap();
    for k in 0..5 {
        let (before, then) = (x.clone(), y.clone());
        plain.step(k, &before, &mut x).unwrap();
        with.step(k, &then, &mut y).unwrap();
        assert_eq!(x[..n], y[..n], "step {k}");
    }
}

/// The checks see one wrong entry of ∂G/∂p.
#[test]
fn a_wrong_column_is_caught() {
    struct Wrong(RodStep);
    macro_rules! same {
        ($($name:ident($($arg:ident: $of:ty),*) $(-> $out:ty)?;)*) => {
            $(fn $name(&mut self, $($arg: $of),*) $(-> $out)? { self.0.$name($($arg),*) })*
        };
    }
    impl ImplicitStep for Wrong {
        type Equations<'a> = <RodStep as ImplicitStep>::Equations<'a>;
        fn dim(&self) -> usize {
            self.0.dim()
        }
        fn unknowns(&self) -> usize {
            self.0.unknowns()
        }
        fn structure(&self) -> varda_implicit::Structure {
            self.0.structure()
        }
        fn control_dim(&self) -> usize {
            self.0.control_dim()
        }
        fn kept(&self) -> usize {
            self.0.kept()
        }
        fn equations<'a>(
            &'a mut self,
            at: &varda_implicit::Interval,
            x: &'a [f64],
        ) -> Result<Self::Equations<'a>, varda_implicit::Refusal> {
            self.0.equations(at, x)
        }
        same! {
            advance(at: &varda_implicit::Interval, x: &[f64], u: &[f64], next: &mut [f64]);
            recover(at: &varda_implicit::Interval, x: &[f64], next: &[f64], u: &mut [f64]);
            keep(at: &varda_implicit::Interval, x: &[f64], u: &[f64], kept: &mut [f64]);
            previous(of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]);
            previous_transpose_add(of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]);
            advance_tangent(of: &SolvedStep<'_>, dx: &[f64], du: &[f64], next: &mut [f64]);
            advance_adjoint(of: &SolvedStep<'_>, lambda: &[f64], dx: &mut [f64], du: &mut [f64]);
            initial_state(t: f64, z: &[f64], x: &mut [f64]) -> Result<(), varda_implicit::Refusal>;
            initial_tangent(t: f64, dz: &[f64], dx: &mut [f64]);
            initial_adjoint(t: f64, lambda: &[f64], dz: &mut [f64]);
        }
    }
    impl ParametricStep for Wrong {
        fn parameters(&self) -> usize {
            self.0.parameters()
        }
        fn set_parameters(&mut self, p: &[f64]) -> Result<(), varda_implicit::Refusal> {
            self.0.set_parameters(p)
        }
        fn parameter_jacobian(&mut self, of: &SolvedStep<'_>, columns: &mut [f64]) {
            self.0.parameter_jacobian(of, columns);
            let unknowns = of.u.len();
            columns[unknowns + 10] *= 1.5;
        }
    }
    let step = step(PLAIN, Scheme::BackwardEuler);
    let z = control(&step);
    // small changes of the state, so that those of the parameters show
    let mut scale = vec![1e-3; z.len()];
    scale[z.len() - step.parameters()..].fill(0.1);
    let mut right = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
    let report = varda_implicit::check::model(&mut right, &z, 3, &scale, 1).unwrap();
    assert!(report.passed(), "{report}");
    let mut wrong =
        ImplicitModel::new(WithParameters::new(Wrong(right.into_inner().into_step()), 0), 0, 0.01);
    assert!(!varda_implicit::check::model(&mut wrong, &z, 3, &scale, 1).unwrap().passed());
}

#[test]
fn what_cannot_be_a_parameter_is_refused() {
    let refused = |change: Change, damping: Damping| {
        let parameter = vec![Parameter { change, law: Law::Exponential }];
        let made = RodStep::with_parameters(rod(PLAIN), supports(PLAIN), DOWN, damping, parameter);
        made.err().expect("refused").to_string()
    };
    let none = Change::default;
    let damping = Damping { stiffness: 0.1, mass: 0.0 };
    assert!(refused(Change { damping, ..none() }, Damping::default()).contains("damping.stiffness"));
    assert!(refused(Change { ea: vec![1.0; 3], ..none() }, damping).contains("change of EA"));
    let spin_inertia = vec![1e-6; SEGMENTS];
    assert!(refused(Change { spin_inertia, ..none() }, damping).contains("spin inertia"));
    // a value at which there is no rod ends the step, and names the constant
    let masses = rod(PLAIN).masses.iter().map(|m| -2.0 * m).collect();
    let parameter = vec![Parameter { change: Change { masses, ..none() }, law: Law::Linear }];
    let step =
        RodStep::with_parameters(rod(PLAIN), supports(PLAIN), DOWN, Damping::default(), parameter).unwrap();
    let mut z = control(&step);
    *z.last_mut().unwrap() = PI;
    let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
    let mut x = vec![0.0; model.dim()];
    let error: Error = model.initial_state(&z, &mut x).unwrap_err();
    assert!(error.to_string().contains("vertex mass"), "{error}");
}

/// Cases of rods at rest: nothing of a motion in them, gravity as it is, and `still` supports too.
fn at_rest(still: bool) -> impl Iterator<Item = (Case, WithParameters<RodStep>, Vec<f64>)> {
    cases().into_iter().filter(|case| !case.spins && case.held).map(move |case| {
        let case = Case { damping: PLAIN.damping, ..case };
        let step = step(case, Scheme::BackwardEuler).at_rest().unwrap();
        let (rod, supports) = (step.rod(), step.supports());
        let found = varda_rod::rest(rod, supports, &loads(case), 0.0, &varda_rod::Search::default()).unwrap();
        let mut z = step.control_at_rest(&found.rest);
        let first = z.len();
        z.extend(noise(2).take(step.parameters()).map(|e| 0.2 * e));
        for (z, p) in z[first..].iter_mut().zip(unknowns(case)) {
            let known = [p.change.gravity, p.change.gravity_turn] == [Vector3::zeros(); 2];
            if !known || !p.change.supports.is_empty() && still {
                *z = 0.0;
            }
        }
        (case, WithParameters::new(step, 0), z)
    })
}

/// Every step, the first included, ends at the equilibrium of the rod with those constants, which another
/// function finds.
#[test]
fn a_rod_at_rest_is_in_equilibrium_at_every_step() {
    for (case, step, z) in at_rest(true) {
        let mut model = ImplicitModel::new(step, 0, 0.01);
        let mut x = vec![0.0; Model::dim(&model)];
        model.initial_state(&z, &mut x).unwrap();
        let mut next = x.clone();
        for k in 0..4 {
            if k > 0 {
                model.step(k - 1, &x, &mut next).unwrap();
                std::mem::swap(&mut x, &mut next);
            }
            let t = 0.01 * k as f64;
            let (rod, own) = model.step_mut().at(&x).unwrap();
            let own = own.to_vec();
            let vertices = rod.vertices(t, &own).unwrap();
            let guess = varda_rod::Rest { theta: vec![0.0; SEGMENTS], vertices };
            let (found, _) =
                varda_rod::equilibrium(rod.rod(), rod.supports(), &loads(case), t, &guess).unwrap();
            let apart = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (a - b).norm();
            let most = found.vertices.iter().zip(&guess.vertices).map(apart).fold(0.0, f64::max);
            // both solve to 1e-11 of the length
            assert!(most <= 1e-9, "{}, step {k}: off by {most:e} m", case.name);
        }
    }
}

/// What can turn about a point has no equilibrium of its own, and what spins is not at rest.
#[test]
fn a_rod_that_is_free_to_turn_is_not_at_rest() {
    let hung = step(Case { held: false, ..PLAIN }, Scheme::BackwardEuler);
    assert!(hung.at_rest().err().unwrap().to_string().contains("two prescribed vertices"));
    let spinning = step(Case { spins: true, ..PLAIN }, Scheme::BackwardEuler);
    assert!(spinning.at_rest().err().unwrap().to_string().contains("nothing spins at rest"));
}

/// ∂x₀/∂p and its transpose, each parameter alone; places and velocities of the control move nothing.
#[test]
fn the_first_state_at_rest_moves_with_parameters_alone() {
    for (case, step, z) in at_rest(false) {
        let parameters = step.places().parameters();
        let mut model = ImplicitModel::new(step, 0, 0.01);
        let n = Model::dim(&model);
        let start = |model: &mut ImplicitModel<_>, z: &[f64]| {
            let mut x = vec![0.0; n];
            model.initial_state(z, &mut x).unwrap();
            x
        };
        for p in parameters.clone() {
            let mut dz = vec![0.0; z.len()];
            dz[p] = 1.0;
            let differences = common::difference(&z, &dz, 1e-3, |z| start(&mut model, z));
            start(&mut model, &z);
            let mut dx = vec![0.0; n];
            model.initial_tangent(&dz, &mut dx);
            let name = format!("{}, parameter {}", case.name, p - parameters.start);
            // rounding of 1e-11 m over 1e-3, and the third derivative
            assert_close(&name, &dx, &differences, 1e-6);
            // a check that cannot fail is none
            dx.iter_mut().take(parameters.start).for_each(|d| *d *= 1.001);
            let (error, size) = common::off(&dx, &differences);
            let moves = dx[..parameters.start].iter().any(|d| d.abs() > 1e-2);
            assert!(!moves || error > 1e-6 * size, "{name}: a tangent 0.1 % too large passes");
        }
        let dz: Vec<f64> = noise(3).take(z.len()).collect();
        let lambda: Vec<f64> = noise(5).take(n).collect();
        let (mut dx, mut back) = (vec![0.0; n], vec![0.0; z.len()]);
        model.initial_tangent(&dz, &mut dx);
        model.initial_adjoint(&lambda, &mut back);
        let gap = (common::dot(&dx, &lambda) - common::dot(&dz, &back)).abs();
        assert!(gap <= 1e-13 * common::norm(&dx) * common::norm(&lambda), "{}: {gap:e}", case.name);
        assert!(back[..parameters.start].iter().all(|b| *b == 0.0), "{}", case.name);
    }
}

/// Steps from one equilibrium to the next, supports moving.
#[test]
fn tangent_and_adjoint_of_steps_at_rest() {
    for (case, step, z) in at_rest(false) {
        let mut model = ImplicitModel::new(step, 0, 0.01);
        for product in products(&mut model, &z) {
            assert_eq!(product.substeps, 0, "{}", case.name);
            // velocities are differences of places over 0.01 s
            assert_close(case.name, &product.tangent, &product.by_difference, 3e-6);
            assert!(product.gap <= 1e-12, "{}: the transposes differ by {:e}", case.name, product.gap);
        }
    }
}
