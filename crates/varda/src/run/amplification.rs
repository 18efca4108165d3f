//! How much a window amplifies perturbations of its start: a scene's random directions for the library's
//! estimate.

use rand_distr::{Distribution, StandardNormal};
use varda_implicit::Model;
use varda_implicit::check::{self, Amplification};

use crate::setup::random::{Stream, stream};

/// [`check::amplification`] with normal directions from the scene's seed; `None` for a run that cannot be
/// linearized.
pub(crate) fn estimate(
    model: &mut dyn Model,
    control: &[f64],
    sigma: &[f64],
    states: &[f64],
    seed: u64,
) -> Option<Amplification> {
    let mut rng = stream(seed, Stream::Directions);
    check::amplification(model, control, sigma, states, &mut || StandardNormal.sample(&mut rng)).ok()
}
