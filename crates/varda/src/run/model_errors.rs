//! What a weak-constraint run says of Q.

use varda_assimilation::ErrorScale;

use crate::outcome::ModelErrors;
use crate::scene::{Covariance, Scene};

/// A remark where the innovations ask for another size of the model error than Q has: how many times, and the
/// values to try.
pub(super) fn remark(scene: &Scene, errors: Option<&ModelErrors>, j_q: f64) -> Option<String> {
    let (errors, q) = (errors?, &scene.algorithm.model_error.as_ref()?.covariance);
    let (scale, expected) = (errors.scale?, errors.expected_j_q?);
    if scale.low <= 1.0 && 1.0 <= scale.high {
        return None;
    }
    let beside = format!("J_q is {}, where {} is expected", shown(j_q), shown(expected));
    if scale.factor == 0.0 || scale.low == 0.0 {
        return Some(format!(
            "sigma of the model error is at least {} times too large: the innovations show hardly any error \
             of this kind ({beside}); try {} or less, or a strong constraint",
            shown(1.0 / scale.high),
            keys(q, scale.high)
        ));
    }
    let (times, low, high, wrong) = match scale {
        ErrorScale { factor, low, high } if factor > 1.0 => (factor, low, high, "small"),
        ErrorScale { factor, low, high } => (1.0 / factor, 1.0 / high, 1.0 / low, "large"),
    };
    let far = !(0.1..=10.0).contains(&scale.factor);
    let again = if far { ", and once more what that run says" } else { "" };
    let to = if high.is_finite() { shown(high) } else { "any".into() };
    Some(format!(
        "sigma of the model error is about {} times too {wrong} ({} to {to} with 95 %, if B and R are right; \
         {beside}): try {}{again}",
        shown(times),
        shown(low),
        keys(q, scale.factor)
    ))
}

/// The keys of Q that say its size, scaled: what to write into the scene.
fn keys(q: &Covariance, factor: f64) -> String {
    let values = serde_json::to_value(q.scaled(factor)).unwrap_or_default();
    let sizes = values.as_object().into_iter().flatten();
    let sizes = sizes.filter(|(key, _)| key.starts_with("sigma") || *key == "scale");
    let written = sizes.filter_map(|(key, value)| Some(format!("{key} = {}", shown(value.as_f64()?))));
    written.collect::<Vec<_>>().join(", ")
}

/// Two digits.
fn shown(value: f64) -> String {
    let rounded: f64 = format!("{value:.1e}").parse().unwrap_or(value);
    if rounded == 0.0 || (1e-3..1e5).contains(&rounded.abs()) {
        format!("{rounded}")
    } else {
        format!("{rounded:e}")
    }
}
