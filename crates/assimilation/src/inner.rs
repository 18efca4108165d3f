//! Conjugate gradients on the inner problem, in control space and in observation space, with the same
//! iterates.

use crate::{Error, LeastSquares};
use varda_linalg::krylov::{self, CgProgress};
pub use varda_linalg::krylov::{CgEnd as InnerEnd, CgLimits as InnerLimits};
use varda_linalg::{axpy, dot};

/// A p = −∇q(0), A = I + GᵀG, from p = 0 by conjugate gradients in the control space (n unknowns),
/// residuals re-orthogonalised twice.
///
/// When to use: the default of [`outer_loop`](crate::outer_loop). When not: m far below n and many
/// iterations, see [`restricted_conjugate_gradients`].
///
/// Cost of an iteration: one tangent and one adjoint sweep. Memory: 4n + m, and n more for each iteration.
///
/// # Errors
/// Products that fail or are not finite.
///
/// # Panics
/// If nothing has been linearized, or a slice is not of length `dim`.
pub fn conjugate_gradients(
    problem: &mut dyn LeastSquares,
    gradient: &[f64],
    limits: &InnerLimits,
    p: &mut [f64],
) -> Result<InnerEnd, Error> {
    let mut dy = vec![0.0; problem.observation_dim()];
    let right: Vec<f64> = gradient.iter().map(|g| -g).collect();
    let mut product = |direction: &[f64], out: &mut [f64]| {
        problem.jacobian(direction, &mut dy)?;
        problem.jacobian_transpose(&dy, out)?;
        axpy(1.0, direction, out);
        Ok::<f64, Error>(dot(direction, direction) + dot(&dy, &dy))
    };
    krylov::conjugate_gradients(&mut product, &right, limits, p)
}

/// The same p, iterate for iterate, by restricted conjugate gradients in observation space (Gratton and
/// Tshimanga 2009; the background term about z_b as in Gürol et al. 2014): PSAS and 4D-PSAS.
///
/// All residuals and directions of the primal lie in the range of [Gᵀ, b], so they are written r = [Gᵀ,
/// b] r̂ with r̂ of length m + 1, and the recurrences, the inner products and the re-orthogonalisation run
/// on r̂ and K r̂, with
///
/// ```text
///     K = [Gᵀ, b]ᵀ [Gᵀ, b],    G Gᵀ = R^{-1/2} H B Hᵀ R^{-1/2},
///     A [Gᵀ, b] r̂ = [Gᵀ, b] (r̂ + (K r̂, 0))
/// ```
///
/// through the same sweeps as the primal. B enters by its products only. p falls as the primal's does, so an
/// early stop is safe, unlike one of a plain minimizer of [`Dual`](crate::Dual).
///
/// When to use: m well below n, and many iterations. When not: m above n/2, where the primal needs less
/// memory.
///
/// Cost of an iteration: one adjoint and one tangent sweep. Memory: 4n + 5m, and 2m more for each iteration,
/// where [`conjugate_gradients`] needs n.
///
/// # Errors
/// Products that fail or are not finite.
///
/// # Panics
/// If nothing has been linearized, or `p` is not of length `dim`.
pub fn restricted_conjugate_gradients(
    problem: &mut dyn LeastSquares,
    limits: &InnerLimits,
    p: &mut [f64],
) -> Result<InnerEnd, Error> {
    let (n, m) = (problem.dim(), problem.observation_dim());
    let mut b = vec![0.0; n];
    // r̂ = (d, −1): r = Gᵀd − b.
    let mut r = vec![-1.0; m + 1];
    problem.departures(&mut b, &mut r[..m]);
    // K r̂, with r itself on the way.
    let mut product = |r: &[f64], control: &mut [f64], kr: &mut [f64]| {
        problem.jacobian_transpose(&r[..m], control)?;
        axpy(r[m], &b, control);
        problem.jacobian(control, &mut kr[..m])?;
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
    let mut progress = CgProgress::new(dot(&control, &control));
    p.fill(0.0);
    while progress.goes_on(limits, n)? {
        let g_direction = &k_direction[..m];
        let alpha =
            progress.square / (dot(&direction_control, &direction_control) + dot(g_direction, g_direction));
        axpy(alpha, &direction_control, p);
        let length = progress.square.sqrt();
        basis.extend(r.iter().map(|r| r / length));
        k_basis.extend(kr.iter().map(|r| r / length));
        axpy(-alpha, &direction, &mut r);
        axpy(-alpha, g_direction, &mut r[..m]);
        for _ in 0..2 {
            for (q, kq) in basis.chunks_exact(m + 1).zip(k_basis.chunks_exact(m + 1)) {
                let c = dot(kq, &r);
                axpy(-c, q, &mut r);
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
