//! What the departures that are left after an analysis tell of their cause: plain data in, plain data out.

use std::fmt::Write;

use varda_linalg::dense::Cholesky;

use crate::outcome::{Cause, Evidence};

/// One observed value after the analysis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// Index of its marker, place or component; in space in the order of arc length.
    pub site: usize,
    /// Axis of the value, 0 to 2 in space; 0 elsewhere.
    pub axis: usize,
    /// When it was seen \[s\].
    pub time: f64,
    /// d = y − H(x_a).
    pub value: f64,
    /// Its assumed σ.
    pub sigma: f64,
    /// H(x_a).
    pub predicted: f64,
    /// Rate of change of H(x_a) at that time.
    pub rate: f64,
}

/// A marker stands out where its mean squared departure is this many times that of every other.
const STANDS_OUT: f64 = 3.0;
/// A cause with few unknowns is named where it explains this share of Σ (d/σ)².
const EXPLAINS: f64 = 0.5;
/// A cause that moves all markers together explains all but this share, where it is the one: shapes that are
/// wrong look turned too.
const ALL_BUT: f64 = 0.9;
/// What an analysis leaves of a shifted clock, as a share.
const FOLLOWS: f64 = 0.2;
/// Departures are white where no correlation is larger than this, or than four of its standard errors.
const WHITE: f64 = 0.3;

/// The likely cause of departures that are larger than their σ, from their own pattern:
///
/// ```text
///     one marker far above the others:   its mean ≠ 0: biased; white: noisy
///     d ≈ δt ∂H/∂t:                      the clock
///     d ≈ ω × H + c in space:            the frame
///     white in time and along the rod:   σ too small
///     d ≈ constant at every marker:      rest shape or stiffness
///     d ≈ (a + b t) (H − H̄):             damping;   d ≈ (a + b t) ∂H/∂t:  stiffness or mass
/// ```
///
/// with H = H(x_a) at the marker and its time mean H̄. An analysis takes up what it can of a fault, so
/// that these are likely causes, not proofs. `labels` are the names of the sites, `in_space` says that axes
/// are those of places. `None` where 2J_o/m ≤ 1 + 4 √(2/m), and for fewer than eight values.
///
/// # Panics
/// If a site has no label.
pub fn evidence(departures: &[Departure], labels: &[String], in_space: bool) -> Option<Evidence> {
    let m = departures.len();
    let r: Vec<f64> = departures.iter().map(|d| d.value / d.sigma).collect();
    let mean_square = r.iter().map(|r| r * r).sum::<f64>() / m as f64;
    if m < 8 || !(mean_square > 1.0 + 4.0 * (2.0 / m as f64).sqrt()) {
        return None;
    }
    let series = Series::of(departures, &r);
    let in_time = Correlation::of(&series.pairs_in_time());
    let along =
        if in_space { Correlation::of(&series.pairs_of_neighbours()) } else { Correlation::default() };
    let found = Found { departures, labels, r: &r, series: &series, mean_square, in_time, along };
    let (cause, text) = found
        .frame(in_space)
        .or_else(|| found.one_site())
        .or_else(|| found.white())
        .or_else(|| found.clock())
        .unwrap_or_else(|| found.correlated(in_space));
    Some(Evidence { cause, text, in_time: in_time.value, along_the_rod: along.value, mean_square })
}

/// What the causes are judged by.
struct Found<'a> {
    departures: &'a [Departure],
    labels: &'a [String],
    r: &'a [f64],
    series: &'a Series,
    mean_square: f64,
    in_time: Correlation,
    along: Correlation,
}

impl Found<'_> {
    /// One marker that does not go with the others: biased, noisy, or not where it is said to be.
    fn one_site(&self) -> Option<(Cause, String)> {
        let sites = self.labels.len();
        if sites < 2 {
            return None;
        }
        let of = |site: usize| self.departures.iter().zip(self.r).filter(move |(d, _)| d.site == site);
        let square = |site: usize| of(site).map(|(_, r)| r * r).sum::<f64>();
        let count = |site: usize| of(site).count() as f64;
        let seen = (0..sites).filter(|s| count(*s) > 0.0);
        let worst = seen.max_by(|a, b| (square(*a) / count(*a)).total_cmp(&(square(*b) / count(*b))))?;
        let others: Vec<usize> = (0..sites).filter(|s| *s != worst).collect();
        let seen_others = others.iter().filter(|s| count(**s) > 0.0);
        let rest = seen_others.map(|s| square(*s) / count(*s)).fold(0.0, f64::max);
        let own = square(worst) / count(worst);
        if !(own > STANDS_OUT * rest.max(0.5)) {
            return None;
        }
        let label = &self.labels[worst];
        let start =
            format!("{label} stands out: {:.1} σ rms, the others {:.1} at most", own.sqrt(), rest.sqrt());
        let (mut of_means, mut bias) = (0.0, Vec::new());
        for axis in 0..3 {
            let of_axis: Vec<_> = of(worst).filter(|(d, _)| d.axis == axis).collect();
            if !of_axis.is_empty() {
                let n = of_axis.len() as f64;
                of_means += of_axis.iter().map(|(_, r)| *r).sum::<f64>().powi(2) / n;
                bias.push(format!("{:.3e}", of_axis.iter().map(|(d, _)| d.value).sum::<f64>() / n));
            }
        }
        let own_series = Correlation::of(&self.series.pairs_in_time_of(worst));
        Some(if of_means >= EXPLAINS * square(worst) {
            let bias = bias.join(", ");
            (Cause::BiasedMarker, format!("{start}: it is biased, its values are off by ({bias}) throughout"))
        } else if own_series.is_white() {
            let sigma = own.sqrt();
            (
                Cause::NoisyMarker,
                format!("{start}: it is noisy, its σ is about {sigma:.1} times what was assumed"),
            )
        } else {
            let text = format!(
                "{start}, correlated in time ({:.2}): what is left of it changes slowly: its place on the \
                 model or its label is not what was assumed",
                own_series.value
            );
            (Cause::MisplacedMarker, text)
        })
    }

    /// d = δt ∂H/∂t.
    fn clock(&self) -> Option<(Cause, String)> {
        let (share, shift) = explained(self.r, &[self.column(|d| d.rate)])?;
        let (growing, _) = explained(self.r, &[self.growing(|_, d| d.rate)])?;
        let about = self.series.about_means(self.departures);
        let (swing, _) = explained(self.r, &[self.growing(|i, _| about[i]), self.column_of(&about)])?;
        (share >= FOLLOWS && share > 2.0 * growing.max(swing)).then(|| {
            let text = format!(
                "the departures follow the motion ({:.0} % of them is its speed times {:.1} ms): the clock \
                 of the recording is off by that at least",
                100.0 * share,
                1e3 * shift[0]
            );
            (Cause::Clock, text)
        })
    }

    /// d = ω × H + c.
    fn frame(&self, in_space: bool) -> Option<(Cause, String)> {
        if !in_space {
            return None;
        }
        let by_time = self.series.places(self.departures);
        let mut columns = vec![vec![0.0; self.r.len()]; 6];
        for (i, d) in self.departures.iter().enumerate() {
            let place = by_time[i]?;
            let (j, k) = ((d.axis + 1) % 3, (d.axis + 2) % 3);
            // (ω × x)_a = ω_j x_k − ω_k x_j
            columns[j][i] = place[k] / d.sigma;
            columns[k][i] = -place[j] / d.sigma;
            columns[3 + d.axis][i] = 1.0 / d.sigma;
        }
        let (share, found) = explained(self.r, &columns)?;
        (share >= ALL_BUT).then(|| {
            let angle = found[..3].iter().map(|w| w * w).sum::<f64>().sqrt().to_degrees();
            let text = format!(
                "the departures are those of a turned frame ({:.0} % of them by {angle:.1}° about ({:.2}, \
                 {:.2}, {:.2}) and a shift): the axes of the recording, or the direction of the clamp, are \
                 not what was assumed",
                100.0 * share,
                found[0] / angle.to_radians(),
                found[1] / angle.to_radians(),
                found[2] / angle.to_radians(),
            );
            (Cause::Frame, text)
        })
    }

    /// No pattern: σ.
    fn white(&self) -> Option<(Cause, String)> {
        (self.in_time.is_white() && self.along.is_white()).then(|| {
            let text = format!(
                "the departures have no pattern in time ({:.2}){}: σ of the observations is too small, \
                 about {:.1} times what was assumed would fit",
                self.in_time.value,
                if self.along.pairs > 0 {
                    format!(" or along the rod ({:.2})", self.along.value)
                } else {
                    String::new()
                },
                self.mean_square.sqrt()
            );
            (Cause::Sigma, text)
        })
    }

    /// A pattern: where it lies.
    fn correlated(&self, in_space: bool) -> (Cause, String) {
        let mut text =
            format!("the departures are correlated from one time to the next ({:.2})", self.in_time.value);
        if in_space && self.along.pairs > 0 {
            let _ = write!(text, " and along the rod ({:.2})", self.along.value);
        }
        let share = |columns: &[Vec<f64>]| explained(self.r, columns).map_or(0.0, |(share, _)| share);
        let lasting = self.series.share_of_means();
        let about = self.series.about_means(self.departures);
        let amplitude = share(&[self.growing(|i, _| about[i]), self.column_of(&about)]);
        let phase = share(&[self.growing(|_, d| d.rate), self.column(|d| d.rate)]);
        let everywhere = if in_space { "at every marker" } else { "in every component" };
        if !in_space {
            let _ = write!(
                text,
                ": the model does not describe what was seen (its constants, its forcing, the clock); \
                 {:.0} % of them is constant {everywhere}",
                100.0 * lasting
            );
            (Cause::Model, text)
        } else if lasting >= EXPLAINS {
            let _ = write!(
                text,
                ", {:.0} % of them constant {everywhere}: the shape at rest (rest shape, stiffness, mass) \
                 is not that of the model",
                100.0 * lasting
            );
            (Cause::RestShape, text)
        } else if amplitude > phase {
            let _ = write!(
                text,
                "; they go with how far the model swings ({:.0} %, its speed {:.0} %): it loses energy at \
                 another rate (damping)",
                100.0 * amplitude,
                100.0 * phase
            );
            (Cause::Damping, text)
        } else {
            let _ = write!(
                text,
                "; they go with the speed of the model ({:.0} %, how far it swings {:.0} %): it swings at \
                 another rate (stiffness, mass)",
                100.0 * phase,
                100.0 * amplitude
            );
            (Cause::Stiffness, text)
        }
    }

    /// Growing in time through zero in the middle.
    fn growing(&self, of: impl Fn(usize, &Departure) -> f64) -> Vec<f64> {
        let times = || self.departures.iter().map(|d| d.time);
        let middle =
            0.5 * (times().fold(f64::INFINITY, f64::min) + times().fold(f64::NEG_INFINITY, f64::max));
        let each = self.departures.iter().enumerate();
        each.map(|(i, d)| (d.time - middle) * of(i, d) / d.sigma).collect()
    }

    fn column_of(&self, values: &[f64]) -> Vec<f64> {
        self.departures.iter().zip(values).map(|(d, h)| h / d.sigma).collect()
    }

    fn column(&self, of: impl Fn(&Departure) -> f64) -> Vec<f64> {
        self.departures.iter().map(|d| of(d) / d.sigma).collect()
    }
}

/// The values of each site and axis in the order of time.
struct Series {
    /// Site, axis, and the indices with their d/σ.
    each: Vec<(usize, usize, Vec<(usize, f64, f64)>)>,
}

impl Series {
    fn of(departures: &[Departure], r: &[f64]) -> Series {
        let mut each: Vec<(usize, usize, Vec<(usize, f64, f64)>)> = Vec::new();
        for (i, d) in departures.iter().enumerate() {
            let found = each.iter_mut().find(|s| (s.0, s.1) == (d.site, d.axis));
            match found {
                Some(series) => series.2.push((i, d.time, r[i])),
                None => each.push((d.site, d.axis, vec![(i, d.time, r[i])])),
            }
        }
        each.iter_mut().for_each(|s| s.2.sort_by(|a, b| a.1.total_cmp(&b.1)));
        Series { each }
    }

    fn pairs_in_time(&self) -> Vec<[f64; 2]> {
        self.each.iter().flat_map(|s| s.2.windows(2).map(|w| [w[0].2, w[1].2])).collect()
    }

    /// About their mean.
    fn pairs_in_time_of(&self, site: usize) -> Vec<[f64; 2]> {
        let own = self.each.iter().filter(|s| s.0 == site);
        own.flat_map(|s| {
            let mean = s.2.iter().map(|v| v.2).sum::<f64>() / s.2.len() as f64;
            s.2.windows(2).map(move |w| [w[0].2 - mean, w[1].2 - mean])
        })
        .collect()
    }

    fn pairs_of_neighbours(&self) -> Vec<[f64; 2]> {
        let mut pairs = Vec::new();
        for (site, axis, values) in &self.each {
            let next = self.each.iter().filter(|s| s.1 == *axis && s.0 > *site).min_by_key(|s| s.0);
            for (_, time, value) in values {
                let beside = next.and_then(|s| s.2.iter().find(|v| v.1 == *time));
                pairs.extend(beside.map(|v| [*value, v.2]));
            }
        }
        pairs
    }

    /// Share of Σ (d/σ)² that the time means of sites and axes are.
    fn share_of_means(&self) -> f64 {
        let (mut means, mut all) = (0.0, 0.0);
        for (_, _, values) in &self.each {
            let sum: f64 = values.iter().map(|v| v.2).sum();
            means += sum * sum / values.len() as f64;
            all += values.iter().map(|v| v.2 * v.2).sum::<f64>();
        }
        means / all
    }

    /// H − H̄ of every value.
    fn about_means(&self, departures: &[Departure]) -> Vec<f64> {
        let mut out = vec![0.0; departures.len()];
        for (_, _, values) in &self.each {
            let mean = values.iter().map(|v| departures[v.0].predicted).sum::<f64>() / values.len() as f64;
            values.iter().for_each(|v| out[v.0] = departures[v.0].predicted - mean);
        }
        out
    }

    /// For every value the predicted place of its site at its time; `None` where an axis was not seen.
    fn places(&self, departures: &[Departure]) -> Vec<Option<[f64; 3]>> {
        let at = |d: &Departure, axis: usize| {
            let series = self.each.iter().find(|s| (s.0, s.1) == (d.site, axis))?;
            let value = series.2.iter().find(|v| v.1 == d.time)?;
            Some(departures[value.0].predicted)
        };
        departures.iter().map(|d| Some([at(d, 0)?, at(d, 1)?, at(d, 2)?])).collect()
    }
}

/// A correlation of neighbouring values.
#[derive(Debug, Clone, Copy, Default)]
struct Correlation {
    value: f64,
    pairs: usize,
}

impl Correlation {
    fn of(pairs: &[[f64; 2]]) -> Correlation {
        let sum = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>();
        let size = (sum(&|p| p[0] * p[0]) * sum(&|p| p[1] * p[1])).sqrt();
        let value = if size > 0.0 { sum(&|p| p[0] * p[1]) / size } else { 0.0 };
        Correlation { value, pairs: pairs.len() }
    }

    fn is_white(&self) -> bool {
        self.value.abs() <= WHITE.max(4.0 / (self.pairs.max(1) as f64).sqrt())
    }
}

/// Least squares of r by some columns: the share of Σ r² explained, and the coefficients; `None` where they
/// do not tell, being dependent.
fn explained(r: &[f64], columns: &[Vec<f64>]) -> Option<(f64, Vec<f64>)> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let n = columns.len();
    let scale: Vec<f64> = columns.iter().map(|c| dot(c, c).sqrt()).collect();
    if scale.iter().any(|s| !(*s > 0.0)) {
        return None;
    }
    let entry = |i: usize, j: usize| {
        dot(&columns[i], &columns[j]) / (scale[i] * scale[j]) + if i == j { 1e-10 } else { 0.0 }
    };
    let matrix: Vec<f64> = (0..n * n).map(|ij| entry(ij / n, ij % n)).collect();
    let right: Vec<f64> = (0..n).map(|i| dot(&columns[i], r) / scale[i]).collect();
    let mut x = right.clone();
    Cholesky::new(n, &matrix).ok()?.solve_columns(&mut x);
    let share = dot(&right, &x) / dot(r, r);
    Some((share, x.iter().zip(&scale).map(|(x, s)| x / s).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four markers in space that swing, seen at 50 times with σ = 1 mm, and what is added to each
    /// departure, beside its own noise, of size `noise` σ.
    fn swinging(noise: f64, fault: impl Fn(usize, usize, f64, [f64; 3], [f64; 3]) -> f64) -> Vec<Departure> {
        let (mut out, mut state) = (Vec::new(), 12345_u64);
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for k in 0..50 {
            let t = 0.02 * k as f64;
            for site in 0..4 {
                let s = 0.1 * (site + 1) as f64;
                let (w, a) = (9.0, 0.3 * s);
                let place = [a * (w * t).sin(), 0.5 * a * (w * t).cos(), -s];
                let rate = [a * w * (w * t).cos(), -0.5 * a * w * (w * t).sin(), 0.0];
                for axis in 0..3 {
                    let white = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                    let value = 1e-3 * noise * white + fault(site, axis, t, place, rate);
                    let (predicted, rate) = (place[axis], rate[axis]);
                    out.push(Departure { site, axis, time: t, value, sigma: 1e-3, predicted, rate });
                }
            }
        }
        out
    }

    fn cause(of: &[Departure]) -> Option<Cause> {
        let labels: Vec<String> = (1..5).map(|i| format!("marker {i}")).collect();
        let found = evidence(of, &labels, true)?;
        assert!(!found.text.is_empty() && found.mean_square > 1.0);
        Some(found.cause)
    }

    #[test]
    fn planted_patterns_are_named() {
        assert_eq!(cause(&swinging(1.0, |_, _, _, _, _| 0.0)), None);
        assert_eq!(cause(&swinging(3.0, |_, _, _, _, _| 0.0)), Some(Cause::Sigma));
        let biased = swinging(1.0, |site, axis, _, _, _| if site == 1 && axis == 0 { 8e-3 } else { 0.0 });
        assert_eq!(cause(&biased), Some(Cause::BiasedMarker));
        let clock = swinging(1.0, |_, axis, _, _, rate| 0.02 * rate[axis]);
        assert_eq!(cause(&clock), Some(Cause::Clock));
        let turned = swinging(1.0, |_, axis, _, x, _| 0.087 * [x[2], 0.0, -x[0]][axis]);
        assert_eq!(cause(&turned), Some(Cause::Frame));
        let shape =
            swinging(1.0, |site, axis, _, _, _| if axis == 0 { [0.0, 4e-3, 0.0, -6e-3][site] } else { 2e-3 });
        assert_eq!(cause(&shape), Some(Cause::RestShape));
        let damped = swinging(1.0, |_, axis, t, x, _| if axis < 2 { (t - 0.5) * 0.3 * x[axis] } else { 0.0 });
        assert_eq!(cause(&damped), Some(Cause::Damping));
        let faster = swinging(1.0, |_, axis, t, _, rate| 0.05 * (t - 0.5) * rate[axis]);
        assert_eq!(cause(&faster), Some(Cause::Stiffness));
    }

    #[test]
    fn a_noisy_marker_is_told_from_a_biased_one() {
        let mut noisy = swinging(1.0, |_, _, _, _, _| 0.0);
        let more = swinging(6.0, |_, _, _, _, _| 0.0);
        for (d, m) in noisy.iter_mut().zip(&more).filter(|(d, _)| d.site == 2) {
            d.value = m.value;
        }
        assert_eq!(cause(&noisy), Some(Cause::NoisyMarker));
        let labels: Vec<String> = (1..5).map(|i| format!("marker {i}")).collect();
        let text = evidence(&noisy, &labels, true).unwrap().text;
        assert!(text.contains("marker 3"), "{text}");
    }
}
