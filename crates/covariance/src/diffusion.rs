//! A covariance given by implicit diffusion.

use crate::error::Error;
use crate::grid::Grid;
use crate::input::check_lengths;
use crate::operator::{Covariance, Precision};
use varda_linalg::Structure;
use varda_linalg::sparse::{Cholesky, Ordering};

/// Errors correlated by M steps of implicit diffusion on a grid:
///
/// ```text
/// B^{1/2} = Σ N A^{−M/2},   A = I − ℓ² Δ_h,   ℓ = L / (2M − d)^{1/2}
/// N_ii = ((A^{−M})_ii)^{−1/2}
/// ```
///
/// Σ holds the standard deviations, N normalises the variance to 1 at every point, ends included. The
/// correlation is a Matérn function of ν = M − d/2 and length L, that of [`Kernel`](crate::Kernel),
/// nearly Gaussian for large M.
///
/// # When to use
///
/// Smooth fields on large grids, with a standard deviation that may vary from point to point. For rough ones
/// (M = 1) use [`SparsePrecision`](crate::SparsePrecision).
///
/// # Limitations
///
/// M is even, the length the same everywhere. Beyond an end of the grid that is not periodic the field is
/// mirrored: correlations within a length L of it are larger.
///
/// # Cost
///
/// One sparse factorization, some n^{3/2} operations on a square of n points; M/2 solves of n log n for a
/// root, exact normalisation by cosines in n (n_x + n_y). Memory: the factor.
///
/// # References
///
/// Weaver and Courtier (2001); implicit form, Mirouze and Weaver (2010).
///
/// # Example
///
/// ```
/// use varda_covariance::{Covariance, Diffusion, Grid};
///
/// let grid = Grid::rectangle([60, 40], [0.1, 0.1])?;
/// let b = Diffusion::new(grid, &vec![2.0; 2400], 0.5, 10)?;
/// let mut variance = vec![0.0; 2400];
/// b.variance(&mut variance);
/// assert!(variance.iter().all(|v| (v - 4.0).abs() < 1e-12));
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Diffusion {
    sigma: Vec<f64>,
    /// Σ N.
    scale: Vec<f64>,
    half_steps: usize,
    structure: Structure,
    values: Vec<f64>,
    factor: Cholesky,
    work: crate::scratch::Scratch,
}

impl Diffusion {
    /// From the standard deviation of every point, the correlation length L and the number of steps M.
    ///
    /// # Errors
    ///
    /// [`Error::Size`] unless there is a σ for every point; [`Error::Parameter`] for a σ or L that is not
    /// positive and finite, an M that is odd or not above d/2.
    pub fn new(grid: Grid, sigma: &[f64], length: f64, steps: usize) -> Result<Self, Error> {
        let n = grid.dim();
        if sigma.len() != n {
            return Err(Error::Size {
                what: "standard deviations of a grid",
                expected: n,
                found: sigma.len(),
            });
        }
        let usable = |value: f64| value > 0.0 && (value * value).is_normal();
        let steps_range = "even, at least 2, at most 100";
        let not_positive = sigma.iter().find(|sigma| !usable(**sigma));
        for (what, range, found) in [
            ("standard deviation", "positive", not_positive.copied()),
            ("correlation length", "positive", (!usable(length)).then_some(length)),
            (
                "steps of diffusion",
                steps_range,
                (steps % 2 == 1 || !(2..=100).contains(&steps)).then_some(steps as f64),
            ),
        ] {
            if let Some(value) = found {
                return Err(Error::Parameter { what, value, range });
            }
        }
        let l2 = length * length / (2 * steps - grid.dimensions()) as f64;
        let (structure, values) = grid.shifted_laplacian(1.0, l2);
        let ordering = if grid.dimensions() == 1 { Ordering::Natural } else { Ordering::MinimumDegree };
        let factor = Cholesky::new(n, &structure, &values, ordering)?;
        let diagonal = grid.inverse_power_diagonal(1.0, l2, steps as i32);
        let scale = sigma.iter().zip(&diagonal).map(|(sigma, d)| sigma / d.sqrt()).collect();
        let work = crate::scratch::Scratch::new(n);
        Ok(Self { sigma: sigma.to_vec(), scale, half_steps: steps / 2, structure, values, factor, work })
    }

    /// y ← A^{−M/2} y.
    fn diffuse(&self, y: &mut [f64]) {
        (0..self.half_steps).for_each(|_| self.factor.solve(y));
    }

    /// y ← A^{M/2} y.
    fn sharpen(&self, y: &mut [f64]) {
        self.work.with(|work| {
            for _ in 0..self.half_steps {
                work.copy_from_slice(y);
                self.structure.product(&self.values, work, y);
            }
        });
    }

    fn scaled(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.sigma.len(), y, self.sigma.len());
        y.iter_mut().zip(x).zip(&self.scale).for_each(|((y, x), s)| *y = s * x);
    }
}

impl Covariance for Diffusion {
    fn dim(&self) -> usize {
        self.sigma.len()
    }

    fn root_dim(&self) -> usize {
        self.sigma.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.scaled(x, y);
        self.diffuse(y);
        self.diffuse(y);
        y.iter_mut().zip(&self.scale).for_each(|(y, s)| *y *= s);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        x.copy_from_slice(v);
        self.diffuse(x);
        x.iter_mut().zip(&self.scale).for_each(|(x, s)| *x *= s);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.scaled(x, v);
        self.diffuse(v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.dim(), "length of the variance");
        variance.iter_mut().zip(&self.sigma).for_each(|(v, sigma)| *v = sigma * sigma);
    }
}

impl Precision for Diffusion {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.whiten(x, y);
        self.sharpen(y);
        y.iter_mut().zip(&self.scale).for_each(|(y, s)| *y /= s);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        v.iter_mut().zip(x).zip(&self.scale).for_each(|((v, x), s)| *v = x / s);
        self.sharpen(v);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        x.copy_from_slice(v);
        self.sharpen(x);
        x.iter_mut().zip(&self.scale).for_each(|(x, s)| *x /= s);
    }
}
