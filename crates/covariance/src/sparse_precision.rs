//! A covariance known by its sparse inverse.

use crate::error::Error;
use crate::grid::Grid;
use crate::input::check_lengths;
use crate::operator::{Covariance, Precision};
use varda_linalg::Structure;
use varda_linalg::sparse::{Cholesky, Ordering};

/// A covariance B = P⁻¹ given by its sparse symmetric positive definite precision matrix P, through the
/// sparse Cholesky factor Π P Πᵀ = L Lᵀ: B^{1/2} = Πᵀ L⁻ᵀ.
///
/// # When to use
///
/// Random fields of a finite correlation length on grids and meshes of up to some 10⁵ points
/// ([`matern`](Self::matern)), and graphs of conditional independence: P_ij = 0 where i and j are independent
/// given all others.
///
/// # Limitations
///
/// The Matérn fields are those of a stencil: their variance exceeds σ² by some 1.5 h²/L² in the interior
/// of the grid, and by more at an end that is not periodic (it is about twice as large there on a line,
/// within a correlation length). [`Diffusion`](crate::Diffusion) has the σ given everywhere.
///
/// # Cost
///
/// On a square of n points in two dimensions some n^{3/2} operations to factorize, n log n for a product.
/// `variance` takes as long as the factorization, and allocates.
///
/// # References
///
/// Lindgren, Rue and Lindström (2011); Rue and Held (2005).
///
/// # Example
///
/// ```
/// use varda_covariance::{Covariance, Grid, SparsePrecision};
///
/// let grid = Grid::rectangle([60, 40], [0.05, 0.05])?;
/// let b = SparsePrecision::matern(grid, 2.0, 0.5, 2)?; // σ = 2, L = 0.5, ν = 1
/// let mut variance = vec![0.0; 2400];
/// b.variance(&mut variance);
/// assert!((variance[30 + 60 * 20] / 4.0 - 1.0).abs() < 0.05);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct SparsePrecision {
    structure: Structure,
    values: Vec<f64>,
    factor: Cholesky,
}

impl SparsePrecision {
    /// From a symmetric positive definite n × n matrix P of any [`Structure`].
    ///
    /// # Errors
    ///
    /// [`Error::Size`] for n = 0 or a wrong number of values; [`Error::NonFinite`], [`Error::NotSymmetric`],
    /// [`Error::Singular`], [`Error::NotPositiveDefinite`] for what is no precision matrix;
    /// [`Error::LinearAlgebra`] for a broken pattern.
    pub fn new(n: usize, structure: Structure, values: Vec<f64>, ordering: Ordering) -> Result<Self, Error> {
        structure.check(n)?;
        let expected = structure.values_len(n);
        if n == 0 || values.len() != expected {
            return Err(Error::Size {
                what: "a precision matrix",
                expected: expected.max(1),
                found: values.len(),
            });
        }
        for j in 0..n {
            for (i, place) in structure.column(n, j) {
                let value = values[place];
                if !value.is_finite() {
                    return Err(Error::NonFinite { row: i, column: j, value });
                }
                let mirror = structure.position(n, j, i).map_or(0.0, |place| values[place]);
                let size = value.abs().max(mirror.abs());
                // rounding of a product of matrices
                if !((value - mirror).abs() <= 1e-12 * size) {
                    return Err(Error::NotSymmetric { row: i, column: j, value, mirror });
                }
            }
        }
        let factor = Cholesky::new(n, &structure, &values, ordering)?;
        Ok(Self { structure, values, factor })
    }

    /// The Matérn field of standard deviation σ and correlation length L (that of
    /// [`Kernel`](crate::Kernel)) on a grid, as the solution of a stochastic differential equation (Whittle
    /// 1954; Lindgren, Rue and Lindström 2011):
    ///
    /// ```text
    /// (κ² − Δ)^{α/2} x = W / τ,   ν = α − d/2,   κ = (2ν)^{1/2} / L
    /// τ² = Γ(ν) / (Γ(α) (4π)^{d/2} κ^{2ν} σ²)
    /// P = τ² h^d (κ² − Δ_h)^α
    /// ```
    ///
    /// On a line α = 1, 2, 3 are the kernels `Matern12`, `Matern32`, `Matern52`; on a rectangle α = 2, 3
    /// have ν = 1, 2.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for σ or L that is not positive and finite, or an α outside d/2 < α ≤ 4 (a
    /// wider stencil loses digits and fills the factor: use [`Diffusion`](crate::Diffusion)).
    pub fn matern(grid: Grid, sigma: f64, length: f64, alpha: usize) -> Result<Self, Error> {
        let half = 0.5 * grid.dimensions() as f64;
        let nu = alpha as f64 - half;
        if !(nu > 0.0) || alpha > 4 {
            let range = "above d/2, at most 4";
            return Err(Error::Parameter { what: "order α of a Matérn field", value: alpha as f64, range });
        }
        for (what, value) in [("standard deviation", sigma), ("correlation length", length)] {
            if !(value > 0.0 && (value * value).is_normal()) {
                return Err(Error::Parameter { what, value, range: "positive" });
            }
        }
        let n = grid.dim();
        let kappa2 = 2.0 * nu / (length * length);
        let gammas = gamma_of_halves(nu) / gamma_of_halves(alpha as f64);
        let tau2 = gammas / ((4.0 * std::f64::consts::PI).powf(half) * kappa2.powf(nu) * sigma * sigma);
        let (stencil, weights) = grid.shifted_laplacian(kappa2, 1.0);
        let (mut structure, mut values) = (stencil.clone(), weights.clone());
        for _ in 1..alpha {
            (structure, values) = product(n, (&stencil, &weights), (&structure, &values));
        }
        values.iter_mut().for_each(|value| *value *= tau2 * grid.cell());
        let ordering = if grid.dimensions() == 1 { Ordering::Natural } else { Ordering::MinimumDegree };
        Self::new(n, structure, values, ordering)
    }

    /// Number of entries of the Cholesky factor: a product with a square root costs twice as many operations.
    pub fn factor_entries(&self) -> usize {
        self.factor.entries()
    }
}

impl Covariance for SparsePrecision {
    fn dim(&self) -> usize {
        self.factor.dim()
    }

    fn root_dim(&self) -> usize {
        self.factor.dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.factor.solve_into(x, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        self.factor.root_inverse_transpose(v, x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        self.factor.root_inverse(x, v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.dim(), "length of the variance");
        variance.copy_from_slice(&self.factor.inverse_diagonal());
    }
}

impl Precision for SparsePrecision {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.structure.product(&self.values, x, y);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        self.factor.root_transpose(x, v);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        self.factor.root(v, x);
    }
}

/// The product of two sparse matrices that commute, both symmetric.
fn product(n: usize, a: (&Structure, &[f64]), b: (&Structure, &[f64])) -> (Structure, Vec<f64>) {
    let mut column = vec![0.0; n];
    let mut entries = Vec::new();
    let mut pairs = Vec::new();
    for j in 0..n {
        let mut touched: Vec<usize> = Vec::new();
        for (k, p) in b.0.column(n, j) {
            for (i, q) in a.0.column(n, k) {
                column[i] += a.1[q] * b.1[p];
                touched.push(i);
            }
        }
        touched.sort_unstable();
        touched.dedup();
        for i in touched {
            pairs.push((i, j));
            entries.push(std::mem::take(&mut column[i]));
        }
    }
    // column by column, rows ascending: the order of the structure's values
    (Structure::from_pairs(n, pairs).expect("rows and columns below n"), entries)
}

/// Γ(x) for x = ½, 1, 3/2, …
fn gamma_of_halves(x: f64) -> f64 {
    match x {
        0.5 => std::f64::consts::PI.sqrt(),
        1.0 => 1.0,
        _ => (x - 1.0) * gamma_of_halves(x - 1.0),
    }
}
