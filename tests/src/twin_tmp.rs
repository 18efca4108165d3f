//! Streams (until the twin module lands).
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
/// What for.
#[derive(Clone, Copy)]
pub enum Stream {
    /// B.
    Background = 1,
    /// R.
    Observations = 2,
}
/// One stream.
pub fn stream(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream as u64);
    rng
}
/// N(0, σ²).
pub fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    sigma * unit
}
