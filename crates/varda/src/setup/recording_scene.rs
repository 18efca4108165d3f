//! A scene for a recording of a rod: what the recording itself says is filled in, the rest is left to its
//! user with a note.

use std::fmt::Write;

use varda_rod::Vector3;

use super::csv::{self, ObservedRow, Subject};
use super::recording::scatter;
use crate::Error;

type V = Vector3<f64>;

const TEMPLATE: &str = include_str!("../../scenes/recording.toml");
/// Column of the template's comments.
const COMMENTS: usize = 33;
/// The longest step of time that is proposed \[s\].
const STEP: f64 = 0.01;
/// The longest window and forecast that are proposed \[s\].
const WINDOW: f64 = 1.0;
/// Markers move far where σ_x is more than this share of the rod's length: a minimization over the whole
/// window then starts from a rod that is far from all that was seen.
const FAR: f64 = 0.2;
/// A marker moves where it travels this many times σ.
const MOVES: f64 = 5.0;
/// Length of the rod, and place of its only marker, where nothing says them \[m\].
const ALONE: f64 = 1.0;
/// A marker at rest travels at most this many times σ: noise of three coordinates is √3 σ.
const AT_REST: f64 = 3.0;
/// A marker at a moved clamp travels at least this share of its neighbour's way: beside a clamp at rest
/// travel grows with s², beside a hook at rest with s.
const IS_CARRIED: f64 = 0.5;
/// Frames of a block that may be quiet.
const BLOCK: usize = 20;
/// Noise alone makes the quietest of ten blocks, of 20 frames each, this much quieter than it is.
const ALIKE: f64 = 1.35;
/// Share of the chords between two markers that the one which is taken for the largest is above.
const LARGEST: f64 = 0.95;
/// Its place among normal numbers of variance 1.
const LARGEST_OF_NORMAL: f64 = 1.645;
/// Neighbours in time that are averaged: over them a rod hardly changes its shape.
const NEAR: usize = 9;

/// The TOML of a scene for a recording, whose text is `text`; `file` is the recording's name as the scene
/// writes it.
///
/// Read from the recording: markers with their arc lengths (column `s_m`; by name the sums of the largest
/// chords between neighbours, which are lower bounds), rate, window, σ (third differences in time, frames at
/// rest), places of the rod before it is held, and how far it moves. Named markers are put in a row from the
/// end that moves less; a comment says so, and what the arc lengths are from the other end. A single one
/// stands at the end of a rod of 1 m, which is the user's to change.
///
/// # Errors
/// [`Error::Data`] for a file that is no recording of points in space, or has fewer than four frames.
pub(super) fn scene_of_recording(file: &str, text: &str) -> Result<String, Error> {
    let rows = csv::observations(file, text)?;
    let recording = Recorded::of(&rows);
    if recording.tracks.iter().all(|t| t.seen.len() < 4) {
        let message = "fewer than four frames: there is nothing to read a rate or a noise from".to_string();
        return Err(Error::Data { place: file.to_string(), message });
    }
    Ok(recording.scene(file))
}

/// A marker or point through time.
pub(super) struct Track {
    pub(super) name: Option<String>,
    pub(super) arc_length: f64,
    /// Times \[s\] and whole places \[m\], in the order of time.
    seen: Vec<(f64, V)>,
}

impl Track {
    pub(super) fn mean(&self) -> V {
        self.seen.iter().map(|(_, x)| x).sum::<V>() / self.seen.len().max(1) as f64
    }

    /// How far it moves about its mean place, root mean square \[m\].
    fn travel(&self) -> f64 {
        let mean = self.mean();
        root_mean_square(&self.seen.iter().map(|(_, x)| (x - mean).norm()).collect::<Vec<_>>())
    }

    /// Scatter of a coordinate about its mean over the frames in which it scatters least \[m\].
    fn quietest(&self, axis: usize) -> f64 {
        let blocks = self.seen.chunks_exact(BLOCK.min(self.seen.len().max(4)));
        let of = |block: &[(f64, V)]| {
            let mean = block.iter().map(|(_, x)| x[axis]).sum::<f64>() / block.len() as f64;
            let off = root_mean_square(&block.iter().map(|(_, x)| x[axis] - mean).collect::<Vec<_>>());
            // the mean is taken from the block itself
            off * (block.len() as f64 / (block.len() as f64 - 1.0)).sqrt()
        };
        blocks.map(of).fold(f64::INFINITY, f64::min)
    }
}

/// A recording by its tracks, in the order of arc length.
pub(super) struct Recorded {
    pub(super) tracks: Vec<Track>,
    /// Whether the file has the places of named markers.
    pub(super) placed: bool,
    /// Time between two frames \[s\].
    interval: f64,
    /// First and last time \[s\].
    span: [f64; 2],
}

impl Recorded {
    pub(super) fn of(rows: &[ObservedRow]) -> Recorded {
        let mut tracks: Vec<Track> = Vec::new();
        for row in rows {
            let [Some(x), Some(y), Some(z)] = row.position else { continue };
            let (name, s) = match &row.subject {
                Subject::Marker(name) => (Some(name.clone()), row.arc_length.unwrap_or(0.0)),
                Subject::ArcLength(s) => (None, *s),
            };
            let known = tracks.iter().position(|t| t.name == name && t.arc_length == s);
            let at = known.unwrap_or_else(|| {
                tracks.push(Track { name, arc_length: s, seen: Vec::new() });
                tracks.len() - 1
            });
            tracks[at].seen.push((row.time, V::new(x, y, z)));
        }
        for track in &mut tracks {
            track.seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let mut times: Vec<f64> = tracks.iter().flat_map(|t| t.seen.iter().map(|s| s.0)).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
        let span = [times.first(), times.last()].map(|t| t.copied().unwrap_or(0.0));
        let interval = frame_interval(&mut gaps, span[1] - span[0]).unwrap_or(STEP);
        let placed = rows.iter().any(|row| row.arc_length.is_some());
        if tracks.iter().all(|t| t.name.is_some()) && !placed {
            tracks = in_a_row(tracks);
            if let [alone] = &mut tracks[..] {
                alone.arc_length = ALONE;
            }
        } else {
            tracks.sort_by(|a, b| a.arc_length.total_cmp(&b.arc_length));
        }
        Recorded { tracks, placed, interval, span }
    }

    /// Arc length of the last marker \[m\].
    pub(super) fn length(&self) -> f64 {
        self.tracks.last().map_or(1.0, |t| t.arc_length).max(1e-3)
    }

    /// σ of a coordinate \[m\], in the middle of all markers: what third differences in time say, which have
    /// most values; where the quietest frames say far less, they, since motion adds to differences.
    fn sigma(&self) -> f64 {
        let places =
            |t: &Track| -> Vec<_> { t.seen.iter().map(|(t, x)| (*t, [x.x, x.y, x.z].map(Some))).collect() };
        let scatters = self.tracks.iter().filter_map(|t| scatter(&places(t), self.interval));
        let scatter = quantile(&mut scatters.collect::<Vec<_>>(), 0.5);
        let quiet = self.tracks.iter().flat_map(|t| (0..3).map(|axis| t.quietest(axis)));
        let quiet = quantile(&mut quiet.collect::<Vec<_>>(), 0.5);
        let (scatter, quiet) = (scatter.unwrap_or(f64::INFINITY), quiet.unwrap_or(f64::INFINITY));
        let sigma = if scatter <= ALIKE * quiet { scatter } else { quiet };
        if sigma.is_finite() && sigma > 0.0 { sigma } else { 1e-3 * self.length() }
    }

    /// How far a coordinate of the marker that moves most is from its mean, and how fast it moves, root mean
    /// square \[m\], \[m/s\].
    fn motion(&self) -> [f64; 2] {
        let of = |track: &Track| {
            let mean = track.mean();
            let far: Vec<f64> = track.seen.iter().flat_map(|(_, x)| <[f64; 3]>::from(x - mean)).collect();
            let speed =
                |w: &[(f64, V)]| <[f64; 3]>::from((w[2].1 - w[0].1) / (w[2].0 - w[0].0).max(self.interval));
            let fast: Vec<f64> = track.seen.windows(3).flat_map(speed).collect();
            [root_mean_square(&far), root_mean_square(&fast)]
        };
        let largest = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].max(b[1])];
        self.tracks.iter().map(of).fold([0.0; 2], largest)
    }

    /// A guess of the place of the clamp at arc length 0 and of its direction: the marker nearest to it stays
    /// at its own arc length from there, and no other is farther than its own.
    fn clamp(&self) -> [V; 2] {
        let first = &self.tracks[0];
        let p = first.mean();
        let next = self.tracks.iter().find(|t| t.arc_length > first.arc_length);
        let along = next.map_or(-V::z(), |t| t.mean() - p);
        let along = along.try_normalize(1e-12).unwrap_or(-V::z());
        let mut base = p - along * first.arc_length;
        if first.arc_length > 0.0 {
            for _ in 0..50 {
                base -= self.misfit_of_base(base, first.arc_length);
            }
        }
        let tangent = if first.arc_length > 0.0 { (p - base).try_normalize(1e-12) } else { None };
        [base, tangent.unwrap_or(along)]
    }

    /// A step of a mean of projections: along the way to every place that is nearer or farther than it may
    /// be.
    fn misfit_of_base(&self, base: V, first: f64) -> V {
        let (mut sum, mut count) = (V::zeros(), 0.0);
        for track in &self.tracks {
            for (_, x) in &track.seen {
                let (way, s) = (x - base, track.arc_length);
                let excess = way.norm() - s;
                if way.norm() > 0.0 && (excess > 0.0 || s == first) {
                    sum -= way.normalize() * excess;
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { sum / count } else { sum }
    }

    /// A named marker at arc length 0 that the clamp follows: it moves, and not as what is beside a support
    /// at rest.
    fn hand(&self, sigma: f64) -> Option<&str> {
        let (first, next) = (self.tracks.first()?, self.tracks.get(1));
        let carried = next.is_none_or(|next| first.travel() >= IS_CARRIED * next.travel());
        let moves = first.arc_length == 0.0 && first.travel() > MOVES * sigma && carried;
        first.name.as_deref().filter(|_| moves)
    }

    /// Which end of named markers was taken for the start, as a comment of the scene.
    fn order(&self, sigma: f64, hand: Option<&str>) -> String {
        let ends = [self.tracks.first(), self.tracks.last()];
        let [Some((Some(first), start)), Some((Some(last), end))] =
            ends.map(|track| track.map(|t| (t.name.as_deref(), 1e3 * t.travel())))
        else {
            return String::new();
        };
        if self.tracks.len() < 2 || self.placed {
            return String::new();
        }
        let beside = self.tracks[0].travel() > AT_REST * sigma && hand.is_none();
        let aside = match beside {
            true => format!(
                "# {first:?} moves too, so it is not where the rod is held: add its distance from there \
                 along the rod to every\n# arc_length and to model.length, and write the support's place \
                 into [model.start].\n"
            ),
            false => String::new(),
        };
        format!(
            "\n# Arc lengths count from marker {first:?}, which moves by {start:.1} mm (rms), to {last:?}, \
             {end:.1} mm: from the\n# end that moves less. Where the rod starts at {last:?}, take the \
             numbers from the other end, and hold [model.start]\n# there; a support at the far end is \
             [model.end], or a vertex of [[model.prescribed]]. A column s_m decides by itself.\n{aside}"
        )
    }

    /// The scene, from a template.
    fn scene(&self, file: &str) -> String {
        let length = self.length();
        let parts = (self.interval / STEP - 1e-9).ceil().max(1.0);
        let step = self.interval / parts;
        let span = self.span[1] - self.span[0];
        let window = ((0.5 * span).min(WINDOW) / step).floor().max(1.0);
        let forecast = (span - window * step).clamp(0.0, WINDOW);
        let [far, fast] = self.motion().map(|size| rounded(size.max(0.01 * length)));
        let [place, tangent] = self.clamp();
        let are_named = self.tracks.iter().all(|t| t.name.is_some()) && !self.placed;
        let note = match (are_named, self.tracks.len()) {
            (true, 1) => "one marker says nothing of it",
            (true, _) => "the sum of the largest distances between markers, a lower bound",
            (false, _) => "the recording's last point; from the clamp's face",
        };
        let steps = if parts > 1.0 { format!("{parts} steps") } else { "a step".to_string() };
        let number = |x: f64| format!("{x:?}");
        let whole = |x: f64| format!("{x:.0}");
        let sigma = self.sigma();
        let hand = self.hand(sigma);
        let followed = hand.unwrap_or("hand");
        let [held, moved] = if hand.is_some() { ["# ", ""] } else { ["", "# "] };
        let values = [
            ("{held}", held.to_string()),
            ("{moved}", moved.to_string()),
            ("{followed}", format!("{followed:?}")),
            ("{file}", file.to_string()),
            ("{title}", format!("{:?}", format!("A rod, from {file}"))),
            ("{length}", if are_named { format!("{length:.4}") } else { number(length) }),
            ("{length_note}", note.to_string()),
            ("{segments}", (4 * self.tracks.len()).clamp(20, 100).to_string()),
            ("{position}", vector(place)),
            ("{tangent}", vector(tangent)),
            ("{director}", vector(across(tangent))),
            ("{step}", number(step)),
            ("{frames}", format!("{steps} a frame at {:.4} Hz", 1.0 / self.interval)),
            ("{window}", whole(window)),
            ("{window_seconds}", format!("{:.3}", window * step)),
            ("{sigma_x}", number(far)),
            ("{sigma_v}", number(fast)),
            ("{correlation_x}", number(rounded(0.5 * length))),
            ("{correlation_v}", number(rounded(0.5 * length))),
            ("{growth}", growth(window, far > FAR * length)),
            ("{path}", format!("{file:?}")),
            ("{time_zero}", number(self.span[0])),
            ("{sigma}", number(rounded(sigma))),
        ];
        let mut out = filled(TEMPLATE, &values);
        out.push_str(&self.order(sigma, hand));
        for track in &self.tracks {
            if let Some(name) = track.name.as_deref().filter(|name| Some(*name) != hand) {
                if self.placed {
                    let s = track.arc_length;
                    let _ = write!(
                        out,
                        "\n[[observations.markers]]\nname = {name:?}\narc_length = {s:?}  # from the file\n\
                         # use = \"withhold\"               # keep it back to test the analysis\n"
                    );
                    continue;
                }
                if self.tracks.len() == 1 {
                    let _ = write!(
                        out,
                        "\n[[observations.markers]]\nname = {name:?}\narc_length = {ALONE:?}  # m, yours\n"
                    );
                    continue;
                }
                let _ = write!(
                    out,
                    "\n[[observations.markers]]\nname = {name:?}\n# m, yours: a lower bound, from distances \
                     between markers\narc_length = {:.4}              # {:.4} from the other end\n\
                     # use = \"withhold\"               # keep it back to test the analysis\n",
                    track.arc_length,
                    length - track.arc_length
                );
            }
        }
        if forecast > 0.0 {
            let _ = write!(out, "\n[report]\nforecast = {:?}  # s\n", rounded(forecast));
        }
        out
    }
}

/// How the window grows; a proposal, unless markers move far.
fn growth(window: f64, far: bool) -> String {
    let sizes = (1..).map(|i| 2.0_f64.powi(i)).take_while(|size| 1.5 * size <= window);
    let sizes: Vec<String> = sizes.chain([window]).map(|size| format!("{size:.0}")).collect();
    let (mark, why) = if far {
        ("", "markers go far for this rod: the window grows from its first steps")
    } else {
        ("# ", "where a run does not converge, let the window grow from its first steps:")
    };
    format!(
        "{mark}[algorithm]  # {why}\n{mark}window_growth = [{}]\n{mark}minimizer = \"trust-region\"",
        sizes.join(", ")
    )
}

/// Lines with values for their keys; a comment behind a value stays in its column where there is room.
pub(super) fn filled(template: &str, values: &[(&str, String)]) -> String {
    let mut out = String::with_capacity(2 * template.len());
    for line in template.lines() {
        let mut line = line.to_string();
        for (key, value) in values {
            if let Some((before, after)) = line.split_once(key) {
                let gap = if after.starts_with('#') {
                    " ".repeat(COMMENTS.saturating_sub(before.chars().count() + value.chars().count()).max(2))
                } else {
                    String::new()
                };
                line = format!("{before}{value}{gap}{after}");
            }
        }
        out.push_str(&line);
        out.push('\n');
    }
    out
}

/// Named markers in a row, with the sums of the largest chords for arc lengths: the shortest of the ways from
/// marker to nearest marker, from the end that moves less.
fn in_a_row(mut tracks: Vec<Track>) -> Vec<Track> {
    let means: Vec<V> = tracks.iter().map(Track::mean).collect();
    let ways = (0..tracks.len()).map(|first| nearest_in_turn(&means, first));
    let length = |way: &[usize]| way.windows(2).map(|w| (means[w[0]] - means[w[1]]).norm()).sum::<f64>();
    let Some(mut way) = ways.min_by(|a, b| length(a).total_cmp(&length(b))) else { return tracks };
    let ends = [way.first(), way.last()].map(|end| end.map_or(0.0, |i| tracks[*i].travel()));
    if ends[1] < ends[0] {
        way.reverse();
    }
    for pair in way.windows(2) {
        tracks[pair[1]].arc_length = tracks[pair[0]].arc_length + chord(&tracks[pair[0]], &tracks[pair[1]]);
    }
    tracks.sort_by(|a, b| a.arc_length.total_cmp(&b.arc_length));
    tracks
}

/// All places in turn, each the nearest of those left to the one before.
fn nearest_in_turn(places: &[V], first: usize) -> Vec<usize> {
    let mut left: Vec<usize> = (0..places.len()).filter(|i| *i != first).collect();
    let mut way = vec![first];
    while !left.is_empty() {
        let from = places[way[way.len() - 1]];
        let distance = |i: &usize| (places[left[*i]] - from).norm();
        let next = (0..left.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        way.push(left.swap_remove(next));
    }
    way
}

/// The largest distance of two markers at equal times, without what noise adds to the largest of many.
fn chord(a: &Track, b: &Track) -> f64 {
    let mut distances: Vec<f64> = Vec::new();
    let mut other = b.seen.iter().peekable();
    for (t, x) in &a.seen {
        while other.next_if(|(u, _)| u < t).is_some() {}
        if let Some((_, y)) = other.peek().filter(|(u, _)| u == t) {
            distances.push((x - y).norm());
        }
    }
    largest(&distances).unwrap_or_else(|| (a.mean() - b.mean()).norm())
}

/// The value that a share [`LARGEST`] of a series in time is below, its noise taken off: of means over
/// [`NEAR`] neighbours, less what noise leaves of it in that share of means.
fn largest(series: &[f64]) -> Option<f64> {
    if series.len() < 2 * NEAR {
        return quantile(&mut series.to_vec(), LARGEST);
    }
    let near = NEAR as f64;
    let mut means: Vec<f64> = series.windows(NEAR).map(|w| w.iter().sum::<f64>() / near).collect();
    let off: Vec<f64> = means.iter().zip(&series[NEAR / 2..]).map(|(mean, v)| v - mean).collect();
    // a mean takes 1/n of the variance along
    let noise = root_mean_square(&off) * (near / (near - 1.0)).sqrt();
    Some(quantile(&mut means, LARGEST)? - LARGEST_OF_NORMAL * noise / near.sqrt())
}

fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((share * values.len() as f64) as usize).or(values.last()).copied()
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// A direction across another, upwards where that can be.
pub(super) fn across(tangent: V) -> V {
    let up = if tangent.z.abs() < 0.95 { V::z() } else { V::x() };
    (up - tangent * up.dot(&tangent)).normalize()
}

/// As a scene writes it.
pub(super) fn vector(v: V) -> String {
    format!("[{:.4}, {:.4}, {:.4}]", v.x, v.y, v.z)
}

/// Two significant digits.
pub(super) fn rounded(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// The time between two frames from the gaps between times over a span, some of which are lost frames. Times
/// may be written to few digits, so that only the span gives the interval to more.
fn frame_interval(gaps: &mut [f64], span: f64) -> Option<f64> {
    let middle = quantile(gaps, 0.5)?;
    let single: Vec<f64> = gaps.iter().copied().filter(|gap| *gap < 1.5 * middle).collect();
    let mean = single.iter().sum::<f64>() / single.len() as f64;
    let frames: f64 = gaps.iter().map(|gap| (gap / mean).round()).sum();
    Some(rate_made_whole(span / frames))
}

/// The interval of a whole number of frames a second, where it is one to the digits of times.
fn rate_made_whole(interval: f64) -> f64 {
    let rate = 1.0 / interval;
    if (rate - rate.round()).abs() < 1e-3 * rate && rate >= 1.0 { 1.0 / rate.round() } else { interval }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chord of 0.05 m that noise of 1.4 mm makes up to 0.055 m long, and one that swings between 0.04 and
    /// 0.05 m: both are 0.05 m at most. Without noise a constant is what it is.
    #[test]
    fn noise_makes_no_chord_longer() {
        let mut state = 7_u64;
        let mut uniform = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut noise = move || 1.4e-3 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
        let still: Vec<f64> = (0..200).map(|_| 0.05 + noise()).collect();
        let swings: Vec<f64> = (0..200).map(|k| 0.045 + 0.005 * (0.1 * k as f64).sin() + noise()).collect();
        let highest = still.iter().copied().fold(0.0, f64::max);
        assert!(highest > 0.053, "{highest}");
        // a mean of nine has 0.5 mm of noise left, of which the chord may keep as much
        assert!((largest(&still).unwrap() - 0.05).abs() < 5e-4, "{:?}", largest(&still));
        assert!((0.0485..0.0505).contains(&largest(&swings).unwrap()), "{:?}", largest(&swings));
        assert!((largest(&[0.05; 30]).unwrap() - 0.05).abs() < 1e-12);
    }

    /// Five markers 0.1 m apart on a cable from x = 0 to 0.5 m, seen 60 times: `travel` of each at its arc
    /// length, across the cable.
    fn recording(names: [&str; 5], travel: impl Fn(f64) -> f64) -> String {
        let mut text = "time_s,marker,x_m,y_m,z_m\n".to_string();
        for k in 0..60 {
            let t = 0.01 * k as f64;
            for (i, name) in names.iter().enumerate() {
                let s = 0.05 + 0.1 * i as f64;
                let y = travel(s) * (8.0 * t).sin();
                let _ = writeln!(text, "{t},{name},{s},{y},0.0");
            }
        }
        text
    }

    fn scene(names: [&str; 5], travel: impl Fn(f64) -> f64) -> String {
        scene_of_recording("seen.csv", &recording(names, travel)).unwrap()
    }

    const NAMES: [&str; 5] = ["a", "b", "c", "d", "e"];

    #[test]
    fn a_marker_beside_a_support_at_rest_is_no_hand() {
        // a hook moved at the far end, and a clamp, or a hook, at rest at the near one
        for near in [|s: f64| 0.4 * s * s, |s: f64| 0.2 * s] {
            let text = scene(NAMES, near);
            assert!(text.contains("# motion = ") && text.contains("\nposition = "), "{text}");
            assert!(text.contains("from marker \"a\""), "{text}");
            assert_eq!(text.matches("[[observations.markers]]").count(), 5);
            // the far end first: the same order
            let turned = scene(["e", "d", "c", "b", "a"], |s| near(0.5 - s));
            assert!(turned.contains("from marker \"a\"") && turned.contains("# motion = "), "{turned}");
        }
    }

    #[test]
    fn one_marker_is_no_clamp_and_gives_no_length() {
        let mut text = "time_s,marker,x_m,y_m,z_m\n".to_string();
        for k in 0..100 {
            let t = 0.01 * f64::from(k);
            text += &format!("{t},tip,{},0.0,-0.1\n", 0.05 * (9.0 * t).sin());
        }
        let scene = scene_of_recording("seen.csv", &text).unwrap();
        for line in ["length = 1.0000", "one marker says nothing of it", "name = \"tip\"\narc_length = 1.0"] {
            assert!(scene.contains(line), "{line}: {scene}");
        }
        assert!(scene.contains("# motion = { kind = \"markers\""), "{scene}");
    }

    #[test]
    fn a_moved_end_is_a_hand() {
        let text = scene(NAMES, |s| 0.05 + 0.1 * s);
        assert!(text.contains("\nmotion = { kind = \"markers\", names = [\"a\"] }"), "{text}");
        assert_eq!(text.matches("[[observations.markers]]").count(), 4);
    }

    #[test]
    fn the_window_grows_where_markers_go_far() {
        let grows = |text: &str| text.contains("\n[algorithm]  #");
        let growth = "window_growth = [2, 4, 8, 16, ";
        let far = scene(NAMES, |s| 1.6 * s * s);
        assert!(grows(&far) && far.contains(&format!("\n{growth}")), "{far}");
        let near = scene(NAMES, |s| 0.1 * s * s);
        assert!(!grows(&near) && near.contains(&format!("\n# {growth}")), "{near}");
    }

    #[test]
    fn arc_lengths_are_given_from_both_ends() {
        let text = scene(NAMES, |s| 0.4 * s * s);
        assert!(text.contains("name = \"b\"\n"), "{text}");
        let b = text.split("name = \"b\"").nth(1).unwrap();
        let line = b.lines().find(|line| line.starts_with("arc_length = ")).unwrap();
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        // a length of 0.4 m and a little from the first marker to the last
        assert!((numbers[0] + numbers[1] - 0.4).abs() < 2e-2 && numbers[0] < 0.11, "{line}");
    }
}
