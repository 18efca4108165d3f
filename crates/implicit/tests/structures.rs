//! Jacobians made from tangents, in every layout, and those that disagree with them.

use varda_implicit::{Error, ImplicitModel, Keep, Model, OneLeg, Rhs, Structure, Trajectory, check};

const N: usize = 12;

/// ẋ_i = 20 (x_{i−1} − 2 x_i + x_{i+1}) − x_i³, on a line with x = 0 beyond its ends or on a ring.
struct Diffusion {
    ring: bool,
    structure: Structure,
    /// What the Jacobian adds to its entry (3, 4); `None` where there is no Jacobian.
    jacobian: Option<f64>,
}

impl Diffusion {
    fn neighbours(&self, i: usize) -> impl Iterator<Item = usize> + use<> {
        let ring = self.ring;
        let before = if i > 0 { Some(i - 1) } else { ring.then_some(N - 1) };
        let after = if i + 1 < N { Some(i + 1) } else { ring.then_some(0) };
        before.into_iter().chain(after)
    }

    fn entry(&self, x: &[f64], i: usize, j: usize) -> f64 {
        let own = if i == j { -40.0 - 3.0 * x[i] * x[i] } else { 0.0 };
        own + 20.0 * self.neighbours(i).filter(|&k| k == j).count() as f64
    }
}

impl Rhs for Diffusion {
    fn dim(&self) -> usize {
        N
    }
    fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) {
        for i in 0..N {
            f[i] = -40.0 * x[i] - x[i].powi(3) + 20.0 * self.neighbours(i).map(|j| x[j]).sum::<f64>();
        }
    }
    fn tangent(&mut self, _: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        for i in 0..N {
            let spread = 20.0 * self.neighbours(i).map(|j| dx[j]).sum::<f64>();
            df[i] = (-40.0 - 3.0 * x[i] * x[i]) * dx[i] + spread;
        }
    }
    fn adjoint_add(&mut self, _: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        for i in 0..N {
            let spread = 20.0 * self.neighbours(i).map(|j| lambda[j]).sum::<f64>();
            dx[i] += (-40.0 - 3.0 * x[i] * x[i]) * lambda[i] + spread;
        }
    }
    fn structure(&self) -> Structure {
        self.structure.clone()
    }
    fn jacobian(&mut self, _: f64, x: &[f64], values: &mut [f64]) -> bool {
        let Some(wrong) = self.jacobian else { return false };
        let entry = |i, j| self.entry(x, i, j) + if (i, j) == (3, 4) { wrong } else { 0.0 };
        values.copy_from_slice(&self.structure.values(N, entry));
        true
    }
}

/// All pairs of neighbours, and the diagonal.
fn pairs(ring: bool) -> Structure {
    let of = |i: usize| [(i, i), (i, (i + 1) % N), ((i + 1) % N, i)];
    let pairs = (0..N).flat_map(of).filter(|&(i, j)| ring || i.abs_diff(j) <= 1);
    Structure::from_pairs(N, pairs).unwrap()
}

fn layouts() -> Vec<(bool, Structure)> {
    vec![
        (false, Structure::Dense),
        (false, Structure::tridiagonal()),
        (false, Structure::Band { half_bandwidth: 3 }),
        (false, Structure::SymmetricBand { half_bandwidth: 1 }),
        (false, pairs(false)),
        (true, Structure::Dense),
        (true, Structure::periodic_band(N, 1)),
        (true, pairs(true)),
    ]
}

fn model(ring: bool, structure: &Structure, jacobian: Option<f64>) -> ImplicitModel<OneLeg<Diffusion>> {
    let rhs = Diffusion { ring, structure: structure.clone(), jacobian };
    ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-12), 0, 0.05)
}

fn start() -> Vec<f64> {
    (0..N).map(|i| 1.0 + (0.9 * i as f64).sin()).collect()
}

#[test]
fn a_jacobian_made_from_tangents_is_as_good_as_one_that_is_given() {
    for (ring, structure) in layouts() {
        let run = |jacobian| {
            let mut model = model(ring, &structure, jacobian);
            let mut trajectory = Trajectory::new();
            trajectory.run(&mut model, &start(), 20, Keep::Linearizations).unwrap();
            (trajectory.state(20).to_vec(), trajectory.log().counts)
        };
        let ((given, given_counts), (made, made_counts)) = (run(Some(0.0)), run(None));
        assert_eq!(given_counts, made_counts, "{structure:?}");
        assert!(given_counts.factorizations < 20 * 8, "{given_counts:?}");
        // the tangent of a band with its neighbours in another order: rounding
        assert!(given.iter().zip(&made).all(|(a, b)| (a - b).abs() <= 1e-13), "{structure:?}");
        let mut model = model(ring, &structure, None);
        let direction: Vec<f64> = (0..N).map(|i| (1.3 * i as f64).cos()).collect();
        let taylor = check::taylor_step(&mut model, 2, &start(), &direction, &[1.0; N]).unwrap();
        assert!((taylor.slope - 2.0).abs() <= 0.05, "{structure:?}: {}", taylor.slope);
        let window = check::window(&mut model, &start(), 10, &[1.0; N], 1).unwrap();
        assert!(window.pass, "{structure:?}: {window:?}");
    }
}

#[test]
fn one_wrong_entry_of_a_jacobian_is_an_error_at_the_first_step() {
    for (ring, structure) in layouts() {
        // a symmetric band holds its lower triangle only
        if matches!(structure, Structure::SymmetricBand { .. }) {
            continue;
        }
        let mut model = model(ring, &structure, Some(1e-3));
        let error = model.step(0, &start(), &mut [0.0; N]).unwrap_err();
        let Error::JacobianDisagrees { step: 0, row: 3, .. } = error else {
            panic!("{structure:?}: {error}")
        };
    }
}

#[test]
fn a_structure_that_leaves_out_an_entry_is_an_error_at_the_first_step() {
    for (ring, structure) in [
        (true, Structure::tridiagonal()),
        (true, pairs(false)),
        (false, {
            let diagonal = (0..N).map(|i| (i, i));
            Structure::from_pairs(N, diagonal).unwrap()
        }),
    ] {
        let mut model = model(ring, &structure, None);
        let error = model.step(7, &start(), &mut [0.0; N]).unwrap_err();
        assert!(matches!(error, Error::JacobianDisagrees { step: 7, .. }), "{structure:?}: {error}");
    }
}

#[test]
fn what_no_step_can_be_made_of_is_refused_at_construction() {
    use std::panic::catch_unwind;
    use varda_implicit::lorenz::Lorenz63;
    for tolerance in [0.0, -1e-9, f64::NAN, f64::INFINITY] {
        let made = catch_unwind(|| OneLeg::implicit_euler(Lorenz63::default(), tolerance));
        assert!(made.is_err(), "{tolerance}");
    }
    for (columns, rows) in
        [(vec![0; N], vec![]), ((0..=N).collect(), vec![N; N]), ((0..=N).rev().collect(), (0..N).collect())]
    {
        let structure = Structure::Sparse { columns, rows };
        let made = catch_unwind(|| model(false, &structure, None));
        let message = made.err().and_then(|error| error.downcast_ref::<String>().cloned());
        assert!(message.as_ref().is_some_and(|m| m.contains("structure of")), "{structure:?}: {message:?}");
    }
}
