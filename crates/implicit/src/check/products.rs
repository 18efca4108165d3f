//! Dot-product tests.

use super::vectors::norm_of;
use crate::{Error, Keep, Model, Trajectory};
use varda_linalg::{check::Random, dot};

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
    /// Estimate of ‖M‖ ‖dx‖ / ‖M dx‖, the condition of the product M dx: ‖M‖ by twelve power
    /// iterations with MᵀM.
    pub condition: f64,
    /// Whether `value` ≤ `bound`.
    pub pass: bool,
}

/// Condition beyond which a dot product says nothing.
const WORST_CONDITION: f64 = 1e10;

/// The dot-product test of the linearizations in the given slots, one after the other, with random vectors
/// drawn from `seed`.
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

/// The condition of a product needs the largest singular value, and M with its transpose is at hand: ‖M‖
/// in scaled variables from below, by `products` power iterations with MᵀM from v; the last one ends at M
/// v.
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

/// Compares ⟨M dx, λ⟩ with ⟨dx, Mᵀ λ⟩ for products already made, and a norm of M in scaled
/// variables (a larger one loosens the bound). `scales` are those of dx and of M dx, which may differ in
/// length.
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
