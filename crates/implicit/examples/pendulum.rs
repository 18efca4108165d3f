//! A damped pendulum by implicit Euler: where it ends, how that depends on where it starts, and whether to
//! believe it.
#![allow(clippy::print_stdout)]

use varda_implicit::{Error, ImplicitModel, Keep, OneLeg, Rhs, Trajectory, check};

/// φ̈ = −(g/l) sin φ − c φ̇, as x = [φ, φ̇] in rad and rad/s.
struct Pendulum {
    /// g/l [1/s²].
    stiffness: f64,
    /// c [1/s].
    damping: f64,
}

impl Rhs for Pendulum {
    fn dim(&self) -> usize {
        2
    }

    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f[0] = x[1];
        f[1] = -self.stiffness * x[0].sin() - self.damping * x[1];
    }

    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = dx[1];
        df[1] = -self.stiffness * x[0].cos() * dx[0] - self.damping * dx[1];
    }

    fn adjoint_add(&mut self, _t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= self.stiffness * x[0].cos() * lambda[1];
        dx[1] += lambda[0] - self.damping * lambda[1];
    }
}

fn main() -> Result<(), Error> {
    let step = OneLeg::implicit_euler(Pendulum { stiffness: 9.81, damping: 0.2 }, 1e-12);
    let mut model = ImplicitModel::new(step, 0, 0.01);
    let (x0, steps) = ([2.5, 0.0], 300);

    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &x0, steps, Keep::Linearizations)?;
    let end = trajectory.state(steps);
    println!("after 3 s: φ = {:.6} rad, φ̇ = {:.6} rad/s", end[0], end[1]);

    let mut gradient = [0.0; 2];
    trajectory.adjoint(&mut model, &mut gradient, &mut |k, _, lambda| {
        if k == steps {
            lambda[0] += 1.0;
        }
    })?;
    println!(
        "adjoint:   ∂φ(3 s)/∂φ(0) = {:.9}, ∂φ(3 s)/∂φ̇(0) = {:.9} \
        s",
        gradient[0], gradient[1]
    );
    for (component, name) in ["∂φ(3 s)/∂φ(0)", "∂φ(3 s)/∂φ̇(0)"].into_iter().enumerate() {
        let mut dx = [0.0; 2];
        dx[component] = 1.0;
        trajectory.tangent(&mut model, &mut dx, &mut |_, _, _| {})?;
        println!("tangent:   {name} = {:.9}", dx[0]);
    }

    let dot = check::dot_product(&mut model, 0..steps, &[1.0, 3.0], 1)?;
    println!("dot product: {:.1e}, bound {:.1e}", dot.value, dot.bound);
    let mut last = |x0: &[f64]| {
        trajectory.run(&mut model, x0, steps, Keep::States)?;
        Ok(trajectory.state(steps)[0])
    };
    let taylor = check::taylor(&mut last, &gradient, &x0, &[0.01, 0.02])?;
    println!("Taylor slope: {:.3}", taylor.slope);
    Ok(())
}
