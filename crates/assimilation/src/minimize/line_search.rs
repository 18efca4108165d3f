//! The one line search: steps along a direction on which J decreases enough.

use super::stopping::NOISE;
use crate::Error;
use crate::cost::{dot, norm};

/// Armijo: φ(α) ≤ φ(0) + 10⁻⁴ α φ'(0).
const DECREASE: f64 = 1e-4;
/// Wolfe: |φ'(α)| ≤ 0.9 |φ'(0)|.
const CURVATURE: f64 = 0.9;

/// What is asked of a step α along p, with φ(α) = J(v + αp).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Conditions {
    /// Nothing: the full step, whatever J does there.
    FullStep,
    /// Sufficient decrease, by steps of 1, ½, ¼, …; where the decrease promised is below what J resolves,
    /// a smaller gradient. A gradient is computed only where the value is accepted, or decides.
    Armijo,
    /// Sufficient decrease and a flatter slope (strong Wolfe), every trial with its gradient; where the
    /// decrease is below what J resolves the slopes decide (Hager and Zhang 2005, approximate Wolfe).
    Wolfe,
}

/// Where a search starts: the point v with J(v) and ‖∇J(v)‖, the direction p and the slope ∇Jᵀp (of
/// the whitened increment, where p is not one).
pub(crate) struct Ray<'a> {
    pub(crate) v: &'a [f64],
    pub(crate) direction: &'a [f64],
    pub(crate) value: f64,
    pub(crate) slope: f64,
    pub(crate) gradient_norm: f64,
    /// The first length tried.
    pub(crate) first: f64,
}

/// J and, if asked for, the gradient at a point.
pub(crate) type Evaluate<'a> = dyn FnMut(&[f64], Option<&mut [f64]>) -> Result<f64, Error> + 'a;

/// A line search and what it leaves behind: the point taken and its gradient, the cost's last evaluation.
pub(crate) struct LineSearch {
    pub(crate) trial: Vec<f64>,
    pub(crate) gradient: Vec<f64>,
    /// Trial points refused since this was last set to 0.
    pub(crate) refused: usize,
    /// The last failure at a trial point; the search goes on with J = ∞ there.
    pub(crate) failure: Option<Error>,
}

/// φ(α) and its slope.
#[derive(Clone, Copy)]
struct Sample {
    length: f64,
    value: f64,
    slope: f64,
}

impl LineSearch {
    pub(crate) fn new(n: usize) -> Self {
        Self { trial: vec![0.0; n], gradient: vec![0.0; n], refused: 0, failure: None }
    }

    /// The length of a step that satisfies the conditions (or, with Wolfe's, at least lowers J); `None` if
    /// there is none.
    pub(crate) fn run(&mut self, conditions: Conditions, cost: &mut Evaluate, ray: &Ray) -> Option<f64> {
        match conditions {
            Conditions::FullStep => {
                self.place(ray, ray.first);
                let taken = self.gradient_here(cost).is_some();
                self.refused += usize::from(!taken);
                taken.then_some(ray.first)
            }
            Conditions::Armijo => self.armijo(cost, ray),
            Conditions::Wolfe => self.wolfe(cost, ray),
        }
    }

    fn armijo(&mut self, cost: &mut Evaluate, ray: &Ray) -> Option<f64> {
        let (mut length, mut blind) = (ray.first, 0);
        // 2⁻⁴⁰: a descent direction that needs less than 1e-12 of its step is none. Where J resolves
        // nothing, a gradient that does not fall over 2⁻⁷ of the step is at the accuracy of the model.
        for _ in 0..=40 {
            self.place(ray, length);
            let by_gradient = -length * ray.slope <= NOISE * ray.value;
            let accepted = if by_gradient {
                self.gradient_here(cost).is_some() && norm(&self.gradient) < ray.gradient_norm
            } else {
                let lower = match cost(&self.trial, None) {
                    Ok(value) => value <= ray.value + DECREASE * length * ray.slope,
                    Err(error) => {
                        self.failure = Some(error);
                        false
                    }
                };
                lower && self.gradient_here(cost).is_some()
            };
            if accepted {
                return Some(length);
            }
            self.refused += 1;
            length *= 0.5;
            blind += usize::from(by_gradient);
            if blind >= 8 {
                break;
            }
        }
        None
    }

    /// The bracket [low, high] always has a solution in it: low has decreased J enough and still falls
    /// steeply, high has not, or rises, or cannot be evaluated.
    fn wolfe(&mut self, cost: &mut Evaluate, ray: &Ray) -> Option<f64> {
        let &Ray { value, slope, .. } = ray;
        if !(slope < 0.0) {
            return None;
        }
        let noise = NOISE * value.abs();
        let mut low = Sample { length: 0.0, value, slope };
        let mut high: Option<(f64, Option<Sample>)> = None;
        let mut length = ray.first;
        // The bracket halves at least every third trial: 60 reach 1e-6 of it and more than 1e18 beyond it.
        for trial in 0..60 {
            match self.sample(cost, ray, length) {
                None => high = Some((length, None)),
                Some(here) => {
                    let lower = here.value <= value + DECREASE * length * slope
                        || (here.value <= value + noise && here.slope <= -(1.0 - 2.0 * DECREASE) * slope);
                    if lower && here.slope.abs() <= -CURVATURE * slope {
                        return Some(length);
                    }
                    if lower && here.slope < 0.0 {
                        low = here;
                    } else {
                        high = Some((length, Some(here)));
                    }
                }
            }
            self.refused += 1;
            length = match high {
                // Where the slope vanishes if it goes on as it does.
                None => (length * slope / (slope - low.slope)).clamp(2.0 * length, 10.0 * length),
                Some((end, None)) => low.length + 0.25 * (end - low.length),
                Some((end, Some(_))) if trial % 3 == 2 => 0.5 * (low.length + end),
                Some((_, Some(end))) => between(&low, &end, noise),
            };
            if let Some((end, _)) = high
                && !(end - low.length > 1e-12 * end)
            {
                break;
            }
        }
        // A step at the rounding level of v is not progress.
        let moves = low.length * norm(ray.direction) > 1e-12 * (1.0 + norm(ray.v));
        (moves && self.sample(cost, ray, low.length).is_some()).then_some(low.length)
    }

    fn place(&mut self, ray: &Ray, length: f64) {
        let from = ray.v.iter().zip(ray.direction);
        self.trial.iter_mut().zip(from).for_each(|(t, (v, p))| *t = v + length * p);
    }

    /// J and the gradient at the trial point.
    fn gradient_here(&mut self, cost: &mut Evaluate) -> Option<f64> {
        cost(&self.trial, Some(&mut self.gradient)).map_err(|error| self.failure = Some(error)).ok()
    }

    fn sample(&mut self, cost: &mut Evaluate, ray: &Ray, length: f64) -> Option<Sample> {
        self.place(ray, length);
        let value = self.gradient_here(cost)?;
        Some(Sample { length, value, slope: dot(&self.gradient, ray.direction) })
    }
}

/// The minimizer of the cubic through both ends (of the parabola through the slopes where the values are
/// rounding), kept away from them.
fn between(low: &Sample, high: &Sample, noise: f64) -> f64 {
    let width = high.length - low.length;
    let share = if (high.value - low.value).abs() <= noise {
        -low.slope / (high.slope - low.slope)
    } else {
        let d1 = low.slope + high.slope - 3.0 * (high.value - low.value) / width;
        let d2 = (d1 * d1 - low.slope * high.slope).max(0.0).sqrt();
        1.0 - (high.slope + d2 - d1) / (high.slope - low.slope + 2.0 * d2)
    };
    low.length + width * if share.is_finite() { share.clamp(0.1, 0.9) } else { 0.5 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// J = ½ v², and no value beyond |v| = 3.
    fn bowl(v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        if v[0].abs() > 3.0 {
            return Err(Error::NonFinite { what: "the cost", step: 0 });
        }
        if let Some(g) = gradient {
            g[0] = v[0];
        }
        Ok(0.5 * v[0] * v[0])
    }

    /// From v = 1 along −p, `p` times the step to the minimum.
    fn from_one(conditions: Conditions, p: f64) -> (Option<f64>, LineSearch, [usize; 2]) {
        let (mut search, mut calls) = (LineSearch::new(1), [0, 0]);
        let ray = Ray { v: &[1.0], direction: &[-p], value: 0.5, slope: -p, gradient_norm: 1.0, first: 1.0 };
        let mut cost = |v: &[f64], gradient: Option<&mut [f64]>| {
            calls[usize::from(gradient.is_some())] += 1;
            bowl(v, gradient)
        };
        (search.run(conditions, &mut cost, &ray), search, calls)
    }

    #[test]
    fn a_good_step_is_taken_whole_under_all_conditions() {
        for (conditions, values) in
            [(Conditions::FullStep, 0), (Conditions::Armijo, 1), (Conditions::Wolfe, 0)]
        {
            let (length, search, calls) = from_one(conditions, 1.0);
            assert_eq!((length, search.refused, calls), (Some(1.0), 0, [values, 1]), "{conditions:?}");
            assert_eq!((search.trial[0], search.gradient[0]), (0.0, 0.0), "{conditions:?}");
        }
    }

    #[test]
    fn a_trial_that_fails_is_refused_and_the_search_goes_on() {
        // v = −7 has no value; at −3 and −1 J is not lower
        let (length, search, _) = from_one(Conditions::Armijo, 8.0);
        assert_eq!((length, search.refused), (Some(0.125), 3));
        assert!(search.failure.is_some());
        let (length, search, _) = from_one(Conditions::Wolfe, 8.0);
        let end = search.trial[0];
        assert!(length.is_some() && 0.5 * end * end < 0.5 && end.abs() <= 0.9 && search.failure.is_some());
        let (length, search, calls) = from_one(Conditions::FullStep, 8.0);
        assert_eq!((length, search.refused, calls), (None, 1, [0, 1]));
    }

    #[test]
    fn no_step_is_found_uphill() {
        for conditions in [Conditions::Armijo, Conditions::Wolfe] {
            assert_eq!(from_one(conditions, -0.5).0, None, "{conditions:?}");
        }
    }
}
