//! Checks of second derivatives.

use super::taylor::fit;
use super::vectors::norm_of;
use crate::{Error, Model};
use varda_linalg::check::{Finding, Random};
use varda_linalg::dot;

/// Two second derivatives that should be one may differ by this share of their size: the rounding of a step
/// and of the solves in it.
const SYMMETRY: f64 = 1e-10;

/// Checks the second derivatives of step k of a model at x ([`SecondOrder`](crate::SecondOrder)), with
/// perturbations of the size of `scale`: ‖M'(x + h d)ᵀλ − M'(x)ᵀλ − h D‖ must fall like h²,
/// with D = Σ_i λ_i ∂²M_i/∂x² d; the form is symmetric, D_a·b = D_b·a; λ̇ that is given is
/// carried by the adjoint. Nothing where the model has none.
///
/// [`conformance`](super::conformance) and [`model`](super::model) do this too. A step whose second
/// derivative vanishes along the direction only has to give zero.
///
/// # Errors
/// Those of the model; [`Error::EmptyTest`] where no range of steps is left between truncation and rounding.
///
/// # Panics
/// If lengths differ.
pub fn second_order(
    model: &mut dyn Model,
    k: usize,
    x: &[f64],
    scale: &[f64],
    seed: u64,
) -> Result<Vec<Finding>, Error> {
    let n = model.dim();
    assert!(x.len() == n && scale.len() == n, "lengths differ");
    if model.second_order().is_none() {
        return Ok(Vec::new());
    }
    let mut random = Random(seed);
    let mut draw = || -> Vec<f64> { scale.iter().map(|s| s * random.draw()).collect() };
    let (a, b) = (draw(), draw());
    let dual: Vec<f64> = scale.iter().map(|s| 1.0 / s).collect();
    let lambda: Vec<f64> = dual.iter().map(|s| s * random.draw()).collect();
    let mut next = vec![0.0; n];
    let mut adjoint_at = |model: &mut dyn Model, x: &[f64]| {
        model.step(k, x, &mut next)?;
        model.linearize(0, k, x, &next)?;
        let mut back = lambda.clone();
        model.adjoint(0, &mut back);
        Ok::<_, Error>(back)
    };
    let here = adjoint_at(model, x)?;
    let derivative = |model: &mut dyn Model, dx: &[f64], given: &[f64]| {
        let mut out = given.to_vec();
        let second = model.second_order().expect("asked above");
        second.adjoint_derivative(0, dx, &lambda, &mut out).map(|()| out)
    };
    let (by_a, by_b) = (derivative(model, &a, &vec![0.0; n])?, derivative(model, &b, &vec![0.0; n])?);
    let carried = derivative(model, &a, &lambda)?;
    let carried: Vec<f64> = carried.iter().zip(&by_a).zip(&here).map(|((c, a), h)| c - a - h).collect();
    let mut findings = vec![Finding::at_most(
        "second derivative: departure of a given derivative from the adjoint",
        norm_of(&carried, &dual) / norm_of(&here, &dual),
        SYMMETRY,
    )];
    let size = norm_of(&by_a, &dual) * norm_of(&b, scale);
    if size == 0.0 {
        let moved: Vec<f64> = x.iter().zip(&a).map(|(x, a)| x + 1e-3 * a).collect();
        let change: Vec<f64> = adjoint_at(model, &moved)?.iter().zip(&here).map(|(t, h)| t - h).collect();
        let what = "second derivative: change of the adjoint though it is zero";
        findings.push(Finding::at_most(what, norm_of(&change, &dual) / norm_of(&here, &dual), 1e-12));
        return Ok(findings);
    }
    let asymmetry = (dot(&by_a, &b) - dot(&by_b, &a)).abs() / size;
    findings.push(Finding::at_most("second derivative: asymmetry", asymmetry, SYMMETRY));
    let slope = fit(&mut |h| {
        let moved: Vec<f64> = x.iter().zip(&a).map(|(x, a)| x + h * a).collect();
        let mut change = adjoint_at(model, &moved)?;
        change.iter_mut().zip(&here).for_each(|(c, h)| *c -= h);
        let difference = norm_of(&change, &dual);
        change.iter_mut().zip(&by_a).for_each(|(c, d)| *c -= h * d);
        Ok((difference, norm_of(&change, &dual)))
    })?;
    findings.push(Finding {
        what: "second derivative: 2 − Taylor slope".to_string(),
        value: 2.0 - slope.slope,
        bound: 2.0 - slope.bound,
        pass: slope.pass,
    });
    Ok(findings)
}
