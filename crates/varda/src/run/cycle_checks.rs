//! What a sequence of windows says of itself: whether its errors are those that it assumes.

use varda_assimilation::Departures;

use crate::outcome::{CycleRow, Means};
use crate::scene;

/// Beyond this factor a ratio that should be 1 is far off.
const FAR_OFF: f64 = 2.0;

/// Remarks on a sequence whose means count: 2J/m, departures, and, of a twin, spread against error.
pub(super) fn remarks(
    rows: &[CycleRow],
    means: &Means,
    covariance: scene::CycledCovariance,
    inflation: f64,
) -> Vec<String> {
    let mut remarks = Vec::new();
    let is_off = |ratio: f64| !(1.0 / FAR_OFF..=FAR_OFF).contains(&ratio);
    // A ratio of sums over m values has a standard deviation of √(2/m): too few values say nothing.
    let said = 3.0 * (2.0 / means.departures.count.max(1) as f64).sqrt() <= 0.5;
    if let Some(chi2) = means.chi2_of_all.filter(|chi2| said && is_off(*chi2)) {
        remarks.push(format!(
            "2J/m over all windows is {chi2:.2}, not 1: the errors assumed of background and observations \
             are not those found"
        ));
    }
    let of = Departures::from(means.departures);
    let suggested = |ratio: f64| match covariance {
        scene::CycledCovariance::Static => format!("multiply its standard deviations by {:.2}", ratio.sqrt()),
        _ => format!("an inflation of {:.2} would be right by these innovations", inflation * ratio.sqrt()),
    };
    if let Some(ratio) = of.background_ratio().filter(|r| said && is_off(*r)) {
        let wrong = if ratio > 1.0 { "too small" } else { "too large" };
        let remedy = if ratio > 0.0 { format!(": {}", suggested(ratio)) } else { String::new() };
        remarks.push(format!(
            "B is {wrong}: increments are {ratio:.2} times what it says of them (Desroziers){remedy}"
        ));
    }
    if let Some(ratio) = of.observation_ratio().filter(|r| said && is_off(*r)) {
        let wrong = if ratio > 1.0 { "too small" } else { "too large" };
        remarks.push(format!(
            "sigma of the observations is {wrong}: residuals are {ratio:.2} times what it says of them \
             (Desroziers), sigma × {:.2} would be right by them",
            ratio.max(0.0).sqrt()
        ));
    }
    for (i, spread) in means.spread.iter().enumerate() {
        // The spread of a propagated posterior is that of the next background.
        let errors = match covariance {
            scene::CycledCovariance::Propagated => &means.rmse_background,
            _ => &means.rmse_end,
        };
        let (Some(spread), Some(Some(error))) = (*spread, errors.get(i)) else { continue };
        if means.count >= 5 && is_off(error / spread) {
            let group = if means.spread.len() > 1 {
                format!(" (group {} of the state)", i + 1)
            } else {
                String::new()
            };
            remarks.push(format!(
                "the error is {error:.3e} where {spread:.3e} is expected{group}: {}",
                if error > &spread {
                    "the spread has collapsed, or the truth is lost"
                } else {
                    "the spread is too wide"
                }
            ));
        }
    }
    let drawn: usize = rows.iter().map(|r| r.drawn_again).sum();
    if drawn > 0 {
        let windows = rows.iter().filter(|r| r.drawn_again > 0).count();
        remarks.push(format!(
            "{drawn} members failed in {windows} windows and were drawn again from the others"
        ));
    }
    remarks
}
