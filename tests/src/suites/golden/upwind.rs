//! Linear advection–diffusion on a circle by explicit upwind steps: a model of the twin fixtures.

use varda_implicit::{ControlMap, Error, Model, Work};

/// x_i ← (1 − c − 2ν) x_i + (c + ν) x_{i−1} + ν x_{i+1}, periodic.
pub(super) struct Upwind {
    /// Number of points.
    pub n: usize,
    /// c, the part of a spacing that the field is carried in a step.
    pub courant: f64,
    /// ν, the number of diffusion.
    pub nu: f64,
}

impl Upwind {
    /// y = M x, or y = Mᵀ x where `transposed`.
    fn product(&self, x: &[f64], transposed: bool, y: &mut [f64]) {
        let n = self.n;
        for i in 0..n {
            let (mut before, mut after) = (x[(i + n - 1) % n], x[(i + 1) % n]);
            if transposed {
                std::mem::swap(&mut before, &mut after);
            }
            let stays = 1.0 - self.courant - 2.0 * self.nu;
            y[i] = stays * x[i] + (self.courant + self.nu) * before + self.nu * after;
        }
    }
}

impl Model for Upwind {
    fn dim(&self) -> usize {
        self.n
    }
    fn step(&mut self, _: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        self.product(x, false, x_next);
        Ok(Work::default())
    }
    fn linearize(&mut self, _: usize, _: usize, _: &[f64], _: &[f64]) -> Result<Work, Error> {
        Ok(Work::default())
    }
    fn tangent(&mut self, _: usize, dx: &mut [f64]) {
        let given = dx.to_vec();
        for (given, dx) in given.chunks_exact(self.n).zip(dx.chunks_exact_mut(self.n)) {
            self.product(given, false, dx);
        }
    }
    fn adjoint(&mut self, _: usize, lambda: &mut [f64]) {
        let given = lambda.to_vec();
        for (given, lambda) in given.chunks_exact(self.n).zip(lambda.chunks_exact_mut(self.n)) {
            self.product(given, true, lambda);
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use varda_implicit::check;

    #[test]
    fn a_step_is_the_stated_formula_and_has_its_transpose() {
        let mut model = Upwind { n: 5, courant: 0.5, nu: 0.1 };
        let mut next = [0.0; 5];
        model.step(0, &[1.0, 0.0, 0.0, 0.0, 2.0], &mut next).unwrap();
        let expected = [0.3 + 0.6 * 2.0, 0.6, 0.0, 0.1 * 2.0, 0.3 * 2.0 + 0.1];
        assert!(next.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15), "{next:?}");
        let outcomes = check::conformance(&mut model, 0, &[1.0, -0.3, 0.2, 0.0, 2.0], &[1.0; 5], 3).unwrap();
        assert!(outcomes.iter().all(|o| o.pass), "{outcomes:?}");
    }
}
