//! Quasi-static growth of the window: for costs that have several minima because the window is long.

use crate::{Error, Minimum, ObservationSet};

/// Minimises the cost of the observations it is given from a control variable on, and leaves the point in it.
pub type Assimilate<'a> = dyn FnMut(&mut ObservationSet, &mut Vec<f64>) -> Result<Minimum, Error> + 'a;

/// Assimilates the sub-windows of `windows` steps in turn, each from where the one before ended (Pires,
/// Vautard and Talagrand 1996), and returns the observations with the minimum of every stage.
///
/// `assimilate` minimises the cost of the sub-window it is given, with any method and minimizer, from `v` on,
/// and leaves the point in it; a method whose control grows with the window lengthens `v` itself. The
/// observations of a sub-window of w steps are those at times up to w, a prefix of the stacked vector of all.
/// The last of `windows` must be the whole window.
///
/// In a chaotic system the cost of a short window has one minimum; the minimum of a window moves little when
/// the window grows a little, as long as the growth adds less than a few e-foldings of the error that is
/// left. A stage that ends otherwise than converged still hands its point on: look at the statuses.
///
/// When to use: windows of several e-foldings of a chaotic model, where a start from the background ends in a
/// wrong minimum. When not: one minimum, where every stage but the last is wasted. Cost: a minimization for
/// every window, of its length, the later ones from a start near their minimum. Memory: a copy of the
/// observations.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let all = Selection::new(vec![0, 1, 2], 3)?;
/// let see = |step, values: [f64; 3]| Observation::new(step, vec![0, 1, 2], values.to_vec(), 1.0);
/// let set = ObservationSet::new(
///     40,
///     vec![Box::new(all)],
///     vec![see(20, [8.1, 14.5, 14.9]), see(40, [16.0, 11.0, 41.0])],
/// )?;
/// let b = Diagonal::uniform(3, 1.0)?;
/// let mut v = vec![0.0; 3];
/// let (set, minima) = window_growth(set, &[20, 40], &mut v, &mut |seen, v| {
///     let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
///     let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
///     let mut cost = StrongConstraint::new(&mut model, transform, seen)?;
///     Minimizer::default().minimize(&mut cost, v, &mut |_| ControlFlow::Continue(()))
/// })?;
/// assert_eq!((set.dim(), minima.len()), (6, 2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error::Setting`] for windows that do not increase to the whole one; what `assimilate` returns.
pub fn window_growth(
    observations: ObservationSet,
    windows: &[usize],
    v: &mut Vec<f64>,
    assimilate: &mut Assimilate,
) -> Result<(ObservationSet, Vec<Minimum>), Error> {
    let whole = observations.steps();
    if let Some(pair) = windows.windows(2).find(|pair| pair[0] >= pair[1]) {
        return Err(Error::Setting { what: "a window that does not grow", value: pair[1] as f64 });
    }
    if windows.last() != Some(&whole) {
        let value = windows.last().map_or(f64::NAN, |&w| w as f64);
        return Err(Error::Setting { what: "the last of window_growth", value });
    }
    let times = observations.times().clone();
    let (mut operators, all) = observations.into_parts();
    let mut minima = Vec::new();
    for &window in windows {
        let seen = all.iter().filter(|o| o.step as f64 + o.weight <= window as f64).cloned().collect();
        let mut set = ObservationSet::of(times.first(window), operators, seen)?;
        minima.push(assimilate(&mut set, v)?);
        operators = set.into_parts().0;
    }
    Ok((ObservationSet::of(times, operators, all)?, minima))
}
