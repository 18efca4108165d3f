//! Sums over vectors.

/// Σ aᵢ bᵢ, term after term.
///
/// ```
/// assert_eq!(varda_linalg::dot(&[1.0, 2.0], &[3.0, 4.0]), 11.0);
/// ```
#[inline]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// ‖a‖₂, without protection against overflow of the squares.
///
/// ```
/// assert_eq!(varda_linalg::norm(&[3.0, 4.0]), 5.0);
/// ```
#[inline]
pub fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// y ← y + α x.
///
/// ```
/// let mut y = [1.0, 1.0];
/// varda_linalg::axpy(2.0, &[1.0, 2.0], &mut y);
/// assert_eq!(y, [3.0, 5.0]);
/// ```
#[inline]
pub fn axpy(alpha: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += alpha * x);
}

/// Σ aᵢ bᵢ in four running sums: up to four times as fast as [`dot`] on long vectors, rounded otherwise,
/// with the same bits on every machine.
pub fn dot_in_lanes(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (p, q) in a4.iter().zip(b4) {
        for k in 0..4 {
            sums[k] += p[k] * q[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + dot(a_rest, b_rest)
}
