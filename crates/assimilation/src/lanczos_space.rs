//! Subspaces of a Hessian that is the identity but for a few directions, what random probes find beside them,
//! and a bound on what is left out.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use varda_linalg::krylov::Product;

use crate::Error;
use crate::cost::{dot, norm};
use crate::minimize::eigen;

/// Random vectors w and (A − I) w.
pub(crate) type Probes = Vec<(Vec<f64>, Vec<f64>)>;

pub(crate) fn probe<R: Rng + ?Sized>(
    n: usize,
    product: &mut Product<Error>,
    count: usize,
    rng: &mut R,
) -> Result<Probes, Error> {
    let mut probes = Vec::new();
    for _ in 0..count {
        let w = normals(n, rng);
        let mut image = vec![0.0; n];
        product(&w, &mut image)?;
        image.iter_mut().zip(&w).for_each(|(a, w)| *a -= w);
        probes.push((w, image));
    }
    Ok(probes)
}

pub(crate) fn normals<R: Rng + ?Sized>(n: usize, rng: &mut R) -> Vec<f64> {
    (0..n).map(|_| StandardNormal.sample(rng)).collect()
}

/// A space and A on it: Q orthonormal and A Q, one column after the other.
pub(crate) struct Space {
    n: usize,
    basis: Vec<f64>,
    images: Vec<f64>,
}

impl Space {
    pub(crate) fn new(n: usize) -> Self {
        Self { n, basis: Vec::new(), images: Vec::new() }
    }

    /// That of Ritz pairs with their residuals A z − μ z.
    pub(crate) fn of(values: Vec<f64>, vectors: Vec<f64>, residuals: Vec<f64>) -> Self {
        let n = vectors.len() / values.len();
        let mut images = residuals;
        for ((image, z), mu) in images.chunks_exact_mut(n).zip(vectors.chunks_exact(n)).zip(values) {
            image.iter_mut().zip(z).for_each(|(r, z)| *r += mu * z);
        }
        Self { n, basis: vectors, images }
    }

    /// Adds one direction after the other, the largest residual, or where that is far below what the probes
    /// find a random one, until the bound is at most the tolerance. Returns the Ritz pairs with their split.
    pub(crate) fn grown<R: Rng + ?Sized>(
        &mut self,
        product: &mut Product<Error>,
        (tolerance, most): (f64, usize),
        (around, probes): (Around, &Probes),
        rng: &mut R,
    ) -> Result<(Vec<f64>, Vec<f64>, Split), Error> {
        let n = self.n;
        loop {
            let (values, vectors) = self.ritz()?;
            let residuals = self.residuals(&values, &vectors);
            let split = best_split(around, &values, &vectors, &residuals, probes);
            let ended = split.bound <= tolerance || self.dim() >= most.min(n);
            // Not along what the probes found: they would no longer be independent of the space they judge.
            let next = match split.worst {
                Some(i) => residuals[i * n..][..n].to_vec(),
                None => normals(n, rng),
            };
            if ended || !self.add_measured(&next, product)? {
                return Ok((values, vectors, split));
            }
        }
    }

    pub(crate) fn dim(&self) -> usize {
        self.basis.len() / self.n.max(1)
    }

    /// Adds the direction of s with y = A s, if more than 10⁻³ of it is new; says whether it was.
    pub(crate) fn add(&mut self, s: &[f64], y: &[f64]) -> bool {
        let (mut q, mut aq) = (s.to_vec(), y.to_vec());
        // Twice is enough.
        for _ in 0..2 {
            for (p, ap) in self.basis.chunks_exact(self.n).zip(self.images.chunks_exact(self.n)) {
                let c = dot(p, &q);
                q.iter_mut().zip(p).for_each(|(q, p)| *q -= c * p);
                aq.iter_mut().zip(ap).for_each(|(q, p)| *q -= c * p);
            }
        }
        let left = norm(&q);
        let new = left > 1e-3 * norm(s);
        if new {
            self.basis.extend(q.iter().map(|q| q / left));
            self.images.extend(aq.iter().map(|aq| aq / left));
        }
        new
    }

    /// Adds the direction of s with its image from a product.
    pub(crate) fn add_measured(&mut self, s: &[f64], product: &mut Product<Error>) -> Result<bool, Error> {
        let new = self.add(s, s);
        if new {
            let last = self.basis.len() - self.n;
            product(&self.basis[last..], &mut self.images[last..])?;
        }
        Ok(new)
    }

    /// Ritz values, ascending, and vectors, one after the other.
    pub(crate) fn ritz(&self) -> Result<(Vec<f64>, Vec<f64>), Error> {
        let (n, k) = (self.n, self.dim());
        let mut small = vec![0.0; k * k];
        for (j, aq) in self.images.chunks_exact(n).enumerate() {
            for (i, q) in self.basis.chunks_exact(n).enumerate() {
                small[i + j * k] += 0.5 * dot(q, aq);
                small[j + i * k] += 0.5 * dot(q, aq);
            }
        }
        let (values, small) = eigen(k, &small)?;
        Ok((values, self.combine(&self.basis, &small)))
    }

    /// A z_i − μ_i z_i of the Ritz pairs, from the space's images.
    fn residuals(&self, values: &[f64], vectors: &[f64]) -> Vec<f64> {
        let n = self.n;
        let along = |z: &[f64]| self.basis.chunks_exact(n).map(|q| dot(q, z)).collect::<Vec<f64>>();
        let small: Vec<f64> = vectors.chunks_exact(n).flat_map(along).collect();
        let mut residuals = self.combine(&self.images, &small);
        for ((r, z), mu) in residuals.chunks_exact_mut(n).zip(vectors.chunks_exact(n)).zip(values) {
            r.iter_mut().zip(z).for_each(|(r, z)| *r -= mu * z);
        }
        residuals
    }

    /// The columns times a k × k matrix.
    fn combine(&self, columns: &[f64], matrix: &[f64]) -> Vec<f64> {
        let (n, k) = (self.n, self.dim());
        let mut out = vec![0.0; n * k];
        for (z, w) in out.chunks_exact_mut(n).zip(matrix.chunks_exact(k.max(1))) {
            for (q, w) in columns.chunks_exact(n).zip(w) {
                z.iter_mut().zip(q).for_each(|(z, q)| *z += w * q);
            }
        }
        out
    }
}

/// A residual below this part of what the probes find is left for another direction.
const FOLLOWED: f64 = 1e-3;

/// What is known of a Hessian beside its products.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Around {
    /// Its eigenvalues are at least 1, as those of I + GᵀG are.
    AboveOne,
    /// Nothing: those of an exact Hessian lie on both sides of 1.
    BothSides,
}

/// Which of the Ritz pairs to keep.
pub(crate) struct Split {
    /// Their numbers, ascending.
    pub(crate) kept: Vec<usize>,
    /// The error bound with these; infinite where there is none.
    pub(crate) bound: f64,
    /// The pair with the largest residual, scaled as in ν; `None` where the probes find more beside all
    /// pairs.
    worst: Option<usize>,
}

/// How many of the Ritz pairs, ascending, with their residuals, to keep for the least error bound: those
/// farthest from 1.
pub(crate) fn best_split(
    around: Around,
    values: &[f64],
    vectors: &[f64],
    residuals: &[f64],
    probes: &Probes,
) -> Split {
    // Π(A − I)w less R Zᵀw is Π(A − I)Πw, with R the residuals of the pairs Z that Π projects out.
    let n = probes[0].0.len();
    let mut rest: Vec<(Vec<f64>, Vec<f64>)> =
        probes.iter().map(|(_, image)| (image.clone(), vec![0.0; n])).collect();
    let mut order: Vec<usize> = (0..values.len()).rev().collect();
    if around == Around::BothSides {
        order.sort_by(|&a, &b| (values[b] - 1.0).abs().total_cmp(&(values[a] - 1.0).abs()));
    }
    let (mut nu, mut smallest) = (0.0, 1.0_f64);
    let (mut best, mut worst) = ((0, f64::INFINITY), None);
    let (mut largest, mut missed) = (0.0, 0.0);
    for kept in 0..=values.len() {
        if kept > 0 {
            let i = order[kept - 1];
            let (z, r) = (&vectors[i * n..][..n], &residuals[i * n..][..n]);
            let size = norm(r) / values[i].abs().sqrt();
            (nu, smallest) = (f64::hypot(nu, size), smallest.min(values[i]));
            if size > largest {
                (largest, worst) = (size, Some(i));
            }
            for ((image, along), (w, _)) in rest.iter_mut().zip(probes) {
                let (c, d) = (dot(z, image), dot(z, w));
                image.iter_mut().zip(z).for_each(|(a, z)| *a -= c * z);
                along.iter_mut().zip(r).for_each(|(a, r)| *a += d * r);
            }
        }
        let found = |(image, along): &(Vec<f64>, Vec<f64>)| {
            image.iter().zip(along).map(|(a, r)| (a - r) * (a - r)).sum::<f64>().sqrt()
        };
        missed = rest.iter().map(found).fold(0.0, f64::max);
        let omega = 10.0 * (2.0 / std::f64::consts::PI).sqrt() * missed;
        let bound = match around {
            // P_v and A⁻¹ both lie between 0 and I.
            Around::AboveOne if nu < 1.0 => (nu / (1.0 - nu) + omega / (1.0 + omega)).min(1.0),
            Around::AboveOne => 1.0,
            Around::BothSides if nu + omega < 1.0 && smallest > 0.0 => {
                (nu + omega) / (1.0 - nu - omega) / smallest
            }
            Around::BothSides => f64::INFINITY,
        };
        if bound < best.1 {
            best = (kept, bound);
        }
    }
    // A probe has norm √n or so, a Ritz vector 1. What is known to be inexact is followed to its end first:
    // of a multiple eigenvalue one more copy is then found for two products.
    if missed * FOLLOWED >= largest * (n as f64).sqrt() {
        worst = None;
    }
    let (count, bound) = best;
    // without a bound what was found is still what there is
    let count = if bound.is_finite() { count } else { values.len() };
    let mut kept = order[..count].to_vec();
    kept.sort_unstable();
    Split { kept, bound, worst }
}
