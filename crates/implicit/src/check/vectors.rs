//! Scaled norms, comparison of bits, random directions.

/// ‖v / scale‖.
pub(super) fn norm_of(v: &[f64], scale: &[f64]) -> f64 {
    assert_eq!(v.len(), scale.len(), "a vector and its scale differ in length");
    v.iter().zip(scale).map(|(v, s)| (v / s).powi(2)).sum::<f64>().sqrt()
}

/// Number of values that differ in a bit.
pub(super) fn differing(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64
}

/// SplitMix64 (Steele, Lea and Flood 2014): enough for test vectors, and no dependency.
pub(super) struct Random(pub(super) u64);

impl Random {
    /// A number in [−1, 1).
    pub(super) fn draw(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
