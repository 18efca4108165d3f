//! Flame fronts and films along a circle: the Kuramoto–Sivashinsky equation.

#[cfg(feature = "implicit")]
use crate::{ImplicitModel, OneLeg, Scheme};
use crate::{Model, ParametricRhs, Rhs, Rk4, Structure};

/// A field on a circle that long waves feed, short ones damp, and transport by itself ties together: chaotic
/// in space and time where the circle is long.
///
/// ```text
/// ∂u/∂t = −u ∂u/∂s − ∂²u/∂s² − ∂⁴u/∂s⁴,   0 ≤ s < L
/// u̇_i = −ū_i (u_{i+1} − u_{i−1})/2h − (u_{i−1} − 2u_i + u_{i+1})/h²
///        − (u_{i−2} − 4u_{i−1} + 6u_i − 4u_{i+1} + u_{i+2})/h⁴
/// ū_i = (u_{i−1} + u_i + u_{i+1})/3,   h = L/n
/// ```
///
/// (Kuramoto and Tsuzuki 1976; Sivashinsky 1977.) Small waves of wave number q grow at q² − q⁴: those
/// longer than 2π. Differences are centred, of second order; Σ u stays what it is, and so does Σ u² under
/// transport alone. [`Rk4`] needs Δt ≲ 0.17 h⁴; implicit steps have no limit, and their Jacobian is
/// sparse: five values in a row, four rows of them in the corners.
///
/// ```
/// use varda_implicit::{Keep, Scheme, Trajectory};
/// use varda_implicit::kuramoto::KuramotoSivashinsky;
///
/// let fronts = KuramotoSivashinsky::new(128, 32.0 * std::f64::consts::PI);
/// let u0: Vec<f64> = (0..128).map(|i| (0.3 * fronts.position(i)).cos()).collect();
/// let mut run = Trajectory::new();
/// run.run(fronts.implicit(Scheme::Midpoint, 1e-11, 0, 0.25).as_mut(), &u0, 800, Keep::States)?;
/// let rms = (run.state(800).iter().map(|u| u * u).sum::<f64>() / 128.0).sqrt();
/// assert!(rms > 0.5 && rms < 3.0, "{rms}"); // on its attractor
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KuramotoSivashinsky {
    points: usize,
    length: f64,
}

/// Values of a row, and where the first of them stands before the diagonal.
const WIDTH: usize = 5;

impl KuramotoSivashinsky {
    /// On a circle of this length, seen at so many points.
    ///
    /// # Panics
    /// For less than five points, or a length that is not positive and finite.
    pub fn new(points: usize, length: f64) -> Self {
        assert!(points >= WIDTH, "a fourth derivative needs {WIDTH} points, not {points}");
        assert!(length > 0.0 && length.is_finite(), "a circle needs a length, not {length}");
        Self { points, length }
    }

    /// h.
    pub fn spacing(&self) -> f64 {
        self.length / self.points as f64
    }

    /// s_i.
    pub fn position(&self, i: usize) -> f64 {
        i as f64 * self.spacing()
    }

    /// The model of this equation by [`Rk4`], compiled in this crate.
    ///
    /// # Panics
    /// As [`Rk4::new`].
    pub fn rk4(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(Rk4::new(self, first_index, length))
    }

    /// The model of this equation by an implicit scheme, compiled in this crate. `tolerance` as for
    /// [`OneLeg::implicit_euler`].
    ///
    /// # Panics
    /// As [`ImplicitModel::new`].
    #[cfg(feature = "implicit")]
    pub fn implicit(
        self,
        scheme: Scheme,
        tolerance: f64,
        first_index: usize,
        length: f64,
    ) -> Box<dyn Model + Send> {
        Box::new(ImplicitModel::new(OneLeg::new(self, scheme, tolerance), first_index, length))
    }

    /// Indices of u_{i−2} … u_{i+2}.
    fn near(&self, i: usize) -> [usize; WIDTH] {
        let n = self.points;
        [(i + n - 2) % n, (i + n - 1) % n, i, (i + 1) % n, (i + 2) % n]
    }

    /// Coefficients of the linear part in u_{i−2} … u_{i+2}, and 1/2h.
    fn linear(&self) -> ([f64; WIDTH], f64) {
        let h = self.spacing();
        let (second, fourth) = (1.0 / (h * h), 1.0 / (h * h).powi(2));
        let side = 4.0 * fourth - second;
        ([-fourth, side, 2.0 * second - 6.0 * fourth, side, -fourth], 0.5 / h)
    }

    /// ∂u̇_i/∂(u_{i−2} … u_{i+2}).
    fn row(&self, u: &[f64], i: usize, (linear, transport): &([f64; WIDTH], f64)) -> [f64; WIDTH] {
        let [_, l, m, r, _] = self.near(i).map(|j| u[j]);
        let (carried, carries) = (transport / 3.0 * (l + m + r), transport / 3.0 * (r - l));
        let mut row = *linear;
        row[1] += carried - carries;
        row[2] -= carries;
        row[3] -= carried + carries;
        row
    }
}

/// None.
impl ParametricRhs for KuramotoSivashinsky {
    fn parameters(&self) -> usize {
        0
    }

    fn set_parameters(&mut self, _p: &[f64]) {}

    fn parameter_jacobian(&mut self, _t: f64, _u: &[f64], _columns: &mut [f64]) {}

    fn has_second_parameters(&self) -> bool {
        true
    }
}

impl Rhs for KuramotoSivashinsky {
    fn dim(&self) -> usize {
        self.points
    }

    fn eval(&mut self, _t: f64, u: &[f64], f: &mut [f64]) {
        let (linear, transport) = self.linear();
        for (i, f) in f.iter_mut().enumerate() {
            let near = self.near(i).map(|j| u[j]);
            let [_, l, m, r, _] = near;
            let spread: f64 = linear.iter().zip(near).map(|(c, u)| c * u).sum();
            *f = spread - transport / 3.0 * (l + m + r) * (r - l);
        }
    }

    fn tangent(&mut self, _t: f64, u: &[f64], du: &[f64], df: &mut [f64]) {
        let scales = self.linear();
        for (i, df) in df.iter_mut().enumerate() {
            let row = self.row(u, i, &scales);
            *df = row.iter().zip(self.near(i)).map(|(c, j)| c * du[j]).sum();
        }
    }

    fn adjoint_add(&mut self, _t: f64, u: &[f64], lambda: &[f64], du: &mut [f64]) {
        let scales = self.linear();
        for (i, l) in lambda.iter().enumerate() {
            let row = self.row(u, i, &scales);
            row.iter().zip(self.near(i)).for_each(|(c, j)| du[j] += c * l);
        }
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }

    /// The transport −(l + m + r)(r − l)/6h is quadratic.
    fn second_adjoint_add(&mut self, _t: f64, _u: &[f64], du: &[f64], lambda: &[f64], out: &mut [f64]) {
        let (_, transport) = self.linear();
        for (i, lambda) in lambda.iter().enumerate() {
            let [_, l, m, r, _] = self.near(i);
            let share = transport / 3.0 * lambda;
            let (sum, difference) = (du[l] + du[m] + du[r], du[r] - du[l]);
            out[l] -= share * (difference - sum);
            out[m] -= share * difference;
            out[r] -= share * (difference + sum);
        }
    }

    fn structure(&self) -> Structure {
        let (mut columns, mut rows) = (vec![0], Vec::with_capacity(WIDTH * self.points));
        for j in 0..self.points {
            let mut column = self.near(j);
            column.sort_unstable();
            rows.extend(column);
            columns.push(rows.len());
        }
        Structure::Sparse { columns, rows }
    }

    fn jacobian(&mut self, _t: f64, u: &[f64], values: &mut [f64]) -> bool {
        let scales = self.linear();
        for i in 0..self.points {
            for (value, j) in self.row(u, i, &scales).into_iter().zip(self.near(i)) {
                // the place of row i among the ascending rows of column j
                let place = self.near(j).iter().filter(|other| **other < i).count();
                values[WIDTH * j + place] = value;
            }
        }
        true
    }
}

#[cfg(all(test, feature = "implicit"))]
mod tests {
    use super::*;
    use crate::{Keep, Trajectory, check};
    use std::f64::consts::{PI, TAU};

    fn fronts() -> KuramotoSivashinsky {
        KuramotoSivashinsky::new(32, 22.0)
    }

    fn rough() -> Vec<f64> {
        (0..32).map(|i| (1.0 + 7.0 * i as f64).sin() + 0.5 * (0.3 * i as f64).cos()).collect()
    }

    #[test]
    fn its_derivatives_are_exact() {
        for mut model in [
            fronts().implicit(Scheme::Midpoint, 1e-12, 0, 0.1),
            fronts().implicit(Scheme::Bdf2, 1e-12, 0, 0.1),
            fronts().rk4(0, 0.01),
        ] {
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&rough(), &mut x).unwrap();
            let scale = vec![0.1; x.len()];
            for finding in check::conformance(model.as_mut(), 0, &x, &scale, 3).unwrap() {
                assert!(finding.value <= finding.bound, "{finding:?}");
            }
        }
    }

    /// The Jacobian by columns of the tangent, and one value of it that is wrong.
    #[test]
    fn its_jacobian_is_that_of_its_tangent() {
        let (mut fronts, u) = (fronts(), rough());
        let mut values = vec![0.0; WIDTH * 32];
        assert!(fronts.jacobian(0.0, &u, &mut values));
        let Structure::Sparse { columns, rows } = fronts.structure() else { panic!("sparse") };
        let mut off = |values: &[f64]| {
            let mut largest: f64 = 0.0;
            for j in 0..32 {
                let (mut unit, mut column) = (vec![0.0; 32], vec![0.0; 32]);
                unit[j] = 1.0;
                fronts.tangent(0.0, &u, &unit, &mut column);
                for at in columns[j]..columns[j + 1] {
                    column[rows[at]] -= values[at];
                }
                largest = column.iter().fold(largest, |m, c| m.max(c.abs()));
            }
            largest
        };
        assert!(off(&values) <= 1e-12, "{:e}", off(&values));
        values[7] *= 1.001;
        assert!(off(&values) > 1e-6, "a wrong value is not seen");
    }

    /// A small wave grows at q² − q⁴ of the differences' own wave numbers, and Σ u stays.
    #[test]
    fn small_waves_grow_as_they_should() {
        let fronts = KuramotoSivashinsky::new(64, 32.0 * PI);
        let q = 8.0 * TAU / (32.0 * PI);
        let u0: Vec<f64> = (0..64).map(|i| 1e-9 * (q * fronts.position(i)).cos()).collect();
        let mut run = Trajectory::new();
        run.run(fronts.implicit(Scheme::Midpoint, 1e-14, 0, 0.05).as_mut(), &u0, 100, Keep::States).unwrap();
        let seen = (2.0 * (0.5 * q * fronts.spacing()).sin() / fronts.spacing()).powi(2);
        let grown = run.state(100)[0] / u0[0];
        let rate = seen - seen * seen;
        // midpoint: (rate Δt)³/12 a step
        assert!((grown.ln() / (5.0 * rate) - 1.0).abs() <= 1e-4, "{} for {rate}", grown.ln() / 5.0);
        assert!(run.state(100).iter().sum::<f64>().abs() <= 1e-20);
    }
}
