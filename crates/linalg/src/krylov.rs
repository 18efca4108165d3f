//! Krylov methods for symmetric operators known by their products: conjugate gradients and Lanczos iteration,
//! with full re-orthogonalisation.
//!
//! When to use: products are expensive (a sweep of a model) and few are needed. When not: thousands of
//! iterations, whose vectors are all kept.

use crate::vector::{axpy, dot, norm};
use crate::{Eigen, Error};

/// When conjugate gradients stop: at the first of the two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CgLimits {
    /// ‖A x − b‖ has fallen to this part of ‖b‖.
    pub residual: f64,
    /// Iterations: products with A, and vectors kept for re-orthogonalisation.
    pub iterations: usize,
}

/// What conjugate gradients have done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CgEnd {
    /// Iterations done.
    pub iterations: usize,
    /// ‖A x − b‖ / ‖b‖, by the recurrence; 0 where b = 0.
    pub residual: f64,
}

/// A x = b from x = 0 by conjugate gradients (Hestenes and Stiefel 1952) for a symmetric positive definite A
/// of n rows, residuals re-orthogonalised twice, so that rounding does not delay convergence.
///
/// `product(p, out)` writes A p to `out` and returns pᵀ A p > 0, which a caller may know better than as an
/// inner product: for A = I + GᵀG it is ‖p‖² + ‖G p‖².
///
/// Cost of iteration k: one product and 4 k n operations. Memory: (4 + k) n.
///
/// ```
/// use varda_linalg::krylov::{CgLimits, conjugate_gradients};
///
/// let mut x = [0.0; 2];
/// let limits = CgLimits { residual: 1e-12, iterations: 2 };
/// let mut product = |p: &[f64], out: &mut [f64]| {
///     (out[0], out[1]) = (4.0 * p[0] + p[1], p[0] + 3.0 * p[1]);
///     Ok::<f64, varda_linalg::Error>(varda_linalg::dot(p, out))
/// };
/// conjugate_gradients(&mut product, &[1.0, 2.0], &limits, &mut x)?;
/// assert!((x[0] - 1.0 / 11.0).abs() < 1e-15 && (x[1] - 7.0 / 11.0).abs() < 1e-15);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
///
/// # Errors
/// Those of the products; [`Error::NonFiniteProduct`] for one that is not finite;
/// [`Error::NegativeCurvature`] unless pᵀ A p > 0.
///
/// # Panics
/// If `b` and `x` differ in length.
pub fn conjugate_gradients<E: From<Error>>(
    product: &mut dyn FnMut(&[f64], &mut [f64]) -> Result<f64, E>,
    b: &[f64],
    limits: &CgLimits,
    x: &mut [f64],
) -> Result<CgEnd, E> {
    assert_eq!(b.len(), x.len(), "right-hand side and solution differ in length");
    let n = b.len();
    let mut image = vec![0.0; n];
    let mut basis: Vec<f64> = Vec::new();
    let mut r = b.to_vec();
    let mut direction = r.clone();
    let mut progress = CgProgress::new(dot(&r, &r));
    x.fill(0.0);
    while progress.goes_on(limits, n)? {
        let curvature = product(&direction, &mut image)?;
        if !curvature.is_finite() {
            return Err(Error::NonFiniteProduct { iteration: progress.iterations }.into());
        }
        if curvature <= 0.0 {
            return Err(Error::NegativeCurvature { iteration: progress.iterations, curvature }.into());
        }
        let alpha = progress.square / curvature;
        axpy(alpha, &direction, x);
        basis.extend(r.iter().map(|r| r / progress.square.sqrt()));
        axpy(-alpha, &image, &mut r);
        for _ in 0..2 {
            for q in basis.chunks_exact(n) {
                let c = dot(q, &r);
                axpy(-c, q, &mut r);
            }
        }
        let beta = progress.advance(dot(&r, &r));
        direction.iter_mut().zip(&r).for_each(|(d, r)| *d = r + beta * *d);
    }
    Ok(progress.end())
}

/// The squared residual of conjugate gradients, and when they stop: for a recurrence of one's own.
#[derive(Debug, Clone)]
pub struct CgProgress {
    first: f64,
    /// ‖r‖².
    pub square: f64,
    iterations: usize,
}

impl CgProgress {
    /// From ‖b‖².
    pub fn new(square: f64) -> Self {
        Self { first: square, square, iterations: 0 }
    }

    /// Whether another iteration is due. A Krylov space has no more than n dimensions.
    ///
    /// # Errors
    /// [`Error::NonFiniteProduct`] for a residual that is not finite.
    pub fn goes_on(&self, limits: &CgLimits, n: usize) -> Result<bool, Error> {
        if !self.square.is_finite() {
            return Err(Error::NonFiniteProduct { iteration: self.iterations });
        }
        Ok(self.iterations < limits.iterations.min(n)
            && self.square > 0.0
            && self.square.sqrt() > limits.residual * self.first.sqrt())
    }

    /// Takes the new ‖r‖², returns β.
    pub fn advance(&mut self, square: f64) -> f64 {
        self.iterations += 1;
        let beta = square / self.square;
        self.square = square;
        beta
    }

    /// What was done.
    pub fn end(&self) -> CgEnd {
        let residual = if self.first > 0.0 { (self.square / self.first).sqrt() } else { 0.0 };
        CgEnd { iterations: self.iterations, residual }
    }
}

/// An approximate eigenpair A z ≈ μ z, ‖z‖ = 1.
#[derive(Debug, Clone, PartialEq)]
pub struct RitzPair {
    /// μ.
    pub value: f64,
    /// z.
    pub vector: Vec<f64>,
    /// ‖A z − μ z‖: an eigenvalue of A lies within this of μ.
    pub residual: f64,
}

/// All Ritz pairs of a Krylov space.
#[derive(Debug, Clone, PartialEq)]
pub struct Ritz {
    /// μ, ascending.
    pub values: Vec<f64>,
    /// z, one after the other.
    pub vectors: Vec<f64>,
    /// e with A zᵢ − μᵢ zᵢ = eᵢ q, where q is [`Lanczos::extension`].
    pub coupling: Vec<f64>,
}

/// The Krylov space of (A, g) and A on it: Qᵀ A Q = T tridiagonal, Q orthonormal to rounding.
///
/// ```
/// use varda_linalg::krylov::{Lanczos, LanczosLimits};
///
/// let mut lanczos = Lanczos::new(3);
/// let mut product = |p: &[f64], out: &mut [f64]| {
///     out.iter_mut().zip(p).zip([1.0, 2.0, 5.0]).for_each(|((out, p), a)| *out = a * p);
///     Ok::<(), varda_linalg::Error>(())
/// };
/// let limits = LanczosLimits { residual: 0.0, radius: f64::INFINITY, iterations: 3 };
/// lanczos.run(&mut product, &[1.0, 1.0, 1.0], &limits)?;
/// assert!((lanczos.ritz()?.values[2] - 5.0).abs() < 1e-14);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Lanczos {
    n: usize,
    /// Columns of Q, one after the other.
    basis: Vec<f64>,
    diagonal: Vec<f64>,
    off_diagonal: Vec<f64>,
    work: Vec<f64>,
}

/// When [`Lanczos::run`] stops: at the first of the four.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LanczosLimits {
    /// The conjugate gradient iterate has a residual below this part of ‖g‖.
    pub residual: f64,
    /// That iterate has left the ball of this radius: the best step is on its boundary (Steihaug 1983).
    pub radius: f64,
    /// Iterations. (The fourth: the space is invariant, nothing is left to be found.)
    pub iterations: usize,
}

/// out = A p.
pub type Product<'a, E> = dyn FnMut(&[f64], &mut [f64]) -> Result<(), E> + 'a;

impl Lanczos {
    /// For vectors of length n. Nothing can be asked of it before [`begin`](Self::begin) or
    /// [`run`](Self::run).
    pub fn new(n: usize) -> Self {
        Self { n, basis: Vec::new(), diagonal: Vec::new(), off_diagonal: Vec::new(), work: vec![0.0; n] }
    }

    /// Builds the space of (A, g), g ≠ 0.
    ///
    /// # Errors
    /// Those of the products; [`Error::NonFiniteProduct`] for one that is not finite.
    ///
    /// # Panics
    /// If `g` is not of length n.
    pub fn run<E: From<Error>>(
        &mut self,
        product: &mut Product<E>,
        g: &[f64],
        limits: &LanczosLimits,
    ) -> Result<(), E> {
        let length = norm(g);
        self.begin(g);
        for _ in 0..limits.iterations.min(self.n) {
            self.extend(product)?;
            let (last, size) = self.galerkin(length);
            if self.residual() * last.abs() <= limits.residual * length
                || size >= limits.radius
                || self.invariant()
            {
                break;
            }
        }
        Ok(())
    }

    /// An empty space, to be grown from g ≠ 0.
    ///
    /// # Panics
    /// If `g` is not of length n.
    pub fn begin(&mut self, g: &[f64]) {
        assert_eq!(g.len(), self.n, "length of the first vector");
        let length = norm(g);
        self.basis.clear();
        self.diagonal.clear();
        self.off_diagonal.clear();
        self.basis.extend(g.iter().map(|g| g / length));
    }

    /// One dimension more; not past an invariant space.
    ///
    /// # Errors
    /// As for [`run`](Self::run).
    pub fn extend<E: From<Error>>(&mut self, product: &mut Product<E>) -> Result<(), E> {
        let (n, k) = (self.n, self.iterations());
        if k > 0 {
            let beta = self.residual();
            self.basis.extend(self.work.iter().map(|w| w / beta));
        }
        product(&self.basis[k * n..], &mut self.work)?;
        self.diagonal.push(dot(&self.basis[k * n..], &self.work));
        // Twice is enough (Giraud, Langou and Rozložník 2005).
        for q in self.basis.chunks_exact(n).rev().chain(self.basis.chunks_exact(n)) {
            let c = dot(q, &self.work);
            axpy(-c, q, &mut self.work);
        }
        let beta = norm(&self.work);
        if !beta.is_finite() {
            return Err(Error::NonFiniteProduct { iteration: k }.into());
        }
        self.off_diagonal.push(beta);
        Ok(())
    }

    /// Number of dimensions.
    pub fn iterations(&self) -> usize {
        self.diagonal.len()
    }

    /// β: how far the space is from invariant, ‖A Q − Q T‖.
    fn residual(&self) -> f64 {
        self.off_diagonal[self.off_diagonal.len() - 1]
    }

    /// Nothing is left to be found from this start.
    ///
    /// # Panics
    /// If the space is empty.
    pub fn invariant(&self) -> bool {
        let scale = self.diagonal.iter().fold(0.0, |m: f64, a| m.max(a.abs()));
        self.iterations() == self.n || self.residual() <= 1e-14 * scale
    }

    /// The vector of norm 1 that would extend the space; zero where it is invariant.
    ///
    /// # Panics
    /// If the space is empty.
    pub fn extension(&self) -> Vec<f64> {
        let beta = self.residual();
        self.work.iter().map(|w| if beta > 0.0 { w / beta } else { 0.0 }).collect()
    }

    /// The Ritz pairs: O(k³ + n k²) for k dimensions.
    ///
    /// # Errors
    /// [`Error::Eigen`].
    ///
    /// # Panics
    /// If the space is empty.
    pub fn ritz(&self) -> Result<Ritz, Error> {
        let (n, k, beta) = (self.n, self.iterations(), self.residual());
        let mut t = vec![0.0; k * k];
        for i in 0..k {
            t[i + i * k] = self.diagonal[i];
            if i + 1 < k {
                t[i + 1 + i * k] = self.off_diagonal[i];
                t[i + (i + 1) * k] = self.off_diagonal[i];
            }
        }
        let Eigen { values, vectors: small } = Eigen::new(k, &t)?;
        let mut vectors = vec![0.0; n * k];
        for (z, w) in vectors.chunks_exact_mut(n).zip(small.chunks_exact(k)) {
            for (q, w) in self.basis.chunks_exact(n).zip(w) {
                axpy(*w, q, z);
            }
        }
        let coupling = small.chunks_exact(k).map(|w| beta * w[k - 1]).collect();
        Ok(Ritz { values, vectors, coupling })
    }

    /// Last entry and norm of the y with T y = −‖g‖ e₁: the conjugate gradient iterate in the basis.
    fn galerkin(&self, length: f64) -> (f64, f64) {
        let k = self.iterations();
        // T = L D Lᵀ; forward substitution gives the entries of D⁻¹L⁻¹b, the last of which is that of
        // y.
        let (mut pivots, mut y) = (vec![self.diagonal[0]], vec![-length / self.diagonal[0]]);
        for i in 1..k {
            let beta = self.off_diagonal[i - 1];
            pivots.push(self.diagonal[i] - beta * beta / pivots[i - 1]);
            y.push(-beta * y[i - 1] / pivots[i]);
        }
        if pivots.iter().any(|&d| d <= 0.0) {
            // Negative curvature: the step goes to the boundary.
            return (y[k - 1], f64::INFINITY);
        }
        for i in (0..k - 1).rev() {
            y[i] -= self.off_diagonal[i] / pivots[i] * y[i + 1];
        }
        (y[k - 1], norm(&y))
    }
}
