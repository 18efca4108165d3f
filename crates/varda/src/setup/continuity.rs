//! Rows of a recording that do not go on from those before: labels exchanged, jumps faster than a rod moves.

use std::collections::HashMap;

use varda_rod::Vector3;

use super::reachable::Sighting;
use super::rod_model::RodParts;
use crate::scene::rounded;

/// Standard deviations that a move may have beyond the speed: of a difference in space √2 χ₃ σ is
/// expected, beyond 8 σ once in a million.
const SIGMAS: f64 = 8.0;
/// A speed that nobody stated is this many times what the rod and its supports do by themselves.
const MARGIN: f64 = 5.0;
/// Rows in succession that agree on a new place: from then on the marker is there.
const AGREED: usize = 3;
/// Labels are exchanged among so many neighbours along the rod at most.
const NEIGHBOURS: usize = 64;

/// What a speed is compared with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fastest {
    /// \[m/s\].
    pub(super) speed: f64,
    /// Whether the scene states it.
    pub(super) stated: bool,
}

impl Fastest {
    /// The stated speed; else five times the sum of the supports' greatest speed, of a fall by the rod's
    /// length, √(2 g L), and of a cantilever that swings by half its length, ½ L (1.875/L)² √(EI/μ).
    pub(super) fn of(parts: &RodParts, stated: Option<f64>, run: [f64; 2]) -> Fastest {
        if let Some(speed) = stated {
            return Fastest { speed, stated: true };
        }
        let support = speed_of_supports(parts, run);
        let rod = &parts.rod;
        let (length, mass) = (rod.length(), rod.masses.iter().sum::<f64>());
        let fall = (2.0 * parts.loads.gravity.norm() * length).sqrt();
        let ei = rod.ei.iter().map(|ei| ei[0].max(ei[2])).fold(0.0, f64::max);
        let swing = 0.5 * 1.875_f64.powi(2) / length * (ei * length / mass).sqrt();
        Fastest { speed: MARGIN * (support + fall + swing), stated: false }
    }
}

/// The largest speed of a support between two times \[m/s\].
pub(super) fn speed_of_supports(parts: &RodParts, run: [f64; 2]) -> f64 {
    const SAMPLES: usize = 500;
    let supports = &parts.supports;
    let clamps = [&supports.start, &supports.end].into_iter().flatten().map(|clamp| &clamp.position);
    let moving = clamps.chain(supports.prescribed.iter().map(|(_, place)| place));
    let h = (run[1] - run[0]) / SAMPLES as f64;
    let time = |k: usize| run[0] + h * k as f64;
    let speeds = moving
        .flat_map(|place| (0..SAMPLES).map(move |k| (place.at(time(k + 1)) - place.at(time(k))).norm() / h));
    speeds.fold(0.0, f64::max)
}

impl std::fmt::Display for Fastest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Fastest { speed, stated } = self;
        if *stated {
            write!(f, "observations.max_speed is {speed} m/s")
        } else {
            write!(
                f,
                "{speed:.1} m/s is five times what such a rod does (observations.max_speed states another)"
            )
        }
    }
}

/// Two markers whose labels are exchanged.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Exchange {
    pub(super) sites: [usize; 2],
    /// Rows with the wrong label, in the order of time.
    pub(super) rows: Vec<usize>,
    /// Whether they are right again later.
    pub(super) ends: bool,
}

/// A row too far from the marker's place before.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Jump {
    pub(super) row: usize,
    /// The row before.
    before: usize,
}

/// The rows that have three coordinates, in the order of time, those of one time together.
fn in_time(rows: &[Sighting]) -> Vec<(usize, &Sighting, Vector3<f64>)> {
    let whole = |(i, row): (usize, &'_ Sighting)| match row.written {
        [Some(x), Some(y), Some(z)] => Some((i, Vector3::new(x, y, z))),
        _ => None,
    };
    let mut all: Vec<_> =
        rows.iter().enumerate().filter_map(|r| whole(r).map(|(i, place)| (i, r.1, place))).collect();
    all.sort_by(|a, b| a.1.time.total_cmp(&b.1.time));
    all
}

/// Labels that two markers exchange: from one time to the next each comes to where the other was, much nearer
/// than to where it was itself.
pub(super) fn exchanges(rows: &[Sighting], arc_lengths: &[f64]) -> Vec<Exchange> {
    let rank = ranks(arc_lengths);
    let all = in_time(rows);
    let mut last: HashMap<usize, (Vector3<f64>, f64)> = HashMap::new();
    let mut open: Vec<Exchange> = Vec::new();
    let mut closed = Vec::new();
    for now in all.chunk_by(|a, b| a.1.time == b.1.time) {
        let moved: Vec<_> = now
            .iter()
            .filter_map(|(_, row, place)| {
                let (before, sigma) = last.get(&row.site)?;
                let own = (place - before).norm();
                (own > SIGMAS * row.sigma.hypot(*sigma)).then_some((row.site, *place, *before, own))
            })
            .collect();
        for (i, a) in moved.iter().enumerate() {
            for b in moved[i + 1..].iter().filter(|b| rank[a.0].abs_diff(rank[b.0]) <= NEIGHBOURS) {
                let across = (a.1 - b.2).norm() + (b.1 - a.2).norm();
                if !(across < 0.25 * (a.3 + b.3)) {
                    continue;
                }
                let sites = [a.0.min(b.0), a.0.max(b.0)];
                match open.iter().position(|e| e.sites == sites) {
                    Some(at) => closed.push(Exchange { ends: true, ..open.remove(at) }),
                    None => open.push(Exchange { sites, rows: Vec::new(), ends: false }),
                }
            }
        }
        for (index, row, place) in now {
            last.insert(row.site, (*place, row.sigma));
            let wrong = open.iter_mut().filter(|e| e.sites.contains(&row.site));
            wrong.for_each(|e| e.rows.push(*index));
        }
    }
    closed.extend(open);
    closed.sort_by_key(|e| e.rows.first().copied());
    closed
}

fn ranks(arc_lengths: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..arc_lengths.len()).collect();
    order.sort_by(|a, b| arc_lengths[*a].total_cmp(&arc_lengths[*b]));
    let mut rank = vec![0; order.len()];
    order.iter().enumerate().for_each(|(r, site)| rank[*site] = r);
    rank
}

/// Rows that a marker would have come to faster than it can. Several in succession that agree are where it
/// is.
pub(super) fn jumps(rows: &[Sighting], fastest: Fastest) -> Vec<Jump> {
    let all = in_time(rows);
    /// The last row that was believed, and those since that were not.
    #[derive(Default)]
    struct Past {
        believed: Option<(usize, Vector3<f64>)>,
        doubted: Vec<(usize, Vector3<f64>)>,
    }
    let mut pasts: HashMap<usize, Past> = HashMap::new();
    let far = |a: (usize, Vector3<f64>), b: (usize, Vector3<f64>)| {
        let (from, to) = (&rows[a.0], &rows[b.0]);
        let reach = fastest.speed * (to.time - from.time) + SIGMAS * from.sigma.max(to.sigma);
        (b.1 - a.1).norm() > reach
    };
    let mut found = Vec::new();
    for (index, row, place) in all {
        let here = (index, place);
        let past = pasts.entry(row.site).or_default();
        match past.believed {
            Some(believed) if far(believed, here) => {
                if past.doubted.last().is_some_and(|doubted| far(*doubted, here)) {
                    past.doubted.clear();
                }
                past.doubted.push(here);
                found.push(Jump { row: index, before: believed.0 });
                if past.doubted.len() >= AGREED {
                    *past = Past { believed: Some(here), doubted: Vec::new() };
                }
            }
            _ => *past = Past { believed: Some(here), doubted: Vec::new() },
        }
    }
    found
}

/// The marker that was last seen where the row is.
fn label_of(rows: &[Sighting], jump: &Jump, fastest: Fastest) -> Option<usize> {
    let row = &rows[jump.row];
    let place = Vector3::from(row.written.map(|v| v.unwrap_or(f64::NAN)));
    let own = Vector3::from(rows[jump.before].written.map(|v| v.unwrap_or(f64::NAN)));
    let near = rows.iter().filter(|r| r.site != row.site && r.time < row.time);
    let near = near.filter(|r| row.time - r.time <= row.time - rows[jump.before].time);
    let off = |r: &Sighting| (place - Vector3::from(r.written.map(|v| v.unwrap_or(f64::NAN)))).norm();
    let near = near.filter(|r| {
        off(r) <= 0.25 * (place - own).norm()
            && off(r) <= fastest.speed * (row.time - r.time) + SIGMAS * row.sigma.max(r.sigma)
    });
    near.min_by(|a, b| off(a).total_cmp(&off(b))).map(|r| r.site)
}

/// Said of exchanges: the markers, the times and the lines.
pub(super) fn explain_exchanges(rows: &[Sighting], found: &[Exchange], labels: &[&str]) -> String {
    const SHOWN: usize = 4;
    let one = |e: &Exchange| {
        let [a, b] = e.sites.map(|site| labels[site]);
        let (first, last) = (&rows[e.rows[0]], &rows[e.rows[e.rows.len() - 1]]);
        let lines: Vec<usize> = e.rows.iter().map(|i| rows[*i].line).collect();
        let (from, to) = (lines.iter().min().unwrap_or(&0), lines.iter().max().unwrap_or(&0));
        let until =
            if e.ends { format!("to {} s", rounded(last.time)) } else { "on, to the end".to_string() };
        format!("{a} and {b} from {} s {until} (lines {from} to {to})", rounded(first.time))
    };
    let shown: Vec<String> = found.iter().take(SHOWN).map(one).collect();
    let more = found.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!(", and {more} more") } else { String::new() };
    format!("labels exchanged: {}{more}: each comes to where the other was", shown.join(", "))
}

/// What is wrong with the first of the jumps, and the likely cause.
pub(super) fn explain_jumps(rows: &[Sighting], found: &[Jump], fastest: Fastest, labels: &[&str]) -> String {
    let jump = &found[0];
    let (row, before) = (&rows[jump.row], &rows[jump.before]);
    let [x, y, z] = row.written.map(|v| v.unwrap_or(f64::NAN));
    let distance = (0..3)
        .map(|c| (row.written[c].unwrap_or(f64::NAN) - before.written[c].unwrap_or(f64::NAN)).powi(2))
        .sum::<f64>()
        .sqrt();
    let after = row.time - before.time;
    let speed = if after > 0.0 { format!("{:.1} m/s", distance / after) } else { "at the same time".into() };
    let others = match found.len() {
        1 => String::new(),
        n => format!(" {n} of {} rows jump so.", rows.len()),
    };
    let cause = if row.written.iter().flatten().all(|v| *v == 0.0) {
        "A lost marker that was exported as 0,0,0? Leave its cells empty.".to_string()
    } else if let Some(other) = label_of(rows, jump, fastest) {
        format!("That is where {} was: are labels exchanged?", labels[other])
    } else {
        "A false detection, another marker's label, or rows of another recording?".to_string()
    };
    format!(
        "{} at time {} s is at ({x}, {y}, {z}), {distance:.4} m from where it was {after:.4} s before (line \
         {}): {speed}, and {fastest}.{others} {cause}",
        labels[row.site],
        rounded(row.time),
        before.line
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(line: usize, site: usize, time: f64, place: [f64; 3]) -> Sighting {
        Sighting { line, site, time, written: place.map(Some), sigma: 1e-3 }
    }

    /// Three markers 5 cm apart that swing together at half a metre a second, at 50 Hz.
    fn recording(label: impl Fn(usize, usize) -> usize) -> Vec<Sighting> {
        let mut rows = Vec::new();
        for k in 0..50 {
            let t = 0.02 * k as f64;
            for site in 0..3 {
                let place = [0.05 * site as f64 + 0.1 * (5.0 * t).sin(), 0.0, -0.3];
                rows.push(sighting(rows.len() + 2, label(k, site), t, place));
            }
        }
        rows
    }

    #[test]
    fn labels_exchanged_for_a_while_are_found_with_both_ends() {
        let clean = recording(|_, site| site);
        let s = [0.1, 0.2, 0.3];
        assert_eq!(exchanges(&clean, &s), []);
        let swapped = recording(|k, site| match site {
            1 if (10..17).contains(&k) => 2,
            2 if (10..17).contains(&k) => 1,
            0 if k >= 30 => 1,
            1 if k >= 30 => 0,
            other => other,
        });
        let found = exchanges(&swapped, &s);
        assert_eq!((found.len(), found[0].sites, found[0].ends), (2, [1, 2], true));
        assert_eq!((found[0].rows.len(), found[1].sites, found[1].ends), (14, [0, 1], false));
        let text = explain_exchanges(&swapped, &found, &["a", "b", "c"]);
        for part in ["b and c from 0.2 s to 0.32 s (lines 33 to 52)", "a and b from 0.6 s on, to the end"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn a_marker_that_comes_back_from_a_gap_elsewhere_is_no_exchange() {
        let rows: Vec<_> = recording(|_, site| site)
            .into_iter()
            .filter(|r| !(r.site == 1 && (0.3..0.7).contains(&r.time)))
            .collect();
        assert_eq!(exchanges(&rows, &[0.1, 0.2, 0.3]), []);
    }

    #[test]
    fn a_jump_is_found_and_the_rows_after_it_are_not() {
        let fastest = Fastest { speed: 3.0, stated: true };
        let clean = recording(|_, site| site);
        assert_eq!(jumps(&clean, fastest), []);
        let mut rows = clean.clone();
        rows[31].written = [0.4, 0.5, -0.3].map(Some);
        rows[60].written = [0.0; 3].map(Some);
        let found = jumps(&rows, fastest);
        assert_eq!(found.iter().map(|j| j.row).collect::<Vec<_>>(), [31, 60]);
        let text = explain_jumps(&rows, &found, fastest, &["a", "b", "c"]);
        for part in
            ["b at time 0.2 s is at (0.4, 0.5, -0.3)", "(line 30)", "max_speed is 3 m/s", "2 of 150 rows"]
        {
            assert!(text.contains(part), "{text}");
        }
        assert!(text.contains("false detection"));
        let zero = explain_jumps(&rows, &found[1..], fastest, &["a", "b", "c"]);
        assert!(zero.contains("0,0,0?"), "{zero}");
        // A marker that was moved stays where it is from the third row on.
        let moved: Vec<_> = clean
            .iter()
            .map(|r| {
                if r.site == 0 && r.time > 0.5 {
                    sighting(r.line, 0, r.time, [5.0 + r.time, 0.0, 0.0])
                } else {
                    r.clone()
                }
            })
            .collect();
        assert_eq!(jumps(&moved, fastest).len(), 3);
    }

    #[test]
    fn the_place_of_another_marker_is_named() {
        let fastest = Fastest { speed: 2.0, stated: true };
        let mut rows = recording(|_, site| site);
        // c has the place that a goes on from; a is lost for as long.
        let lost = rows[33].clone();
        rows[35].written = lost.written;
        rows.remove(33);
        let found = jumps(&rows, fastest);
        assert_eq!((found.len(), label_of(&rows, &found[0], fastest)), (1, Some(0)));
        assert!(explain_jumps(&rows, &found, fastest, &["a", "b", "c"]).contains("where a was"));
    }
}
