//! What the kinds of field cases share.

pub(super) use problems::statics::greatest;
use varda_implicit::{ImplicitModel, Model};
use varda_rod::RodStep;

/// The state after some steps of a length from a control.
pub(super) fn state_after(
    step: RodStep,
    z: &[f64],
    length: f64,
    steps: usize,
) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let mut model = ImplicitModel::new(step, 0, length);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x)?;
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// Least-squares slope of ln |error| over ln h.
pub(super) fn slope(errors: &[(f64, f64)]) -> f64 {
    let points: Vec<[f64; 2]> = errors.iter().map(|(h, e)| [h.ln(), e.abs().ln()]).collect();
    let mean = [0, 1].map(|i| points.iter().map(|p| p[i]).sum::<f64>() / points.len() as f64);
    let [h, e]: [fn(&[f64; 2]) -> f64; 2] = [|p| p[0], |p| p[1]];
    let both: f64 = points.iter().map(|p| (h(p) - mean[0]) * (e(p) - mean[1])).sum();
    both / points.iter().map(|p| (h(p) - mean[0]).powi(2)).sum::<f64>()
}
