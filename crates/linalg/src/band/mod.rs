//! Band matrices: symmetric LDLᵀ without pivoting, LU with partial pivoting, Cholesky roots.
//!
//! Plain functions on slices in the layouts of [`Structure`](crate::Structure). The factorizations cost O(n
//! w²), every solve O(n w), and nothing allocates. The symmetric factorization is the hot loop of a rod:
//! half-bandwidths 5, 8 and 10 (a chain, a rod without twist, a rod) have their own code, in which every loop
//! over the band has a fixed length.
//!
//! LDLᵀ without pivoting is backward stable for a positive definite matrix, and exact up to the growth of
//! its intermediate values otherwise (Golub and Van Loan 2013, section 4.4); Sylvester's law makes the number
//! of negative pivots that of negative eigenvalues.

mod cholesky;

pub use cholesky::Cholesky;

/// The first row at which a factorization found no usable pivot: zero, subnormal (its inverse overflows), not
/// finite, or nothing but rounding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no usable pivot at row {row}")]
pub struct BadPivot {
    /// Index of the row.
    pub row: usize,
}

/// A pivot no larger than this fraction of what it was computed from is rounding.
const NEGLIGIBLE: f64 = f64::EPSILON;

/// A = L D Lᵀ in place, for a symmetric band matrix of half-bandwidth w in the layout of
/// `Structure::SymmetricBand`.
///
/// On return row i holds l_{i,i−w} … l_{i,i−1} and then 1/d_i. Returns the number of negative pivots,
/// which is the number of negative eigenvalues of A.
///
/// # Errors
/// [`BadPivot`] where |d_i| is not above rounding of a_ii (NaN included); `a` is then half factored.
///
/// # Panics
/// If the length of `a` is not a multiple of w + 1.
pub fn ldlt_factor(w: usize, a: &mut [f64]) -> Result<usize, BadPivot> {
    assert_rows(w, a);
    match w {
        5 => ldlt_factor_fixed::<5, 6>(a),
        8 => ldlt_factor_fixed::<8, 9>(a),
        10 => ldlt_factor_fixed::<10, 11>(a),
        _ => ldlt_factor_any(w, a),
    }
}

/// b ← A⁻¹ b with the factor of [`ldlt_factor`].
///
/// # Panics
/// If the length of `a` is not w + 1 times that of `b`.
pub fn ldlt_solve(w: usize, a: &[f64], b: &mut [f64]) {
    assert_eq!(a.len(), b.len() * (w + 1), "factor and right-hand side differ in size");
    match w {
        5 => ldlt_solve_fixed::<5>(a, b),
        8 => ldlt_solve_fixed::<8>(a, b),
        10 => ldlt_solve_fixed::<10>(a, b),
        _ => ldlt_solve_any(w, a, b),
    }
}

/// Right-hand sides that [`ldlt_solve_block`] takes at once: enough to fill the registers of a processor.
pub const BLOCK: usize = 16;

/// B ← A⁻¹ B for a block of right-hand sides with the factor of [`ldlt_factor`]; B is n rows: entry (i,
/// c) is `b[i][c]`. The bits of a column are those of [`ldlt_solve`].
///
/// # Panics
/// If the length of `a` is not w + 1 times the number of rows of `b`.
pub fn ldlt_solve_block(w: usize, a: &[f64], b: &mut [[f64; BLOCK]]) {
    assert_eq!(a.len(), b.len() * (w + 1), "factor and right-hand sides differ in size");
    // the widest vectors there are; products and sums stay apart, so that the bits are the same on every
    // machine
    pulp::Arch::new().dispatch(SolveBlock { w, a, b });
}

struct SolveBlock<'a> {
    w: usize,
    a: &'a [f64],
    b: &'a mut [[f64; BLOCK]],
}

impl pulp::WithSimd for SolveBlock<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        solve_block(self.w, self.a, self.b);
    }
}

#[inline(always)]
fn solve_block(w: usize, a: &[f64], b: &mut [[f64; BLOCK]]) {
    let (n, s) = (b.len(), w + 1);
    for i in 0..n {
        let mut row = b[i];
        let reach = i.min(w);
        for (l, above) in a[i * s + w - reach..i * s + w].iter().zip(&b[i - reach..i]) {
            subtract(&mut row, *l, above);
        }
        b[i] = row;
    }
    for i in (0..n).rev() {
        let mut row = b[i].map(|y| y * a[i * s + w]);
        let reach = (n - 1 - i).min(w);
        // l_{i+d,i} lies d w after the diagonal of row i
        for d in (1..=reach).rev() {
            subtract(&mut row, a[i * s + w + d * w], &b[i + d]);
        }
        b[i] = row;
    }
}

/// row −= l · other.
#[inline(always)]
fn subtract(row: &mut [f64; BLOCK], l: f64, other: &[f64; BLOCK]) {
    for c in 0..BLOCK {
        row[c] -= l * other[c];
    }
}

/// A direction z in which a matrix with a negative pivot curves downwards: zᵀ A z = d_i < 0, where i is the
/// first row with a negative pivot. Returns d_i; `None`, and z untouched, where all pivots are positive.
///
/// z solves Lᵀ z = e_i. The rows before i are those of a positive definite matrix, so that z is accurate
/// however wild the later pivots are.
///
/// # Panics
/// If the length of `a` is not w + 1 times that of `z`.
pub fn ldlt_negative_curvature(w: usize, a: &[f64], z: &mut [f64]) -> Option<f64> {
    assert_eq!(a.len(), z.len() * (w + 1), "factor and direction differ in size");
    let first = a.chunks_exact(w + 1).position(|row| row[w] < 0.0)?;
    z.fill(0.0);
    z[first] = 1.0;
    back_substitute(w, a, &mut z[..=first]);
    Some(1.0 / a[first * (w + 1) + w])
}

/// Right-looking form: pivot j updates the w rows below it. `S` is W + 1.
fn ldlt_factor_fixed<const W: usize, const S: usize>(a: &mut [f64]) -> Result<usize, BadPivot> {
    let n = a.len() / S;
    let mut negative = 0;
    // |a_ii| of the rows the window has touched, before it did: the measure of a negligible pivot.
    let mut diagonal = [0.0; W];
    for i in 0..n.min(W) {
        diagonal[i] = a[i * S + W].abs();
    }
    for j in 0..n {
        let (head, below) = a[j * S..].split_at_mut(S);
        let d = head[W];
        let usable = d.abs() > NEGLIGIBLE * diagonal[j % W] && d.is_normal();
        if !usable {
            return Err(BadPivot { row: j });
        }
        negative += usize::from(d < 0.0);
        let reciprocal = 1.0 / d;
        head[W] = reciprocal;
        if below.len() >= W * S {
            let below = &mut below[..W * S];
            diagonal[j % W] = below[W * S - 1].abs();
            eliminate::<W, S>(W, reciprocal, below);
        } else {
            eliminate::<W, S>(below.len() / S, reciprocal, below);
        }
    }
    Ok(negative)
}

/// Takes one pivot out of the `rows` rows below it; its column sits at W−1 + t W of `below`.
#[inline(always)]
fn eliminate<const W: usize, const S: usize>(rows: usize, reciprocal: f64, below: &mut [f64]) {
    // The column, after a zero.
    let mut v = [0.0; S];
    for t in 0..rows {
        v[t + 1] = below[W - 1 + t * W];
    }
    // In two runs, each short enough for the compiler to write out in full.
    for t in 0..rows.min(W / 2 + 1) {
        eliminate_row::<W, S>(t, v[t + 1] * reciprocal, &v, below);
    }
    for t in W / 2 + 1..rows {
        eliminate_row::<W, S>(t, v[t + 1] * reciprocal, &v, below);
    }
}

/// Row t below a pivot minus l times the column v, from the next column to its diagonal.
#[inline(always)]
fn eliminate_row<const W: usize, const S: usize>(t: usize, l: f64, v: &[f64; S], below: &mut [f64]) {
    let at = W - 1 + t * W;
    below[at] = l;
    // Every run is made even in length (the zero leaves l as it is), so that what is written here in pairs is
    // read by the next pivot in the same pairs.
    let odd = (t + 1) % 2;
    for (r, v) in below[at + 1 - odd..at + 2 + t].iter_mut().zip(&v[1 - odd..]) {
        *r -= l * v;
    }
}

/// Left-looking form for any half-bandwidth: row i takes inner products with the w rows above it, in place.
fn ldlt_factor_any(w: usize, a: &mut [f64]) -> Result<usize, BadPivot> {
    let s = w + 1;
    let mut negative = 0;
    for i in 0..a.len() / s {
        let (above, row) = a.split_at_mut(i * s);
        let row = &mut row[..s];
        // v_j = l_ij d_j for the columns j = i − w + p
        for p in w.saturating_sub(i)..w {
            let j = i + p - w;
            let other = &above[j * s + w - p..j * s + w];
            let dot: f64 = other.iter().zip(row.iter()).map(|(l, v)| l * v).sum();
            row[p] -= dot;
        }
        let mut d = row[w];
        for p in w.saturating_sub(i)..w {
            let v = row[p];
            row[p] = v * above[(i + p - w) * s + w];
            d -= v * row[p];
        }
        let usable = d.abs() > NEGLIGIBLE * row[w].abs() && d.is_normal();
        if !usable {
            return Err(BadPivot { row: i });
        }
        negative += usize::from(d < 0.0);
        row[w] = 1.0 / d;
    }
    Ok(negative)
}

/// Row by row; every number takes its terms one after the other, that of the nearest row last.
fn ldlt_solve_any(w: usize, a: &[f64], b: &mut [f64]) {
    let s = w + 1;
    for i in 0..b.len() {
        let reach = i.min(w);
        let l = &a[i * s + w - reach..i * s + w];
        b[i] = l.iter().zip(&b[i - reach..i]).fold(b[i], |x, (l, y)| x - l * y);
    }
    for (row, y) in a.chunks_exact(s).zip(b.iter_mut()) {
        *y *= row[w];
    }
    back_substitute(w, a, b);
}

/// The same sums, those of the next W rows in registers: a number that is found goes to all that wait for it,
/// and a row waits for one product and one difference.
fn ldlt_solve_fixed<const W: usize>(a: &[f64], b: &mut [f64]) {
    let (n, s) = (b.len(), W + 1);
    if n <= W {
        return ldlt_solve_any(W, a, b);
    }
    // sums[d] of row i + d
    let mut sums: [f64; W] = std::array::from_fn(|d| b[d]);
    for i in 0..n - W {
        let x = sums[0];
        // l_{i+d,i} lies d W after the diagonal of row i
        let column = &a[i * s + W..i * s + W + W * W + 1];
        for d in 1..W {
            sums[d - 1] = sums[d] - column[d * W] * x;
        }
        sums[W - 1] = b[i + W] - column[W * W] * x;
        b[i] = x * column[0];
    }
    b[n - W..].copy_from_slice(&sums);
    for i in n - W..n {
        let x = b[i];
        for d in 1..n - i {
            b[i + d] -= a[i * s + W + d * W] * x;
        }
        b[i] = x * a[i * s + W];
    }
    // sums[d] of row i − d
    let mut sums: [f64; W] = std::array::from_fn(|d| b[n - 1 - d]);
    for i in (W..n).rev() {
        let x = sums[0];
        let row = &a[i * s..i * s + W];
        for d in 1..W {
            sums[d - 1] = sums[d] - row[W - d] * x;
        }
        sums[W - 1] = b[i - W] - row[0] * x;
        b[i] = x;
    }
    for d in 0..W {
        b[W - 1 - d] = sums[d];
    }
    back_substitute(W, a, &mut b[..W]);
}

/// b ← L⁻ᵀ b for the first rows of L, as many as b has.
fn back_substitute(w: usize, a: &[f64], b: &mut [f64]) {
    let s = w + 1;
    for i in (0..b.len()).rev() {
        let reach = i.min(w);
        let x = b[i];
        for (y, l) in b[i - reach..i].iter_mut().zip(&a[i * s + w - reach..i * s + w]) {
            *y -= l * x;
        }
    }
}

/// Number of values the factor of [`lu_factor`] takes: n rows of 3w + 1.
pub fn lu_len(n: usize, w: usize) -> usize {
    n * (3 * w + 1)
}

/// P A = L U for a general band matrix of half-bandwidth w in the layout of `Structure::Band`, with partial
/// pivoting.
///
/// Row k of `factor` (3w + 1 values) holds 1/u_kk, u_{k,k+1} … u_{k,k+2w} and then the w multipliers of
/// column k; `pivots[k]` is the row that was swapped with row k.
///
/// # Errors
/// [`BadPivot`] where no pivot of column k is above rounding of the largest value of A in the rows within
/// reach (NaN included).
///
/// # Panics
/// If the lengths do not fit: `a` n (2w + 1), `factor` [`lu_len`], `pivots` n.
pub fn lu_factor(w: usize, a: &[f64], factor: &mut [f64], pivots: &mut [usize]) -> Result<(), BadPivot> {
    let n = pivots.len();
    let (wide, s) = (2 * w + 1, 3 * w + 1);
    assert_eq!(a.len(), n * wide, "a band of half-bandwidth {w} and {n} rows needs rows of {wide} values");
    assert_eq!(factor.len(), lu_len(n, w), "the factor needs rows of {s} values");
    // Every row from its first column on; in the first w rows that is column 0.
    for i in 0..n {
        let skip = w.saturating_sub(i);
        let row = &mut factor[i * s..i * s + s];
        row[..wide - skip].copy_from_slice(&a[i * wide + skip..(i + 1) * wide]);
        row[wide - skip..].fill(0.0);
    }
    for k in 0..n {
        let last = (k + w + 1).min(n);
        // All rows k … last−1 now begin at column k.
        let mut p = k;
        let mut largest: f64 = 0.0;
        for i in k..last {
            let candidate = factor[i * s].abs();
            if candidate > factor[p * s].abs() || candidate.is_nan() {
                p = i;
            }
            largest = a[i * wide..(i + 1) * wide].iter().fold(largest, |m, v| m.max(v.abs()));
        }
        let pivot = factor[p * s];
        let usable = pivot.abs() > NEGLIGIBLE * largest && pivot.is_normal();
        if !usable {
            return Err(BadPivot { row: k });
        }
        pivots[k] = p;
        if p != k {
            // the multipliers stay with their column: row k has none yet
            let (upper, lower) = factor.split_at_mut(p * s);
            upper[k * s..k * s + wide].swap_with_slice(&mut lower[..wide]);
        }
        let (head, below) = factor[k * s..last * s].split_at_mut(s);
        let reciprocal = 1.0 / pivot;
        head[0] = reciprocal;
        let (upper, multipliers) = head.split_at_mut(wide);
        for (row, l) in below.chunks_exact_mut(s).zip(multipliers) {
            *l = row[0] * reciprocal;
            // eliminate, and shift the row left by the column that vanished
            for j in 1..wide {
                row[j - 1] = row[j] - *l * upper[j];
            }
            row[wide - 1] = 0.0;
        }
    }
    Ok(())
}

/// b ← A⁻¹ b with the factor of [`lu_factor`].
///
/// # Panics
/// If the lengths do not fit.
pub fn lu_solve(w: usize, factor: &[f64], pivots: &[usize], b: &mut [f64]) {
    let (n, wide, s) = (b.len(), 2 * w + 1, 3 * w + 1);
    assert!(factor.len() == lu_len(n, w) && pivots.len() == n, "factor and right-hand side differ in size");
    for k in 0..n {
        b.swap(k, pivots[k]);
        let x = b[k];
        for (y, l) in b[k + 1..].iter_mut().zip(&factor[k * s + wide..(k + 1) * s]) {
            *y -= l * x;
        }
    }
    for k in (0..n).rev() {
        let row = &factor[k * s..k * s + wide];
        let dot: f64 = row[1..].iter().zip(&b[k + 1..]).map(|(u, x)| u * x).sum();
        b[k] = (b[k] - dot) * row[0];
    }
}

/// b ← A⁻ᵀ b with the factor of [`lu_factor`].
///
/// # Panics
/// If the lengths do not fit.
pub fn lu_solve_transpose(w: usize, factor: &[f64], pivots: &[usize], b: &mut [f64]) {
    let (n, wide, s) = (b.len(), 2 * w + 1, 3 * w + 1);
    assert!(factor.len() == lu_len(n, w) && pivots.len() == n, "factor and right-hand side differ in size");
    for k in 0..n {
        let row = &factor[k * s..k * s + wide];
        b[k] *= row[0];
        let y = b[k];
        for (x, u) in b[k + 1..].iter_mut().zip(&row[1..]) {
            *x -= u * y;
        }
    }
    for k in (0..n).rev() {
        let dot: f64 = factor[k * s + wide..(k + 1) * s].iter().zip(&b[k + 1..]).map(|(l, x)| l * x).sum();
        b[k] -= dot;
        b.swap(k, pivots[k]);
    }
}

fn assert_rows(w: usize, a: &[f64]) {
    assert!(a.len().is_multiple_of(w + 1), "a band of half-bandwidth {w} needs rows of {} values", w + 1);
}
