//! Truth, background error and observation error of a twin experiment, from one seed.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// What a stream of random numbers is for. Streams of one seed are independent: more observations do not
/// change the background.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// Anything random in the truth.
    Truth = 0,
    /// The background error.
    Background = 1,
    /// The observation errors.
    Observations = 2,
    /// Ensemble perturbations.
    Ensemble = 3,
    /// Directions followed through a window.
    Directions = 4,
    /// Rotations of an ensemble between windows.
    Rotations = 5,
    /// Errors of the model, drawn for members.
    ModelErrors = 6,
}

/// ChaCha with 8 rounds, one stream per purpose: the same numbers on every machine and in every version.
pub fn stream(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream as u64);
    rng
}

/// The same for a window of a sequence: every window has numbers of its own, whatever the others drew.
pub fn stream_of_window(seed: u64, stream: Stream, window: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(((window as u64 + 1) << 8) + stream as u64);
    rng
}

/// A draw from N(0, σ²).
pub fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    sigma * unit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |seed, s| normal(&mut stream(seed, s), 1.0);
        assert_eq!(draw(1, Stream::Background), draw(1, Stream::Background));
        assert_ne!(draw(1, Stream::Background), draw(1, Stream::Observations));
        assert_ne!(draw(1, Stream::Background), draw(2, Stream::Background));
        let of_window = |window| normal(&mut stream_of_window(1, Stream::Background, window), 1.0);
        assert_eq!(of_window(3), of_window(3));
        assert!(of_window(0) != of_window(1) && of_window(0) != draw(1, Stream::Background));
    }
}
