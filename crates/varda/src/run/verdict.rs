//! The verdict of a window: plain data in, plain data out.

use std::collections::BTreeSet;
use std::fmt::Write;

use varda_assimilation::{highest_j_of_a_fit, huber};

use super::departures::Departure;
use super::second_minimum::Second;
use crate::outcome::{CycleRow, Evidence, Judgement, Quantity, Status, Verdict};
use crate::solve::AT_THE_MINIMUM;

/// A marker, time, axis or camera stands out beyond this many standard deviations.
const STANDS_OUT: f64 = 4.0;
/// 2J/m from which on the model itself is doubted.
const FAR: f64 = 30.0;
/// Groups that are named in a text, at most.
const NAMED: usize = 3;

/// What a window is judged by.
pub(super) struct Judged<'a> {
    pub status: Status,
    /// Whether the time allowed was over.
    pub late: bool,
    /// Whether J comes from an ensemble, which resolves no gradient: it then ends where it stalls.
    pub is_ensemble: bool,
    /// Whether the rod is at rest at every step.
    pub at_rest: bool,
    /// Whether the window could grow, and does not.
    pub may_grow: bool,
    /// Iterations done, and those that the scene allows.
    pub iterations: usize,
    pub max_iterations: usize,
    /// ‖∇J‖ at the first point and at the last.
    pub gradient_norms: [f64; 2],
    /// J at the analysis.
    pub j: f64,
    /// Number of observed values m.
    pub observed: usize,
    /// Threshold of Huber's norm, where J has one.
    pub robust: Option<f64>,
    pub departures: &'a [Departure],
    /// Names of the sites that departures count.
    pub labels: &'a [String],
    /// The camera of each site that has one.
    pub cameras: &'a [Option<String>],
    pub evidence: Option<&'a Evidence>,
    /// What was found out about a second minimum.
    pub second_minimum: Option<&'a Second>,
}

/// The verdict: a fit is 2J/m ≤ 1 + 3 √(2/m) with no marker, time or axis beyond 4 standard deviations.
pub(super) fn judge(judged: &Judged) -> Judgement {
    let m = judged.observed as f64;
    if judged.observed == 0 {
        let text = "no observed value is inside the window: the analysis is the background".to_string();
        return Judgement { verdict: Verdict::NothingObserved, text };
    }
    let chi2 = 2.0 * judged.j / m;
    let most = 2.0 * highest_j_of_a_fit(judged.observed) / m;
    if let Some(why) = not_converged(judged) {
        let far = if chi2 > FAR {
            "; so far from a fit a constant of the model, the place of a marker, a unit or an axis is \
             likelier wrong than the minimizer"
        } else {
            ""
        };
        let text = format!("{why}; 2J/m = {chi2:.3} so far (a fit has at most {most:.3}, m = {m}){far}");
        return Judgement { verdict: Verdict::NotConverged, text };
    }
    let numbers = format!("2J/m = {chi2:.3}, m = {m} (a fit has at most {most:.3})");
    let standing_out = standing_out(judged);
    let fits = chi2 <= most && standing_out.is_empty();
    let mut text = numbers;
    if fits {
        // As far below 1 as a fit may be above it.
        if chi2 < 2.0 - most {
            text.push_str(
                "; the residuals are smaller than σ says: σ of the observations or of the background is \
                           larger than it need be",
            );
        }
        // growth of the window found the minimum that fits
        if let Some(second) = judged.second_minimum {
            let _ = write!(text, "; {}", second.text);
        }
        return Judgement { verdict: Verdict::Fits, text };
    }
    let mut named = standing_out.iter().take(NAMED).peekable();
    if named.peek().is_some() {
        text.push_str("; out of line:");
        for (i, group) in named.enumerate() {
            let _ = write!(text, "{} {} ({:.1} σ rms)", if i > 0 { "," } else { "" }, group.name, group.rms);
        }
        if standing_out.len() > NAMED {
            let _ = write!(text, " and {} more", standing_out.len() - NAMED);
        }
    }
    let second = judged.second_minimum;
    let why = match judged.evidence {
        _ if second.is_some_and(|second| second.explains) => "",
        Some(evidence) => &evidence.text,
        None if standing_out.is_empty() => {
            "the observations are fitted to their σ, but far from the background: its σ is too small"
        }
        None => "the rest is as σ says: look at these first",
    };
    for reason in [why, second.map_or("", |second| second.text.as_str())] {
        if !reason.is_empty() {
            let _ = write!(text, "; {reason}");
        }
    }
    Judgement { verdict: Verdict::DoesNotFit, text }
}

/// Why a minimization counts as not converged, and what to try.
fn not_converged(judged: &Judged) -> Option<String> {
    let [first, last] = judged.gradient_norms;
    let gradient = format!("‖∇J‖ is at {:.1e} of the first", last / first);
    match judged.status {
        Status::Converged | Status::LinearizedOnce => None,
        Status::Stalled if judged.is_ensemble || last <= AT_THE_MINIMUM * first => None,
        Status::Stalled if judged.at_rest => Some(format!(
            "the minimizer stalled after {} iterations, {gradient}: near these constants the rod snaps into \
             another shape. A prior may be too narrow (of a clamp's turn about its tangent, say, which is \
             seldom recorded), or GJ or a curvature at rest be wrong; a `model.initial_shape` nearer to what \
             was seen may help",
            judged.iterations
        )),
        Status::Stalled if judged.may_grow => Some(format!(
            "the minimizer stalled after {} iterations, {gradient}: let the window grow \
             (algorithm.window_growth = [2, 4, 8, …], minimizer = \"trust-region\"), give the background a \
             longer correlation length, or try shorter time steps",
            judged.iterations
        )),
        Status::Stalled => Some(format!(
            "the minimizer stalled after {} iterations, {gradient}: try shorter time steps or another \
             `algorithm.minimizer`",
            judged.iterations
        )),
        Status::MaxIterations if judged.iterations < judged.max_iterations => Some(format!(
            "every start of the minimizer was given up before its minimum, after {} iterations in all, \
             {gradient}: the cost is hard to minimize, as with a prior that is not smooth",
            judged.iterations
        )),
        Status::MaxIterations => Some(format!(
            "{} iterations were not enough, {gradient}: allow more (algorithm.max_iterations)",
            judged.iterations
        )),
        Status::Interrupted if judged.late => {
            Some(format!("the time allowed is over (limits.seconds), {gradient}"))
        }
        Status::Interrupted => Some(format!("interrupted, {gradient}")),
        Status::Failed => Some("the minimization failed".to_string()),
    }
}

/// Windows of a sequence that may miss the bounds of a fit, or their minimum, as a share: one in 700 does by
/// chance where all is right, and a sequence need not be perfect.
const MAY_MISS: f64 = 0.05;

/// The verdict of a sequence of windows, from those that count: each is judged by its own 2J/m.
pub(super) fn judge_windows(
    rows: &[&CycleRow],
    asked_for: Option<usize>,
    is_ensemble: bool,
    late: bool,
) -> Judgement {
    let seen: Vec<&&CycleRow> = rows.iter().filter(|r| r.observations > 0).collect();
    let m: usize = seen.iter().map(|r| r.observations).sum();
    if m == 0 {
        let text = "no observed value is inside a window: every analysis is its background".to_string();
        return Judgement { verdict: Verdict::NothingObserved, text };
    }
    let n = seen.len();
    let chi2 = seen.iter().map(|r| 2.0 * r.j).sum::<f64>() / m as f64;
    let badly = seen.iter().filter(|r| !(r.j <= highest_j_of_a_fit(r.observations))).count();
    let numbers = format!(
        "2J/m = {chi2:.3} over {n} windows, {badly} of them above 1 + 3 √(2/m) (at most {:.0} % are \
         expected of a fit)",
        100.0 * MAY_MISS
    );
    let early = seen.iter().filter(|r| matches!(r.status, Status::MaxIterations | Status::Stalled)).count();
    let too_many = |count: usize| count as f64 > MAY_MISS * n as f64;
    let (verdict, text) = if let Some(asked_for) = asked_for {
        let why = if late { "the time allowed is over (limits.seconds)" } else { "interrupted" };
        (Verdict::NotConverged, format!("{why} after {} of {asked_for} windows; {numbers}", rows.len()))
    } else if too_many(early) && !is_ensemble {
        let text = format!(
            "{early} of {n} minimizations ended before their minimum (algorithm.max_iterations, or stalled); \
             {numbers}"
        );
        (Verdict::NotConverged, text)
    } else if too_many(badly) {
        let text = format!(
            "{numbers}: B, Q or σ are smaller than the errors are, or the model does not describe what was \
             seen; inflation or model noise lets later windows believe their observations"
        );
        (Verdict::DoesNotFit, text)
    } else {
        (Verdict::Fits, numbers)
    };
    Judgement { verdict, text }
}

/// A marker, a time, an axis or a camera.
struct Group {
    name: String,
    /// Root mean square of d/σ.
    rms: f64,
    /// How improbable that is, in standard deviations of a normal variable.
    deviations: f64,
}

/// Markers, times, axes and cameras whose departures are too large for their number, the largest first.
fn standing_out(judged: &Judged) -> Vec<Group> {
    let delta = judged.robust.unwrap_or(f64::INFINITY);
    let d = judged.departures;
    let mut groups = Vec::new();
    let mut group = |name: String, members: &mut dyn Iterator<Item = &Departure>| {
        let squares: Vec<f64> = members.map(|d| 2.0 * huber(delta, d.value / d.sigma).0).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        let deviations = normal_deviate(mean, squares.len());
        if deviations > STANDS_OUT {
            groups.push(Group { name, rms: mean.sqrt(), deviations });
        }
    };
    let mut by_site: Vec<&Departure> = d.iter().collect();
    by_site.sort_by_key(|d| d.site);
    for members in by_site.chunk_by(|a, b| a.site == b.site) {
        group(judged.labels[members[0].site].clone(), &mut members.iter().copied());
    }
    let mut times: Vec<f64> = d.iter().map(|d| d.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    if times.len() > 1 {
        // departures of one time stand together once they are sorted
        let mut by_time: Vec<&Departure> = d.iter().collect();
        by_time.sort_by(|a, b| a.time.total_cmp(&b.time));
        for members in by_time.chunk_by(|a, b| a.time == b.time) {
            group(format!("t = {:.4} s", members[0].time), &mut members.iter().copied());
        }
    }
    for quantity in Quantity::OF_RODS {
        for (axis, name) in quantity.axes().iter().enumerate() {
            let of_axis = d.iter().filter(|d| d.quantity == quantity && d.axis == axis);
            group(format!("axis {name}"), &mut of_axis.into_iter());
        }
    }
    let cameras: BTreeSet<&String> = judged.cameras.iter().flatten().collect();
    for camera in cameras {
        let of_camera = d.iter().filter(|d| judged.cameras[d.site].as_ref() == Some(camera));
        group(format!("camera {camera}"), &mut of_camera.into_iter());
    }
    groups.sort_by(|a, b| b.deviations.total_cmp(&a.deviations));
    groups
}

/// The standard normal variable that exceeds its value as seldom as χ²/n of n values exceeds `mean`
/// (Wilson and Hilferty 1931): ((χ²/n)^{1/3} − (1 − 2/(9n))) / √(2/(9n)).
fn normal_deviate(mean: f64, n: usize) -> f64 {
    let share = 2.0 / (9.0 * n as f64);
    (mean.cbrt() - (1.0 - share)) / share.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 4 σ of a normal variable has probability 3.17e-5; χ² of two values exceeds x with probability
    /// exp(−x/2). The approximation is 3 per cent off there, and better for more values.
    #[test]
    fn few_values_may_be_larger() {
        let mean_of_two = -3.167e-5_f64.ln();
        assert!((normal_deviate(mean_of_two, 2) - 4.0).abs() < 0.15);
        // many values: (mean − 1) / √(2/n)
        let n = 20_000;
        let mean = 1.0 + 4.0 * (2.0 / n as f64).sqrt();
        assert!((normal_deviate(mean, n) - 4.0).abs() < 0.05);
    }

    fn departures(off: impl Fn(usize, usize) -> f64) -> Vec<Departure> {
        let one = |k: usize, site: usize| Departure {
            site,
            quantity: Quantity::Component,
            axis: 0,
            time: k as f64,
            value: off(k, site),
            sigma: 1.0,
            predicted: 0.0,
            rate: 0.0,
        };
        (0..40).flat_map(|k| (0..3).map(move |site| (k, site))).map(|(k, s)| one(k, s)).collect()
    }

    fn judged<'a>(departures: &'a [Departure], labels: &'a [String]) -> Judged<'a> {
        Judged {
            at_rest: false,
            may_grow: false,
            status: Status::Converged,
            late: false,
            is_ensemble: false,
            iterations: 5,
            max_iterations: 100,
            gradient_norms: [1.0, 1e-9],
            j: 0.5 * departures.iter().map(|d| d.value * d.value).sum::<f64>(),
            observed: departures.len(),
            robust: None,
            departures,
            labels,
            cameras: &[],
            evidence: None,
            second_minimum: None,
        }
    }

    #[test]
    fn a_marker_or_a_time_that_stands_out_is_named_though_the_whole_fits() {
        let labels: Vec<String> = ["a", "b", "c"].map(String::from).to_vec();
        let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let fits = departures(|k, _| sign(k));
        assert_eq!(judge(&judged(&fits, &labels)).verdict, Verdict::Fits);
        let marker = departures(|k, site| sign(k) * if site == 1 { 1.65 } else { 0.7 });
        let found = judge(&judged(&marker, &labels));
        assert_eq!(found.verdict, Verdict::DoesNotFit, "{}", found.text);
        assert!(found.text.contains("out of line: b (1.6 σ rms)"), "{}", found.text);
        let time = departures(|k, _| if k == 7 { 3.5 } else { sign(k) * 0.9 });
        let found = judge(&judged(&time, &labels));
        assert!(found.text.contains("t = 7.0000 s (3.5 σ rms)"), "{}", found.text);
        let small = departures(|k, _| 0.1 * sign(k));
        let found = judge(&judged(&small, &labels));
        assert!(found.verdict == Verdict::Fits && found.text.contains("larger than it need be"));
    }

    #[test]
    fn an_end_before_the_minimum_is_told_from_one_at_it() {
        let (labels, d) = (vec!["a".to_string(); 3], departures(|_, _| 1.0));
        let with = |status, ratio| {
            let judged = Judged { status, gradient_norms: [1.0, ratio], ..judged(&d, &labels) };
            judge(&judged).verdict
        };
        assert_eq!(with(Status::Stalled, 1e-2), Verdict::NotConverged);
        assert_eq!(with(Status::Stalled, 1e-4), Verdict::Fits);
        assert_eq!(with(Status::MaxIterations, 1e-9), Verdict::NotConverged);
        assert_eq!(with(Status::Stalled, f64::NAN), Verdict::NotConverged);
        let none = Judged { observed: 0, ..judged(&[], &labels) };
        assert_eq!(judge(&none).verdict, Verdict::NothingObserved);
    }
}
