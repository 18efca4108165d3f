//! First guesses: what holds the rod, and curves of the right length between the places that are held.

use nalgebra::{Rotation3, Unit, Vector3};

use crate::Error;
use crate::clamp_frame::ClampFrame;
use crate::geometry::{any_perpendicular, perpendicular};
use crate::rod::Rod;
use crate::support::Supports;

/// Points of a curve at which its length is measured.
const SAMPLES: usize = 800;
/// Two held places nearer than this share of the arc between them are one place: a ring.
const RING: f64 = 0.02;
/// Weight × length³ over bending stiffness from which a span is guessed as a catenary.
const CABLE: f64 = 50.0;

/// What holds a rod at one time.
pub(crate) struct Held {
    pub(crate) start: Option<ClampFrame>,
    pub(crate) end: Option<ClampFrame>,
    /// Held vertices and their places, ascending; a clamp counts with its end vertex.
    pub(crate) points: Vec<(usize, Vector3<f64>)>,
}

impl Held {
    pub(crate) fn at(rod: &Rod, supports: &Supports, t: f64) -> Result<Held, Error> {
        rod.check()?;
        supports.prescribed_vertices(rod)?;
        let start = supports.start.as_ref().map(|c| c.frame(t)).transpose()?;
        let end = supports.end.as_ref().map(|c| c.frame(t)).transpose()?;
        let mut points: Vec<_> = supports.prescribed.iter().map(|(v, m)| (*v, m.at(t))).collect();
        points.extend(start.as_ref().map(|f| (0, f.position)));
        points.extend(end.as_ref().map(|f| (rod.segments(), f.position)));
        points.sort_by_key(|p| p.0);
        if points.is_empty() {
            return Err(Error::NothingHolds);
        }
        Ok(Held { start, end, points })
    }

    /// Whether at least two places are held, so that the rod spans something.
    pub(crate) fn spans(&self) -> bool {
        self.points.len() > 1
    }

    /// Unit vector along the first (or last) span; the clamp's tangent where the span is a ring.
    pub(crate) fn chord(&self, first: bool, rod: &Rod) -> Vector3<f64> {
        let n = self.points.len();
        let (a, b) =
            if first { (self.points[0], self.points[1]) } else { (self.points[n - 2], self.points[n - 1]) };
        let arc: f64 = rod.rest_lengths[a.0..b.0].iter().sum();
        let chord = b.1 - a.1;
        if chord.norm() > RING * arc {
            return chord.normalize();
        }
        let clamp = if first {
            self.start.as_ref().or(self.end.as_ref())
        } else {
            self.end.as_ref().or(self.start.as_ref())
        };
        clamp.map_or_else(|| chord.try_normalize(0.0).unwrap_or(Vector3::x()), |f| f.tangent)
    }
}

/// Where a span leaves its chord to: with gravity, else along the start's director.
pub(crate) fn sideways(held: &Held, chord: &Vector3<f64>, gravity: &Vector3<f64>) -> Vector3<f64> {
    let across = |w: &Vector3<f64>| w - chord * w.dot(chord);
    if across(gravity).norm() > 1e-3 * gravity.norm() {
        return perpendicular(gravity, chord);
    }
    for f in [&held.start, &held.end].into_iter().flatten() {
        if across(&f.director).norm() > 1e-3 {
            return perpendicular(&f.director, chord);
        }
    }
    any_perpendicular(chord)
}

/// A rod along all its held places, its clamps with these tangents: spans of the right length, free ends
/// hanging.
pub(crate) fn along(
    rod: &Rod,
    held: &Held,
    start: Option<&Vector3<f64>>,
    end: Option<&Vector3<f64>>,
    gravity: &Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let n = rod.segments();
    let s = rod.arc_lengths();
    let mut x = vec![Vector3::zeros(); n + 1];
    let mut points = held.points.clone();
    if let Some(t) = start {
        x[0] = points[0].1;
        points[0] = (1, x[0] + t * rod.rest_lengths[0]);
    }
    if let Some(t) = end {
        let last = points.len() - 1;
        x[n] = points[last].1;
        points[last] = (n - 1, x[n] - t * rod.rest_lengths[n - 1]);
    }
    for &(v, place) in &points {
        x[v] = place;
    }
    let stiffest = rod.ei.iter().fold(0.0, |m: f64, k| m.max(k[0]).max(k[2]));
    let weight = gravity.norm() * rod.masses.iter().sum::<f64>() / rod.length();
    for (i, pair) in points.windows(2).enumerate() {
        let ((a, p), (b, q)) = (pair[0], pair[1]);
        let arc: Vec<f64> = s[a..=b].iter().map(|v| v - s[a]).collect();
        let length = s[b] - s[a];
        let clamped = [i == 0 && start.is_some(), i + 2 == points.len() && end.is_some()];
        let chord = if i == 0 || i + 2 == points.len() {
            held.chord(i == 0, rod)
        } else {
            (q - p).try_normalize(1e-12 * length).unwrap_or(Vector3::x())
        };
        let curve = if (q - p).norm() >= length * (1.0 - 1e-9) {
            arc.iter().map(|v| p + (q - p) * (v / length)).collect()
        } else if weight * length.powi(3) > CABLE * stiffest {
            catenary(&p, &q, &arc, gravity)
        } else {
            bow(&p, &q, &arc, &chord, &sideways(held, &chord, gravity), clamped)
        };
        x[a + 1..b].copy_from_slice(&curve[1..b - a]);
    }
    hang_ends(rod, held, &points, gravity, &mut x);
    x
}

/// Free ends beyond the first and last held vertices hang, a little outwards.
fn hang_ends(
    rod: &Rod,
    held: &Held,
    points: &[(usize, Vector3<f64>)],
    gravity: &Vector3<f64>,
    x: &mut [Vector3<f64>],
) {
    let (n, s) = (rod.segments(), rod.arc_lengths());
    let (first, last) = (points[0], points[points.len() - 1]);
    let mut out = if held.spans() { held.chord(false, rod) } else { Vector3::zeros() };
    let down = gravity.try_normalize(0.0).unwrap_or_default();
    if out == Vector3::zeros() {
        out = if down == out { -Vector3::z() } else { any_perpendicular(&down) };
    }
    // a rod held at its very end hangs straight; held inside, its halves must not lie on each other
    let tilt =
        if !held.spans() && (first.0 == 0 || last.0 == n) && down != Vector3::zeros() { 0.0 } else { 0.3 };
    let ahead = (down + out * tilt).normalize();
    let back = if held.spans() { -held.chord(true, rod) } else { -out };
    let back = (down + back * tilt).normalize();
    if last.0 < n && held.end.is_none() {
        for v in last.0 + 1..=n {
            x[v] = last.1 + ahead * (s[v] - s[last.0]);
        }
    }
    if first.0 > 0 && held.start.is_none() {
        for v in 0..first.0 {
            x[v] = first.1 + back * (s[first.0] - s[v]);
        }
    }
}

/// The inextensible catenary from p to q, at these arc lengths; a vertical one is opened a little.
fn catenary(p: &Vector3<f64>, q: &Vector3<f64>, arc: &[f64], gravity: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let length = arc[arc.len() - 1];
    let up = -gravity.normalize();
    let rise = (q - p).dot(&up);
    let flat = (q - p) - up * rise;
    let true_width = flat.norm();
    let across = flat.try_normalize(1e-9 * length).unwrap_or_else(|| any_perpendicular(&up));
    let slack = (length * length - rise * rise).sqrt();
    let width = true_width.max((0.02 * length).min(0.5 * slack));
    // sinh z / z = slack/width, monotone
    let ratio = slack / width;
    let (mut low, mut high) = (1e-6, 2.0 * (1.0 + ratio.ln()) + 4.0);
    for _ in 0..80 {
        let z: f64 = 0.5 * (low + high);
        if z.sinh() / z < ratio { low = z } else { high = z }
    }
    let a = width / (low + high);
    let x0 = 0.5 * width - a * (rise / length).atanh();
    arc.iter()
        .map(|v| {
            let x = x0 + a * (v / a - (x0 / a).sinh()).asinh();
            let y = a * (((x - x0) / a).cosh() - (x0 / a).cosh());
            p + across * (x - (width - true_width) * v / length) + up * y
        })
        .collect()
}

/// A bow from p to q of the right length, tangent to the chord at clamped ends; a circle where the ends meet.
fn bow(
    p: &Vector3<f64>,
    q: &Vector3<f64>,
    arc: &[f64],
    chord: &Vector3<f64>,
    side: &Vector3<f64>,
    clamped: [bool; 2],
) -> Vec<Vector3<f64>> {
    use std::f64::consts::{PI, TAU};
    let length = arc[arc.len() - 1];
    let slack = 1.0 - (q - p).norm() / length;
    let ring = 1.0 - slack < RING && clamped == [true, true];
    let place = |height: f64, u: f64| {
        let (sin, turn) = ((PI * u).sin(), (TAU * u).sin());
        let rise = match clamped {
            [true, true] => sin * sin,
            [false, false] => sin,
            [true, false] => 6.75 * u * u * (1.0 - u),
            [false, true] => 6.75 * u * (1.0 - u) * (1.0 - u),
        };
        let bulge = if ring {
            0.5 * turn
        } else if clamped == [false, false] {
            -0.3 * slack * slack * turn
        } else {
            -0.5 * slack * slack * turn * sin * sin
        };
        p + (q - p) * u + side * (height * rise) + chord * (height * bulge)
    };
    let points = |height: f64| -> Vec<Vector3<f64>> {
        (0..=SAMPLES).map(|i| place(height, i as f64 / SAMPLES as f64)).collect()
    };
    let (mut low, mut high) = (0.0, length);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if polyline_length(&points(middle)) < length { low = middle } else { high = middle }
    }
    resample(&points(high), arc)
}

fn polyline_length(points: &[Vector3<f64>]) -> f64 {
    points.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
}

/// Points of a polyline at the given arc lengths, its own length scaled to the last of them.
pub(crate) fn resample(points: &[Vector3<f64>], arc: &[f64]) -> Vec<Vector3<f64>> {
    let scale = polyline_length(points) / arc[arc.len() - 1];
    let (mut i, mut before) = (0, 0.0);
    arc.iter()
        .map(|v| {
            let wanted = v * scale;
            let mut step = (points[i + 1] - points[i]).norm();
            while before + step < wanted && i + 2 < points.len() {
                before += step;
                i += 1;
                step = (points[i + 1] - points[i]).norm();
            }
            points[i]
                + (points[i + 1] - points[i])
                    * ((wanted - before) / step.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
        })
        .collect()
}

/// The rod in its rest shape from a first edge and its director, with its Bishop angles: no energy at all.
pub(crate) fn rest_shape(
    rod: &Rod,
    place: Vector3<f64>,
    tangent: Vector3<f64>,
    director: Vector3<f64>,
) -> (Vec<Vector3<f64>>, Vec<f64>) {
    let n = rod.segments();
    let (mut x, mut theta) = (vec![place; n + 1], vec![0.0; n]);
    let (mut t, mut m1) = (tangent, perpendicular(&director, &tangent));
    for e in 0..n {
        x[e + 1] = x[e] + t * rod.rest_lengths[e];
        let Some([k1, k2]) = rod.natural_curvature.get(e).copied() else { break };
        let twist = rod.natural_twist[e];
        // κ₁, κ₂ are means over both directors: (cos τ/2) times a turn by τ/2 of the binormal seen
        // from the first
        let (sin, cos) = (0.5 * twist).sin_cos();
        let (c, s) = if cos.abs() > 1e-6 {
            ((-k2 * cos - k1 * sin) / cos, (k1 * cos - k2 * sin) / cos)
        } else {
            (0.0, 0.0)
        };
        let m2 = t.cross(&m1);
        let kb = m1 * c + m2 * s;
        let turn = Unit::try_new(kb, 0.0).map_or(Rotation3::identity(), |axis| {
            Rotation3::from_axis_angle(&axis, 2.0 * (0.5 * kb.norm()).atan())
        });
        t = (turn * t).normalize();
        m1 = Rotation3::from_axis_angle(&Unit::new_unchecked(t), twist) * (turn * m1);
        m1 = perpendicular(&m1, &t);
        theta[e + 1] = theta[e] + twist;
    }
    (x, theta)
}
