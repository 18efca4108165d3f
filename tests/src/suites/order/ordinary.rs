//! Ready-made steps on a pendulum, whose passage through the bottom is known in closed form.

use super::slopes::slope_row;
use crate::row::{Case, Outcome, Rows};
use varda_implicit::{ImplicitModel, Model, OneLeg, Rhs, Rk4, Scheme};

pub(super) fn run(rows: &mut Rows) {
    rows.case("pendulum", pendulum);
}

/// θ̈ = −sin θ.
#[derive(Clone)]
struct Pendulum;

impl Rhs for Pendulum {
    fn dim(&self) -> usize {
        2
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        (f[0], f[1]) = (x[1], -x[0].sin());
    }
    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        (df[0], df[1]) = (dx[1], -x[0].cos() * dx[0]);
    }
    fn adjoint_add(&mut self, _t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= x[0].cos() * lambda[1];
        dx[1] += lambda[0];
    }
}

/// Let go at 2 rad, it is at the bottom after a quarter of its period 2π / agm(1, cos 1) (Gauss), there with
/// the speed that energy gives. Followed for five quarters.
fn pendulum(case: &mut Case) -> Outcome {
    let start = 2.0_f64;
    let (mut a, mut b) = (1.0, (0.5 * start).cos());
    while (a - b).abs() > 1e-15 {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    let end = 1.25 * std::f64::consts::TAU / a;
    let bottom = [0.0, -2.0 * (0.5 * start).sin()];
    let leg = |scheme, h| -> Box<dyn Model> {
        Box::new(ImplicitModel::new(OneLeg::new(Pendulum, scheme, 1e-12), 0, h))
    };
    let rk4 = |h| -> Box<dyn Model> { Box::new(Rk4::new(Pendulum, 0, h)) };
    type Make<'a> = &'a dyn Fn(f64) -> Box<dyn Model>;
    let steps: [(&str, f64, usize, Make); 4] = [
        ("implicit Euler", 1.0, 4000, &|h| leg(Scheme::BackwardEuler, h)),
        ("implicit midpoint", 2.0, 250, &|h| leg(Scheme::Midpoint, h)),
        ("BDF2", 2.0, 1000, &|h| leg(Scheme::Bdf2, h)),
        ("RK4", 4.0, 480, &rk4),
    ];
    for (name, order, first, make) in steps {
        let mut errors = Vec::new();
        for steps in [first, 2 * first, 4 * first] {
            let mut model = make(end / steps as f64);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&[start, 0.0], &mut x)?;
            let mut next = x.clone();
            for k in 0..steps {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
            }
            errors.push((end / steps as f64, (x[0] - bottom[0]).hypot(x[1] - bottom[1])));
        }
        slope_row(case, name, &errors, order);
    }
    Ok(())
}
