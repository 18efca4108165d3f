//! The χ² distribution: tails, and how large J may be at a fit.

use libm::{erfc, lgamma};
use std::f64::consts::FRAC_1_SQRT_2;

/// Beyond this many standard deviations a tail is not told from 0 in double precision.
const FARTHEST: f64 = 25.0;

/// J below which an analysis explains m observed values: at the minimum of a linear problem whose B and R are
/// right, 2J is χ² with m degrees of freedom, and this is its mean with three of its standard
/// deviations, 2J/m = 1 + 3 √(2/m).
///
/// ```
/// use varda_assimilation::highest_j_of_a_fit;
///
/// assert_eq!(2.0 * highest_j_of_a_fit(72) / 72.0, 1.5);
/// ```
pub fn highest_j_of_a_fit(m: usize) -> f64 {
    let m = m as f64;
    0.5 * m + 1.5 * (2.0 * m).sqrt()
}

/// The length √(dᵀ S⁻¹ d) that r jointly normal values exceed as seldom as one value exceeds `limit`
/// standard deviations: the root of P(χ²_r > x²) = P(|z| > limit). Beyond 25 σ it grows in proportion.
///
/// The tail by the finite sums of Abramowitz and Stegun (1964), 26.4.4 and 26.4.5, the root by bisection.
pub(super) fn distance(limit: f64, r: usize) -> f64 {
    if r <= 1 || !(limit > 0.0) {
        return limit;
    }
    if limit > FARTHEST {
        return limit / FARTHEST * distance(FARTHEST, r);
    }
    let tail_of_one = erfc(limit * FRAC_1_SQRT_2);
    let (mut below, mut above) = (limit, limit + 1.0);
    while tail(above, r) > tail_of_one {
        (below, above) = (above, 2.0 * above);
    }
    loop {
        let middle = 0.5 * (below + above);
        if !(below < middle && middle < above) {
            return above;
        }
        if tail(middle, r) > tail_of_one { below = middle } else { above = middle }
    }
}

/// P(χ²_r > x²).
fn tail(x: f64, r: usize) -> f64 {
    let y = 0.5 * x * x;
    // y^a e^{-y} / Γ(a + 1)
    let term = |a: f64| (a * y.ln() - y - lgamma(a + 1.0)).exp();
    if r.is_multiple_of(2) {
        (0..r / 2).map(|k| term(k as f64)).sum()
    } else {
        erfc(x * FRAC_1_SQRT_2) + (1..=r / 2).map(|k| term(k as f64 - 0.5)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_printed_tables() {
        // Upper 5 % and 0.1 % points, Pearson and Hartley (1966), table 8: five digits.
        for (r, upper, p) in [
            (1, 3.841459, 0.05),
            (2, 5.991465, 0.05),
            (3, 7.814728, 0.05),
            (10, 18.30704, 0.05),
            (3, 16.26624, 1e-3),
            (100, 149.4493, 1e-3),
        ] {
            assert!((tail(f64::sqrt(upper), r) / p - 1.0).abs() < 1e-5, "{r} {upper}");
        }
    }

    #[test]
    fn a_group_is_refused_as_seldom_as_one_value() {
        for limit in [0.1, 1.0, 4.0, 10.0, 24.9, 25.0] {
            let one = erfc(limit * FRAC_1_SQRT_2);
            let mut last = limit;
            for r in [2, 3, 4, 17, 400] {
                let x = distance(limit, r);
                assert!(x > last, "{limit} {r}");
                // one unit in the last place of x changes the tail by x² units
                assert!((tail(x, r) / one - 1.0).abs() <= 1e-14 * (10.0 + x * x), "{limit} {r}");
                last = x;
            }
        }
        assert_eq!(distance(4.0, 1), 4.0);
        assert!((distance(50.0, 3) / distance(25.0, 3) - 2.0).abs() < 1e-15);
        assert_eq!(distance(f64::INFINITY, 3), f64::INFINITY);
        assert!(distance(f64::NAN, 3).is_nan());
    }
}
