//! Covariances made of smaller ones: the same for every component of a vector field, and several side by
//! side.

use crate::input::check_lengths;
use crate::operator::{Covariance, Precision};
use crate::scratch::Scratch;

/// B = C ⊗ I_c: the c components of every point are independent of each other and share the covariance C
/// between points.
///
/// Vectors are ordered point by point, the components of a point together (x₀ y₀ z₀ x₁ y₁ z₁
/// …), so that component k of point i is entry i c + k; of the control likewise. B is never formed: each
/// component is gathered into a buffer, C applied, and the result scattered. One lock guards the buffer
/// during a call: share a covariance between threads freely, clone it where they would wait for each other.
///
/// ```
/// use varda_covariance::{Covariance, Dense, Interleaved};
///
/// let b = Interleaved::new(Dense::new(2, &[4.0, 2.0, 2.0, 5.0])?, 3);
/// let mut column = [0.0; 6];
/// b.apply(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], &mut column);
/// assert_eq!(column, [4.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Interleaved<C> {
    part: C,
    components: usize,
    /// One component of the input, then one of the output.
    buffer: Scratch,
}

/// B = diag(B₁, B₂, …): independent vectors one after the other, such as positions and velocities.
///
/// `T` is one type, or `Box<dyn Covariance>` or `Box<dyn Precision>` for a mixture.
///
/// ```
/// use varda_covariance::{BlockDiagonal, Covariance, Diagonal};
///
/// let b = BlockDiagonal::new(vec![Diagonal::uniform(1, 2.0)?, Diagonal::uniform(2, 3.0)?]);
/// let mut variance = [0.0; 3];
/// b.variance(&mut variance);
/// assert_eq!(variance, [4.0, 9.0, 9.0]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct BlockDiagonal<T> {
    parts: Vec<T>,
}

impl<C: Covariance> Interleaved<C> {
    /// C between points, for fields of `components` components.
    ///
    /// # Panics
    ///
    /// If `components` is zero.
    pub fn new(part: C, components: usize) -> Self {
        assert!(components > 0, "a field has at least one component");
        let buffer = Scratch::new(2 * part.dim().max(part.root_dim()));
        Self { part, components, buffer }
    }

    /// C, the covariance between points of one component.
    pub fn part(&self) -> &C {
        &self.part
    }

    /// For every component: gathers it from `x` (`rows` values), lets `product` overwrite the output,
    /// scatters that to `y`.
    fn each(
        &self,
        x: &[f64],
        rows: usize,
        y: &mut [f64],
        columns: usize,
        product: impl Fn(&[f64], &mut [f64]),
    ) {
        let c = self.components;
        check_lengths(x, rows * c, y, columns * c);
        self.buffer.with(|buffer| {
            let half = buffer.len() / 2;
            let (input, output) = buffer.split_at_mut(half);
            let (input, output) = (&mut input[..rows], &mut output[..columns]);
            for k in 0..c {
                for (value, point) in input.iter_mut().zip(x.chunks_exact(c)) {
                    *value = point[k];
                }
                product(input, output);
                for (point, value) in y.chunks_exact_mut(c).zip(output.iter()) {
                    point[k] = *value;
                }
            }
        });
    }
}

impl<C: Covariance> Covariance for Interleaved<C> {
    fn dim(&self) -> usize {
        self.part.dim() * self.components
    }

    fn root_dim(&self) -> usize {
        self.part.root_dim() * self.components
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, self.part.dim(), y, self.part.dim(), |x, y| self.part.apply(x, y));
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, self.part.root_dim(), x, self.part.dim(), |v, x| self.part.root(v, x));
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, self.part.dim(), v, self.part.root_dim(), |x, v| self.part.root_transpose(x, v));
    }

    fn variance(&self, variance: &mut [f64]) {
        self.each(&[], 0, variance, self.part.dim(), |_, variance| self.part.variance(variance));
    }
}

impl<C: Precision> Precision for Interleaved<C> {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, self.part.dim(), y, self.part.dim(), |x, y| self.part.solve(x, y));
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, self.part.dim(), v, self.part.dim(), |x, v| self.part.whiten(x, v));
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, self.part.dim(), x, self.part.dim(), |v, x| self.part.whiten_transpose(v, x));
    }
}

impl<T: Covariance> BlockDiagonal<T> {
    /// The blocks, in the order of their parts of the vector.
    pub fn new(parts: Vec<T>) -> Self {
        Self { parts }
    }

    /// The blocks.
    pub fn parts(&self) -> &[T] {
        &self.parts
    }

    /// Lets `product` overwrite each block's part of the output (`columns` of them) from its part of the
    /// input (`rows`).
    fn each(
        &self,
        x: &[f64],
        rows: impl Fn(&T) -> usize,
        y: &mut [f64],
        columns: impl Fn(&T) -> usize,
        product: impl Fn(&T, &[f64], &mut [f64]),
    ) {
        check_lengths(x, self.parts.iter().map(&rows).sum(), y, self.parts.iter().map(&columns).sum());
        let (mut x, mut y) = (x, y);
        for part in &self.parts {
            let (x_part, x_rest) = x.split_at(rows(part));
            let (y_part, y_rest) = y.split_at_mut(columns(part));
            product(part, x_part, y_part);
            (x, y) = (x_rest, y_rest);
        }
    }
}

impl<T: Covariance> Covariance for BlockDiagonal<T> {
    fn dim(&self) -> usize {
        self.parts.iter().map(T::dim).sum()
    }

    fn root_dim(&self) -> usize {
        self.parts.iter().map(T::root_dim).sum()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, T::dim, y, T::dim, T::apply);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, T::root_dim, x, T::dim, T::root);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, T::dim, v, T::root_dim, T::root_transpose);
    }

    fn variance(&self, variance: &mut [f64]) {
        self.each(&[], |_| 0, variance, T::dim, |part, _, variance| part.variance(variance));
    }
}

impl<T: Precision> Precision for BlockDiagonal<T> {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, T::dim, y, T::dim, T::solve);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, T::dim, v, T::dim, T::whiten);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, T::dim, x, T::dim, T::whiten_transpose);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Dense, Diagonal, Spectrum, Truncated};

    #[test]
    fn interleaved_by_hand() {
        // C = [[4, 2], [2, 5]], L = [[2, 0], [1, 2]]; two points of three components.
        let b = Interleaved::new(Dense::new(2, &[4.0, 2.0, 2.0, 5.0]).unwrap(), 3);
        let mut out = [9.0; 6];
        b.root(&[1.0, 0.0, 10.0, 1.0, 0.0, 0.0], &mut out);
        assert_eq!(out, [2.0, 0.0, 20.0, 3.0, 0.0, 10.0]);
        b.apply(&[0.0, 1.0, 0.0, 0.0, -1.0, 1.0], &mut out);
        assert_eq!(out, [0.0, 2.0, 2.0, 0.0, -3.0, 5.0]);
        b.variance(&mut out);
        assert_eq!(out, [4.0, 4.0, 4.0, 5.0, 5.0, 5.0]);
    }

    #[test]
    fn blocks_of_different_kinds_and_ranks() {
        let truncated = Interleaved::new(Truncated::eigen(2, &[1.0, 1.0, 1.0, 1.0], 1e-10).unwrap(), 2);
        let parts: Vec<Box<dyn Covariance>> =
            vec![Box::new(truncated), Box::new(Diagonal::uniform(1, 3.0).unwrap())];
        let b: Box<dyn Covariance> = Box::new(BlockDiagonal::new(parts));
        assert_eq!((b.dim(), b.root_dim()), (5, 3));
        let mut out = [0.0; 5];
        b.apply(&[1.0, 0.0, 1.0, 2.0, 1.0], &mut out);
        for (out, expected) in out.iter().zip([2.0, 2.0, 2.0, 2.0, 9.0]) {
            assert!((out - expected).abs() < 1e-14);
        }
        let values = Spectrum::of(&b).unwrap().eigenvalues;
        for (value, expected) in values.iter().zip([9.0, 2.0, 2.0, 0.0, 0.0]) {
            assert!((value - expected).abs() < 1e-14);
        }
    }

    #[test]
    fn blocks_have_an_inverse_where_their_parts_do() {
        let parts: Vec<Box<dyn Precision>> = vec![
            Box::new(Interleaved::new(Dense::new(1, &[4.0]).unwrap(), 2)),
            Box::new(Diagonal::uniform(1, 3.0).unwrap()),
        ];
        let b: Box<dyn Precision> = Box::new(BlockDiagonal::new(parts));
        let mut out = [0.0; 3];
        b.solve(&[4.0, 8.0, 9.0], &mut out);
        assert_eq!(out, [1.0, 2.0, 1.0]);
        b.whiten(&[4.0, 8.0, 9.0], &mut out);
        assert_eq!(out, [2.0, 4.0, 3.0]);
        b.whiten_transpose(&[2.0, 4.0, 3.0], &mut out);
        assert_eq!(out, [1.0, 2.0, 1.0]);
    }
}
