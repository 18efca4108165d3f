//! The posterior of the exact Hessian, beside that of Gauss and Newton.

use varda_assimilation::{ControlTransform, Error, LeastSquares, LowRankPosterior, Posterior};

use super::intervals;
use super::task::{PosteriorSpread, low_rank_options};
use crate::outcome::ExactHessian;
use crate::setup::random::{Stream, stream};

/// Draws that are run through the model.
const DRAWS: usize = 32;

const NONE: ExactHessian =
    ExactHessian { smallest_eigenvalue: None, sigma_change: None, draws: 0, effective_share: None };

/// The largest |σ/σ_GN − 1|.
fn largest_change(exact: &PosteriorSpread, other: &PosteriorSpread) -> f64 {
    let pairs = exact.sigma.iter().zip(&other.sigma).filter(|(_, other)| **other > 0.0);
    pairs.map(|(exact, other)| (exact / other - 1.0).abs()).fold(0.0, f64::max)
}

/// The spread of low rank by the exact Hessian around the point of the last gradient; by that of Gauss and
/// Newton where J is not convex there, or products do not bound what is left out.
pub(super) fn low_rank(
    cost: &mut dyn LeastSquares,
    transform: &ControlTransform,
) -> Result<(PosteriorSpread, ExactHessian), Error> {
    let gauss_newton = PosteriorSpread::of_low_rank(cost, transform)?;
    let mut rng = stream(0, Stream::Directions);
    match LowRankPosterior::lanczos_exact(cost, &low_rank_options(), &mut rng) {
        Ok(exact) if exact.error_bound().is_some() => {
            let spread = PosteriorSpread::around_low_rank(&exact, transform);
            let sigma_change = Some(largest_change(&spread, &gauss_newton));
            // all that were not found are 1
            let smallest = exact.spectrum().first().map_or(1.0, |mu| mu.min(1.0));
            Ok((spread, ExactHessian { smallest_eigenvalue: Some(smallest), sigma_change, ..NONE }))
        }
        Ok(_) => Ok((gauss_newton, NONE)),
        Err(Error::NotPositiveDefinite { smallest }) => {
            Ok((gauss_newton, ExactHessian { smallest_eigenvalue: Some(smallest), ..NONE }))
        }
        Err(error) => Err(error),
    }
}

/// The spread by the exact Hessian around v, the point of the last gradient; by that of Gauss and Newton
/// where J is not convex there.
pub(super) fn spread(
    cost: &mut dyn LeastSquares,
    transform: &ControlTransform,
    v: &[f64],
    constants: &[usize],
) -> Result<(Option<PosteriorSpread>, Option<Error>, ExactHessian), Error> {
    let gauss_newton = Posterior::new(cost);
    let exact = match Posterior::exact(cost) {
        Ok(exact) => exact,
        Err(Error::NotPositiveDefinite { smallest }) => {
            let (spread, no_spread) = match gauss_newton {
                Ok(posterior) => (Some(PosteriorSpread::around(&posterior, transform, true)), None),
                Err(reason @ Error::NotPositiveDefinite { .. }) => (None, Some(reason)),
                Err(error) => return Err(error),
            };
            return Ok((spread, no_spread, ExactHessian { smallest_eigenvalue: Some(smallest), ..NONE }));
        }
        Err(error) => return Err(error),
    };
    let sigma_change = gauss_newton.ok().map(|other| {
        let other = PosteriorSpread::around(&other, transform, false);
        largest_change(&PosteriorSpread::around(&exact, transform, false), &other)
    });
    let share = exact.effective_share(cost, v, DRAWS, &mut stream(0, Stream::Directions))?;
    let found = ExactHessian {
        smallest_eigenvalue: exact.spectrum().first().copied(),
        sigma_change,
        draws: DRAWS,
        effective_share: Some(share),
    };
    Ok((Some(intervals::spread(&exact, cost, transform, v, constants)?), None, found))
}
