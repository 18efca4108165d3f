//! What code for wide registers leaves behind.

use pulp::{Arch, Simd, WithSimd};
use std::hint::black_box;

/// Leaves the upper halves of the vector registers clean.
///
/// Dense products and eigenvalues (faer's kernels) return without clearing them, and code for narrow
/// registers, which is most of a program, then runs at a third of its speed on some processors (x86 with
/// AVX-512: 2.9 times, measured on RK4 with 1000 variables) until some function for wide ones returns as its
/// compiler would have it. This is one; it takes nanoseconds. Changes no number.
pub(crate) fn clear_upper_registers() {
    Arch::new().dispatch(Wide);
}

struct Wide;

impl WithSimd for Wide {
    type Output = ();

    /// Something that takes a wide register, so that the compiler clears it at the end.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mut numbers = black_box([1.0_f64; 8]);
        numbers.iter_mut().for_each(|x| *x = 1.5 * *x + 1.0);
        black_box(&mut numbers);
    }
}
