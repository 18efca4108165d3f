//! What a recording holds, from its rows.

use crate::outcome::{Quantity, TrackSummary};

/// A row of a site, before any is left out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Recorded {
    /// Time in the file \[s\].
    pub(super) time: f64,
    /// Index of the site.
    pub(super) site: usize,
    /// Its coordinates \[m\], or pixel \[px\].
    pub(super) position: [Option<f64>; 3],
    /// Its σ, in their unit.
    pub(super) sigma: f64,
}

/// Gaps are longer than so many usual intervals.
const GAP: f64 = 2.5;
/// Rows are at even times where intervals differ by less than this share: times may be written to few digits.
const UNEVEN: f64 = 0.3;
/// Fewest third differences that tell a scatter.
const FEWEST: usize = 8;

/// The rows of one site.
pub(super) fn track((label, quantity): (&str, Quantity), site: usize, rows: &[Recorded]) -> TrackSummary {
    let mut own: Vec<&Recorded> =
        rows.iter().filter(|r| r.site == site && r.position.iter().any(Option::is_some)).collect();
    own.sort_by(|a, b| a.time.total_cmp(&b.time));
    let intervals: Vec<f64> = own.windows(2).map(|w| w[1].time - w[0].time).collect();
    let interval = median(&intervals);
    let longest = (0..intervals.len()).max_by(|a, b| intervals[*a].total_cmp(&intervals[*b]));
    let gap = longest.filter(|i| intervals[*i] > GAP * interval).map(|i| [own[i].time, intervals[i]]);
    let sigma = own.iter().map(|r| r.sigma).sum::<f64>() / own.len().max(1) as f64;
    let places: Vec<_> = own.iter().map(|r| (r.time, r.position)).collect();
    let scatter = scatter(&places, interval);
    TrackSummary { label: label.to_string(), quantity, rows: own.len(), interval, gap, scatter, sigma }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| *v > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// √(mean δ³²/20) of places at even times: of white noise its σ, since 1 + 9 + 9 + 1 = 20.
pub(super) fn scatter(rows: &[(f64, [Option<f64>; 3])], interval: f64) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0);
    for four in rows.windows(4) {
        let even = four.windows(2).all(|w| (w[1].0 - w[0].0 - interval).abs() <= UNEVEN * interval);
        for c in 0..3 {
            let values: Vec<f64> = four.iter().filter_map(|(_, x)| x[c]).collect();
            if let (true, &[a, b, c, d]) = (even, &values[..]) {
                sum += (d - 3.0 * c + 3.0 * b - a).powi(2);
                count += 1;
            }
        }
    }
    (count >= FEWEST).then(|| (sum / (20.0 * f64::from(count as u32))).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(noise: impl Fn(usize) -> f64) -> Vec<Recorded> {
        let row = |k: usize| {
            let time = 0.01 * k as f64;
            let position = [Some(0.1 * (3.0 * time).sin() + noise(k)), None, Some(0.5)];
            Recorded { time, site: 0, position, sigma: 1e-3 }
        };
        (0..60).filter(|k| !(20..25).contains(k)).map(row).collect()
    }

    #[test]
    fn gaps_and_scatter_are_found() {
        let smooth = track(("tip", Quantity::Place), 0, &rows(|_| 0.0));
        // a mean of equal numbers, to rounding
        assert!(smooth.rows == 55 && (smooth.sigma - 1e-3).abs() < 1e-17, "{smooth:?}");
        assert!((smooth.interval - 0.01).abs() < 1e-12);
        let gap = smooth.gap.unwrap();
        assert!((gap[0] - 0.19).abs() < 1e-12 && (gap[1] - 0.06).abs() < 1e-12, "{gap:?}");
        assert!(smooth.scatter.unwrap() < 1e-5);
        // ±1 mm in turn: third differences of 8 mm, in one coordinate of two
        let noisy = track(("tip", Quantity::Place), 0, &rows(|k| if k % 2 == 0 { 1e-3 } else { -1e-3 }));
        let expected = 8e-3 / 20.0_f64.sqrt() / 2.0_f64.sqrt();
        assert!((noisy.scatter.unwrap() - expected).abs() < 1e-5, "{:?} {expected}", noisy.scatter);
        assert_eq!(track(("other", Quantity::Place), 1, &rows(|_| 0.0)).rows, 0);
    }
}
