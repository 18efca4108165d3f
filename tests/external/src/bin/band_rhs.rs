//! Heat along a rod: a right-hand side with a band and without a Jacobian of its own, by implicit steps.

use varda_implicit::{ImplicitModel, Keep, OneLeg, Rhs, Structure, Trajectory, check};

/// u̇_i = (u_{i−1} − 2 u_i + u_{i+1})/h² − u_i³ with u = 0 beyond both ends.
struct Heat {
    points: usize,
}

impl Heat {
    fn h2(&self) -> f64 {
        (1.0 / (self.points as f64 + 1.0)).powi(2)
    }

    /// The sum of the neighbours of point i.
    fn beside(u: &[f64], i: usize) -> f64 {
        (if i > 0 { u[i - 1] } else { 0.0 }) + u.get(i + 1).unwrap_or(&0.0)
    }
}

impl Rhs for Heat {
    fn dim(&self) -> usize {
        self.points
    }
    fn structure(&self) -> Structure {
        Structure::tridiagonal()
    }
    fn eval(&mut self, _t: f64, u: &[f64], f: &mut [f64]) {
        for i in 0..u.len() {
            f[i] = (Self::beside(u, i) - 2.0 * u[i]) / self.h2() - u[i].powi(3);
        }
    }
    fn tangent(&mut self, _t: f64, u: &[f64], du: &[f64], df: &mut [f64]) {
        for i in 0..u.len() {
            df[i] = (Self::beside(du, i) - 2.0 * du[i]) / self.h2() - 3.0 * u[i] * u[i] * du[i];
        }
    }
    fn adjoint_add(&mut self, _t: f64, u: &[f64], lambda: &[f64], du: &mut [f64]) {
        for i in 0..u.len() {
            du[i] += (Self::beside(lambda, i) - 2.0 * lambda[i]) / self.h2() - 3.0 * u[i] * u[i] * lambda[i];
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let u0: Vec<f64> = (0..200).map(|i| (f64::from(i) * 0.1).sin()).collect();
    let mut model = ImplicitModel::new(OneLeg::implicit_midpoint(Heat { points: 200 }, 1e-11), 0, 0.01);
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &u0, 20, Keep::Linearizations)?;
    let iterations = trajectory.log().counts.newton_iterations;
    println!("{iterations} Newton iterations for 20 steps");
    assert!(iterations <= 4 * 20, "Newton converges quadratically: {iterations}");
    let all_pass = check::conformance(&mut model, 0, &u0, &[1.0; 200], 1)?.iter().all(|o| o.pass);
    assert!(all_pass, "the tangent is the derivative, the adjoint its transpose");
    Ok(())
}
