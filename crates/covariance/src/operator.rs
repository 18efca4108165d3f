//! What a covariance is here: a product, a square root and its transpose; where it has full rank, an inverse.

use std::rc::Rc;
use std::sync::Arc;

/// A covariance operator B = U Uᵀ given by its square root U = B^{1/2} (n rows, r columns).
///
/// Vectors are slices; every method overwrites its output, allocates nothing, and panics on a wrong length.
pub trait Covariance {
    /// n, the length of the vectors B acts on.
    fn dim(&self) -> usize;

    /// r, the number of columns of the square root; less than `dim` where the rank was truncated, more where
    /// several roots stand side by side ([`Sum`](crate::Sum)).
    fn root_dim(&self) -> usize;

    /// y = B x.
    fn apply(&self, x: &[f64], y: &mut [f64]);

    /// x = B^{1/2} v, with v of length `root_dim` and x of length `dim`.
    fn root(&self, v: &[f64], x: &mut [f64]);

    /// v = (B^{1/2})ᵀ x, with x of length `dim` and v of length `root_dim`.
    fn root_transpose(&self, x: &[f64], v: &mut [f64]);

    /// The diagonal of B: the variance of every component.
    fn variance(&self, variance: &mut [f64]);
}

/// A covariance of full rank: it has an inverse, and its square root does too.
///
/// Observation errors R and costs written in the state space ask for this trait in their signature.
pub trait Precision: Covariance {
    /// y = B⁻¹ x.
    fn solve(&self, x: &[f64], y: &mut [f64]);

    /// v = (B^{1/2})⁻¹ x, so that ‖v‖² = xᵀ B⁻¹ x.
    fn whiten(&self, x: &[f64], v: &mut [f64]);

    /// x = (B^{1/2})⁻ᵀ v, the transpose of `whiten`: B⁻¹ = (B^{1/2})⁻ᵀ (B^{1/2})⁻¹.
    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]);
}

/// A covariance behind a pointer is one.
macro_rules! forward {
    ($($pointer:ty),*) => {$(
        impl<C: Covariance + ?Sized> Covariance for $pointer {
            fn dim(&self) -> usize {
                (**self).dim()
            }

            fn root_dim(&self) -> usize {
                (**self).root_dim()
            }

            fn apply(&self, x: &[f64], y: &mut [f64]) {
                (**self).apply(x, y);
            }

            fn root(&self, v: &[f64], x: &mut [f64]) {
                (**self).root(v, x);
            }

            fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
                (**self).root_transpose(x, v);
            }

            fn variance(&self, variance: &mut [f64]) {
                (**self).variance(variance);
            }
        }

        impl<C: Precision + ?Sized> Precision for $pointer {
            fn solve(&self, x: &[f64], y: &mut [f64]) {
                (**self).solve(x, y);
            }

            fn whiten(&self, x: &[f64], v: &mut [f64]) {
                (**self).whiten(x, v);
            }

            fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
                (**self).whiten_transpose(v, x);
            }
        }
    )*};
}

forward!(&C, Box<C>, Rc<C>, Arc<C>);
