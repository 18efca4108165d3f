//! The posterior covariance as the identity less a few directions: from Lanczos iterations or from what
//! L-BFGS has learnt.

use crate::cost::dot;
use crate::lanczos_space::{Around, Space, Split, best_split, normals, probe};
use crate::minimize::{at_least_one, setters};
use crate::{ControlTransform, Error, InverseHessian, LeastSquares};
use rand::Rng;
use varda_linalg::krylov::{Lanczos, Product, Ritz};

/// A posterior of low rank around the prior, in the control variable:
///
/// ```text
///     P_v = A⁻¹ ≈ I − Σ_i (1 − 1/μ_i) q_i q_iᵀ,    P_z = U P_v Uᵀ
/// ```
///
/// When to use: where the observations determine few directions of many (4 to 11 of 144 on the hanging rod),
/// so that A is the identity but for a few large eigenvalues. When not: for n up to a few hundred
/// [`Posterior`](crate::Posterior) is exact; where everything is observed there is no low rank, and a bound
/// below 1 takes as many products as there are directions.
///
/// | made by | products with A | error |
/// |---|---|---|
/// | [`lanczos`](Self::lanczos) | about twice the pairs kept | a bound, to the tolerance asked for |
/// | [`lanczos_exact`](Self::lanczos_exact) | the same, with ∇²J | a bound, if definite |
/// | [`from_inverse_hessian`](Self::from_inverse_hessian) | none | an estimate, often no better than 1 |
/// | [`refined`](Self::refined) | one for each direction of L-BFGS, and what is missing | a bound |
///
/// Cost: one tangent and one adjoint sweep a product. Memory: a vector for every product while it is made
/// (two, if refined), one for every pair afterwards.
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
/// use rand::{SeedableRng, rngs::ChaCha8Rng};
/// // x₀ and x₂ of Lorenz-63 seen at step 20: `cost` is its strong constraint.
/// let mut v = vec![0.0; 3];
/// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// let mut rng = ChaCha8Rng::seed_from_u64(1);
/// let posterior = LowRankPosterior::lanczos(&mut cost, &LanczosOptions::default(), &mut rng)?;
/// assert!(posterior.error_bound().is_some_and(|bound| bound < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct LowRankPosterior {
    n: usize,
    /// μ, ascending.
    values: Vec<f64>,
    /// q, one after the other.
    vectors: Vec<f64>,
    error_bound: Option<f64>,
    products: usize,
}

/// Settings of [`LowRankPosterior::lanczos`] and [`LowRankPosterior::refined`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LanczosOptions {
    /// Stop when the error bound ‖P_v − A⁻¹‖ is below this (prior variances in v are 1).
    pub tolerance: f64,
    /// Products with the Hessian at most, and vectors kept; those of the probes come on top.
    pub max_products: usize,
    /// Random vectors, one product each, that say what has been missed; the bound fails with probability
    /// 10^{−probes}.
    pub probes: usize,
}

impl Default for LanczosOptions {
    fn default() -> Self {
        Self { tolerance: 1e-6, max_products: 200, probes: 6 }
    }
}

setters!(LanczosOptions {
    with_tolerance: tolerance: f64,
    with_max_products: max_products: usize,
    with_probes: probes: usize,
});

impl LowRankPosterior {
    /// From Lanczos iterations with full re-orthogonalisation, started from a random vector, around the point
    /// of the last gradient of `cost`.
    ///
    /// The pairs kept, with residuals r_i, are those that give the least bound
    ///
    /// ```text
    ///     ‖P_v − A⁻¹‖₂ ≤ ν / (1 − ν) + 1 − 1/(1 + ω),    ν² = Σ r_i² / μ_i,
    ///     ω = 10 (2/π)^{1/2} max_j ‖Π(A − I)Π w_j‖
    /// ```
    ///
    /// The first part is for the pairs kept being inexact (scaled by the roots of its diagonal blocks, the
    /// off-diagonal block of A between them and the rest has norm ≤ ν, since A ⪰ I). The second is for
    /// all that was left out: Π projects on the complement of the pairs, and ω bounds A − I there, with
    /// probability 1 − 10^{−probes}, from products with that many random vectors w_j (Halko, Martinsson
    /// and Tropp 2011, lemma 4.1). The probes find what Lanczos iterations may miss, such as copies of a
    /// multiple eigenvalue.
    ///
    /// Where the Krylov space ends and the probes find more, as with components observed directly with equal
    /// σ, directions are added as in [`Self::refined`]. Stops at the tolerance, at `max_products`, or when
    /// nothing is left; see [`Self::error_bound`] for what was reached.
    ///
    /// # Errors
    /// Products that fail, or settings out of range.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn lanczos<R: Rng + ?Sized>(
        cost: &mut dyn LeastSquares,
        options: &LanczosOptions,
        rng: &mut R,
    ) -> Result<Self, Error> {
        let n = cost.dim();
        Self::iterate(n, &mut |p, out| cost.hessian_apply(p, out), Around::AboveOne, options, rng)
    }

    /// The same of the exact Hessian A of J at that point, whose eigenvalues lie on both sides of 1. Kept are
    /// the pairs farthest from 1; with φ = ν + ω, scaled as above, ω of the rest and μ_1 the least that
    /// is kept,
    ///
    /// ```text
    ///     ‖P_v − A⁻¹‖₂ ≤ φ / (1 − φ) / min(1, μ_1)    where φ < 1
    /// ```
    ///
    /// since D^{-1/2} A D^{-1/2} = I + F with D the blocks of P_v⁻¹ and ‖F‖ ≤ φ: A is then positive
    /// definite. There is no bound ([`Self::error_bound`] is `None`) where φ stays above 1.
    ///
    /// # Errors
    /// [`Error::NoSecondDerivatives`]; [`Error::NotPositiveDefinite`] where a Ritz value, and with it an
    /// eigenvalue of A, is not positive; those of [`Self::lanczos`].
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn lanczos_exact<R: Rng + ?Sized>(
        cost: &mut dyn LeastSquares,
        options: &LanczosOptions,
        rng: &mut R,
    ) -> Result<Self, Error> {
        let n = cost.dim();
        Self::iterate(n, &mut |p, out| cost.exact_hessian_apply(p, out), Around::BothSides, options, rng)
    }

    fn iterate<R: Rng + ?Sized>(
        n: usize,
        product: &mut Product<Error>,
        around: Around,
        options: &LanczosOptions,
        rng: &mut R,
    ) -> Result<Self, Error> {
        options.check()?;
        let probes = probe(n, product, options.probes, rng)?;
        let mut lanczos = Lanczos::new(n);
        lanczos.begin(&normals(n, rng));
        let mut next_check = 1;
        loop {
            lanczos.extend(product)?;
            let k = lanczos.iterations();
            let ended = lanczos.invariant() || k >= options.max_products;
            if k < next_check && !ended {
                continue;
            }
            next_check = k + 1 + k / 8;
            let Ritz { values, vectors, coupling } = lanczos.ritz()?;
            let q = lanczos.extension();
            let residuals: Vec<f64> = coupling.iter().flat_map(|c| q.iter().map(move |q| c * q)).collect();
            let split = best_split(around, &values, &vectors, &residuals, &probes);
            if split.bound <= options.tolerance || k >= options.max_products.min(n) {
                return Self::kept(n, &values, &vectors, &split, k + options.probes);
            }
            if ended {
                let mut space = Space::of(values, vectors, residuals);
                let until = (options.tolerance, options.max_products);
                let (values, vectors, split) = space.grown(product, until, (around, &probes), rng)?;
                return Self::kept(n, &values, &vectors, &split, space.dim() + options.probes);
            }
        }
    }

    /// From what L-BFGS has learnt of the Hessian of J on its way: no products with the Hessian at all, no
    /// tangent model.
    ///
    /// The pairs y ≈ A s, newest first, give A on the space of the steps (Rayleigh–Ritz); steps that are
    /// within 10⁻³ of dependent on newer ones are left out, and eigenvalues below 1, which A does not
    /// have, are put to 1. Exact on that space where J is quadratic; the directions no step went along keep
    /// their prior variance 1. (L-BFGS's own matrix, [`InverseHessian::apply`], fits the last pair only and
    /// is much further off.)
    ///
    /// How good it is depends on the path, and without products no bound better than 1 can come with it: what
    /// no step has met is unknown. [`Self::error_estimate`] says how far off it is for a few products,
    /// [`Self::refined`] makes it as good as asked for. It refers to the Hessian of J, second derivatives
    /// included, along the way.
    ///
    /// # Errors
    /// An eigenvalue problem that fails.
    pub fn from_inverse_hessian(inverse: &InverseHessian) -> Result<Self, Error> {
        let mut space = Space::new(inverse.dim());
        for i in (0..inverse.pairs()).rev() {
            let (s, y) = inverse.pair(i);
            space.add(s, y);
        }
        let (values, vectors) = space.ritz()?;
        let values = values.iter().map(|mu| mu.max(1.0)).collect();
        Ok(Self { n: inverse.dim(), values, vectors, error_bound: None, products: 0 })
    }

    /// From the space of L-BFGS's steps, newest first, with the curvature along it measured by one product
    /// each around the point of the last gradient of `cost`; then, one more product at a time, the largest
    /// residual, or where that is far below what the probes find a random direction, until the bound is at
    /// most the tolerance. The bound is that of [`Self::lanczos`], with r_i = A z_i − μ_i z_i the
    /// residuals of the Ritz pairs:
    ///
    /// ```text
    ///     ‖P_v − A⁻¹‖₂ ≤ ν / (1 − ν) + 1 − 1/(1 + ω),    ν² = Σ ‖r_i‖² / μ_i
    /// ```
    ///
    /// When to use: after L-BFGS that kept its pairs (`memory` above its iterations), whose directions are
    /// then those that matter and are not looked for again. When not: after anything else. Cost beyond the
    /// products: n k² a product of the second kind, k being all products.
    ///
    /// # Errors
    /// Products that fail, or settings out of range.
    ///
    /// # Panics
    /// If no gradient has been evaluated, or `inverse` is of another length than `cost`.
    pub fn refined<R: Rng + ?Sized>(
        inverse: &InverseHessian,
        cost: &mut dyn LeastSquares,
        options: &LanczosOptions,
        rng: &mut R,
    ) -> Result<Self, Error> {
        options.check()?;
        let n = cost.dim();
        assert_eq!(inverse.dim(), n, "length of the control variable");
        let mut product = |p: &[f64], out: &mut [f64]| cost.hessian_apply(p, out);
        let probes = probe(n, &mut product, options.probes, rng)?;
        let mut space = Space::new(n);
        for i in (0..inverse.pairs()).rev() {
            if space.dim() < options.max_products {
                space.add_measured(inverse.pair(i).0, &mut product)?;
            }
        }
        let (known, until) = ((Around::AboveOne, &probes), (options.tolerance, options.max_products));
        let (values, vectors, split) = space.grown(&mut product, until, known, rng)?;
        Self::kept(n, &values, &vectors, &split, space.dim() + options.probes)
    }

    /// The pairs of a split.
    fn kept(
        n: usize,
        values: &[f64],
        vectors: &[f64],
        split: &Split,
        products: usize,
    ) -> Result<Self, Error> {
        if let Some(&smallest) = values.first().filter(|smallest| !(**smallest > 0.0)) {
            return Err(Error::NotPositiveDefinite { smallest });
        }
        Ok(Self {
            n,
            values: split.kept.iter().map(|&i| values[i]).collect(),
            vectors: split.kept.iter().flat_map(|&i| &vectors[i * n..][..n]).copied().collect(),
            error_bound: Some(split.bound).filter(|bound| bound.is_finite()),
            products,
        })
    }

    /// Upper bound of ‖P_v − A⁻¹‖₂, with the probability stated at [`Self::lanczos`]; `None` where
    /// there is none.
    ///
    /// Every variance of z is then right to within the bound times its prior variance, and the trace to the
    /// bound times tr B.
    pub fn error_bound(&self) -> Option<f64> {
        self.error_bound
    }

    /// Estimates ‖P_v A − I‖_F, which is at least ‖P_v − A⁻¹‖₂ since A ⪰ I, from `samples`
    /// random vectors w: the mean of ‖(P_v A − I) w‖² is its square. One product with the Hessian
    /// each; relative error about (2 / samples)^{1/2} at worst.
    ///
    /// # Errors
    /// Products that fail.
    ///
    /// # Panics
    /// If no gradient has been evaluated, `samples` is 0 or the cost is of another length.
    pub fn error_estimate<R: Rng + ?Sized>(
        &self,
        cost: &mut dyn LeastSquares,
        samples: usize,
        rng: &mut R,
    ) -> Result<f64, Error> {
        assert!(samples > 0, "no samples");
        let mut product = vec![0.0; self.n];
        let mut sum = 0.0;
        for _ in 0..samples {
            let w = normals(self.n, rng);
            cost.hessian_apply(&w, &mut product)?;
            self.scale(&mut product, |mu| 1.0 / mu);
            sum += product.iter().zip(&w).map(|(p, w)| (p - w) * (p - w)).sum::<f64>();
        }
        Ok((sum / samples as f64).sqrt())
    }

    /// Products with the Hessian that were made, those of the probes included.
    pub fn products(&self) -> usize {
        self.products
    }

    /// The eigenvalues of A that were found, ascending; all others are taken to be 1.
    pub fn spectrum(&self) -> &[f64] {
        &self.values
    }

    /// Degrees of freedom for signal, Σ (1 − 1/μ).
    pub fn degrees_of_freedom(&self) -> f64 {
        self.values.iter().map(|mu| 1.0 - 1.0 / mu).sum()
    }

    /// out = P_v x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn apply(&self, x: &[f64], out: &mut [f64]) {
        assert_eq!(x.len(), self.n, "length of x");
        out.copy_from_slice(x);
        self.scale(out, |mu| 1.0 / mu);
    }

    /// Variances of v, the diagonal of P_v.
    pub fn control_variable_variance(&self) -> Vec<f64> {
        let mut variance = vec![1.0; self.n];
        for (mu, q) in self.pairs() {
            variance.iter_mut().zip(q).for_each(|(s, q)| *s -= (1.0 - 1.0 / mu) * q * q);
        }
        variance
    }

    /// Variances of z, the diagonal of P_z = B − Σ (1 − 1/μ) (Uq)(Uq)ᵀ.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn variance(&self, transform: &ControlTransform) -> Vec<f64> {
        assert_eq!(transform.dim(), self.n, "length of the control variable");
        let mut variance = vec![0.0; transform.control_dim()];
        let mut z = variance.clone();
        transform.covariance().variance(&mut variance);
        for (mu, q) in self.pairs() {
            transform.tangent(q, &mut z);
            variance.iter_mut().zip(&z).for_each(|(s, z)| *s -= (1.0 - 1.0 / mu) * z * z);
        }
        variance
    }

    /// tr P_z.
    ///
    /// # Panics
    /// If the transform is of another length.
    pub fn trace(&self, transform: &ControlTransform) -> f64 {
        self.variance(transform).iter().sum()
    }

    /// A draw of the control from N(z, P_z) around the analysis z of v: z_b + U (v + P_v^{1/2} ξ), P_v^{1/2}
    /// = I − Σ (1 − μ^{-1/2}) q qᵀ.
    ///
    /// # Panics
    /// If a length does not agree with the transform.
    pub fn draw<R: Rng + ?Sized>(&self, transform: &ControlTransform, v: &[f64], rng: &mut R) -> Vec<f64> {
        assert_eq!((v.len(), transform.dim()), (self.n, self.n), "length of the control variable");
        let mut w = normals(self.n, rng);
        self.scale(&mut w, |mu| 1.0 / mu.sqrt());
        w.iter_mut().zip(v).for_each(|(w, v)| *w += v);
        let mut z = vec![0.0; transform.control_dim()];
        transform.control(&w, &mut z);
        z
    }

    /// x ← f(A) x, with f(1) = 1.
    fn scale(&self, x: &mut [f64], f: impl Fn(f64) -> f64) {
        for (mu, q) in self.pairs() {
            let c = (f(mu) - 1.0) * dot(q, x);
            x.iter_mut().zip(q).for_each(|(x, q)| *x += c * q);
        }
    }

    fn pairs(&self) -> impl Iterator<Item = (f64, &[f64])> {
        self.values.iter().copied().zip(self.vectors.chunks_exact(self.n.max(1)))
    }
}

impl LanczosOptions {
    fn check(&self) -> Result<(), Error> {
        if !(self.tolerance > 0.0) {
            return Err(Error::Setting { what: "tolerance", value: self.tolerance });
        }
        at_least_one("max_products", self.max_products)?;
        at_least_one("probes", self.probes)
    }
}
