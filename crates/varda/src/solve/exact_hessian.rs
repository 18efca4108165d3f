//! The posterior of the exact Hessian, beside that of Gauss and Newton.

use varda_assimilation::{ControlTransform, Error, LeastSquares, Posterior};

use super::task::PosteriorSpread;
use crate::outcome::ExactHessian;
use crate::setup::random::{Stream, stream};

/// Draws that are run through the model.
const DRAWS: usize = 32;

/// The spread by the exact Hessian around v, the point of the last gradient; by that of Gauss and Newton
/// where J is not convex there.
pub(super) fn spread(
    cost: &mut dyn LeastSquares,
    transform: &ControlTransform,
    v: &[f64],
) -> Result<(Option<PosteriorSpread>, Option<Error>, ExactHessian), Error> {
    let gauss_newton = Posterior::new(cost);
    let none =
        ExactHessian { smallest_eigenvalue: None, sigma_change: None, draws: 0, effective_share: None };
    let exact = match Posterior::exact(cost) {
        Ok(exact) => exact,
        Err(Error::NotPositiveDefinite { smallest }) => {
            let (spread, no_spread) = PosteriorSpread::of(gauss_newton, transform, true)?;
            return Ok((spread, no_spread, ExactHessian { smallest_eigenvalue: Some(smallest), ..none }));
        }
        Err(error) => return Err(error),
    };
    let sigma_change = gauss_newton.ok().map(|other| {
        let pairs = exact.variance(transform).into_iter().zip(other.variance(transform));
        let change = |(exact, other): (f64, f64)| ((exact / other).sqrt() - 1.0).abs();
        pairs.filter(|(_, other)| *other > 0.0).map(change).fold(0.0, f64::max)
    });
    let share = exact.effective_share(cost, v, DRAWS, &mut stream(0, Stream::Directions))?;
    let found = ExactHessian {
        smallest_eigenvalue: exact.spectrum().first().copied(),
        sigma_change,
        draws: DRAWS,
        effective_share: Some(share),
    };
    Ok((Some(PosteriorSpread::around(&exact, transform, true)), None, found))
}
