//! The one line search: steps along a direction on which J decreases enough.

use crate::Error;
use crate::cost::{dot, norm};

/// A decrease below this part of J cannot be seen in J (its trajectory is only as exact as the model's
/// solver); steps are then judged by the gradient.
pub(crate) const NOISE: f64 = 1e-11;
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
