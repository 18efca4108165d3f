//! Checks of a covariance of your own: is it symmetric and positive, and do its root and its inverse belong
//! to it?
//!
//! [`covariance()`] checks what the trait [`Covariance`] promises, [`precision`] what [`Precision`] promises
//! beyond that. Both return a [`Report`] with a line for every promise. Components may have different units:
//! every comparison is one of the correlation C = S⁻¹ B S⁻¹ with S = diag(σ), σ² the variance that
//! the covariance states.

use crate::operator::{Covariance, Precision};
use varda_linalg::check::{Random, differing};
use varda_linalg::{dot, norm};

pub use varda_linalg::check::{Finding, Report};

/// The most components whose entries are looked at one by one.
const ENTRIES: usize = 64;

/// Share of ‖C‖ that rounding of a product, of a root or of a solve may leave, backward error of the
/// solve: some thousand roundings.
const ROUNDING: f64 = 1e-12;

/// Power iterations for ‖C‖.
const POWERS: usize = 12;

/// Every check of a covariance: it has components; variances are finite and not negative; all values are
/// written and finite; same input, same bits; B is linear, symmetric (⟨x, B y⟩ = ⟨B x, y⟩), positive
/// and has the stated variances on its diagonal; B = B^{1/2} B^{T/2}; and ⟨B^{1/2} v, x⟩ = ⟨v, B^{T/2}
/// x⟩.
///
/// Up to 64 components (all of a smaller covariance, otherwise drawn from `seed`) are looked at entry by
/// entry: their block of C must be symmetric, with the stated diagonal, and have no negative eigenvalue.
/// Random vectors show the rest. Cost: some hundred products.
///
/// ```
/// use varda_covariance::{Covariance, check};
///
/// /// B = [4 1; 1 2] by its Cholesky root, whose transpose was forgotten.
/// struct Wrong;
///
/// impl Covariance for Wrong {
///     fn dim(&self) -> usize {
///         2
///     }
///     fn root_dim(&self) -> usize {
///         2
///     }
///     fn apply(&self, x: &[f64], y: &mut [f64]) {
///         y.copy_from_slice(&[4.0 * x[0] + x[1], x[0] + 2.0 * x[1]]);
///     }
///     fn root(&self, v: &[f64], x: &mut [f64]) {
///         x.copy_from_slice(&[2.0 * v[0], 0.5 * v[0] + 1.75_f64.sqrt() * v[1]]);
///     }
///     fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
///         self.root(x, v);
///     }
///     fn variance(&self, variance: &mut [f64]) {
///         variance.copy_from_slice(&[4.0, 2.0]);
///     }
/// }
///
/// let report = check::covariance(&Wrong, 1);
/// assert!(!report.passed());
/// assert!(report.failed().all(|finding| finding.what.starts_with("root")), "{report}");
/// ```
pub fn covariance(b: &(impl Covariance + ?Sized), seed: u64) -> Report {
    Report { findings: Checked::new(b, seed).map_or_else(|report| report, |mut checked| checked.products()) }
}

/// Every check of a covariance with an inverse: those of [`covariance()`]; as many columns of the root as
/// rows; B B⁻¹ x = x; B^{1/2} B^{-1/2} x = x; B^{T/2} B^{-T/2} v = v; and ⟨B^{-1/2} x, v⟩ = ⟨x,
/// B^{-T/2} v⟩.
///
/// What a solve leaves is compared with ‖C‖ times the size of its result (backward error): an
/// ill-conditioned B is no fault.
///
/// ```
/// use varda_covariance::{Dense, check};
///
/// let report = check::precision(&Dense::new(2, &[4.0, 1.0, 1.0, 2.0])?, 1);
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_covariance::Error>(())
/// ```
pub fn precision(b: &(impl Precision + ?Sized), seed: u64) -> Report {
    let findings = match Checked::new(b, seed) {
        Err(findings) => findings,
        Ok(mut checked) => {
            let mut findings = checked.products();
            findings.extend(inverses(&mut checked, b));
            findings
        }
    };
    Report { findings }
}

/// A covariance in units of its standard deviations: C = S⁻¹ B S⁻¹ with root S⁻¹ B^{1/2}.
struct Checked<'a, C: ?Sized> {
    b: &'a C,
    n: usize,
    r: usize,
    /// S.
    sigma: Vec<f64>,
    random: Random,
    /// ‖C‖, from below.
    norm: f64,
    findings: Vec<Finding>,
}

/// The output of a product; what is not overwritten stays NaN.
fn out(n: usize, product: impl FnOnce(&mut [f64])) -> Vec<f64> {
    let mut out = vec![f64::NAN; n];
    product(&mut out);
    out
}

/// α a + β b.
fn mixed(alpha: f64, a: &[f64], beta: f64, b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| alpha * a + beta * b).collect()
}

/// ‖a − b‖.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    norm(&mixed(1.0, a, -1.0, b))
}

/// Values that are not finite.
fn not_finite(vectors: &[&[f64]]) -> f64 {
    vectors.iter().flat_map(|v| v.iter()).filter(|v| !v.is_finite()).count() as f64
}

/// The largest of values; NaN if one is.
fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |worst, value| if value <= worst { worst } else { value })
}

impl<'a, C: Covariance + ?Sized> Checked<'a, C> {
    /// Sizes and variances; the findings alone where nothing else can be judged.
    fn new(b: &'a C, seed: u64) -> Result<Self, Vec<Finding>> {
        let (n, r) = (b.dim(), b.root_dim());
        let empty = u8::from(n == 0) + u8::from(r == 0);
        let mut findings = vec![Finding::at_most("sizes: n and r that are zero", f64::from(empty), 0.0)];
        if empty > 0 {
            return Err(findings);
        }
        let variance = out(n, |v| b.variance(v));
        let bad = variance.iter().filter(|v| !(**v >= 0.0 && v.is_finite())).count();
        let what = "variance: values that are negative or not finite";
        findings.push(Finding::at_most(what, bad as f64, 0.0));
        let most = variance.iter().copied().fold(0.0, f64::max).sqrt();
        let what = "variance: every one is zero";
        findings.push(Finding::at_most(what, if most > 0.0 { 0.0 } else { n as f64 }, 0.0));
        if findings.iter().any(|finding| !finding.pass) {
            return Err(findings);
        }
        let sigma = variance.iter().map(|v| if *v > 0.0 { v.sqrt() } else { most }).collect();
        Ok(Self { b, n, r, sigma, random: Random(seed), norm: f64::NAN, findings })
    }

    fn at_most(&mut self, what: impl Into<String>, value: f64, bound: f64) {
        self.findings.push(Finding::at_most(what, value, bound));
    }

    fn divided(&self, mut v: Vec<f64>) -> Vec<f64> {
        v.iter_mut().zip(&self.sigma).for_each(|(v, s)| *v /= s);
        v
    }

    fn times(&self, v: &[f64]) -> Vec<f64> {
        v.iter().zip(&self.sigma).map(|(v, s)| v * s).collect()
    }

    /// C x.
    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let x = self.divided(x.to_vec());
        self.divided(out(self.n, |y| self.b.apply(&x, y)))
    }

    /// C^{1/2} v.
    fn root(&self, v: &[f64]) -> Vec<f64> {
        self.divided(out(self.n, |x| self.b.root(v, x)))
    }

    /// C^{T/2} x.
    fn root_transpose(&self, x: &[f64]) -> Vec<f64> {
        let x = self.divided(x.to_vec());
        out(self.r, |v| self.b.root_transpose(&x, v))
    }

    /// Everything that [`Covariance`] promises.
    fn products(&mut self) -> Vec<Finding> {
        let [x, y] = [0; 2].map(|_| self.random.vector(self.n));
        let [v, w] = [0; 2].map(|_| self.random.vector(self.r));
        let (c_x, c_y) = (self.apply(&x), self.apply(&y));
        let (u_v, u_w) = (self.root(&v), self.root(&w));
        let (ut_x, ut_y) = (self.root_transpose(&x), self.root_transpose(&y));
        self.at_most("product: values not written, or not finite", not_finite(&[&c_x, &c_y]), 0.0);
        self.at_most("root: values not written, or not finite", not_finite(&[&u_v, &u_w]), 0.0);
        self.at_most("root transposed: values not written, or not finite", not_finite(&[&ut_x, &ut_y]), 0.0);

        let again = differing(&c_x, &self.apply(&x));
        self.at_most("product: values that differ when run again", again, 0.0);
        let again = differing(&u_v, &self.root(&v));
        self.at_most("root: values that differ when run again", again, 0.0);
        let again = differing(&ut_x, &self.root_transpose(&x));
        self.at_most("root transposed: values that differ when run again", again, 0.0);

        self.norm = self.estimate_norm(&x);
        let (c, u) = (self.norm, self.norm.sqrt());
        let (xy, vw) = (mixed(0.75, &x, -1.5, &y), mixed(0.75, &v, -1.5, &w));
        let departure = distance(&self.apply(&xy), &mixed(0.75, &c_x, -1.5, &c_y)) / (c * norm(&xy));
        self.at_most("product: departure from linearity", departure, ROUNDING);
        let departure = distance(&self.root(&vw), &mixed(0.75, &u_v, -1.5, &u_w)) / (u * norm(&vw));
        self.at_most("root: departure from linearity", departure, ROUNDING);

        let symmetry = (dot(&x, &c_y) - dot(&c_x, &y)).abs() / (c * norm(&x) * norm(&y));
        self.at_most("product: ⟨x, B y⟩ − ⟨B x, y⟩", symmetry, ROUNDING);
        self.entries();
        let transpose = (dot(&u_v, &x) - dot(&v, &ut_x)).abs() / (u * norm(&v) * norm(&x));
        self.at_most("root transposed: ⟨B^{1/2} v, x⟩ − ⟨v, B^{T/2} x⟩", transpose, ROUNDING);
        let square = |ut: &[f64], c_x: &[f64], x: &[f64]| distance(&self.root(ut), c_x) / (c * norm(x));
        let square = largest([square(&ut_x, &c_x, &x), square(&ut_y, &c_y, &y)]);
        self.at_most("root: B^{1/2} B^{T/2} x − B x", square, ROUNDING);
        std::mem::take(&mut self.findings)
    }

    /// ‖C‖ from below, by power iterations.
    fn estimate_norm(&self, x: &[f64]) -> f64 {
        let (mut x, mut size) = (x.to_vec(), 0.0);
        for _ in 0..POWERS {
            let length = norm(&x);
            x.iter_mut().for_each(|x| *x /= length);
            x = self.apply(&x);
            size = norm(&x);
        }
        size
    }

    /// The block of C of some components: symmetric, its diagonal that of the variances, no negative
    /// eigenvalue.
    fn entries(&mut self) {
        let chosen = self.components();
        let m = chosen.len();
        let mut block = vec![0.0; m * m];
        for (j, &column) in chosen.iter().enumerate() {
            let mut unit = vec![0.0; self.n];
            unit[column] = 1.0;
            let product = self.apply(&unit);
            chosen.iter().enumerate().for_each(|(i, &row)| block[i * m + j] = product[row]);
        }
        let stated = out(self.n, |v| self.b.variance(v));
        let diagonal = |i: usize| stated[chosen[i]] / self.sigma[chosen[i]].powi(2);
        let off_diagonal = largest((0..m).map(|i| (block[i * m + i] - diagonal(i)).abs()));
        let pairs = || (0..m).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mirror = largest(pairs().map(|(i, j)| (block[i * m + j] - block[j * m + i]).abs()));
        let bound = ROUNDING * self.norm.max(1.0);
        self.at_most("variance: difference to the diagonal of B", off_diagonal, bound);
        self.at_most("product: B_ij − B_ji in units of σ_i σ_j", mirror, bound);
        for (i, j) in pairs() {
            let mean = 0.5 * (block[i * m + j] + block[j * m + i]);
            (block[i * m + j], block[j * m + i]) = (mean, mean);
        }
        let lowest = varda_linalg::eigenvalues(m, &block).map(|values| {
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            if least >= 0.0 { 0.0 } else { -least }
        });
        let what = format!("product: most negative eigenvalue, of {m} components");
        self.at_most(what, lowest.unwrap_or(f64::NAN), m as f64 * bound);
    }

    /// All components of a small covariance, some of a large one.
    fn components(&mut self) -> Vec<usize> {
        if self.n <= ENTRIES {
            return (0..self.n).collect();
        }
        // one of each of as many stretches
        (0..ENTRIES)
            .map(|k| {
                let (from, to) = (k * self.n / ENTRIES, (k + 1) * self.n / ENTRIES);
                let share = 0.5 * (1.0 + self.random.draw());
                from + ((to - from) as f64 * share) as usize
            })
            .collect()
    }
}

/// Everything that [`Precision`] promises beyond [`Covariance`].
fn inverses<C: Precision + ?Sized>(checked: &mut Checked<'_, C>, b: &C) -> Vec<Finding> {
    let (n, r) = (checked.n, checked.r);
    checked.at_most("sizes: |n − r|, of a root that has an inverse", n.abs_diff(r) as f64, 0.0);
    if n != r {
        return std::mem::take(&mut checked.findings);
    }
    let (x, v) = (checked.random.vector(n), checked.random.vector(n));
    // C⁻¹ x = S B⁻¹ S x, C^{-1/2} x = B^{-1/2} S x, C^{-T/2} v = S B^{-T/2} v
    let scaled = checked.times(&x);
    let solve = || out(n, |y| b.solve(&scaled, y));
    let whiten = || out(n, |v| b.whiten(&scaled, v));
    let transpose = |v: &[f64]| out(n, |x| b.whiten_transpose(v, x));
    let (solved, white, back) = (solve(), whiten(), transpose(&v));
    let faults = not_finite(&[&solved, &white, &back]);
    checked.at_most("inverse: values not written, or not finite", faults, 0.0);
    let again = largest([
        differing(&solved, &solve()),
        differing(&white, &whiten()),
        differing(&back, &transpose(&v)),
    ]);
    checked.at_most("inverse: values that differ when run again", again, 0.0);

    let (c, u) = (checked.norm, checked.norm.sqrt());
    let c_inverse_x = checked.times(&solved);
    let left = distance(&checked.apply(&c_inverse_x), &x) / (c * norm(&c_inverse_x));
    checked.at_most("solve: B B⁻¹ x − x", left, ROUNDING);
    let left = distance(&checked.root(&white), &x) / (u * norm(&white));
    checked.at_most("whiten: B^{1/2} B^{-1/2} x − x", left, ROUNDING);
    let c_back = checked.times(&back);
    let left = distance(&checked.root_transpose(&c_back), &v) / (u * norm(&c_back));
    checked.at_most("whiten transposed: B^{T/2} B^{-T/2} v − v", left, ROUNDING);
    let transposed = (dot(&white, &v) - dot(&x, &c_back)).abs() / (u * norm(&white) * norm(&c_back));
    checked.at_most("whiten transposed: ⟨B^{-1/2} x, v⟩ − ⟨x, B^{-T/2} v⟩", transposed, ROUNDING);
    std::mem::take(&mut checked.findings)
}
