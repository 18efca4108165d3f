//! The posterior covariance from the dense Gauss–Newton Hessian.

use crate::cost::{dense_jacobian, parts, rows, solve_identity_plus};
use crate::minimize::eigen;
use crate::{ControlTransform, Error, LeastSquares};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use varda_linalg::dense::{View, add_product};
use varda_linalg::{Svd, interrupt};

/// The posterior of a linear-Gaussian problem, or its Laplace approximation around the linearized point:
///
/// ```text
///     P_v = A⁻¹ = (I + GᵀG)⁻¹,    P_z = U P_v Uᵀ = (B⁻¹ + MᵀHᵀR⁻¹HM)⁻¹
///     (paper 2.7, 2.18)
/// ```
///
/// kept as a square root of P_v. With fewer observations than unknowns, m < n, A has the eigenvalue 1 but for
/// m directions z of G = Σ s w zᵀ, and the root is
///
/// ```text
///     P_v^{1/2} = I − Σ (1 − μ^{-1/2}) z zᵀ,    μ = 1 + s²
/// ```
///
/// When to use: n up to a few thousand. When not: larger n ([`LowRankPosterior`](crate::LowRankPosterior));
/// where the dropped second derivatives matter at the minimum, for there the true curvature, and with it the
/// spread, differs. Cost: n tangent or m adjoint sweeps and 9 n³ or so, some 6 n m² + 2 n² m for
/// m < n. Memory: 2n².
///
/// ```
/// # use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// # use varda_covariance::Diagonal;
/// # use varda_implicit::{Rk4, lorenz::Lorenz63};
/// # let (mut model, b) = (Rk4::new(Lorenz63::default(), 0, 0.01), Diagonal::uniform(3, 1.0)?);
/// # let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// # let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
/// # let mut observations = ObservationSet::new(20, vec![all], seen)?;
/// # let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// # let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
/// // x₀ and x₂ of Lorenz-63 seen at step 20: `cost` is its strong constraint.
/// let mut v = vec![0.0; 3];
/// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// let posterior = Posterior::new(&mut cost)?;
/// assert!(posterior.variance(&transform).iter().all(|variance| *variance <= 1.0)); // B = I
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Posterior {
    /// Eigenvalues of A, ascending; ≥ 1 up to rounding.
    eigenvalues: Vec<f64>,
    /// A square root of P_v, by columns: eigenvectors of A, each scaled by μ^{-1/2}; the symmetric one where
    /// most are 1.
    root: Vec<f64>,
}

impl Posterior {
    /// Around the point of the last gradient of `cost`.
    ///
    /// With fewer observations than unknowns G is factored by its singular values. Else I + GᵀG is, but
    /// where its rounding would reach the eigenvalue 1 of what nothing observes (to 10⁻⁶: σ tiny against
    /// the background): then it is G again, n tangent or m adjoint sweeps more, and some 20 n² m.
    ///
    /// # Errors
    /// Products that fail, a G that is not finite, or the Hessian of a cost of one's own that is not positive
    /// definite.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn new(cost: &mut dyn LeastSquares) -> Result<Self, Error> {
        let n = cost.dim();
        // A cost of one's own without observations may have another Hessian than I.
        if (1..n).contains(&cost.observation_dim()) {
            return Self::factored(cost);
        }
        let mut hessian = vec![0.0; n * n];
        cost.hessian(&mut hessian)?;
        match eigen(n, &hessian) {
            Ok((eigenvalues, vectors)) if is_resolved(&eigenvalues) => Self::of_pairs(eigenvalues, vectors),
            _ => Self::factored(cost),
        }
    }

    /// From a singular value decomposition of G.
    fn factored(cost: &mut dyn LeastSquares) -> Result<Self, Error> {
        let (n, m) = (cost.dim(), cost.observation_dim());
        let g = dense_jacobian(cost)?;
        let mut svd = Svd::thin(m, n, &g)?;
        // Rounding of I − … is ε, of the smallest σ 1/s: where that shows, a whole basis.
        let whole = m >= n || svd.values.first().is_some_and(|s| n as f64 * f64::EPSILON * s > 1e-7);
        if whole && m < n {
            svd = Svd::new(m, n, &g)?;
        }
        let Svd { values, right, .. } = svd;
        // The directions that nothing sees come first, with eigenvalue 1.
        let unseen = vec![1.0; n - values.len()];
        let eigenvalues: Vec<f64> =
            unseen.into_iter().chain(values.iter().rev().map(|s| 1.0 + s * s)).collect();
        if whole {
            let vectors = right.chunks_exact(n.max(1)).rev().flatten().copied().collect();
            return Self::of_pairs(eigenvalues, vectors);
        }
        let mut root: Vec<f64> = (0..n * n).map(|i| f64::from(i % (n + 1) == 0)).collect();
        let mut weighted = right.clone();
        for (z, s) in weighted.chunks_exact_mut(n).zip(&values) {
            // 1 − μ^{-1/2} = s²/(μ + √μ), which keeps its digits for small s
            let mu = 1.0 + s * s;
            z.iter_mut().for_each(|z| *z *= s * s / (mu + mu.sqrt()));
        }
        let z = View::new(&right, n, values.len());
        add_product(-1.0, View::new(&weighted, n, values.len()), z.transpose(), &mut root);
        Ok(Self { eigenvalues, root })
    }

    /// Of the initial state alone, where the control goes on with errors of the model (weak constraint): with
    /// G = [G_b, G_q] the errors are integrated out,
    ///
    /// ```text
    ///     A_b = I + G_bᵀ (I + G_q G_qᵀ)⁻¹ G_b,
    ///     P_b = A_b⁻¹, the leading block of (I + GᵀG)⁻¹
    /// ```
    ///
    /// around the last point linearized. Costs m adjoint sweeps, memory m times the length of the control,
    /// and m² numbers. Without model error it is [`new`](Self::new).
    ///
    /// # Errors
    /// Products or a factorization that fail.
    ///
    /// # Panics
    /// If nothing has been linearized.
    pub fn of_initial_state(problem: &mut dyn LeastSquares) -> Result<Self, Error> {
        let rows = rows(problem)?;
        Self::of_initial_rows(problem, &rows)
    }

    /// [`of_initial_state`](Self::of_initial_state) where the rows of G are at hand.
    pub(crate) fn of_initial_rows(problem: &mut dyn LeastSquares, rows: &[f64]) -> Result<Self, Error> {
        let (n, m) = (problem.background_dim(), problem.observation_dim());
        let q = problem.dim() - n;
        let [g_b, g_q] = parts(n, m, rows);
        let mut weighted = g_b.clone();
        match solve_identity_plus(View::new(&g_q, q, m), &mut weighted) {
            Err(Error::NotPositiveDefinite { .. }) => return Self::initial_factored(problem),
            solved => solved?,
        }
        let mut hessian: Vec<f64> = (0..n * n).map(|i| f64::from(i % (n + 1) == 0)).collect();
        let g = View::new(&g_b, m, n);
        add_product(1.0, g.transpose(), View::new(&weighted, m, n), &mut hessian);
        match eigen(n, &hessian) {
            Ok((eigenvalues, vectors)) if is_resolved(&eigenvalues) => Self::of_pairs(eigenvalues, vectors),
            _ => Self::initial_factored(problem),
        }
    }

    /// From a singular value decomposition of all of G: the leading rows of a root of (I + GᵀG)⁻¹
    /// are a root of P_b, and have a decomposition of their own.
    fn initial_factored(problem: &mut dyn LeastSquares) -> Result<Self, Error> {
        let leading: Vec<usize> = (0..problem.background_dim()).collect();
        Self::factored(problem)?.marginal(&leading)
    }

    /// The posterior of some components of v, whatever the others are: the rows of a root of P_v that belong
    /// to them are a root of their covariance, and have a singular value decomposition of their own. Of one
    /// cost among several ([`Joint`](crate::Joint)) it is that of its own v.
    ///
    /// # Errors
    /// A decomposition that fails.
    ///
    /// # Panics
    /// If there is no such component.
    pub fn marginal(&self, components: &[usize]) -> Result<Self, Error> {
        let (n, r) = (components.len(), self.eigenvalues.len());
        let rows: Vec<f64> =
            self.root.chunks_exact(r.max(1)).flat_map(|z| components.iter().map(|i| z[*i])).collect();
        let Svd { values, left, .. } = Svd::new(n, r, &rows)?;
        let eigenvalues = values.iter().map(|s| 1.0 / (s * s)).collect();
        Self::of_pairs(eigenvalues, left)
    }

    /// From the exact Hessian ∇²J around the point of the last gradient of `cost`, in place of A: the
    /// Laplace approximation itself. Where the two differ the problem is nonlinear within the spread of its
    /// posterior.
    ///
    /// Cost: n products of the second-order adjoint, and an eigenvalue decomposition.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] where J is not convex at that point, [`Error::NoSecondDerivatives`] for
    /// a cost without; products that fail.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn exact(cost: &mut dyn LeastSquares) -> Result<Self, Error> {
        let n = cost.dim();
        let mut hessian = vec![0.0; n * n];
        cost.exact_hessian(&mut hessian)?;
        Self::from_hessian(n, &hessian)
    }

    /// From a Hessian in the control variable, n × n.
    ///
    /// # Errors
    /// A Hessian that is not positive definite.
    ///
    /// # Panics
    /// If `hessian` is not of length n².
    pub fn from_hessian(n: usize, hessian: &[f64]) -> Result<Self, Error> {
        assert_eq!(hessian.len(), n * n, "length of the Hessian");
        let (eigenvalues, vectors) = eigen(n, hessian)?;
        Self::of_pairs(eigenvalues, vectors)
    }

    /// From the eigenpairs of A.
    fn of_pairs(eigenvalues: Vec<f64>, vectors: Vec<f64>) -> Result<Self, Error> {
        if let Some(&smallest) = eigenvalues.first()
            && !(smallest > 0.0)
        {
            return Err(Error::NotPositiveDefinite { smallest });
        }
        let (n, mut root) = (eigenvalues.len(), vectors);
        for (column, mu) in root.chunks_exact_mut(n.max(1)).zip(&eigenvalues) {
            column.iter_mut().for_each(|z| *z /= mu.sqrt());
        }
        Ok(Self { eigenvalues, root })
    }

    /// Eigenvalues of A, ascending: 1 where nothing was observed, 1 + (signal / noise)² elsewhere.
    pub fn spectrum(&self) -> &[f64] {
        &self.eigenvalues
    }

    /// The columns of a square root of P_v.
    pub(crate) fn columns(&self) -> impl Iterator<Item = &[f64]> {
        self.root.chunks_exact(self.eigenvalues.len().max(1))
    }

    /// Degrees of freedom for signal, tr(I − A⁻¹) = Σ (1 − 1/μ): how many directions the
    /// observations determine.
    pub fn degrees_of_freedom(&self) -> f64 {
        self.eigenvalues.iter().map(|mu| (mu - 1.0) / mu).sum()
    }

    /// Variances of v, the diagonal of P_v.
    pub fn control_variable_variance(&self) -> Vec<f64> {
        sum_of_squares(&self.root, self.eigenvalues.len())
    }

    /// Variances of z, the diagonal of P_z = U A⁻¹ Uᵀ; square roots of them are σ_a.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn variance(&self, transform: &ControlTransform) -> Vec<f64> {
        sum_of_squares(&self.control_root(transform), transform.control_dim())
    }

    /// tr P_z.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn trace(&self, transform: &ControlTransform) -> f64 {
        self.variance(transform).iter().sum()
    }

    /// P_z, dense, by columns.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn covariance(&self, transform: &ControlTransform) -> Vec<f64> {
        let n = transform.control_dim();
        let mut covariance = vec![0.0; n * n];
        for w in self.control_root(transform).chunks_exact(n) {
            if interrupt::requested() {
                break;
            }
            for (column, wj) in covariance.chunks_exact_mut(n).zip(w) {
                column.iter_mut().zip(w).for_each(|(c, wi)| *c += wi * wj);
            }
        }
        covariance
    }

    /// A draw of the control from N(z, P_z) around the analysis z of v: z_b + U (v + A^{-1/2} ξ), with ξ
    /// from the caller's generator.
    ///
    /// # Panics
    /// If a length does not agree with the transform.
    pub fn draw<R: Rng + ?Sized>(&self, transform: &ControlTransform, v: &[f64], rng: &mut R) -> Vec<f64> {
        let n = self.eigenvalues.len();
        assert_eq!((v.len(), transform.dim()), (n, n), "length of the control variable");
        let mut w = v.to_vec();
        for column in self.root.chunks_exact(n.max(1)) {
            let xi: f64 = StandardNormal.sample(rng);
            w.iter_mut().zip(column).for_each(|(w, c)| *w += xi * c);
        }
        let mut z = vec![0.0; transform.control_dim()];
        transform.control(&w, &mut z);
        z
    }

    /// How Gaussian the posterior is within its own spread: draws v + A^{-1/2} ξ, |ξ|² = 2 ΔJ̃ by the
    /// quadratic model, evaluated by J itself, weigh w = exp(ΔJ̃ − ΔJ), and the share of them that
    /// counts is that of importance sampling (Kong 1992),
    ///
    /// ```text
    ///     (Σ w)² / (N Σ w²)
    /// ```
    ///
    /// 1 for a quadratic J. A draw from which the model cannot be run weighs nothing. Costs a forward run
    /// each; the cost's last gradient is still that at v.
    ///
    /// # Errors
    /// A cost that cannot be evaluated at v.
    ///
    /// # Panics
    /// If v has the wrong length.
    pub fn effective_share<R: Rng + ?Sized>(
        &self,
        cost: &mut dyn LeastSquares,
        v: &[f64],
        draws: usize,
        rng: &mut R,
    ) -> Result<f64, Error> {
        let n = self.eigenvalues.len();
        assert_eq!(v.len(), n, "length of the control variable");
        let at = cost.evaluate(v, None)?;
        let mut logarithms = Vec::with_capacity(draws);
        for _ in 0..draws {
            let (mut w, mut predicted) = (v.to_vec(), 0.0);
            for column in self.root.chunks_exact(n.max(1)) {
                let xi: f64 = StandardNormal.sample(rng);
                predicted += 0.5 * xi * xi;
                w.iter_mut().zip(column).for_each(|(w, c)| *w += xi * c);
            }
            if let Ok(value) = cost.evaluate(&w, None) {
                logarithms.push(predicted - (value - at));
            }
        }
        cost.evaluate(v, Some(&mut vec![0.0; n]))?;
        let largest = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights = logarithms.iter().map(|l| (l - largest).exp());
        let (sum, squares) = weights.fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
        Ok(if squares > 0.0 { sum * sum / (draws as f64 * squares) } else { 0.0 })
    }

    /// U A^{-1/2}, by columns of the length of the control: a square root of P_z.
    /// [`propagate_root`](crate::propagate_root) carries it through a window.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn control_root(&self, transform: &ControlTransform) -> Vec<f64> {
        let (n, n_z) = (self.eigenvalues.len(), transform.control_dim());
        assert_eq!(transform.dim(), n, "length of the control variable");
        let mut root = vec![0.0; n * n_z];
        for (v, z) in self.root.chunks_exact(n.max(1)).zip(root.chunks_exact_mut(n_z)) {
            if interrupt::requested() {
                break;
            }
            transform.tangent(v, z);
        }
        root
    }
}

/// Whether the eigenvalues of A = I + GᵀG, ascending, are right to 10⁻⁶ down to the smallest,
/// which is 1 or more: rounding leaves n ε of the largest.
fn is_resolved(eigenvalues: &[f64]) -> bool {
    let largest = eigenvalues.last().map_or(1.0, |mu| mu.abs());
    eigenvalues.len() as f64 * f64::EPSILON * largest <= 1e-6
}

/// The diagonal of W Wᵀ, W with `rows` rows, by columns.
fn sum_of_squares(w: &[f64], rows: usize) -> Vec<f64> {
    let mut sum = vec![0.0; rows];
    for column in w.chunks_exact(rows.max(1)) {
        sum.iter_mut().zip(column).for_each(|(s, w)| *s += w * w);
    }
    sum
}
