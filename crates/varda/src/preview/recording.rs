//! What of a recording looks as if it were not meant.

use super::finding::Finding;
use crate::outcome::{Quantity, RecordingSummary};
use crate::scene::rounded;

/// Rows are few where so many times as many are left out.
const MOST_LEFT_OUT: usize = 9;
/// σ is far too large where it is so many times the scatter of the rows: smoothed recordings scatter little.
const FAR_ABOVE: f64 = 100.0;

/// The findings, for a window of steps of this length \[s\].
pub(super) fn of_recording(recording: &RecordingSummary, step: f64) -> Vec<Finding> {
    let mut found = Vec::new();
    let rows = &recording.rows;
    let [from, to] = recording.window.map(rounded);
    let [first, last] = recording.span.map(rounded);
    let in_window = rows.used + rows.withheld + rows.forecast;
    let left_out = rows.outside + rows.refused;
    if rows.used == 0 {
        found.push(Finding::error(
            "observations.file",
            format!(
                "nothing is observed ({rows}): the window is {from} to {to} s of the file, and its rows are \
                 {first} to {last} s{}",
                meant(recording)
            ),
        ));
    } else if left_out >= MOST_LEFT_OUT * in_window {
        found.push(Finding::warning(
            "observations.file",
            format!(
                "{left_out} of {} rows are left out ({rows}): the window is {from} to {to} s of the file, \
                 and its rows are {first} to {last} s{}",
                left_out + in_window,
                meant(recording)
            ),
        ));
    }
    for pair in recording.neighbours.iter().filter(|pair| pair.farthest > pair.allowed) {
        found.push(Finding::warning(
            "observations.markers",
            format!(
                "{} and {} are seen {:.4} m apart and the rod between them is {:.4} m long: their arc \
                 lengths, their labels, or the unit?",
                pair.labels[0], pair.labels[1], pair.farthest, pair.arc
            ),
        ));
    }
    let seen = || recording.tracks.iter().filter(|track| track.rows > 1);
    let window = rounded(to - from);
    if rows.used > 0
        && let Some(track) = seen().find(|track| track.interval > 0.5 * window && track.rows > 3)
    {
        found.push(Finding::warning(
            "observations.file",
            format!(
                "{} is seen every {} s, and the window is {window} s long; milliseconds? Name the column \
                 time_ms",
                track.label,
                rounded(track.interval)
            ),
        ));
    }
    if let Some(track) = seen().find(|track| track.interval > 0.0 && track.interval < 1e-2 * step) {
        found.push(Finding::warning(
            "observations.file",
            format!(
                "{} is seen every {:e} s, and a step is {step} s long: hundreds of rows to a step; is \
                 time_s in another unit?",
                track.label, track.interval
            ),
        ));
    }
    let too_large = |scatter: f64, sigma: f64| scatter > 0.0 && sigma > FAR_ABOVE * scatter;
    let loose: Vec<_> = seen().filter(|t| t.scatter.is_some_and(|s| too_large(s, t.sigma))).collect();
    if let Some(track) = loose.first()
        && 2 * loose.len() > seen().count()
    {
        let unit = track.quantity.unit_after();
        let key = match track.quantity {
            Quantity::Pixels => "observations.cameras",
            Quantity::Place | Quantity::Component => "observations.sigma",
            _ => "observations.sensors",
        };
        found.push(Finding::warning(
            key,
            format!(
                "σ = {:.3}{unit}, where {} scatters by {:.1e}{unit} from row to row: another unit, or \
                 meant for what the model lacks?",
                track.sigma,
                track.label,
                track.scatter.unwrap_or(f64::NAN)
            ),
        ));
    }
    found
}

/// What would bring the rows into the window.
fn meant(recording: &RecordingSummary) -> String {
    let [from, to] = recording.window;
    let [first, last] = recording.span;
    let overlap = |first: f64, last: f64| last.min(to) - first.max(from);
    let window = rounded(to - from);
    // as seconds these are few frames a second, as milliseconds they are not too many
    let slow = recording.tracks.iter().any(|track| track.interval >= 0.2);
    if slow
        && last > 20.0 * to
        && overlap(1e-3 * first, 1e-3 * last) > 0.3 * window.min(1e-3 * (last - first))
    {
        "; milliseconds? Name the column time_ms".into()
    } else if overlap(first, last) <= 0.0 {
        format!("; observations.time_zero = {first} would begin with the first row")
    } else {
        String::new()
    }
}
