//! Lanczos iteration with full re-orthogonalisation: truncated conjugate gradients that also return Ritz pairs.

use super::spectral::{Spectral, eigen};
use crate::{Error, cost::dot, cost::norm};

/// An approximate eigenpair A z ≈ μ z of the Hessian, ‖z‖ = 1.
#[derive(Debug, Clone, PartialEq)]
pub struct RitzPair {
    /// μ.
    pub value: f64,
    /// z.
    pub vector: Vec<f64>,
    /// ‖A z − μ z‖: an eigenvalue of A lies within this of μ.
    pub residual: f64,
}

/// The Krylov space of (A, g) and A on it: Qᵀ A Q = T tridiagonal, Q orthonormal to rounding.
pub(crate) struct Lanczos {
    n: usize,
    /// Columns of Q, k + 1 of them after k iterations.
    basis: Vec<f64>,
    diagonal: Vec<f64>,
    off_diagonal: Vec<f64>,
    work: Vec<f64>,
}

/// out = A p.
pub(crate) type Product<'a> = dyn FnMut(&[f64], &mut [f64]) -> Result<(), Error> + 'a;

/// When to stop: at the first of the four.
pub(super) struct Limits {
    /// The conjugate gradient iterate has a residual below this part of ‖g‖.
    pub(super) residual: f64,
    /// That iterate has left the ball of this radius: the best step is on its boundary (Steihaug 1983).
    pub(super) radius: f64,
    /// Iterations. (The fourth: the space is invariant, nothing is left to be found.)
    pub(super) iterations: usize,
}

impl Lanczos {
    pub(crate) fn new(n: usize) -> Self {
        Self { n, basis: Vec::new(), diagonal: Vec::new(), off_diagonal: Vec::new(), work: vec![0.0; n] }
    }

    /// Builds the space, and returns the quadratic model on it.
    pub(super) fn run(
        &mut self,
        product: &mut Product,
        g: &[f64],
        limits: &Limits,
    ) -> Result<Spectral, Error> {
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
        let k = self.iterations();
        let (values, _) = self.eigen()?;
        let vectors = self.largest(k)?;
        Ok(Spectral::new(values, vectors, g))
    }

    /// An empty space, to be grown from g ≠ 0.
    pub(crate) fn begin(&mut self, g: &[f64]) {
        let length = norm(g);
        self.basis.clear();
        self.diagonal.clear();
        self.off_diagonal.clear();
        self.basis.extend(g.iter().map(|g| g / length));
    }

    /// One dimension more; not past an invariant space.
    pub(crate) fn extend(&mut self, product: &mut Product) -> Result<(), Error> {
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
            self.work.iter_mut().zip(q).for_each(|(w, q)| *w -= c * q);
        }
        let beta = norm(&self.work);
        if !beta.is_finite() {
            return Err(Error::NonFinite { what: "a product with the Hessian", step: 0 });
        }
        self.off_diagonal.push(beta);
        Ok(())
    }

    /// β: how far the space is from invariant, ‖A Q − Q T‖.
    fn residual(&self) -> f64 {
        self.off_diagonal[self.off_diagonal.len() - 1]
    }

    /// Nothing is left to be found from this start.
    pub(crate) fn invariant(&self) -> bool {
        let scale = self.diagonal.iter().fold(0.0, |m: f64, a| m.max(a.abs()));
        self.iterations() == self.n || self.residual() <= 1e-14 * scale
    }

    /// A Z − Z D = q eᵀ for all Ritz pairs: q of norm 1, and the entry of e of every pair, ascending.
    pub(crate) fn coupling(&self) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let k = self.iterations();
        let (_, small) = self.eigen()?;
        let beta = self.residual();
        let q = self.work.iter().map(|w| if beta > 0.0 { w / beta } else { 0.0 }).collect();
        Ok((q, small.chunks_exact(k).map(|w| beta * w[k - 1]).collect()))
    }

    /// Ritz values, ascending.
    pub(crate) fn values(&self) -> Result<Vec<f64>, Error> {
        Ok(self.eigen()?.0)
    }

    /// The Ritz vectors of the `count` largest values, ascending, one after the other.
    pub(crate) fn largest(&self, count: usize) -> Result<Vec<f64>, Error> {
        let (n, k) = (self.n, self.iterations());
        let (_, small) = self.eigen()?;
        let mut vectors = vec![0.0; n * count];
        for (z, w) in vectors.chunks_exact_mut(n).zip(small[(k - count) * k..].chunks_exact(k)) {
            for (q, w) in self.basis.chunks_exact(n).zip(w) {
                z.iter_mut().zip(q).for_each(|(z, q)| *z += w * q);
            }
        }
        Ok(vectors)
    }

    pub(crate) fn iterations(&self) -> usize {
        self.diagonal.len()
    }

    /// The pairs of the last run, largest first.
    pub(super) fn ritz(&self, spectral: &Spectral) -> Result<Vec<RitzPair>, Error> {
        let k = self.iterations();
        let (_, small) = self.eigen()?;
        let beta = self.off_diagonal[k - 1];
        let pairs =
            spectral.values.iter().zip(spectral.vectors.chunks_exact(self.n)).zip(small.chunks_exact(k));
        Ok(pairs
            .map(|((&value, z), w)| RitzPair { value, vector: z.to_vec(), residual: beta * w[k - 1].abs() })
            .rev()
            .collect())
    }

    fn eigen(&self) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let k = self.iterations();
        let mut t = vec![0.0; k * k];
        for i in 0..k {
            t[i + i * k] = self.diagonal[i];
            if i + 1 < k {
                t[i + 1 + i * k] = self.off_diagonal[i];
                t[i + (i + 1) * k] = self.off_diagonal[i];
            }
        }
        eigen(k, &t)
    }

    /// Last entry and norm of the y with T y = −‖g‖ e₁: the conjugate gradient iterate in the basis.
    fn galerkin(&self, length: f64) -> (f64, f64) {
        let k = self.iterations();
        // T = L D Lᵀ; forward substitution gives the entries of D⁻¹L⁻¹b, the last of which is that of y.
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
