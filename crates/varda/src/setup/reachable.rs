//! Rows of a recording that no shape of the rod can reach, and why that may be.

use std::collections::BTreeMap;
use std::sync::Arc;

use varda_rod::{Matrix3, Motion, Vector3};

use super::rod_model::RodParts;
use crate::scene::rounded;

/// A row of a recording, in the recording's axes.
#[derive(Debug, Clone)]
pub(super) struct Sighting {
    /// Line of the file.
    pub(super) line: usize,
    /// Index of the site.
    pub(super) site: usize,
    /// Model time \[s\].
    pub(super) time: f64,
    /// Coordinates as written \[m\].
    pub(super) written: [Option<f64>; 3],
    /// Standard deviation of a coordinate \[m\].
    pub(super) sigma: f64,
}

/// Where a site is on the rod: its arc length, and its distance from the centreline \[m\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) arc_length: f64,
    pub(super) offset: f64,
}

/// A row that cannot be true.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unreachable {
    /// Index of the row among those that were judged.
    pub(super) row: usize,
    by: Beyond,
}

/// How a place is beyond reach.
#[derive(Debug, Clone, PartialEq)]
struct Beyond {
    /// How far it is from a held point of the rod \[m\].
    distance: f64,
    /// How far it can be \[m\].
    reach: f64,
    /// Arc length of that point \[m\].
    held: f64,
}

/// Two neighbours along the rod, at the time at which they were seen farthest apart.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chord {
    pub(super) sites: [usize; 2],
    pub(super) arc: f64,
    pub(super) farthest: f64,
    pub(super) allowed: f64,
}

/// How far the points of a rod can be from where it is held.
pub(super) struct Held {
    /// Arc lengths of the held points and where they are.
    points: Vec<(f64, Arc<dyn Motion>)>,
    /// From the model's axes to the recording's.
    axes: Matrix3<f64>,
    /// In the recording's axes, what is added to a written place before it is compared.
    shift: Vector3<f64>,
    sites: Vec<Reach>,
    /// 1 + ε, ε the strain of the taut rod.
    stretch: f64,
    /// Standard deviations that a row may be beyond.
    sigmas: f64,
}

/// Standard deviations that a row may be beyond the rod's reach: 4 for one row, and as improbable that one of
/// n is beyond it, since exp(−z²/2) falls by n.
fn sigmas(rows: usize) -> f64 {
    (16.0 + 2.0 * (rows.max(1) as f64).ln()).sqrt()
}

/// The share of rows that an explanation has to explain, of those that are beyond reach.
const MOST: f64 = 0.9;
/// So many rows of one marker and of no other are not false detections.
const MANY_OF_ONE: usize = 5;

impl Held {
    /// `rows` are to be looked at.
    pub(super) fn new(
        parts: &RodParts,
        axes: Matrix3<f64>,
        shift: [f64; 3],
        sites: Vec<Reach>,
        rows: usize,
    ) -> Self {
        let (supports, s) = (&parts.supports, parts.rod.arc_lengths());
        let mut points: Vec<(f64, Arc<dyn Motion>)> =
            supports.prescribed.iter().map(|(vertex, place)| (s[*vertex], Arc::clone(place))).collect();
        points.extend(supports.start.iter().map(|clamp| (0.0, Arc::clone(&clamp.position))));
        points.extend(supports.end.iter().map(|clamp| (parts.rod.length(), Arc::clone(&clamp.position))));
        let stretch = 1.0 + weight_strain(parts);
        Held { points, axes, shift: shift.into(), sites, stretch, sigmas: sigmas(rows) }
    }

    /// The rows that are beyond reach: farther from a held point than the rod between, with the strain of the
    /// taut rod and 4 σ, more where there are many rows.
    pub(super) fn unreachable(&self, rows: &[Sighting]) -> Vec<Unreachable> {
        let beyond = |(i, row): (usize, &Sighting)| {
            self.beyond(row, row.site, &|p| p).map(|by| Unreachable { row: i, by })
        };
        rows.iter().enumerate().filter_map(beyond).collect()
    }

    /// Whether a row, its written place changed, is beyond the reach of a site. Coordinates that were not
    /// seen only bring it nearer.
    fn beyond(
        &self,
        row: &Sighting,
        site: usize,
        change: &dyn Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Option<Beyond> {
        let written = Vector3::from(row.written.map(|v| v.unwrap_or(f64::NAN)));
        let place = change(written) + self.shift;
        let Reach { arc_length, offset } = self.sites[site];
        let stretch = self.stretch.max(self.taut(row.time));
        self.points.iter().find_map(|(held, motion)| {
            let away = place - self.axes * motion.at(row.time);
            let distance = away.iter().filter(|v| v.is_finite()).map(|v| v * v).sum::<f64>().sqrt();
            let between = (arc_length - held).abs();
            let reach = between * stretch + offset + self.sigmas * row.sigma + 1e-9 * between;
            // Places that overflow are for the model to refuse.
            (distance > reach && distance.is_finite()).then_some(Beyond { distance, reach, held: *held })
        })
    }

    /// The distances of neighbours along the rod, of the times at which both were seen whole.
    pub(super) fn chords(&self, rows: &[Sighting]) -> Vec<Chord> {
        let mut order: Vec<usize> = (0..self.sites.len()).collect();
        order.sort_by(|a, b| self.sites[*a].arc_length.total_cmp(&self.sites[*b].arc_length));
        let place = |row: &Sighting| {
            let whole = row.written.iter().all(Option::is_some);
            whole.then(|| Vector3::from(row.written.map(|v| v.unwrap_or(f64::NAN))))
        };
        let of_site = |site: usize| -> BTreeMap<u64, (&Sighting, Vector3<f64>)> {
            let own = rows.iter().filter(|row| row.site == site);
            own.filter_map(|row| Some((row.time.to_bits(), (row, place(row)?)))).collect()
        };
        let mut chords = Vec::new();
        for pair in order.windows(2) {
            let [a, b] = [of_site(pair[0]), of_site(pair[1])];
            let [start, end] = [self.sites[pair[0]], self.sites[pair[1]]];
            let arc = end.arc_length - start.arc_length;
            let chord = |(time, (row, p)): (&u64, &(&Sighting, Vector3<f64>))| {
                let (other, q) = b.get(time)?;
                let stretch = self.stretch.max(self.taut(row.time));
                let sigma = row.sigma.hypot(other.sigma);
                let allowed = arc * stretch + start.offset + end.offset + self.sigmas * sigma;
                Some(Chord { sites: [pair[0], pair[1]], arc, farthest: (p - q).norm(), allowed })
            };
            let beyond = |c: &Chord| c.farthest - c.allowed;
            chords.extend(a.iter().filter_map(chord).max_by(|a, b| beyond(a).total_cmp(&beyond(b))));
        }
        chords
    }

    /// How much longer than at rest the rod is where its supports pull it taut.
    fn taut(&self, time: f64) -> f64 {
        let mut stretch = 1.0_f64;
        for (i, (s, a)) in self.points.iter().enumerate() {
            for (r, b) in &self.points[..i] {
                if s != r {
                    stretch = stretch.max((a.at(time) - b.at(time)).norm() / (s - r).abs());
                }
            }
        }
        stretch
    }

    /// What is wrong with the first of the rows found, and the likely cause.
    pub(super) fn explain(&self, rows: &[Sighting], found: &[Unreachable], labels: &[&str]) -> String {
        let Unreachable { row, by: Beyond { distance, reach, held } } = &found[0];
        let row = &rows[*row];
        let others = match found.len() {
            1 => String::new(),
            n => format!(" {n} of {} rows are beyond reach.", rows.len()),
        };
        format!(
            "{} at time {} s is {distance:.4} m from where the rod is held at s = {held:.4} m, and the rod \
             reaches {reach:.4} m with its strain and {:.1} σ.{others} {}",
            labels[row.site],
            rounded(row.time),
            self.sigmas,
            self.cause(rows, found, row, labels)
        )
    }

    fn cause(&self, rows: &[Sighting], found: &[Unreachable], row: &Sighting, labels: &[&str]) -> String {
        if row.written.iter().flatten().all(|v| *v == 0.0) {
            return "A lost marker that was exported as 0,0,0? Leave its cells empty.".into();
        }
        let whole: Vec<&Sighting> = found
            .iter()
            .map(|f| &rows[f.row])
            .filter(|row| row.written.iter().all(Option::is_some))
            .collect();
        let explains = |change: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
            let cured = whole.iter().filter(|row| self.beyond(row, row.site, change).is_none());
            !whole.is_empty() && cured.count() as f64 >= MOST * whole.len() as f64
        };
        let many = found.len() as f64 >= 0.5 * rows.len() as f64;
        if many {
            for (factor, unit, suffix) in [(1e-3, "millimetres", "mm"), (1e-2, "centimetres", "cm")] {
                if explains(&|p| p * factor) {
                    return format!("Written in {unit}? Name the columns x_{suffix},y_{suffix},z_{suffix}.");
                }
            }
            for (axes, name) in axes_of_others() {
                if explains(&|p| axes * p) {
                    return format!(
                        "Other axes? With {name}, say, the rows are within reach: observations.frame."
                    );
                }
            }
        }
        let exchanged = |other: &&Sighting| {
            let same_time = other.time == row.time && other.site != row.site;
            same_time
                && self.beyond(row, other.site, &|p| p).is_none()
                && self.beyond(other, row.site, &|p| p).is_none()
        };
        match rows.iter().find(exchanged) {
            Some(other) => format!(
                "The labels of {} and {} exchanged? (lines {} and {})",
                labels[row.site], labels[other.site], row.line, other.line
            ),
            None if many => "Another unit, other axes or another origin (observations.frame)?".into(),
            None if found.len() >= MANY_OF_ONE && found.iter().all(|f| rows[f.row].site == row.site) => {
                "All are of this marker: is it farther along the rod than its arc length says, or is the rod \
                 held elsewhere?"
                    .into()
            }
            None => "A false detection, or another marker's label?".into(),
        }
    }
}

/// The right-handed axes that a program may have, by the turn that brings them to those of the model; those
/// with y upwards first.
fn axes_of_others() -> Vec<(Matrix3<f64>, String)> {
    let mut all = Vec::new();
    let name = |row: [f64; 3]| {
        let at = row.iter().position(|v| *v != 0.0).unwrap_or(0);
        format!("{}{}", if row[at] < 0.0 { "−" } else { "" }, ["x", "y", "z"][at])
    };
    for order in [[0, 2, 1], [2, 0, 1], [0, 1, 2], [1, 2, 0], [2, 1, 0], [1, 0, 2]] {
        for signs in [2, 0, 1, 3, 4, 5, 6, 7_u8] {
            let row = |i: usize| {
                let mut row = [0.0; 3];
                row[order[i]] = if signs >> i & 1 == 1 { -1.0 } else { 1.0 };
                row
            };
            let rows = [row(0), row(1), row(2)];
            let turn = Matrix3::from_fn(|i, j| rows[i][j]);
            if turn.determinant() > 0.0 && turn != Matrix3::identity() {
                let [x, y, z] = rows.map(name);
                all.push((turn, format!("(x, y, z) = ({x}, {y}, {z}) of the file")));
            }
        }
    }
    all
}

/// Twice the strain of all weights and forces hung from one end: a load that is put on suddenly stretches
/// twice as far as it does at rest.
fn weight_strain(parts: &RodParts) -> f64 {
    let (rod, loads) = (&parts.rod, &parts.loads);
    let softest = rod.ea.iter().copied().fold(f64::INFINITY, f64::min);
    2.0 * (rod.masses.iter().sum::<f64>() * loads.gravity.norm() + parts.pull) / softest
}
