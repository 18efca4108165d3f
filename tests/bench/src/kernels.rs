//! The pieces of code that run time is spent in, each ready to be called again and again: for instruction
//! counts and for the harness in benches/kernels.rs.

use super::Result;
use problems::rods::{DrivenRod, HangingRod, wave};
use problems::small_problems::lorenz96_window;
use std::hint::black_box;
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, StrongConstraint};
use varda_covariance::Diagonal;
use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{
    Equations, ImplicitModel, ImplicitStep, Interval, LinearSolver, Model, OneLeg, Rk4, Structure, band,
};
use varda_rod::{RodStep, TwistUnknowns};

/// A kernel.
pub struct Kernel {
    /// What it does.
    pub name: &'static str,
    /// What one call works on, to divide by: segments, variables, columns.
    pub per: (usize, &'static str),
    /// Hands the call to the function it is given, as often as that likes.
    run: fn(&mut dyn FnMut(&mut dyn FnMut())) -> Result<()>,
}

impl Kernel {
    /// Sets the kernel up and hands it to `user`, to be called as often as it likes.
    ///
    /// # Errors
    /// A problem that cannot be set up.
    pub fn with(&self, user: &mut dyn FnMut(&mut dyn FnMut())) -> Result<()> {
        (self.run)(user)
    }
}

/// Calls one kernel `repeats` times.
///
/// # Errors
/// A kernel that does not exist or cannot be set up.
pub fn repeat(name: &str, repeats: usize) -> std::result::Result<(), String> {
    let kernel = KERNELS.iter().find(|k| k.name == name).ok_or(format!("no kernel {name:?}"))?;
    kernel.with(&mut |call| (0..repeats).for_each(|_| call())).map_err(|e| e.to_string())
}

type User<'u> = &'u mut dyn FnMut(&mut dyn FnMut());

const SEGMENTS: (usize, &str) = (25, "segment");

/// All kernels.
pub const KERNELS: &[Kernel] = &[
    Kernel { name: "rod: gradient", per: SEGMENTS, run: |u| assemble(u, TwistUnknowns::WhereNeeded, false) },
    Kernel {
        name: "rod: gradient and Hessian",
        per: SEGMENTS,
        run: |u| assemble(u, TwistUnknowns::WhereNeeded, true),
    },
    Kernel { name: "rod: factor", per: SEGMENTS, run: |u| factor(u, TwistUnknowns::WhereNeeded) },
    Kernel { name: "rod: solve", per: SEGMENTS, run: |u| solve(u, TwistUnknowns::WhereNeeded) },
    Kernel { name: "rod: step", per: SEGMENTS, run: |u| step(u, TwistUnknowns::WhereNeeded) },
    Kernel { name: "rod: linearize", per: SEGMENTS, run: |u| linearize(u, TwistUnknowns::WhereNeeded) },
    Kernel { name: "rod: tangent", per: SEGMENTS, run: |u| tangent(u, TwistUnknowns::WhereNeeded) },
    Kernel { name: "rod: adjoint", per: SEGMENTS, run: |u| adjoint(u, TwistUnknowns::WhereNeeded) },
    Kernel {
        name: "twisting rod: gradient",
        per: SEGMENTS,
        run: |u| assemble(u, TwistUnknowns::Always, false),
    },
    Kernel {
        name: "twisting rod: gradient and Hessian",
        per: SEGMENTS,
        run: |u| assemble(u, TwistUnknowns::Always, true),
    },
    Kernel { name: "twisting rod: factor", per: SEGMENTS, run: |u| factor(u, TwistUnknowns::Always) },
    Kernel { name: "twisting rod: solve", per: SEGMENTS, run: |u| solve(u, TwistUnknowns::Always) },
    Kernel { name: "twisting rod: step", per: SEGMENTS, run: |u| step(u, TwistUnknowns::Always) },
    Kernel { name: "twisting rod: linearize", per: SEGMENTS, run: |u| linearize(u, TwistUnknowns::Always) },
    Kernel { name: "twisting rod: tangent", per: SEGMENTS, run: |u| tangent(u, TwistUnknowns::Always) },
    Kernel { name: "twisting rod: adjoint", per: SEGMENTS, run: |u| adjoint(u, TwistUnknowns::Always) },
    Kernel { name: "band LU, 100 rows, w = 10: factor", per: (100, "row"), run: band_lu },
    Kernel { name: "sparse LU, 100 rows of Burgers: step", per: (100, "variable"), run: burgers },
    Kernel { name: "lorenz96 rk4: step", per: (40, "variable"), run: lorenz96_step },
    Kernel { name: "lorenz96 window: J and gradient", per: (100, "step"), run: lorenz96_gradient },
    Kernel { name: "flagship window: J", per: (100, "step"), run: |u| flagship(u, flagship_value) },
    Kernel {
        name: "flagship window: J and gradient",
        per: (100, "step"),
        run: |u| flagship(u, flagship_gradient),
    },
    Kernel {
        name: "flagship window: Gauss–Newton product",
        per: (100, "step"),
        run: |u| flagship(u, product),
    },
    Kernel { name: "flagship window: dense Hessian", per: (144, "column"), run: |u| flagship(u, hessian) },
];

/// The rod of [`DrivenRod`] in the middle of its motion: model, x_50, x_51.
fn moving(twist: TwistUnknowns) -> Result<(ImplicitModel<RodStep>, Vec<f64>, Vec<f64>)> {
    let (mut model, mut x) = DrivenRod { twist, ..DrivenRod::SOFT }.model(0.02)?;
    let mut next = x.clone();
    for k in 0..50 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    model.step(50, &x, &mut next)?;
    Ok((model, x, next))
}

/// That rod's step, ready to be assembled at u = x_51, with its Hessian.
struct Assembled {
    step: RodStep,
    at: Interval,
    x: Vec<f64>,
    u: Vec<f64>,
    g: Vec<f64>,
    values: Vec<f64>,
    solver: LinearSolver,
}

fn assembled(twist: TwistUnknowns) -> Result<Assembled> {
    let (model, x, next) = moving(twist)?;
    let mut step = model.into_inner();
    let at = Interval { index: 50, start: 1.0, length: 0.02, previous: Some(0.02) };
    let n = step.unknowns();
    let (mut u, mut g) = (vec![0.0; n], vec![0.0; n]);
    step.recover(&at, &x, &next, &mut u);
    let solver = LinearSolver::new(n, &step.structure());
    let mut values = vec![0.0; solver.values_len()];
    step.equations(&at, &x)
        .and_then(|mut equations| equations.assemble(&u, &mut g, Some(&mut values)))
        .map_err(|e| format!("{e:?}"))?;
    Ok(Assembled { step, at, x, u, g, values, solver })
}

fn assemble(user: User, twist: TwistUnknowns, with_hessian: bool) -> Result<()> {
    let Assembled { mut step, at, x, u, mut g, mut values, .. } = assembled(twist)?;
    let mut equations = step.equations(&at, &x).map_err(|e| format!("{e:?}"))?;
    user(&mut || {
        let values = with_hessian.then_some(values.as_mut_slice());
        equations.assemble(black_box(&u), &mut g, values).expect("assembled before");
    });
    Ok(())
}

fn factor(user: User, twist: TwistUnknowns) -> Result<()> {
    let Assembled { mut solver, values, .. } = assembled(twist)?;
    let mut factor = solver.empty_factor();
    solver.factor(&values, &mut factor).map_err(|e| format!("{e:?}"))?;
    user(&mut || {
        solver.factor(black_box(&values), &mut factor).expect("factored before");
    });
    Ok(())
}

fn solve(user: User, twist: TwistUnknowns) -> Result<()> {
    let Assembled { mut solver, values, g, .. } = assembled(twist)?;
    let mut factor = solver.empty_factor();
    solver.factor(&values, &mut factor).map_err(|e| format!("{e:?}"))?;
    let right: Vec<f64> = (0..g.len()).map(|i| wave(i, 1)).collect();
    let mut b = right.clone();
    user(&mut || {
        b.copy_from_slice(&right);
        solver.solve(&factor, black_box(&mut b));
    });
    Ok(())
}

fn step(user: User, twist: TwistUnknowns) -> Result<()> {
    let (mut model, x, mut next) = moving(twist)?;
    user(&mut || drop(model.step(50, black_box(&x), &mut next).expect("stepped before")));
    Ok(())
}

fn linearize(user: User, twist: TwistUnknowns) -> Result<()> {
    let (mut model, x, next) = moving(twist)?;
    model.linearize(50, 50, &x, &next)?;
    user(&mut || drop(model.linearize(50, 50, black_box(&x), &next).expect("linearized before")));
    Ok(())
}

fn tangent(user: User, twist: TwistUnknowns) -> Result<()> {
    let (mut model, x, next) = moving(twist)?;
    model.linearize(50, 50, &x, &next)?;
    let start: Vec<f64> = (0..x.len()).map(|i| wave(i, 1)).collect();
    let mut dx = start.clone();
    user(&mut || {
        dx.copy_from_slice(&start);
        model.tangent(50, black_box(&mut dx));
    });
    Ok(())
}

fn adjoint(user: User, twist: TwistUnknowns) -> Result<()> {
    let (mut model, x, next) = moving(twist)?;
    model.linearize(50, 50, &x, &next)?;
    let start: Vec<f64> = (0..x.len()).map(|i| wave(i, 1)).collect();
    let mut lambda = start.clone();
    user(&mut || {
        lambda.copy_from_slice(&start);
        model.adjoint(50, black_box(&mut lambda));
    });
    Ok(())
}

/// Diagonally dominant, with every entry of the band in use.
fn band_lu(user: User) -> Result<()> {
    let (n, w) = (100, 10);
    let matrix: Vec<f64> = (0..n * (2 * w + 1))
        .map(|i| match (i / (2 * w + 1), i % (2 * w + 1)) {
            (row, p) if row + p < w || row + p >= n + w => 0.0,
            (_, p) if p == w => 2.0 * w as f64,
            _ => wave(i, 2),
        })
        .collect();
    let (mut factor, mut pivots) = (vec![0.0; band::lu_len(n, w)], vec![0; n]);
    user(&mut || {
        band::lu_factor(w, black_box(&matrix), &mut factor, &mut pivots).expect("diagonally dominant");
    });
    Ok(())
}

fn burgers(user: User) -> Result<()> {
    let line = Line { points: 100, length: 1.0, ends: Ends::Periodic };
    let x: Vec<f64> = (0..100).map(|i| (std::f64::consts::TAU * line.position(i)).sin()).collect();
    let mut model =
        ImplicitModel::new(OneLeg::implicit_midpoint(Transport::burgers(line, 0.01), 1e-11), 0, 0.01);
    debug_assert!(matches!(model.step_ref().structure(), Structure::Sparse { .. }));
    let mut next = x.clone();
    user(&mut || drop(model.step(0, black_box(&x), &mut next).expect("a smooth wave")));
    Ok(())
}

fn lorenz96_step(user: User) -> Result<()> {
    let x: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    let mut model = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.01);
    let mut next = x.clone();
    user(&mut || drop(model.step(0, black_box(&x), &mut next).expect("a finite step")));
    Ok(())
}

fn lorenz96_gradient(user: User) -> Result<()> {
    let (background, mut set, mut v) = lorenz96_window(40)?;
    let b = Diagonal::uniform(40, 0.5)?;
    let mut model = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.01);
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(background, &b)?, &mut set)?;
    let mut g = vec![0.0; 40];
    user(&mut || flagship_gradient(&mut cost, &mut v, &mut g));
    Ok(())
}

/// What is called on the cost of the flagship's window, at a v that may be moved; the last is as long as its
/// Hessian.
type OnCost = fn(&mut StrongConstraint, &mut [f64], &mut [f64]);

/// Case 1 of the paper with the prior conditioned on the clamp, at a point of its prior.
fn flagship(user: User, call: OnCost) -> Result<()> {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let observations = rod.observe(&truth, &mut || 0.0)?;
    let mut model = rod.model(rod.first_step)?;
    let mut set = rod.observation_set(model.dim(), observations)?;
    let b = rod.background_covariance()?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(truth, &b)?, &mut set)?;
    let n = cost.dim();
    let mut v: Vec<f64> = (0..n).map(|i| 0.1 * wave(i, 3)).collect();
    let mut out = vec![0.0; n * n];
    cost.evaluate(&v, Some(&mut out[..n]))?;
    user(&mut || call(&mut cost, &mut v, &mut out));
    Ok(())
}

/// A cost keeps what it knows of its last two points: every call needs a new one.
fn moved(v: &mut [f64]) -> &[f64] {
    v[0] += 1e-9;
    v
}

fn flagship_value(cost: &mut StrongConstraint, v: &mut [f64], _: &mut [f64]) {
    black_box(cost.evaluate(moved(v), None).expect("evaluated before"));
}

fn flagship_gradient(cost: &mut StrongConstraint, v: &mut [f64], out: &mut [f64]) {
    let n = v.len();
    black_box(cost.evaluate(moved(v), Some(&mut out[..n])).expect("evaluated before"));
}

fn product(cost: &mut StrongConstraint, v: &mut [f64], out: &mut [f64]) {
    let n = v.len();
    cost.hessian_apply(black_box(v), &mut out[..n]).expect("a gradient came before");
}

fn hessian(cost: &mut StrongConstraint, _: &mut [f64], out: &mut [f64]) {
    cost.hessian(black_box(out)).expect("a gradient came before");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kernel_can_be_called_twice() {
        for kernel in KERNELS {
            let mut calls = 0;
            let twice = &mut |call: &mut dyn FnMut()| {
                for _ in 0..2 {
                    call();
                    calls += 1;
                }
            };
            kernel.with(twice).unwrap();
            assert_eq!(calls, 2, "{}", kernel.name);
        }
        assert!(repeat("no such kernel", 1).is_err());
    }

    #[test]
    fn a_new_point_costs_a_run_every_time() {
        flagship(&mut |call| (0..3).for_each(|_| call()), |cost, v, out| {
            let before = cost.counts().forward_runs;
            flagship_value(cost, v, out);
            assert_eq!(cost.counts().forward_runs, before + 1);
        })
        .unwrap();
    }
}
