//! Conjugate gradients on the inner problem, in control space and in observation space, with the same iterates.

use crate::cost::dot;
use crate::{Error, Incremental};

/// When an inner solve stops: at the first of the two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerLimits {
    /// The residual A p + ∇q(0) has fallen to this part of ∇q(0).
    pub residual: f64,
    /// Iterations: products with A, and vectors kept for re-orthogonalisation.
    pub iterations: usize,
}

/// What an inner solve has done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerEnd {
    /// Iterations done.
    pub iterations: usize,
    /// ‖A p + ∇q(0)‖ / ‖∇q(0)‖, by the recurrence; 0 where ∇q(0) = 0.
    pub residual: f64,
}

/// A p = −∇q(0), A = I + GᵀG, from p = 0 by conjugate gradients in the control space (n unknowns), residuals re-orthogonalised twice.
///
/// When to use: the default of [`outer_loop`](crate::outer_loop). When not: m far below n and many iterations, see
/// [`restricted_conjugate_gradients`].
///
/// Cost of an iteration: one tangent and one adjoint sweep. Memory: 4n + m, and n more for each iteration.
///
/// # Errors
/// Products that fail or are not finite.
///
/// # Panics
/// If nothing has been linearized, or a slice is not of length `dim`.
pub fn conjugate_gradients(
    problem: &mut dyn Incremental,
    gradient: &[f64],
    limits: &InnerLimits,
    p: &mut [f64],
) -> Result<InnerEnd, Error> {
    let n = problem.dim();
    let mut dy = vec![0.0; problem.departure_dim()];
    let mut product = vec![0.0; n];
    let mut basis: Vec<f64> = Vec::new();
    let mut r: Vec<f64> = gradient.iter().map(|g| -g).collect();
    let mut direction = r.clone();
    let mut progress = Progress::new(dot(&r, &r));
    p.fill(0.0);
    while progress.goes_on(limits, n)? {
        problem.tangent(&direction, &mut dy)?;
        problem.adjoint(&dy, &mut product)?;
        let alpha = progress.square / (dot(&direction, &direction) + dot(&dy, &dy));
        add(alpha, &direction, p);
        basis.extend(r.iter().map(|r| r / progress.square.sqrt()));
        add(-alpha, &direction, &mut r);
        add(-alpha, &product, &mut r);
        for _ in 0..2 {
            for q in basis.chunks_exact(n) {
                let c = dot(q, &r);
                add(-c, q, &mut r);
            }
        }
        let beta = progress.advance(dot(&r, &r));
        direction.iter_mut().zip(&r).for_each(|(d, r)| *d = r + beta * *d);
    }
    Ok(progress.end())
}

/// The same p, iterate for iterate, by restricted conjugate gradients in observation space (Gratton and Tshimanga 2009; the
/// background term about z_b as in Gürol et al. 2014): PSAS and 4D-PSAS.
///
/// All residuals and directions of the primal lie in the range of [Gᵀ, b], so they are written r = [Gᵀ, b] r̂ with r̂ of length
/// m + 1, and the recurrences, the inner products and the re-orthogonalisation run on r̂ and K r̂, with
///
/// ```text
///     K = [Gᵀ, b]ᵀ [Gᵀ, b],    G Gᵀ = R^{-1/2} H B Hᵀ R^{-1/2},    A [Gᵀ, b] r̂ = [Gᵀ, b] (r̂ + (K r̂, 0))
/// ```
///
/// through the same sweeps as the primal. B enters by its products only. p falls as the primal's does, so an early stop is safe,
/// unlike one of a plain minimizer of [`Dual`](crate::Dual).
///
/// When to use: m well below n, and many iterations. When not: m above n/2, where the primal needs less memory.
///
/// Cost of an iteration: one adjoint and one tangent sweep. Memory: 4n + 5m, and 2m more for each iteration, where [`conjugate_gradients`]
/// needs n.
///
/// # Errors
/// Products that fail or are not finite.
///
/// # Panics
/// If nothing has been linearized, or `p` is not of length `dim`.
pub fn restricted_conjugate_gradients(
    problem: &mut dyn Incremental,
    limits: &InnerLimits,
    p: &mut [f64],
) -> Result<InnerEnd, Error> {
    let (n, m) = (problem.dim(), problem.departure_dim());
    let mut b = vec![0.0; n];
    // r̂ = (d, −1): r = Gᵀd − b.
    let mut r = vec![-1.0; m + 1];
    problem.departures(&mut b, &mut r[..m]);
    // K r̂, with r itself on the way.
    let mut product = |r: &[f64], control: &mut [f64], kr: &mut [f64]| {
        problem.adjoint(&r[..m], control)?;
        add(r[m], &b, control);
        problem.tangent(control, &mut kr[..m])?;
        kr[m] = dot(&b, control);
        Ok::<(), Error>(())
    };
    let mut control = vec![0.0; n];
    let mut kr = vec![0.0; m + 1];
    product(&r, &mut control, &mut kr)?;
    let mut direction = r.clone();
    let mut k_direction = kr.clone();
    let mut direction_control = control.clone();
    let (mut basis, mut k_basis) = (Vec::new(), Vec::new());
    let mut progress = Progress::new(dot(&control, &control));
    p.fill(0.0);
    while progress.goes_on(limits, n)? {
        let g_direction = &k_direction[..m];
        let alpha =
            progress.square / (dot(&direction_control, &direction_control) + dot(g_direction, g_direction));
        add(alpha, &direction_control, p);
        let length = progress.square.sqrt();
        basis.extend(r.iter().map(|r| r / length));
        k_basis.extend(kr.iter().map(|r| r / length));
        add(-alpha, &direction, &mut r);
        add(-alpha, g_direction, &mut r[..m]);
        for _ in 0..2 {
            for (q, kq) in basis.chunks_exact(m + 1).zip(k_basis.chunks_exact(m + 1)) {
                let c = dot(kq, &r);
                add(-c, q, &mut r);
            }
        }
        product(&r, &mut control, &mut kr)?;
        let beta = progress.advance(dot(&control, &control));
        for (old, new) in [(&mut direction, &r), (&mut k_direction, &kr), (&mut direction_control, &control)]
        {
            old.iter_mut().zip(new).for_each(|(old, new)| *old = new + beta * *old);
        }
    }
    Ok(progress.end())
}

/// The squared residual of both, and when they stop.
struct Progress {
    first: f64,
    square: f64,
    iterations: usize,
}

impl Progress {
    fn new(square: f64) -> Self {
        Self { first: square, square, iterations: 0 }
    }

    /// A Krylov space has no more than n dimensions.
    fn goes_on(&self, limits: &InnerLimits, n: usize) -> Result<bool, Error> {
        if !self.square.is_finite() {
            return Err(Error::NonFinite { what: "a residual of the inner problem", step: 0 });
        }
        Ok(self.iterations < limits.iterations.min(n)
            && self.square > 0.0
            && self.square.sqrt() > limits.residual * self.first.sqrt())
    }

    /// β.
    fn advance(&mut self, square: f64) -> f64 {
        self.iterations += 1;
        let beta = square / self.square;
        self.square = square;
        beta
    }

    fn end(&self) -> InnerEnd {
        let residual = if self.first > 0.0 { (self.square / self.first).sqrt() } else { 0.0 };
        InnerEnd { iterations: self.iterations, residual }
    }
}

/// y += a x.
fn add(a: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}
