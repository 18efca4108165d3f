//! The checks themselves: what they refuse, and what they must not let pass.

use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{
    ControlMap, Error, ImplicitModel, Log, Model, OneLeg, Rhs, Rk4, Structure, Work, check,
};
use varda_linalg::check::Random;

/// A model given by its three functions.
struct Toy {
    step: fn(&[f64], &mut [f64]),
    tangent: fn(&mut [f64]),
    adjoint: fn(&mut [f64]),
}

impl Model for Toy {
    fn dim(&self) -> usize {
        2
    }
    fn step(&mut self, _: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        (self.step)(x, x_next);
        Ok(Work::default())
    }
    fn linearize(&mut self, _: usize, _: usize, _: &[f64], _: &[f64]) -> Result<Work, Error> {
        Ok(Work::default())
    }
    fn tangent(&mut self, _: usize, dx: &mut [f64]) {
        dx.chunks_exact_mut(2).for_each(self.tangent);
    }
    fn adjoint(&mut self, _: usize, lambda: &mut [f64]) {
        lambda.chunks_exact_mut(2).for_each(self.adjoint);
    }
    fn release(&mut self, _: usize) {}
    fn slot_bytes(&self) -> usize {
        0
    }
    fn bytes(&self) -> usize {
        0
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }
}

/// x ← (x₀ + 2 x₁, 3 x₁).
const LINEAR: Toy = Toy {
    step: |x, next| next.copy_from_slice(&[x[0] + 2.0 * x[1], 3.0 * x[1]]),
    tangent: |d| d.copy_from_slice(&[d[0] + 2.0 * d[1], 3.0 * d[1]]),
    adjoint: |l| l.copy_from_slice(&[l[0], 2.0 * l[0] + 3.0 * l[1]]),
};

#[test]
fn a_linear_model_conforms_with_an_infinite_slope() {
    let outcomes = check::conformance(&mut { LINEAR }, 0, &[1.0, 2.0], &[1.0, 1.0], 1).unwrap();
    assert!(outcomes.iter().all(|o| o.pass), "{outcomes:?}");
    let taylor = check::taylor_step(&mut { LINEAR }, 0, &[1.0, 2.0], &[0.3, 0.4], &[1.0, 1.0]).unwrap();
    assert_eq!(taylor.slope, f64::INFINITY);
}

#[test]
fn every_fault_is_caught_by_the_check_made_for_it() {
    let faults = [
        ("adjoint", Toy { adjoint: |l| l.copy_from_slice(&[l[0], -2.0 * l[0] + 3.0 * l[1]]), ..LINEAR }),
        (
            "Taylor",
            Toy { step: |x, next| next.copy_from_slice(&[x[0] + 2.001 * x[1], 3.0 * x[1]]), ..LINEAR },
        ),
        ("M 0", Toy { tangent: |d| d.copy_from_slice(&[d[0] + 2.0 * d[1], 3.0 * d[1] + 1e-300]), ..LINEAR }),
        (
            "linearity",
            Toy { tangent: |d| d.copy_from_slice(&[d[0] + 2.0 * d[1].abs(), 3.0 * d[1]]), ..LINEAR },
        ),
    ];
    for (what, mut toy) in faults {
        let outcomes = check::conformance(&mut toy, 0, &[1.0, 2.0], &[1.0, 1.0], 1).unwrap();
        assert!(outcomes.iter().any(|o| o.what.contains(what) && !o.pass), "{what}: {outcomes:?}");
    }
}

#[test]
fn empty_tests_are_refused() {
    let dead = Toy { tangent: |d| d.fill(0.0), adjoint: |l| l.fill(0.0), ..LINEAR };
    assert!(matches!(check::dot_product(&mut { dead }, 0..1, &[1.0; 2], 1), Err(Error::EmptyTest { .. })));
    let compare =
        |dx: [f64; 2], m_dx: [f64; 2]| check::compare(&dx, &m_dx, &[1.0; 2], &[1.0; 2], 1.0, [&[1.0; 2]; 2]);
    assert!(compare([1.0, 2.0], [2.0, 1.0]).unwrap().pass);
    assert!(matches!(compare([0.0; 2], [1.0; 2]), Err(Error::EmptyTest { .. })));
    assert!(matches!(compare([1.0; 2], [0.0; 2]), Err(Error::EmptyTest { .. })));
    assert!(matches!(compare([1.0; 2], [1e-12; 2]), Err(Error::EmptyTest { .. })));
    let nan = compare([f64::NAN, 1.0], [1.0; 2]).map(|d| d.pass);
    assert!(!matches!(nan, Ok(true)));
    let constant = check::taylor(&mut |_| Ok(3.0), &[0.0], &[1.0], &[1.0]);
    assert!(matches!(constant, Err(Error::EmptyTest { .. })));
}

#[test]
fn outputs_of_another_length_have_their_own_scale() {
    // M = (0 0; 0 0; 3 4) from two components to three, λ along the last: everything happens beyond the
    // length of the input.
    let (dx, lambda) = ([2.0, 1.0], [0.0, 0.0, 5.0]);
    let (m_dx, mt_lambda) = ([0.0, 0.0, 10.0], [15.0, 20.0]);
    let scales: [&[f64]; 2] = [&[1.0; 2], &[1.0, 1.0, 4.0]];
    let test = check::compare(&dx, &m_dx, &lambda, &mt_lambda, 10.0, scales).unwrap();
    assert!(test.pass && test.forward == 50.0 && test.backward == 50.0, "{test:?}");
    // ‖M‖ ‖dx‖ / ‖M dx‖ with ‖M dx‖ = 10 / 4; the rounding of a square root
    assert!((test.condition - 10.0 * 5.0_f64.sqrt() / 2.5).abs() <= 1e-14, "{test:?}");
    // |50 − 60| / (10/4 · 5·4)
    let wrong = check::compare(&dx, &m_dx, &lambda, &[20.0, 20.0], 10.0, scales).unwrap();
    assert!(!wrong.pass && (wrong.value - 0.2).abs() <= 1e-15, "{wrong:?}");
    let one_scale = [scales[0]; 2];
    let mixed = || check::compare(&dx, &m_dx, &lambda, &mt_lambda, 10.0, one_scale);
    assert!(std::panic::catch_unwind(mixed).is_err());
}

#[test]
fn taylor_slopes_tell_right_gradients_from_wrong_ones() {
    let mut function = |x: &[f64]| Ok((x[0] * x[1]).exp() + x[1].powi(3));
    let x: [f64; 2] = [0.4, 0.7];
    let e = (x[0] * x[1]).exp();
    let gradient = [x[1] * e, x[0] * e + 3.0 * x[1] * x[1]];
    let right = check::taylor(&mut function, &gradient, &x, &[1.0, -0.5]).unwrap();
    assert!(right.pass && (right.slope - 2.0).abs() <= 0.05, "{right:?}");
    // the smaller the error the smaller the steps at which it shows; one in 10⁵ still does
    for error in [1.0, 1e-3, 1e-5] {
        let wrong =
            check::taylor(&mut function, &[gradient[0] * (1.0 + error), gradient[1]], &x, &[1.0, -0.5]);
        assert!(!wrong.unwrap().pass, "{error}");
    }
    // a failing function is no passed test
    let failing =
        check::taylor(&mut |_| Err(Error::NonFinite { step: 0, what: "x" }), &gradient, &x, &[1.0, 0.0]);
    assert!(failing.is_err());
}

/// A stiff decay towards a moving point with f beyond reach of explicit steps, no potential: Van der Pol,
/// μ = 1000.
#[derive(Clone)]
struct VanDerPol;

impl Rhs for VanDerPol {
    fn dim(&self) -> usize {
        2
    }
    fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) {
        f.copy_from_slice(&[x[1], 1000.0 * (1.0 - x[0] * x[0]) * x[1] - x[0]]);
    }
    fn tangent(&mut self, _: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        let m = 1000.0;
        df.copy_from_slice(&[
            dx[1],
            -(2.0 * m * x[0] * x[1] + 1.0) * dx[0] + m * (1.0 - x[0] * x[0]) * dx[1],
        ]);
    }
    fn adjoint_add(&mut self, _: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        let m = 1000.0;
        dx[0] -= (2.0 * m * x[0] * x[1] + 1.0) * l[1];
        dx[1] += l[0] + m * (1.0 - x[0] * x[0]) * l[1];
    }
}

#[test]
fn stiff_steps_without_a_potential_go_through_the_contraction_test() {
    // over the jumps of the relaxation cycle, which last about 1/μ, with steps fifty times as long
    let mut model = ImplicitModel::new(OneLeg::implicit_euler(VanDerPol, 1e-10), 0, 0.05);
    let mut x = vec![2.0, 0.0];
    let (mut turns, mut log) = (0, Log::default());
    for k in 0..36_000 {
        let mut next = vec![0.0; 2];
        log.step(k, model.step(k, &x, &mut next).unwrap());
        assert!(next[0].abs() <= 2.1, "{next:?}");
        turns += usize::from(next[0] * x[0] < 0.0);
        x = next;
    }
    // a turn takes (3 − 2 ln 2) μ/2 = 807 s and less where a long step lands short of the slow branch: two
    // at least. The jumps themselves have no root near the guess, and are halved.
    assert!(turns >= 2 && log.counts.substeps > 0, "{turns} {:?}", log.counts);
    assert!(log.warnings.len() < 40, "{:?}", log.warnings);
    let window = check::window(&mut model, &[2.0, 0.0], 100, &[1.0, 1e-3], 3).unwrap();
    assert!(window.pass, "{window:?}");
}

#[test]
fn a_mutated_right_hand_side_fails_the_conformance_of_its_models() {
    /// Lorenz 63 with one wrong sign in the tangent.
    #[derive(Clone)]
    struct Mutated(Lorenz63);
    impl Rhs for Mutated {
        fn dim(&self) -> usize {
            3
        }
        fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
            self.0.eval(t, x, f);
        }
        fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
            self.0.tangent(t, x, dx, df);
            df[1] += 2.0 * dx[1];
        }
        fn adjoint_add(&mut self, t: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
            self.0.adjoint_add(t, x, l, dx);
        }
    }
    let mut model = Rk4::new(Mutated(Lorenz63::default()), 0, 0.01);
    let outcomes = check::conformance(&mut model, 0, &[1.0, 3.0, 20.0], &[1.0; 3], 1).unwrap();
    let failed = |what: &str| outcomes.iter().any(|o| o.what.contains(what) && !o.pass);
    assert!(failed("dot product") && failed("Taylor"), "{outcomes:?}");
}

/// A window of Lorenz-63, and ‖M‖ by the singular values of the matrix.
#[test]
fn amplification_is_the_norm_of_the_window_to_a_factor() {
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let mut states = vec![-4.3, -5.0, 20.0];
    for k in 0..4000 {
        let mut next = vec![0.0; 3];
        model.step(k, &states[3 * k..], &mut next).unwrap();
        states.extend(next);
    }
    for steps in [10, 400, 1200, 4000] {
        let seen = &states[..3 * (steps + 1)];
        let mut squares = 0.0;
        for i in 0..3 {
            let mut dx = [0.0; 3];
            dx[i] = 1.0;
            for (k, pair) in seen.windows(6).step_by(3).enumerate() {
                model.linearize(0, k, &pair[..3], &pair[3..]).unwrap();
                model.tangent(0, &mut dx);
            }
            squares += dx.iter().map(|d| d * d).sum::<f64>();
        }
        let mut random = Random(3);
        let mut sign = || random.draw().signum();
        let found = check::amplification(&mut model, &states[..3], &[1.0; 3], seen, &mut sign).unwrap();
        // four draws of at most three directions
        let factor = found.norm / squares.sqrt();
        assert!((0.4..2.0).contains(&factor), "{steps}: {factor}");
        assert_eq!(found.reliable, steps < 4000, "{found:?}");
        assert_eq!(found.warning().is_some_and(|w| w.contains("shorten the window")), steps == 4000);
    }
}

#[test]
fn units_of_an_amplification_do_not_matter_and_an_overflow_is_flagged() {
    let states = [1.0, 2.0, 3.0, 1.0, 2.0, 3.0];
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let mut of = |sigma: [f64; 3]| {
        let mut random = Random(3);
        let mut sign = || random.draw().signum();
        check::amplification(&mut model, &states[..3], &sigma, &states, &mut sign).unwrap()
    };
    let [one, thousand] = [of([1.0; 3]), of([1e3; 3])];
    assert!((one.norm - thousand.norm).abs() < 1e-12 * one.norm && one.reliable);
    let overflown = of([1e300, 1e-300, 1.0]);
    assert!(!overflown.reliable && overflown.warning().is_some(), "{overflown:?}");
}

/// x_{k+1} = c_k x_k (1 − 0.1 x_k) with c_0 = 0.9 and c_k = 0.8 after; the control is z = ln x₀.
struct Decay {
    z: f64,
    /// Steps k > 0 taken.
    later: i32,
    slopes: Vec<f64>,
    fault: Fault,
}

#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    InitialAdjoint,
    InitialTangent,
    ManyColumns,
    /// c_0 in the tangent and the adjoint of every step.
    LaterSteps,
    /// One linearization for all slots.
    OneSlot,
    /// Products with slot 0, whichever is asked for.
    FirstSlot,
    /// All slots released, whichever is asked for.
    ReleasesAll,
    /// A step that knows how many were taken.
    Memory,
}

impl Model for Decay {
    fn dim(&self) -> usize {
        1
    }
    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        x_next[0] = if k == 0 { 0.9 } else { 0.8 } * x[0] * (1.0 - 0.1 * x[0]);
        self.later += i32::from(k > 0);
        if self.fault == Fault::Memory && k == 0 {
            x_next[0] += 1e-9 * f64::from(self.later);
        }
        Ok(Work::default())
    }
    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], _: &[f64]) -> Result<Work, Error> {
        let c = if k == 0 || self.fault == Fault::LaterSteps { 0.9 } else { 0.8 };
        self.slopes.resize(self.slopes.len().max(slot + 1), 0.0);
        let slot = if self.fault == Fault::OneSlot { 0 } else { slot };
        self.slopes[slot] = c * (1.0 - 0.2 * x[0]);
        Ok(Work::default())
    }
    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        let off = if self.fault == Fault::ManyColumns && dx.len() > 1 { 3.0 } else { 1.0 };
        let slot = if self.fault == Fault::FirstSlot { 0 } else { slot };
        dx.iter_mut().for_each(|d| *d *= off * self.slopes[slot]);
    }
    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        let slot = if self.fault == Fault::FirstSlot { 0 } else { slot };
        lambda.iter_mut().for_each(|l| *l *= self.slopes[slot]);
    }
    fn release(&mut self, from_slot: usize) {
        if self.fault == Fault::ReleasesAll {
            self.slopes.fill(0.0);
        }
        self.slopes.truncate(from_slot);
    }
    fn slot_bytes(&self) -> usize {
        8
    }
    fn bytes(&self) -> usize {
        8 * self.slopes.len()
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        Some(self)
    }
}

impl ControlMap for Decay {
    fn control_len(&self) -> usize {
        1
    }
    fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        (self.z, x[0]) = (z[0], z[0].exp());
        Ok(())
    }
    fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        dx[0] = if self.fault == Fault::InitialTangent { dz[0] } else { self.z.exp() * dz[0] };
    }
    fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        dz[0] = if self.fault == Fault::InitialAdjoint { lambda[0] } else { self.z.exp() * lambda[0] };
    }
}

#[test]
fn every_part_of_a_model_is_checked() {
    let check = |fault| {
        let mut decay = Decay { z: 0.0, later: 0, slopes: Vec::new(), fault };
        check::model(&mut decay, &[0.5], 3, &[1.0], 1).unwrap()
    };
    let right = check(Fault::None);
    assert!(right.passed(), "{right}");
    for (fault, what) in [
        (Fault::InitialAdjoint, "dot product of its adjoint"),
        (Fault::InitialTangent, "Taylor slope of its tangent"),
        (Fault::ManyColumns, "three columns"),
        (Fault::LaterSteps, "step 2: tangent: 2 − Taylor slope"),
        (Fault::OneSlot, "that slot 1 changes"),
        (Fault::FirstSlot, "others in slot 1"),
        (Fault::ReleasesAll, "releasing"),
        (Fault::Memory, "a step elsewhere"),
    ] {
        let report = check(fault);
        assert!(report.failed().any(|f| f.what.contains(what)), "{what} is not in\n{report}");
    }
    let mut decay = Decay { z: 0.0, later: 0, slopes: Vec::new(), fault: Fault::None };
    assert!(matches!(check::model(&mut decay, &[0.5], 1, &[1.0], 1), Err(Error::EmptyTest { .. })));
    assert!(!check::Report::default().passed());
}

/// ẋ = (x₁, −sin x₀) with a mistake in one of its parts.
struct Pendulum(&'static str);

impl Rhs for Pendulum {
    fn dim(&self) -> usize {
        2
    }
    fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) {
        (f[0], f[1]) = (x[1], -x[0].sin());
    }
    fn tangent(&mut self, _: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        let off = if self.0 == "tangent" { 1.001 } else { 1.0 };
        (df[0], df[1]) = (dx[1], -off * x[0].cos() * dx[0]);
    }
    fn adjoint_add(&mut self, _: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        let off = if self.0 == "adjoint" { 1.001 } else { 1.0 };
        dx[0] -= off * x[0].cos() * l[1];
        dx[1] += l[0];
    }
    fn adjoint(&mut self, t: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        dx.fill(if self.0 == "adjoint_add" { 1e-3 } else { 0.0 });
        self.adjoint_add(t, x, l, dx);
    }
    fn structure(&self) -> Structure {
        match self.0 {
            "structure" => Structure::from_pairs(2, [(0, 1), (1, 0)]).unwrap(),
            _ => Structure::Dense,
        }
    }
    fn jacobian(&mut self, _: f64, x: &[f64], values: &mut [f64]) -> bool {
        values.copy_from_slice(&[0.0, -x[0].cos(), if self.0 == "jacobian" { 1.001 } else { 1.0 }, 0.0]);
        self.0 != "structure"
    }
}

#[test]
fn every_part_of_a_right_hand_side_is_checked() {
    let check = |part| check::rhs(&mut Pendulum(part), 0.0, &[0.7, 0.4], &[1.0; 2], 3).unwrap();
    assert!(check("").passed(), "{}", check(""));
    for part in ["tangent", "adjoint", "adjoint_add", "structure", "jacobian"] {
        let report = check(part);
        assert!(report.failed().any(|f| f.what.contains(part)), "{part} is not in\n{report}");
    }
}

/// Diffusion on a fine grid: entries of (∂f/∂x)ᵀ λ are differences of terms many thousand times as
/// large.
#[test]
fn cancelling_terms_of_an_adjoint_are_no_fault() {
    use varda_implicit::line::{Ends, Line, Transport};
    for ends in [Ends::Periodic, Ends::Fixed { left: 0.0, right: 1.0 }] {
        let line = Line { points: 2000, length: 1.0, ends };
        let u: Vec<f64> = (0..2000).map(|i| 1.0 + (0.01 * i as f64).sin()).collect();
        let report = check::rhs(&mut Transport::burgers(line, 1.0), 0.0, &u, &[1e-3; 2000], 5).unwrap();
        assert!(report.passed(), "{report}");
    }
}
