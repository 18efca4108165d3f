//! The numbers that geometry and elements are written over.

use nalgebra::{RealField, Vector3};
use num_dual::Dual64;

/// A number that the energy of a rod can be computed with: f64, or a dual number that carries derivatives
/// along (those of the package `num-dual` are such numbers).
///
/// Implemented for every `Copy` type that is a [`nalgebra::RealField`]; nothing else is asked for.
///
/// ```
/// use num_dual::{Dual64, first_derivative};
/// use varda_rod::Real;
///
/// fn square<T: Real>(x: T) -> T {
///     x * x + T::of(1.0)
/// }
///
/// assert_eq!(square(3.0), 10.0);
/// assert_eq!(first_derivative(|x: Dual64| square(x), 3.0), (10.0, 6.0));
/// ```
pub trait Real: RealField + Copy {
    /// The constant `value`.
    #[inline(always)]
    fn of(value: f64) -> Self {
        nalgebra::convert(value)
    }

    /// Its value, without any derivatives.
    #[inline(always)]
    fn value(self) -> f64 {
        nalgebra::convert_unchecked(self)
    }
}

impl<T: RealField + Copy> Real for T {}

/// |v|².
#[inline(always)]
pub(crate) fn square<T: Real>(v: &Vector3<T>) -> T {
    v.dot(v)
}

/// |v|.
#[inline(always)]
pub(crate) fn length<T: Real>(v: &Vector3<T>) -> T {
    square(v).sqrt()
}

/// v/|v|.
#[inline(always)]
pub(crate) fn unit<T: Real>(v: &Vector3<T>) -> Vector3<T> {
    v * (T::one() / length(v))
}

/// value + ε slope.
pub(crate) fn dual(value: &Vector3<f64>, slope: &Vector3<f64>) -> Vector3<Dual64> {
    Vector3::from_fn(|c, _| Dual64::new(value[c], slope[c]))
}
