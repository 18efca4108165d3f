//! What the kinds of field cases share.

pub(super) use problems::statics::greatest;

/// Least-squares slope of ln |error| over ln h.
pub(super) fn slope(errors: &[(f64, f64)]) -> f64 {
    let points: Vec<[f64; 2]> = errors.iter().map(|(h, e)| [h.ln(), e.abs().ln()]).collect();
    let mean = [0, 1].map(|i| points.iter().map(|p| p[i]).sum::<f64>() / points.len() as f64);
    let [h, e]: [fn(&[f64; 2]) -> f64; 2] = [|p| p[0], |p| p[1]];
    let both: f64 = points.iter().map(|p| (h(p) - mean[0]) * (e(p) - mean[1])).sum();
    both / points.iter().map(|p| (h(p) - mean[0]).powi(2)).sum::<f64>()
}
