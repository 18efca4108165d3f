//! Sums, scalings and products of covariances.

use crate::error::Error;
use crate::input::check_lengths;
use crate::operator::{Covariance, Precision};
use crate::scratch::Scratch;

/// B = B₁ + B₂ + …: errors of independent origin. The root is [U₁, U₂, …], the control vector
/// that of B₁ followed by that of B₂, and so on.
///
/// `T` is one type, or `Box<dyn Covariance>` for a mixture. Cost: that of the parts. There is no inverse:
/// where one is needed, form a [`Dense`](crate::Dense) B.
///
/// ```
/// use varda_covariance::{Covariance, Diagonal, Sum};
///
/// let b = Sum::new(vec![Diagonal::uniform(2, 3.0)?, Diagonal::uniform(2, 4.0)?])?;
/// let mut variance = [0.0; 2];
/// b.variance(&mut variance);
/// assert_eq!((variance, b.root_dim()), ([25.0; 2], 4));
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Sum<T> {
    n: usize,
    parts: Vec<T>,
    work: Scratch,
}

impl<T: Covariance> Sum<T> {
    /// The terms, all of the same size.
    ///
    /// # Errors
    ///
    /// [`Error::Size`] for no terms, or terms that differ in size.
    pub fn new(parts: Vec<T>) -> Result<Self, Error> {
        let Some(n) = parts.first().map(T::dim) else {
            return Err(Error::Size { what: "a sum of covariances", expected: 1, found: 0 });
        };
        match parts.iter().map(T::dim).find(|dim| *dim != n) {
            Some(found) => Err(Error::Size { what: "a term of a sum", expected: n, found }),
            None => Ok(Self { n, parts, work: Scratch::new(n) }),
        }
    }

    /// The terms.
    pub fn parts(&self) -> &[T] {
        &self.parts
    }

    /// y = the sum of what `product` gives for every part.
    fn add_up(&self, y: &mut [f64], mut product: impl FnMut(&T, &mut [f64])) {
        y.fill(0.0);
        self.work.with(|work| {
            for part in &self.parts {
                product(part, work);
                varda_linalg::axpy(1.0, work, y);
            }
        });
    }
}

impl<T: Covariance> Covariance for Sum<T> {
    fn dim(&self) -> usize {
        self.n
    }

    fn root_dim(&self) -> usize {
        self.parts.iter().map(T::root_dim).sum()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.n, y, self.n);
        self.add_up(y, |part, out| part.apply(x, out));
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.root_dim(), x, self.n);
        let mut rest = v;
        self.add_up(x, |part, out| {
            let (own, after) = rest.split_at(part.root_dim());
            part.root(own, out);
            rest = after;
        });
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.n, v, self.root_dim());
        let mut rest = v;
        for part in &self.parts {
            let (own, after) = rest.split_at_mut(part.root_dim());
            part.root_transpose(x, own);
            rest = after;
        }
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.n, "length of the variance");
        self.add_up(variance, |part, out| part.variance(out));
    }
}

/// B = D C D with a diagonal D: a covariance from a correlation and standard deviations, or one whose
/// standard deviations are multiplied by a factor.
///
/// ```
/// use varda_covariance::{Covariance, Dense, Scaled};
///
/// let correlation = Dense::new(2, &[1.0, 0.5, 0.5, 1.0])?;
/// let b = Scaled::new(correlation, vec![2.0, 3.0])?;
/// let mut column = [0.0; 2];
/// b.apply(&[1.0, 0.0], &mut column);
/// assert!((column[0] - 4.0).abs() < 1e-15 && (column[1] - 3.0).abs() < 1e-15);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Scaled<C> {
    part: C,
    scale: Vec<f64>,
    work: Scratch,
}

impl<C: Covariance> Scaled<C> {
    /// From C and the factor of every component.
    ///
    /// # Errors
    ///
    /// [`Error::Size`] unless there is a factor for every component, [`Error::Parameter`] for one that is not
    /// positive, or whose square is not a normal number.
    pub fn new(part: C, scale: Vec<f64>) -> Result<Self, Error> {
        if scale.len() != part.dim() {
            let expected = part.dim();
            return Err(Error::Size { what: "factors of a scaled covariance", expected, found: scale.len() });
        }
        if let Some(&value) = scale.iter().find(|s| !(**s > 0.0 && (**s * **s).is_normal())) {
            let what = "factor of a scaled covariance";
            return Err(Error::Parameter { what, value, range: "positive" });
        }
        let work = Scratch::new(part.dim());
        Ok(Self { part, scale, work })
    }

    /// Every standard deviation times `factor`: B = factor² C.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new).
    pub fn uniform(part: C, factor: f64) -> Result<Self, Error> {
        let scale = vec![factor; part.dim()];
        Self::new(part, scale)
    }

    /// C.
    pub fn part(&self) -> &C {
        &self.part
    }

    /// `act` on D x, or D⁻¹ x.
    fn before(&self, x: &[f64], factor: impl Fn(f64, f64) -> f64, act: impl FnOnce(&[f64])) {
        assert_eq!(x.len(), self.scale.len(), "length of the input vector");
        self.work.with(|work| {
            work.iter_mut().zip(x).zip(&self.scale).for_each(|((w, x), s)| *w = factor(*x, *s));
            act(work);
        });
    }
}

impl<C: Covariance> Covariance for Scaled<C> {
    fn dim(&self) -> usize {
        self.part.dim()
    }

    fn root_dim(&self) -> usize {
        self.part.root_dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.before(x, |x, s| s * x, |work| self.part.apply(work, y));
        y.iter_mut().zip(&self.scale).for_each(|(y, s)| *y *= s);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.part.root(v, x);
        x.iter_mut().zip(&self.scale).for_each(|(x, s)| *x *= s);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.before(x, |x, s| s * x, |work| self.part.root_transpose(work, v));
    }

    fn variance(&self, variance: &mut [f64]) {
        self.part.variance(variance);
        variance.iter_mut().zip(&self.scale).for_each(|(v, s)| *v *= s * s);
    }
}

impl<C: Precision> Precision for Scaled<C> {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.before(x, |x, s| x / s, |work| self.part.solve(work, y));
        y.iter_mut().zip(&self.scale).for_each(|(y, s)| *y /= s);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.before(x, |x, s| x / s, |work| self.part.whiten(work, v));
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.part.whiten_transpose(v, x);
        x.iter_mut().zip(&self.scale).for_each(|(x, s)| *x /= s);
    }
}

/// B = A ⊗ C: component (i, k) has the number i n_C + k, and B((i, k), (j, l)) = A(i, j) C(k, l).
///
/// For fields on products of domains (a line in space and one in time, levels and columns) and for variables
/// whose errors are correlated with each other. Where those are independent, use
/// [`Interleaved`](crate::Interleaved) (C = I).
///
/// Cost: n_A products with C and n_C with A. Nothing of size n_A n_C squared is formed.
///
/// ```
/// use varda_covariance::{Covariance, Dense, Kronecker};
///
/// let time = Dense::new(2, &[1.0, 0.5, 0.5, 1.0])?;
/// let space = Dense::new(2, &[4.0, 1.0, 1.0, 4.0])?;
/// let mut column = [0.0; 4];
/// Kronecker::new(time, space).apply(&[1.0, 0.0, 0.0, 0.0], &mut column);
/// assert!(column.iter().zip([4.0, 1.0, 2.0, 0.5]).all(|(a, b)| (a - b).abs() < 1e-15));
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Kronecker<A, C> {
    outer: A,
    inner: C,
    work: Scratch,
}

impl<A: Covariance, C: Covariance> Kronecker<A, C> {
    /// A ⊗ C.
    pub fn new(outer: A, inner: C) -> Self {
        let (a, c) = ([outer.dim(), outer.root_dim()], [inner.dim(), inner.root_dim()]);
        let (a, c) = (a[0].max(a[1]), c[0].max(c[1]));
        // a vector between the two products, and a column before and after the second
        let work = Scratch::new(a * c + 2 * a);
        Self { outer, inner, work }
    }

    /// A.
    pub fn outer(&self) -> &A {
        &self.outer
    }

    /// C.
    pub fn inner(&self) -> &C {
        &self.inner
    }

    /// y = (P ⊗ Q) x for P of `outer[1]` rows and `outer[0]` columns, Q likewise.
    fn each(
        &self,
        x: &[f64],
        y: &mut [f64],
        outer: [usize; 2],
        inner: [usize; 2],
        p: impl Fn(&[f64], &mut [f64]),
        q: impl Fn(&[f64], &mut [f64]),
    ) {
        check_lengths(x, outer[0] * inner[0], y, outer[1] * inner[1]);
        if x.is_empty() || y.is_empty() {
            return y.fill(0.0);
        }
        self.work.with(|work| {
            let (between, columns) = work.split_at_mut(outer[0] * inner[1]);
            for (x, out) in x.chunks_exact(inner[0]).zip(between.chunks_exact_mut(inner[1])) {
                q(x, out);
            }
            let (before, after) = columns.split_at_mut(outer[0]);
            let after = &mut after[..outer[1]];
            for k in 0..inner[1] {
                before.iter_mut().zip(between.chunks_exact(inner[1])).for_each(|(b, row)| *b = row[k]);
                p(before, after);
                y.chunks_exact_mut(inner[1]).zip(&*after).for_each(|(row, a)| row[k] = *a);
            }
        });
    }
}

impl<A: Covariance, C: Covariance> Covariance for Kronecker<A, C> {
    fn dim(&self) -> usize {
        self.outer.dim() * self.inner.dim()
    }

    fn root_dim(&self) -> usize {
        self.outer.root_dim() * self.inner.root_dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let (a, c) = (self.outer.dim(), self.inner.dim());
        self.each(x, y, [a; 2], [c; 2], |x, y| self.outer.apply(x, y), |x, y| self.inner.apply(x, y));
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        let (a, c) = (&self.outer, &self.inner);
        let sizes = ([a.root_dim(), a.dim()], [c.root_dim(), c.dim()]);
        self.each(v, x, sizes.0, sizes.1, |v, x| a.root(v, x), |v, x| c.root(v, x));
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        let (a, c) = (&self.outer, &self.inner);
        let sizes = ([a.dim(), a.root_dim()], [c.dim(), c.root_dim()]);
        self.each(x, v, sizes.0, sizes.1, |x, v| a.root_transpose(x, v), |x, v| c.root_transpose(x, v));
    }

    fn variance(&self, variance: &mut [f64]) {
        let (a, c) = (self.outer.dim(), self.inner.dim());
        assert_eq!(variance.len(), a * c, "length of the variance");
        if variance.is_empty() {
            return;
        }
        self.work.with(|work| {
            let (outer, rest) = work.split_at_mut(a);
            let inner = &mut rest[..c];
            self.outer.variance(outer);
            self.inner.variance(inner);
            for (row, a) in variance.chunks_exact_mut(c.max(1)).zip(&*outer) {
                row.iter_mut().zip(&*inner).for_each(|(v, c)| *v = a * c);
            }
        });
    }
}

impl<A: Precision, C: Precision> Precision for Kronecker<A, C> {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        let (a, c) = (self.outer.dim(), self.inner.dim());
        self.each(x, y, [a; 2], [c; 2], |x, y| self.outer.solve(x, y), |x, y| self.inner.solve(x, y));
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        let (a, c) = (self.outer.dim(), self.inner.dim());
        self.each(x, v, [a; 2], [c; 2], |x, v| self.outer.whiten(x, v), |x, v| self.inner.whiten(x, v));
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        let (a, c) = (&self.outer, &self.inner);
        let sizes = ([a.dim(); 2], [c.dim(); 2]);
        self.each(v, x, sizes.0, sizes.1, |v, x| a.whiten_transpose(v, x), |v, x| c.whiten_transpose(v, x));
    }
}
