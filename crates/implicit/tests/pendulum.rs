//! A stiff spring pendulum by backward Euler on positions, with its incremental potential: tangent and adjoint through
//! whole and halved steps.

use varda_implicit::{ImplicitModel, ImplicitStep, Interval, Model, Refusal, Structure};

struct Spring {
    stiffness: f64,
}

impl ImplicitStep for Spring {
    fn dim(&self) -> usize {
        4
    }
    fn unknowns(&self) -> usize {
        2
    }
    fn structure(&self) -> Structure {
        Structure::SymmetricBand { half_bandwidth: 1 }
    }
    fn predict(&mut self, at: &Interval, x: &[f64], u: &mut [f64]) -> Result<(), Refusal> {
        for i in 0..2 {
            u[i] = x[i] + at.length * x[2 + i];
        }
        Ok(())
    }
    fn assemble(
        &mut self,
        at: &Interval,
        x: &[f64],
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let h = at.length;
        let r = u[0].hypot(u[1]);
        let (e, k) = ([u[0] / r, u[1] / r], self.stiffness);
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
            j.copy_from_slice(&[0.0, entry(0, 0), entry(1, 0), entry(1, 1)]);
        }
        Ok(Some(phi))
    }
    fn converged_below(&self) -> f64 {
        1e-11
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
    fn previous(&mut self, at: &Interval, _: &[f64], _: &[f64], dx: &[f64], dg: &mut [f64]) {
        let h = at.length;
        for i in 0..2 {
            dg[i] = -(dx[i] + h * dx[2 + i]) / (h * h);
        }
    }
    fn previous_transpose_add(&mut self, at: &Interval, _: &[f64], _: &[f64], mu: &[f64], dx: &mut [f64]) {
        let h = at.length;
        for i in 0..2 {
            dx[i] -= mu[i] / (h * h);
            dx[2 + i] -= mu[i] / h;
        }
    }
    fn advance_tangent(
        &mut self,
        at: &Interval,
        _: &[f64],
        _: &[f64],
        dx: &[f64],
        du: &[f64],
        dx_next: &mut [f64],
    ) {
        for i in 0..2 {
            dx_next[i] = du[i];
            dx_next[2 + i] = (du[i] - dx[i]) / at.length;
        }
    }
    fn advance_adjoint(
        &mut self,
        at: &Interval,
        _: &[f64],
        _: &[f64],
        lambda: &[f64],
        dx: &mut [f64],
        du: &mut [f64],
    ) {
        dx.fill(0.0);
        for i in 0..2 {
            du[i] = lambda[i] + lambda[2 + i] / at.length;
            dx[i] = -lambda[2 + i] / at.length;
        }
    }
}

#[test]
fn adjoint_is_the_transpose_over_a_window() {
    let mut model = ImplicitModel::new(Spring { stiffness: 1e4 }, 0, 0.02);
    let mut states = vec![vec![0.8, -0.5, 0.3, 0.9]];
    for k in 0..50 {
        let mut next = vec![0.0; 4];
        model.step(k, &states[k], &mut next).unwrap();
        states.push(next);
    }
    for k in 0..50 {
        model.linearize(k, &states[k], &states[k + 1]).unwrap();
    }
    let (dx0, lambda0) = ([0.1, -0.2, 0.3, 0.4], [0.7, 0.2, -0.1, 0.5]);
    let (mut dx, mut lambda) = (dx0, lambda0);
    (0..50).for_each(|k| model.tangent(k, &mut dx));
    (0..50).rev().for_each(|k| model.adjoint(k, &mut lambda));
    let dot = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (left, right) = (dot(&dx, &lambda0), dot(&dx0, &lambda));
    assert!(left.abs() > 1e-6 && (left - right).abs() <= 1e-12 * left.abs().max(1.0), "{left} {right}");
    assert!(model.warnings().is_empty(), "{:?}", model.warnings());
}
