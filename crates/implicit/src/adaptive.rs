//! Lengths of steps from an estimate of their error.

use crate::newton::{self, NewtonOptions, NewtonWork};
use crate::{Error, ImplicitStep, Interval, Scheme, StepEquations};

/// Tolerance and limits of [`accepted_times`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Adaptive {
    /// Most error of one step, as a root mean square over the components that matter, in units of their
    /// scale.
    pub tolerance: f64,
    /// Length of the first step tried (s).
    pub first: f64,
    /// No step is shorter (s).
    pub shortest: f64,
    /// No step is longer (s).
    pub longest: f64,
}

/// The times of steps whose estimated error is within a tolerance, from the state x₀; they contain all of
/// `through`.
///
/// The list is plain data. Given to [`ImplicitModel::on_times`](crate::ImplicitModel::on_times) it makes a
/// model with fixed steps, whose tangent and adjoint are exact: freeze it over a minimization, and ask again
/// around the new trajectory.
///
/// The error of a step of length h is estimated by Richardson's extrapolation, from the same step in two
/// halves: ‖x_{h/2,h/2} − x_h‖ / (1 − 2^{−p}), p the order of the scheme. The next length is h ·
/// 0.9 (tolerance/error)^{1/(p+1)}, within a factor of 0.2 and 2 (BDF2 is stable up to 2.4; Hairer, Nørsett
/// and Wanner 1993, III.5). A step that Newton's method does not solve is halved. This costs three solves a
/// step.
///
/// `x0` is a state with its history, as [`ImplicitModel`](crate::ImplicitModel) makes it from a control;
/// `scale` holds a typical size of each of its components, infinity for those that do not matter; those of
/// the history are not read.
///
/// # Errors
/// [`Error::ToleranceNotMet`] where the shortest step is too long, or the error of Newton's method there.
///
/// # Panics
/// If `through` has fewer than two times or does not ascend, lengths differ, or a length or the tolerance of
/// `options` is not positive.
///
/// # Examples
///
/// ```
/// use varda_implicit::{Adaptive, ImplicitModel, Model, OneLeg, Scheme, Substepped, accepted_times};
/// use varda_implicit::lorenz::Lorenz63;
///
/// let mut step = OneLeg::implicit_midpoint(Lorenz63::default(), 1e-11);
/// let options = Adaptive { tolerance: 1e-3, first: 0.01, shortest: 1e-6, longest: 0.1 };
/// let (x0, through) = ([1.0, 3.0, 20.0], [0.0, 0.1, 0.2]);
/// let times = accepted_times(&mut step, Scheme::Midpoint, &x0, &[1.0; 3], &through, &options)?;
/// // two steps of 0.1, each as many of `times` as the tolerance asks for
/// let model = ImplicitModel::on_times(step, times.clone());
/// let mut model = Substepped::through(model, &times, &through);
/// let mut next = [0.0; 3];
/// let work = model.step(0, &x0, &mut next)?;
/// assert!(work.steps > 1);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub fn accepted_times<S: ImplicitStep>(
    step: &mut S,
    scheme: Scheme,
    x0: &[f64],
    scale: &[f64],
    through: &[f64],
    options: &Adaptive,
) -> Result<Vec<f64>, Error> {
    let n = step.dim();
    assert!(x0.len() == n && scale.len() == n, "a state and its scale have {n} values");
    assert!(
        through.len() > 1 && through.windows(2).all(|t| t[0] < t[1]),
        "times to go through must ascend, two or more of them"
    );
    let Adaptive { tolerance, first, shortest, longest } = *options;
    assert!(
        tolerance > 0.0 && first > 0.0 && shortest > 0.0 && longest >= shortest,
        "a tolerance and lengths must be positive"
    );
    let order = scheme.order();
    let mut judge = Judge::new(step, scheme, scale);
    let (mut x, mut times) = (x0.to_vec(), vec![through[0]]);
    let (mut wanted, mut previous) = (first.clamp(shortest, longest), None);
    for end in &through[1..] {
        let mut start = times[times.len() - 1];
        while start < *end {
            // equal shares of what is left, so that no crumb remains before the next time to go through
            let left = end - start;
            let length = left / (left / wanted).ceil();
            let at = Interval { index: times.len() - 1, start, length, previous };
            let error = match judge.error(&at, &x) {
                Ok(error) => error,
                Err(error) if 0.5 * length < shortest => return Err(error),
                Err(_) => {
                    wanted = 0.5 * length;
                    continue;
                }
            };
            let factor = 0.9 * (tolerance / error).powf(1.0 / f64::from(order + 1));
            if error <= tolerance {
                x.copy_from_slice(&judge.whole);
                start = if length == left { *end } else { start + length };
                times.push(start);
                previous = Some(length);
                wanted = (length * factor.clamp(0.2, 2.0)).clamp(shortest, longest);
            } else if length <= shortest || !error.is_finite() {
                return Err(Error::ToleranceNotMet { time: start, length, error, tolerance });
            } else {
                wanted = (length * factor.clamp(0.2, 0.9)).max(shortest);
            }
        }
    }
    Ok(times)
}

/// The largest estimated error of the steps between `times` from another state x₀: whether steps that were
/// accepted along one trajectory still do along another. In the units of [`Adaptive::tolerance`], estimated
/// as in [`accepted_times`]; three solves a step.
///
/// # Errors
/// The error of Newton's method in a step or in one of its halves.
///
/// # Panics
/// If `times` has fewer than two times or does not ascend, or lengths differ.
pub fn largest_error<S: ImplicitStep>(
    step: &mut S,
    scheme: Scheme,
    x0: &[f64],
    scale: &[f64],
    times: &[f64],
) -> Result<f64, Error> {
    let n = step.dim();
    assert!(x0.len() == n && scale.len() == n, "a state and its scale have {n} values");
    assert!(times.len() > 1 && times.windows(2).all(|t| t[0] < t[1]), "times must ascend, two or more");
    let mut judge = Judge::new(step, scheme, scale);
    let (mut x, mut previous, mut largest) = (x0.to_vec(), None, 0.0);
    for (index, pair) in times.windows(2).enumerate() {
        let length = pair[1] - pair[0];
        let error = judge.error(&Interval { index, start: pair[0], length, previous }, &x)?;
        if !(error <= largest) {
            largest = error;
        }
        x.copy_from_slice(&judge.whole);
        previous = Some(length);
    }
    Ok(largest)
}

/// Steps taken whole and in two halves.
struct Judge<'a, S> {
    one: OneStep<'a, S>,
    /// 1 / (1 − 2^{−p}).
    factor: f64,
    scale: &'a [f64],
    /// Components of the state that are not history.
    own: usize,
    /// How many of those matter.
    judged: f64,
    /// The state after the step last judged, taken whole.
    whole: Vec<f64>,
    half: Vec<f64>,
    halves: Vec<f64>,
}

impl<'a, S: ImplicitStep> Judge<'a, S> {
    fn new(step: &'a mut S, scheme: Scheme, scale: &'a [f64]) -> Self {
        let n = step.dim();
        let own = n - step.history();
        Self {
            one: OneStep::new(step),
            factor: 1.0 / (1.0 - 0.5_f64.powi(scheme.order())),
            scale,
            own,
            judged: scale[..own].iter().filter(|s| s.is_finite()).count().max(1) as f64,
            whole: vec![0.0; n],
            half: vec![0.0; n],
            halves: vec![0.0; n],
        }
    }

    /// The estimated error of a step from x.
    fn error(&mut self, at: &Interval, x: &[f64]) -> Result<f64, Error> {
        let length = at.length;
        let first_half = Interval { length: 0.5 * length, ..*at };
        let second_half =
            Interval { start: at.start + 0.5 * length, previous: Some(0.5 * length), ..first_half };
        self.one.take(at, x, &mut self.whole)?;
        self.one.take(&first_half, x, &mut self.half)?;
        self.one.take(&second_half, &self.half, &mut self.halves)?;
        let squares = (0..self.own).map(|i| ((self.halves[i] - self.whole[i]) / self.scale[i]).powi(2));
        Ok((squares.sum::<f64>() / self.judged).sqrt() * self.factor)
    }
}

/// Single steps on any interval.
struct OneStep<'a, S> {
    step: &'a mut S,
    work: NewtonWork,
    u: Vec<f64>,
}

impl<'a, S: ImplicitStep> OneStep<'a, S> {
    fn new(step: &'a mut S) -> Self {
        let work = NewtonWork::new(step.unknowns(), &step.structure());
        Self { work, u: vec![0.0; step.unknowns()], step }
    }

    fn take(&mut self, at: &Interval, x: &[f64], x_next: &mut [f64]) -> Result<(), Error> {
        let own = x.len() - self.step.history();
        let refused = |reason| Error::refused(at.index, reason);
        {
            let mut equations = self.step.equations(at, x).map_err(refused)?;
            equations.predict(&mut self.u).map_err(refused)?;
            newton::solve(&mut equations, &mut self.u, &mut self.work, &NewtonOptions::default())
                .map_err(|failure| failure.in_step(at))?;
        }
        self.step.advance(at, x, &self.u, &mut x_next[..own]);
        x_next[own..].copy_from_slice(&x[..x.len() - own]);
        Ok(())
    }
}
