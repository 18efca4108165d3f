//! Orders of convergence, fitted, and limits, extrapolated.

use crate::row::Case;

pub(super) const SLOPE: f64 = 0.1;
pub(super) const SLOPE_REASON: &str =
    "terms of the next order are a tenth of the error at the first point and halve with every further one";

/// |slope − order| of (h, error); errors must fall in earnest to be judged.
pub(super) fn slope_row(case: &mut Case, what: &str, errors: &[(f64, f64)], order: f64) {
    let slope = slope(errors);
    let list: Vec<String> = errors.iter().map(|e| format!("{:.2e}", e.1)).collect();
    case.at_most(what, (slope - order).abs(), SLOPE, "-")
        .computed(slope)
        .because(SLOPE_REASON)
        .note(format!("slope {slope:.3} of {}", list.join(" ")));
}

/// Least-squares slope of ln error over ln h.
pub(super) fn slope(errors: &[(f64, f64)]) -> f64 {
    let n = errors.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| errors.iter().map(|e| of(e).ln()).sum::<f64>() / n;
    let (h, e) = (mean(|e| e.0), mean(|e| e.1));
    let both: f64 = errors.iter().map(|p| (p.0.ln() - h) * (p.1.ln() - e)).sum();
    both / errors.iter().map(|p| (p.0.ln() - h).powi(2)).sum::<f64>()
}

/// What (h, value) with an error in even powers of h point to at h = 0 (Richardson; Neville's scheme in h²).
pub(super) fn extrapolated(points: &[(f64, f64)]) -> f64 {
    let mut values: Vec<f64> = points.iter().map(|p| p.1).collect();
    for gap in 1..points.len() {
        for i in 0..points.len() - gap {
            let ratio = (points[i].0 / points[i + gap].0).powi(2);
            values[i] = values[i + 1] + (values[i + 1] - values[i]) / (ratio - 1.0);
        }
    }
    values[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::Rows;

    #[test]
    fn even_powers_are_extrapolated_away() {
        let value = |h: f64| 3.0 + 2.0 * h * h - 5.0 * h.powi(4);
        let points = [0.4, 0.25, 0.1].map(|h| (h, value(h)));
        assert!((extrapolated(&points) - 3.0).abs() < 1e-14);
        assert!((extrapolated(&points[..2]) - 3.0).abs() > 1e-3);
    }

    #[test]
    fn a_slope_is_fitted_and_a_wrong_order_fails() {
        let errors = [(0.4, 0.8), (0.2, 0.2), (0.1, 0.05)];
        assert!((slope(&errors) - 2.0).abs() < 1e-15);
        let mut rows = Rows::new("order");
        rows.case("parabola", |case| {
            slope_row(case, "right", &errors, 2.0);
            slope_row(case, "wrong", &errors, 1.0);
            slope_row(case, "nothing falls", &[(0.2, 0.0), (0.1, 0.0)], 2.0);
            Ok(())
        });
        let pass: Vec<bool> = rows.finish().iter().map(|r| r.pass).collect();
        assert_eq!(pass, [true, false, false]);
    }
}
