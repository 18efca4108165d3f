//! Small matrices: roots joined by reflections, and products with 3 × 3 matrices.

/// A 3 × 3 matrix by rows; fewer states leave its last rows and columns zero.
pub(super) type Square = [[f64; 3]; 3];

/// Turns the rows of A (r × c, r ≤ c) into those of the lower triangle L, r × r, with L Lᵀ = A Aᵀ and
/// a diagonal that is not negative (Householder 1958). Rows may differ by any scale: each is as exact as it
/// is long.
pub(super) fn lower(rows: &mut [Vec<f64>]) {
    for k in 0..rows.len() {
        let length = norm(&rows[k][k..]);
        if length > 0.0 {
            let pivot = if rows[k][k] > 0.0 { -length } else { length };
            let mut normal = rows[k][k..].to_vec();
            normal[0] -= pivot;
            let size = norm(&normal);
            normal.iter_mut().for_each(|n| *n /= size);
            for row in &mut rows[k..] {
                let along = 2.0 * row[k..].iter().zip(&normal).map(|(a, n)| a * n).sum::<f64>();
                for (a, n) in row[k..].iter_mut().zip(&normal) {
                    *a -= along * n;
                }
                if pivot < 0.0 {
                    row[k] = -row[k];
                }
            }
            rows[k][k] = length;
        }
        rows[k][k + 1..].fill(0.0);
    }
    let r = rows.len();
    rows.iter_mut().for_each(|row| row.truncate(r));
}

/// Without overflow or underflow of squares.
fn norm(x: &[f64]) -> f64 {
    let largest = x.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    largest * x.iter().map(|x| (x / largest).powi(2)).sum::<f64>().sqrt()
}

/// x ← L⁻¹ x of a lower triangle.
pub(super) fn forward(l: &[Vec<f64>], x: &mut [f64]) {
    for i in 0..l.len() {
        let known: f64 = l[i][..i].iter().zip(&x[..i]).map(|(l, x)| l * x).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn product(a: &Square, x: [f64; 3]) -> [f64; 3] {
    [dot(a[0], x), dot(a[1], x), dot(a[2], x)]
}

pub(super) fn transpose_product(a: &Square, x: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|j| a[0][j] * x[0] + a[1][j] * x[1] + a[2][j] * x[2])
}

/// A B.
pub(super) fn times(a: &Square, b: &Square) -> Square {
    std::array::from_fn(|i| transpose_product(b, a[i]))
}

/// A P Aᵀ.
pub(super) fn between(a: &Square, p: &Square) -> Square {
    let left = times(a, p);
    std::array::from_fn(|i| product(a, left[i]))
}
