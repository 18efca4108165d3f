//! Checks of tangents, adjoints and gradients, for any [`Model`] and any scalar function.
//!
//! A check returns numbers, the bound they were held against and whether they pass, and refuses
//! ([`Error::EmptyTest`]) what it could not judge. Components of a state may have different units: `scale` holds a typical
//! perturbation of each, all norms are those of x/scale (and of λ · scale), and random vectors are drawn to match.
//! [`conformance`] runs everything on one step.
//!
//! A dot-product test proves that the adjoint is the transpose of the tangent; only a Taylor test proves that the
//! tangent is the derivative of the step.

use crate::{Error, Keep, Model, Trajectory};

/// One line of a report: a number, what it must not exceed, and the verdict.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// What was checked.
    pub what: &'static str,
    /// The number found.
    pub value: f64,
    /// The most it may be.
    pub bound: f64,
    /// Whether `value` ≤ `bound` (false for NaN).
    pub pass: bool,
}

impl Outcome {
    fn at_most(what: &'static str, value: f64, bound: f64) -> Self {
        Self { what, value, bound, pass: value <= bound }
    }
}

/// The dot-product test ⟨M dx, λ⟩ = ⟨dx, Mᵀ λ⟩.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DotProduct {
    /// ⟨M dx, λ⟩.
    pub forward: f64,
    /// ⟨dx, Mᵀ λ⟩.
    pub backward: f64,
    /// |forward − backward| / (‖M dx‖ ‖λ‖).
    pub value: f64,
    /// 50 ε `condition`.
    pub bound: f64,
    /// Estimate of ‖M‖ ‖dx‖ / ‖M dx‖, the condition of the product M dx: ‖M‖ by twelve power iterations with MᵀM.
    pub condition: f64,
    /// Whether `value` ≤ `bound`.
    pub pass: bool,
}

/// A Taylor test: remainders of first order against the size of the perturbation.
#[derive(Debug, Clone, PartialEq)]
pub struct Taylor {
    /// Slope of log remainder over log step, fitted by least squares: 2 for a right derivative (more where the second
    /// derivative vanishes along the direction, infinite for a function that is linear to rounding), 1 for a wrong one.
    pub slope: f64,
    /// The slope must be at least this.
    pub bound: f64,
    /// The steps used, decreasing, and their remainders.
    pub points: Vec<(f64, f64)>,
    /// Whether `slope` ≥ `bound` (false for NaN).
    pub pass: bool,
}

/// Condition beyond which a dot product says nothing.
const WORST_CONDITION: f64 = 1e10;
/// Relative error of a gradient that a minimizer can live with.
const WORST_GRADIENT: f64 = 1e-4;
/// Slope that a Taylor test asks for.
const SLOPE: f64 = 1.95;
/// Points a slope is fitted through, at most and at least.
const POINTS: (usize, usize) = (10, 5);
/// Below this step a remainder that grows as the step shrinks is rounding.
const SMALL: f64 = 1e-5;
/// A remainder counts where it is this many times the rounding seen.
const ABOVE_ROUNDING: f64 = 100.0;

/// The dot-product test of the linearizations in the given slots, one after the other, with random vectors drawn from
/// `seed`.
///
/// # Errors
/// [`Error::EmptyTest`] where M dx or Mᵀ λ is zero, or so small beside ‖M‖ that rounding rules it.
///
/// # Panics
/// If a slot holds no linearization or `scale` has the wrong length.
pub fn dot_product(
    model: &mut dyn Model,
    slots: std::ops::Range<usize>,
    scale: &[f64],
    seed: u64,
) -> Result<DotProduct, Error> {
    let n = model.dim();
    assert_eq!(scale.len(), n, "scale and state differ in length");
    let mut random = Random(seed);
    let dx: Vec<f64> = scale.iter().map(|s| s * random.draw()).collect();
    let lambda: Vec<f64> = scale.iter().map(|s| random.draw() / s).collect();
    let norm = norm_by_powers(model, slots.clone(), dx.clone(), scale, 12)?;
    let (mut m_dx, mut mt_lambda) = (dx.clone(), lambda.clone());
    slots.clone().for_each(|k| model.tangent(k, &mut m_dx));
    slots.rev().for_each(|k| model.adjoint(k, &mut mt_lambda));
    compare(&dx, &m_dx, &lambda, &mt_lambda, norm, [scale, scale])
}

/// ‖M‖ in scaled variables from below, by `products` power iterations with MᵀM from v; the last one ends at M v.
fn norm_by_powers(
    model: &mut dyn Model,
    slots: std::ops::Range<usize>,
    mut v: Vec<f64>,
    scale: &[f64],
    products: usize,
) -> Result<f64, Error> {
    let mut norm = 0.0;
    for _ in 0..products {
        let size = norm_of(&v, scale);
        v.iter_mut().for_each(|v| *v /= size);
        slots.clone().for_each(|k| model.tangent(k, &mut v));
        norm = norm_of(&v, scale);
        v.iter_mut().zip(scale).for_each(|(v, s)| *v /= s * s);
        slots.clone().rev().for_each(|k| model.adjoint(k, &mut v));
        v.iter_mut().zip(scale).for_each(|(v, s)| *v *= s * s);
        if !(norm > 0.0 && norm.is_finite() && norm_of(&v, scale) > 0.0) {
            return Err(Error::EmptyTest { what: "the tangent or the adjoint of a random vector is zero" });
        }
    }
    Ok(norm)
}

/// How much a window amplifies a perturbation, and what that leaves of a gradient taken over it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplification {
    /// ‖M‖ of the window in scaled variables, an estimate from below.
    pub norm: f64,
    /// ε ‖M‖: rounding at the start of the window as it arrives at its end, the relative error of a gradient to a
    /// factor of some ten (states are larger than `scale`, and every step rounds).
    pub gradient_error: f64,
    /// Whether `gradient_error` ≤ 1e-4: a minimizer can converge on such a gradient.
    pub reliable: bool,
}

impl Amplification {
    /// Of a window whose ‖M‖ is known, or estimated.
    pub fn of(norm: f64) -> Self {
        let gradient_error = f64::EPSILON * norm;
        Self { norm, gradient_error, reliable: gradient_error <= WORST_GRADIENT }
    }

    /// What to tell a user whose window is too long; `None` where the gradient can be relied on.
    pub fn warning(&self) -> Option<String> {
        (!self.reliable).then(|| {
            format!(
                "the window amplifies perturbations {:.0e} times: its gradient is right to {:.0e} at best; shorten the window, \
                 or observe more often and let errors of the model in (weak constraint)",
                self.norm, self.gradient_error
            )
        })
    }
}

/// Estimates ‖M‖ of the linearizations in the given slots and with it the accuracy of gradients over them: six products with MᵀM from a
/// vector drawn from `seed`. In a chaotic system ‖M‖ grows like exp(λ₁ T) with the window's length T, and ε ‖M‖ with it.
///
/// # Errors
/// [`Error::EmptyTest`] where M is zero or so large that it is not finite.
///
/// # Panics
/// If a slot holds no linearization or `scale` (a typical perturbation of each component) has the wrong length.
pub fn amplification(
    model: &mut dyn Model,
    slots: std::ops::Range<usize>,
    scale: &[f64],
    seed: u64,
) -> Result<Amplification, Error> {
    assert_eq!(scale.len(), model.dim(), "scale and state differ in length");
    let mut random = Random(seed);
    let v = scale.iter().map(|s| s * random.draw()).collect();
    Ok(Amplification::of(norm_by_powers(model, slots, v, scale, 6)?))
}

/// Compares ⟨M dx, λ⟩ with ⟨dx, Mᵀ λ⟩ for products already made, and a norm of M in scaled variables (a larger one
/// loosens the bound). `scales` are those of dx and of M dx, which may differ in length.
///
/// # Errors
/// [`Error::EmptyTest`] where a vector is zero, or M dx so small that rounding rules it.
///
/// # Panics
/// If lengths differ.
pub fn compare(
    dx: &[f64],
    m_dx: &[f64],
    lambda: &[f64],
    mt_lambda: &[f64],
    norm: f64,
    scales: [&[f64]; 2],
) -> Result<DotProduct, Error> {
    let inverse = scales.map(|scale| scale.iter().map(|s| 1.0 / s).collect::<Vec<f64>>());
    let sizes = [
        norm_of(dx, scales[0]),
        norm_of(m_dx, scales[1]),
        norm_of(lambda, &inverse[1]),
        norm_of(mt_lambda, &inverse[0]),
    ];
    if sizes.contains(&0.0) {
        return Err(Error::EmptyTest { what: "a vector of the dot product is zero" });
    }
    let (forward, backward) = (dot(m_dx, lambda), dot(dx, mt_lambda));
    let condition = (norm * sizes[0] / sizes[1]).max(1.0);
    if condition > WORST_CONDITION {
        return Err(Error::EmptyTest { what: "M dx is nothing but rounding of ‖M‖ ‖dx‖" });
    }
    let value = (forward - backward).abs() / (sizes[1] * sizes[2]);
    let bound = 50.0 * f64::EPSILON * condition;
    Ok(DotProduct { forward, backward, value, bound, condition, pass: value <= bound })
}

/// Taylor test of a scalar function: |J(x + h d) − J(x) − h ⟨g, d⟩| must fall like h².
///
/// # Errors
/// What `function` returns; [`Error::EmptyTest`] where d or ⟨g, d⟩ and all differences are zero, or no range of steps is
/// left between truncation and rounding.
///
/// # Panics
/// If lengths differ.
pub fn taylor(
    function: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
    gradient: &[f64],
    x: &[f64],
    direction: &[f64],
) -> Result<Taylor, Error> {
    assert!(gradient.len() == x.len() && direction.len() == x.len(), "lengths differ");
    let value = function(x)?;
    let slope = dot(gradient, direction);
    let mut moved = vec![0.0; x.len()];
    fit(&mut |h| {
        for ((m, x), d) in moved.iter_mut().zip(x).zip(direction) {
            *m = x + h * d;
        }
        let difference = function(&moved)? - value;
        Ok((difference.abs(), (difference - h * slope).abs()))
    })
}

/// Taylor test of step k of a model at x: ‖M(x + h d) − M(x) − h M′ d‖ must fall like h². Linearizes step k at x.
///
/// # Errors
/// Those of the model; [`Error::EmptyTest`] as for [`taylor`].
///
/// # Panics
/// If lengths differ.
pub fn taylor_step(
    model: &mut dyn Model,
    k: usize,
    x: &[f64],
    direction: &[f64],
    scale: &[f64],
) -> Result<Taylor, Error> {
    let n = model.dim();
    assert!(x.len() == n && direction.len() == n && scale.len() == n, "lengths differ");
    let (mut base, mut moved, mut next) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    model.step(k, x, &mut base)?;
    model.linearize(0, k, x, &base)?;
    let mut tangent = direction.to_vec();
    model.tangent(0, &mut tangent);
    fit(&mut |h| {
        for ((m, x), d) in moved.iter_mut().zip(x).zip(direction) {
            *m = x + h * d;
        }
        model.step(k, &moved, &mut next)?;
        next.iter_mut().zip(&base).for_each(|(n, b)| *n -= b);
        let difference = norm_of(&next, scale);
        next.iter_mut().zip(&tangent).for_each(|(n, t)| *n -= h * t);
        Ok((difference, norm_of(&next, scale)))
    })
}

/// Every check of a model on step k from the state x, with perturbations of the size of `scale`: same input, same bits; a zero
/// perturbation stays zero; the tangent is linear; it is the derivative (Taylor); the adjoint is its transpose;
/// linearizing twice gives the same bits.
///
/// # Errors
/// Those of the model and of the single checks.
///
/// # Panics
/// If lengths differ.
pub fn conformance(
    model: &mut dyn Model,
    k: usize,
    x: &[f64],
    scale: &[f64],
    seed: u64,
) -> Result<Vec<Outcome>, Error> {
    let n = model.dim();
    assert!(x.len() == n && scale.len() == n, "lengths differ");
    let mut random = Random(seed);
    let mut draw = || -> Vec<f64> { scale.iter().map(|s| s * random.draw()).collect() };
    let (a, b) = (draw(), draw());
    let mut outcomes = Vec::new();

    let (mut next, mut again, mut elsewhere) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    model.step(k, x, &mut next)?;
    let moved: Vec<f64> = x.iter().zip(&a).map(|(x, a)| x + 1e-3 * a).collect();
    model.step(k, &moved, &mut elsewhere)?;
    model.step(k, x, &mut again)?;
    outcomes.push(Outcome::at_most("step: values that differ when run again", differing(&next, &again), 0.0));

    model.linearize(0, k, x, &next)?;
    let tangent = |model: &mut dyn Model, v: &[f64]| {
        let mut out = v.to_vec();
        model.tangent(0, &mut out);
        out
    };
    let zero = vec![0.0; n];
    let of_zero = tangent(model, &zero).iter().filter(|v| **v != 0.0).count();
    outcomes.push(Outcome::at_most("tangent: values of M 0 that are not zero", of_zero as f64, 0.0));

    let (m_a, m_b) = (tangent(model, &a), tangent(model, &b));
    let mixed: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.75 * a - 1.5 * b).collect();
    let left: Vec<f64> =
        tangent(model, &mixed).iter().zip(&m_a).zip(&m_b).map(|((m, a), b)| m - 0.75 * a + 1.5 * b).collect();

    let test = dot_product(model, 0..1, scale, seed)?;
    let largest = norm_of(&m_a, scale).max(norm_of(&m_b, scale));
    outcomes.push(Outcome::at_most(
        "tangent: departure from linearity",
        norm_of(&left, scale) / largest,
        test.bound,
    ));
    outcomes.push(Outcome::at_most("adjoint: dot product", test.value, test.bound));

    model.linearize(0, k, &moved, &elsewhere)?;
    model.linearize(0, k, x, &next)?;
    let repeated = tangent(model, &a);
    outcomes.push(Outcome::at_most(
        "linearize: values that differ when run again",
        differing(&m_a, &repeated),
        0.0,
    ));

    let slope = taylor_step(model, k, x, &a, scale)?;
    outcomes.push(Outcome {
        what: "tangent: 2 − Taylor slope",
        value: 2.0 - slope.slope,
        bound: 2.0 - slope.bound,
        pass: slope.pass,
    });
    Ok(outcomes)
}

/// The dot-product test over a whole window from x₀.
///
/// # Errors
/// Those of the model and of [`dot_product`].
pub fn window(
    model: &mut dyn Model,
    x0: &[f64],
    steps: usize,
    scale: &[f64],
    seed: u64,
) -> Result<DotProduct, Error> {
    Trajectory::new().run(model, x0, steps, Keep::Linearizations)?;
    dot_product(model, 0..steps, scale, seed)
}

/// Fits the slope of a remainder given as (size of the difference, size of the remainder) for a step h.
///
/// Steps fall from 1 by halves to 2⁻⁴⁶. What is left at the smallest steps is rounding; of the remainders well above it,
/// those at the smallest steps are used, where terms of higher order are least. Steps at which the function fails are
/// passed over while they are the largest.
fn fit(remainder: &mut dyn FnMut(f64) -> Result<(f64, f64), Error>) -> Result<Taylor, Error> {
    let mut points = Vec::new();
    let mut failure = None;
    for halvings in 0..=46 {
        let h = 0.5_f64.powi(halvings);
        match remainder(h) {
            Ok((difference, rest)) => points.push((h, difference, rest)),
            Err(error) if points.is_empty() => failure = Some(error),
            Err(error) => return Err(error),
        }
    }
    let Some(&(_, largest, first)) = points.first() else {
        return Err(failure.unwrap_or(Error::EmptyTest { what: "no step could be taken" }));
    };
    if largest == 0.0 {
        return Err(Error::EmptyTest { what: "the function does not change along the direction" });
    }
    if first <= 1e-13 * largest {
        let points = points.iter().map(|p| (p.0, p.2)).collect();
        return Ok(Taylor { slope: f64::INFINITY, bound: SLOPE, points, pass: true });
    }
    // What is left at the smallest steps is rounding, and so is what grows as the step shrinks.
    let last = points[points.len() - 8..].iter().map(|p| p.2);
    let grown = points.windows(2).filter(|p| p[1].0 <= SMALL && p[1].2 > p[0].2).map(|p| p[1].2);
    let rounding = last.chain(grown).fold(0.0_f64, f64::max);
    let above: Vec<(f64, f64)> = points
        .iter()
        .map(|&(h, _, rest)| (h, rest))
        .take_while(|&(_, rest)| rest > ABOVE_ROUNDING * rounding && rest.is_finite())
        .collect();
    if above.len() < POINTS.1 {
        return Err(Error::EmptyTest { what: "no range of steps between truncation and rounding" });
    }
    let points = above[above.len().saturating_sub(POINTS.0)..].to_vec();
    let slope = log_slope(&points);
    Ok(Taylor { slope, bound: SLOPE, pass: slope >= SLOPE, points })
}

/// Least-squares slope of ln y over ln x.
fn log_slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let logs = points.iter().map(|(x, y)| (x.ln(), y.ln()));
    let (sx, sy) = logs.clone().fold((0.0, 0.0), |s, (x, y)| (s.0 + x, s.1 + y));
    let (mx, my) = (sx / count, sy / count);
    let (sxy, sxx) = logs.fold((0.0, 0.0), |s, (x, y)| (s.0 + (x - mx) * (y - my), s.1 + (x - mx).powi(2)));
    sxy / sxx
}

/// ‖v / scale‖.
fn norm_of(v: &[f64], scale: &[f64]) -> f64 {
    assert_eq!(v.len(), scale.len(), "a vector and its scale differ in length");
    v.iter().zip(scale).map(|(v, s)| (v / s).powi(2)).sum::<f64>().sqrt()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Number of values that differ in a bit.
fn differing(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64
}

/// SplitMix64 (Steele, Lea and Flood 2014): enough for test vectors, and no dependency.
struct Random(u64);

impl Random {
    /// A number in [−1, 1).
    fn draw(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
