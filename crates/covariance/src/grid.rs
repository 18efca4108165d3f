//! Regular grids and their second differences.

use crate::error::Error;
use varda_linalg::Structure;

/// A regular grid on a line or a rectangle, for covariances given by a differential operator.
///
/// Point (i, j) of a rectangle of n_x × n_y points is component i + n_x j. At the ends the field is mirrored
/// (no flux, a zero normal derivative half a cell beyond the last point) unless the grid is periodic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    points: [usize; 2],
    spacing: [f64; 2],
    dimensions: usize,
    periodic: bool,
}

impl Grid {
    /// n points along a line, `spacing` apart [m, or the unit of lengths].
    ///
    /// # Errors
    ///
    /// [`Error::Size`] for no points, [`Error::Parameter`] for a spacing that is not positive and finite.
    pub fn line(n: usize, spacing: f64) -> Result<Self, Error> {
        Self::checked([n, 1], [spacing, spacing], 1)
    }

    /// n_x × n_y points of a rectangle.
    ///
    /// # Errors
    ///
    /// As [`line`](Self::line).
    pub fn rectangle(points: [usize; 2], spacing: [f64; 2]) -> Result<Self, Error> {
        Self::checked(points, spacing, 2)
    }

    /// The same points closed to a ring (a torus).
    pub fn periodic(self) -> Self {
        Self { periodic: true, ..self }
    }

    /// Number of points.
    pub fn dim(&self) -> usize {
        self.points[0] * self.points[1]
    }

    /// 1 for a line, 2 for a rectangle.
    pub fn dimensions(&self) -> usize {
        self.dimensions
    }

    /// The length, area of one cell.
    pub(crate) fn cell(&self) -> f64 {
        self.spacing[..self.dimensions].iter().product()
    }

    /// The matrix c I − s Δ with the five-point (three-point) Laplacian, symmetric.
    pub(crate) fn shifted_laplacian(&self, c: f64, s: f64) -> (Structure, Vec<f64>) {
        let [nx, ny] = self.points;
        let n = self.dim();
        let neighbours = |at: usize| {
            let (i, j) = (at % nx, at / nx);
            let along = |k: usize, n: usize| -> [Option<usize>; 2] {
                let before = k.checked_sub(1).or((self.periodic && n > 2).then(|| n - 1));
                let after = (k + 1 < n).then_some(k + 1).or((self.periodic && n > 2).then_some(0));
                [before, after]
            };
            let [hx, hy] = self.spacing.map(|h| s / (h * h));
            let x = along(i, nx).into_iter().flatten().map(move |i| (i + nx * j, hx));
            let y = along(j, ny).into_iter().flatten().map(move |j| (i + nx * j, hy));
            x.chain(y).collect::<Vec<_>>()
        };
        let pairs = (0..n).flat_map(|p| neighbours(p).into_iter().map(move |(q, _)| (q, p)).chain([(p, p)]));
        let structure = Structure::from_pairs(n, pairs).expect("points of the grid");
        let mut values = vec![0.0; structure.values_len(n)];
        for p in 0..n {
            let own = structure.position(n, p, p).expect("the diagonal is in the pattern");
            values[own] += c;
            for (q, weight) in neighbours(p) {
                let other = structure.position(n, q, p).expect("neighbours are in the pattern");
                values[other] -= weight;
                values[own] += weight;
            }
        }
        (structure, values)
    }

    /// The diagonal of (c I − s Δ)^{−m}, from the eigenvectors of the Laplacian, which on these grids
    /// are cosines.
    pub(crate) fn inverse_power_diagonal(&self, c: f64, s: f64, m: i32) -> Vec<f64> {
        let [nx, ny] = self.points;
        let (mu_x, square_x) = self.modes(0);
        let (mu_y, square_y) = self.modes(1);
        let mut diagonal = vec![0.0; nx * ny];
        for p in 0..nx {
            for j in 0..ny {
                let sum: f64 =
                    (0..ny).map(|q| square_y[q * ny + j] * (c + s * (mu_x[p] + mu_y[q])).powi(-m)).sum();
                for i in 0..nx {
                    diagonal[i + nx * j] += square_x[p * nx + i] * sum;
                }
            }
        }
        diagonal
    }

    /// Along one axis: the eigenvalues of −Δ, and the squares of its eigenvectors, one after the other.
    fn modes(&self, axis: usize) -> (Vec<f64>, Vec<f64>) {
        let (n, h) = (self.points[axis], self.spacing[axis]);
        let pi = std::f64::consts::PI;
        let closed = self.periodic && n > 2;
        let turn = |p: usize| if closed { 2.0 * pi * p as f64 / n as f64 } else { pi * p as f64 / n as f64 };
        let values = (0..n).map(|p| (2.0 * (0.5 * turn(p)).sin() / h).powi(2)).collect();
        let square = |p: usize, i: usize| {
            if closed || p == 0 {
                1.0 / n as f64
            } else {
                2.0 / n as f64 * (turn(p) * (i as f64 + 0.5)).cos().powi(2)
            }
        };
        let squares = (0..n).flat_map(|p| (0..n).map(move |i| (p, i))).map(|(p, i)| square(p, i)).collect();
        (values, squares)
    }

    fn checked(points: [usize; 2], spacing: [f64; 2], dimensions: usize) -> Result<Self, Error> {
        if points.contains(&0) {
            return Err(Error::Size { what: "a grid", expected: 1, found: 0 });
        }
        match spacing.iter().find(|h| !(**h > 0.0 && h.is_finite())) {
            Some(&value) => Err(Error::Parameter { what: "spacing of a grid", value, range: "positive" }),
            None => Ok(Self { points, spacing, dimensions, periodic: false }),
        }
    }
}
