//! The posterior covariance as the identity less a few directions: from Lanczos iterations or from what L-BFGS has learnt.

use crate::cost::{dot, norm};
use crate::minimize::{Lanczos, eigen};
use crate::{ControlTransform, Error, GaussNewton, InverseHessian};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// A posterior of low rank around the prior, in the control variable:
///
/// ```text
///     P_v = A⁻¹ ≈ I − Σ_i (1 − 1/μ_i) q_i q_iᵀ,    P_z = U P_v Uᵀ
/// ```
///
/// When to use: where the observations determine few directions of many (4 to 11 of 144 on the hanging rod), so that A is the identity
/// but for a few large eigenvalues. When not: for n up to a few hundred [`Posterior`](crate::Posterior) is exact.
///
/// Cost: one tangent and one adjoint sweep a product, about twice as many products as pairs. Memory: a vector for every product while
/// it is made, one for every pair afterwards.
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

/// Settings of [`LowRankPosterior::lanczos`].
#[derive(Debug, Clone, PartialEq)]
pub struct LanczosOptions {
    /// Stop when the error bound ‖P_v − A⁻¹‖ is below this (prior variances in v are 1).
    pub tolerance: f64,
    /// Lanczos iterations at most: products with the Hessian, and vectors kept.
    pub max_products: usize,
    /// Random vectors, one product each, that say what has been missed; the bound fails with probability 10^{−probes}.
    pub probes: usize,
}

impl Default for LanczosOptions {
    fn default() -> Self {
        Self { tolerance: 1e-6, max_products: 200, probes: 6 }
    }
}

impl LowRankPosterior {
    /// From Lanczos iterations with full re-orthogonalisation, started from a random vector, around the point of the last gradient of `cost`.
    ///
    /// The pairs kept, with residuals r_i, are those that give the least bound
    ///
    /// ```text
    ///     ‖P_v − A⁻¹‖₂ ≤ ν / (1 − ν) + 1 − 1/(1 + ω),    ν² = Σ r_i² / μ_i,    ω = 10 (2/π)^{1/2} max_j ‖Π(A − I)Π w_j‖
    /// ```
    ///
    /// The first part is for the pairs kept being inexact (scaled by the roots of its diagonal blocks, the off-diagonal block of A between
    /// them and the rest has norm ≤ ν, since A ⪰ I). The second is for all that was left out: Π projects on the complement of the
    /// pairs, and ω bounds A − I there, with probability 1 − 10^{−probes}, from products with that many random vectors w_j (Halko,
    /// Martinsson and Tropp 2011, lemma 4.1). The probes find what Lanczos iterations may miss, such as copies of a multiple eigenvalue.
    ///
    /// Stops at the tolerance, at `max_products`, or when nothing is left; see [`Self::error_bound`] for what was reached.
    ///
    /// # Errors
    /// Products that fail, or settings out of range.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn lanczos<R: Rng + ?Sized>(
        cost: &mut dyn GaussNewton,
        options: &LanczosOptions,
        rng: &mut R,
    ) -> Result<Self, Error> {
        if !(options.tolerance > 0.0) {
            return Err(Error::Setting { what: "tolerance", value: options.tolerance });
        }
        if options.max_products == 0 {
            return Err(Error::Setting { what: "max_products", value: 0.0 });
        }
        if options.probes == 0 {
            return Err(Error::Setting { what: "probes", value: 0.0 });
        }
        let n = cost.dim();
        let mut normals = || (0..n).map(|_| StandardNormal.sample(rng)).collect::<Vec<f64>>();
        let mut probes = Vec::new();
        for _ in 0..options.probes {
            let w = normals();
            let mut image = vec![0.0; n];
            cost.hessian_apply(&w, &mut image)?;
            image.iter_mut().zip(&w).for_each(|(a, w)| *a -= w);
            probes.push((w, image));
        }
        let mut lanczos = Lanczos::new(n);
        lanczos.begin(&normals());
        let mut next_check = 1;
        loop {
            lanczos.extend(&mut |p, out| cost.hessian_apply(p, out))?;
            let k = lanczos.iterations();
            let ended = lanczos.invariant() || k >= options.max_products;
            if k < next_check && !ended {
                continue;
            }
            next_check = k + 1 + k / 8;
            let values = lanczos.values()?;
            let vectors = lanczos.largest(k)?;
            let (kept, error_bound) = best_split(&values, &vectors, lanczos.coupling()?, &probes);
            if ended || error_bound <= options.tolerance {
                return Ok(Self {
                    n,
                    values: values[k - kept..].to_vec(),
                    vectors: vectors[(k - kept) * n..].to_vec(),
                    error_bound: Some(error_bound),
                    products: k + options.probes,
                });
            }
        }
    }

    /// From what L-BFGS has learnt of the Hessian of J on its way: no products with the Hessian at all, no tangent model.
    ///
    /// The pairs y ≈ A s, newest first, give A on the space of the steps (Rayleigh–Ritz); steps that are within 10⁻³ of dependent on newer
    /// ones are left out, and eigenvalues below 1, which A does not have, are put to 1. Exact on that space where J is quadratic; the
    /// directions no step went along keep their prior variance 1. (L-BFGS's own matrix, [`InverseHessian::apply`], fits
    /// the last pair only and is much further off.)
    ///
    /// How good it is depends on the path, and no bound comes with it: [`Self::error_estimate`] gives one for a few products. It
    /// refers to the Hessian of J, second derivatives included, along the way.
    ///
    /// # Errors
    /// An eigenvalue problem that fails.
    pub fn from_inverse_hessian(inverse: &InverseHessian) -> Result<Self, Error> {
        let n = inverse.dim();
        // Q orthonormal and A Q, by columns.
        let mut columns: Vec<(Vec<f64>, Vec<f64>)> = Vec::new();
        for i in (0..inverse.pairs()).rev() {
            let (s, y) = inverse.pair(i);
            let (mut q, mut aq) = (s.to_vec(), y.to_vec());
            let length = norm(s);
            // Twice is enough.
            for _ in 0..2 {
                for (p, ap) in &columns {
                    let c = dot(p, &q);
                    q.iter_mut().zip(p).for_each(|(q, p)| *q -= c * p);
                    aq.iter_mut().zip(ap).for_each(|(q, p)| *q -= c * p);
                }
            }
            let left = norm(&q);
            if left > 1e-3 * length {
                q.iter_mut().chain(&mut aq).for_each(|x| *x /= left);
                columns.push((q, aq));
            }
        }
        let k = columns.len();
        let mut small = vec![0.0; k * k];
        for (j, (q, aq)) in columns.iter().enumerate() {
            for (i, (p, ap)) in columns.iter().enumerate() {
                small[i + j * k] = 0.5 * (dot(p, aq) + dot(q, ap));
            }
        }
        let (values, small) = eigen(k, &small)?;
        let mut vectors = vec![0.0; n * k];
        for (z, w) in vectors.chunks_exact_mut(n.max(1)).zip(small.chunks_exact(k.max(1))) {
            for ((q, _), w) in columns.iter().zip(w) {
                z.iter_mut().zip(q).for_each(|(z, q)| *z += w * q);
            }
        }
        let values = values.iter().map(|mu| mu.max(1.0)).collect();
        Ok(Self { n, values, vectors, error_bound: None, products: 0 })
    }

    /// Upper bound of ‖P_v − A⁻¹‖₂, with the probability stated at [`Self::lanczos`]; `None` where there is none.
    ///
    /// Every variance of z is then right to within the bound times its prior variance, and the trace to the bound times tr B.
    pub fn error_bound(&self) -> Option<f64> {
        self.error_bound
    }

    /// Estimates ‖P_v A − I‖_F, which is at least ‖P_v − A⁻¹‖₂ since A ⪰ I, from `samples` random vectors w:
    /// the mean of ‖(P_v A − I) w‖² is its square. One product with the Hessian each; relative error about (2 / samples)^{1/2} at worst.
    ///
    /// # Errors
    /// Products that fail.
    ///
    /// # Panics
    /// If no gradient has been evaluated, `samples` is 0 or the cost is of another length.
    pub fn error_estimate<R: Rng + ?Sized>(
        &self,
        cost: &mut dyn GaussNewton,
        samples: usize,
        rng: &mut R,
    ) -> Result<f64, Error> {
        assert!(samples > 0, "no samples");
        let mut product = vec![0.0; self.n];
        let mut sum = 0.0;
        for _ in 0..samples {
            let w: Vec<f64> = (0..self.n).map(|_| StandardNormal.sample(rng)).collect();
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

    /// A draw of the control from N(z, P_z) around the analysis z of v: z_b + U (v + P_v^{1/2} ξ), P_v^{1/2} = I − Σ (1 − μ^{-1/2}) q qᵀ.
    ///
    /// # Panics
    /// If a length does not agree with the transform.
    pub fn draw<R: Rng + ?Sized>(&self, transform: &ControlTransform, v: &[f64], rng: &mut R) -> Vec<f64> {
        assert_eq!((v.len(), transform.dim()), (self.n, self.n), "length of the control variable");
        let mut w: Vec<f64> = (0..self.n).map(|_| StandardNormal.sample(rng)).collect();
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

/// How many of the Ritz pairs, ascending, to keep, from the top, for the least error bound; and that bound.
fn best_split(
    values: &[f64],
    vectors: &[f64],
    (q, coupling): (Vec<f64>, Vec<f64>),
    probes: &[(Vec<f64>, Vec<f64>)],
) -> (usize, f64) {
    let n = q.len();
    // Π(A − I)w and the coefficient c of q in Π A (w − Πw), which Π(A − I)Πw = Π(A − I)w − c q needs.
    let mut rest: Vec<(Vec<f64>, f64)> = probes.iter().map(|(_, image)| (image.clone(), 0.0)).collect();
    let mut nu = 0.0;
    let mut best = (0, f64::INFINITY);
    for kept in 0..=values.len() {
        if kept > 0 {
            let i = values.len() - kept;
            let z = &vectors[i * n..(i + 1) * n];
            nu = f64::hypot(nu, coupling[i] / values[i].sqrt());
            for ((image, c), (w, _)) in rest.iter_mut().zip(probes) {
                let along = dot(z, image);
                image.iter_mut().zip(z).for_each(|(a, z)| *a -= along * z);
                *c += coupling[i] * dot(z, w);
            }
        }
        let largest = rest.iter().map(|(image, c)| {
            image.iter().zip(&q).map(|(a, q)| (a - c * q) * (a - c * q)).sum::<f64>().sqrt()
        });
        let omega = 10.0 * (2.0 / std::f64::consts::PI).sqrt() * largest.fold(0.0, f64::max);
        // P_v and A⁻¹ both lie between 0 and I.
        let bound = if nu < 1.0 { (nu / (1.0 - nu) + omega / (1.0 + omega)).min(1.0) } else { 1.0 };
        if bound < best.1 {
            best = (kept, bound);
        }
    }
    best
}
