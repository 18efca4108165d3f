//! What every covariance promises, and how far one is from it.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::{Covariance, Diagonal, Precision, Spectrum, sample};
use varda_linalg::{dot, norm};

pub(crate) const EPS: f64 = f64::EPSILON;

pub(crate) fn out(n: usize, product: impl Fn(&mut [f64])) -> Vec<f64> {
    // NaN, so that an entry that is not overwritten shows.
    let mut out = vec![f64::NAN; n];
    product(&mut out);
    out
}

pub(crate) fn columns(rows: usize, columns: usize, product: impl Fn(&[f64], &mut [f64])) -> Vec<Vec<f64>> {
    (0..columns)
        .map(|j| {
            let mut unit = vec![0.0; columns];
            unit[j] = 1.0;
            out(rows, |y| product(&unit, y))
        })
        .collect()
}

pub(crate) fn random_vector(n: usize, seed: u64) -> Vec<f64> {
    sample(&Diagonal::uniform(n, 1.0).unwrap(), &mut ChaCha8Rng::seed_from_u64(seed))
}

/// The largest difference, relative to its rounding bound, between what a covariance does and what it
/// promises: symmetry, B = B^{1/2} B^{T/2}, variance = diag B, and ⟨B^{1/2} v, x⟩ = ⟨v, B^{T/2} x⟩.
/// At most 1 where it keeps its word.
pub(crate) fn worst_broken_promise(b: &dyn Covariance, seed: u64) -> f64 {
    let (n, r) = (b.dim(), b.root_dim());
    let full = columns(n, n, |x, y| b.apply(x, y));
    let root = columns(n, r, |v, x| b.root(v, x));
    let variance = out(n, |variance| b.variance(variance));
    let largest = variance.iter().fold(0.0, |a: f64, &v| a.max(v));
    // Sums of at most n products, each bounded by the largest variance (Cauchy–Schwarz on the rows of the
    // root).
    let bound = 4.0 * n as f64 * EPS * largest;

    let mut worst: f64 = 0.0;
    let mut note = |difference: f64, bound: f64| {
        let ratio = difference.abs() / bound;
        // NaN is the worst of all.
        worst = if ratio <= worst { worst } else { ratio };
    };
    for i in 0..n {
        note(full[i][i] - variance[i], bound);
        for j in 0..n {
            note(full[i][j] - full[j][i], bound);
            note(full[i][j] - root.iter().map(|column| column[i] * column[j]).sum::<f64>(), bound);
        }
    }
    let (v, x) = (random_vector(r, seed), random_vector(n, seed + 1));
    let (root_v, root_t_x) = (out(n, |x| b.root(&v, x)), out(r, |v| b.root_transpose(&x, v)));
    let size = norm(&v) * norm(&x) * (n as f64 * largest).sqrt();
    note(dot(&root_v, &x) - dot(&v, &root_t_x), 4.0 * n as f64 * EPS * size);
    worst
}

/// Relative errors of B⁻¹ B x against n ε cond B, and of B^{-1/2} B^{1/2} v and its transpose against n
/// ε √cond B.
pub(crate) fn inverse_errors(b: &dyn Precision, seed: u64) -> (f64, f64) {
    let n = b.dim();
    let condition = Spectrum::of(b).unwrap().condition_number();
    let x = random_vector(n, seed);
    let error = |y: Vec<f64>| norm(&y.iter().zip(&x).map(|(y, x)| y - x).collect::<Vec<_>>()) / norm(&x);
    let bx = out(n, |y| b.apply(&x, y));
    let rx = out(n, |y| b.root(&x, y));
    let rounding = 10.0 * n as f64 * EPS;
    let tx = out(n, |v| b.root_transpose(&x, v));
    let transposed = error(out(n, |y| b.whiten_transpose(&tx, y)));
    (
        error(out(n, |y| b.solve(&bx, y))) / (rounding * condition),
        error(out(n, |y| b.whiten(&rx, y))).max(transposed) / (rounding * condition.sqrt()),
    )
}
