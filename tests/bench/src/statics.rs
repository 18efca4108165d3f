//! A rod at rest, held at both ends: error against seconds.

use super::clock::timed;
use super::{Options, Page, Result, Table};
use crate::cells;
use problems::statics::{Catenary, Kirchhoff, Section as End, elastica};
use std::sync::Arc;
use varda::report::chart::{Corner, Panel, Series, Style};
use varda_rod::{Clamp, ClampAt, Found, Loads, Rod, Search, Section, Supports, Vector3, rest};

type V = Vector3<f64>;

/// Weight per length \[N/m\], and gravity \[m/s²\].
const WEIGHT: f64 = 0.5;
const GRAVITY: f64 = 9.81;

pub(super) fn run(options: &Options) -> Result<Page> {
    let columns = ["problem", "segments", "error / L", "ms", "ms (least)", "Newton iterations", "solves"];
    let mut table = Table::new("rest", "", &columns);
    let mut series = Vec::new();
    let meshes: &[usize] = if options.quick { &[20, 40] } else { &[20, 40, 80, 160, 320, 640] };
    for (i, problem) in [CABLE, BUCKLED, HEAVY].iter().enumerate() {
        let mut points = Vec::new();
        for &segments in meshes {
            let held = (problem.held)(segments)?;
            let found = held.rest()?;
            let error = (problem.error)(&held, &found)?;
            let timing = timed(options.samples(), || held.rest().map(drop))?;
            let (iterations, solves) = (found.iterations, found.solves);
            let [median, least] = [timing.median, timing.least].map(|t| 1e3 * t);
            table.push(cells![problem.name, segments, error, median, least, iterations, solves]);
            points.push((timing.least, error));
        }
        series.push(Series { label: problem.name.into(), style: Style::Marked(i), points });
    }
    Ok(Page {
        title: "A rod at rest: error against seconds",
        text: TEXT.into(),
        tables: vec![table],
        panels: vec![Panel {
            x_label: "seconds of one search".into(),
            y_label: "largest error of a place / L".into(),
            log_x: true,
            log_y: true,
            legend: Some(Corner::Top),
            series,
            ..Panel::default()
        }],
        remarks: String::new(),
    })
}

const TEXT: &str = "\
`varda_rod::rest` finds a rod at rest without a first guess of its shape: what a scene with \
`from = \"static-equilibrium\"` waits for. *Error*: the largest distance of a vertex from where the \
continuous rod has that arc length: the elastic catenary for the cable (1.3 m between hooks 1 m apart, \
EI = 0), the elastica for the rod without weight (clamps in line at 0.7 of its length), Kirchhoff's \
equations for the heavy one (clamps at other heights, 0.75 apart), solved by shooting. *Solves*: calls of \
Newton's method, stages of the way included.";

/// A rod with what holds it.
struct Held {
    rod: Rod,
    supports: Supports,
    loads: Loads,
}

impl Held {
    fn rest(&self) -> Result<Found> {
        Ok(rest(&self.rod, &self.supports, &self.loads, 0.0, &Search::default())?)
    }

    /// The largest distance of the vertices between the held ones from places, over the length.
    fn farthest(&self, found: &Found, places: &[V]) -> f64 {
        let inner = 1..self.rod.segments();
        let off = inner.map(|v| (found.rest.vertices[v] - places[v]).norm());
        off.fold(0.0, f64::max) / self.rod.length()
    }
}

struct Problem {
    name: &'static str,
    held: fn(usize) -> Result<Held>,
    error: fn(&Held, &Found) -> Result<f64>,
}

fn section(ea: f64, ei: f64) -> Section {
    Section { ea, ei1: ei, ei2: ei, gj: ei, mass_per_length: WEIGHT / GRAVITY }
}

fn weight() -> Loads {
    Loads { gravity: V::new(0.0, 0.0, -GRAVITY), ..Loads::default() }
}

const CABLE: Problem = Problem {
    name: "cable, two hooks",
    held: |segments| {
        let mut supports = Supports::default();
        supports.prescribed.push((0, Arc::new([0.0; 3])));
        supports.prescribed.push((segments, Arc::new([1.0, 0.0, 0.3])));
        Ok(Held { rod: Rod::uniform(1.3, segments, &section(1e4, 0.0))?, supports, loads: weight() })
    },
    error: |held, found| {
        let catenary = Catenary::between(1.3, [1.0, 0.3], WEIGHT, 1e4).ok_or("no catenary")?;
        let place = |s: f64| {
            let [x, z] = catenary.at(s);
            V::new(x, 0.0, z)
        };
        let places: Vec<V> = held.rod.arc_lengths().into_iter().map(place).collect();
        Ok(held.farthest(found, &places))
    },
};

/// Between clamps at their faces.
fn clamped(segments: usize, length: f64, ends: [[V; 2]; 2], loads: Loads) -> Result<Held> {
    let clamp = |[place, tangent]: [V; 2]| Clamp::new(ClampAt::Face, place, tangent, V::y());
    let supports = Supports { start: Some(clamp(ends[0])), end: Some(clamp(ends[1])), ..Supports::default() };
    let rod = Rod::uniform(length, segments, &section(1e5, 1e-2))?;
    Ok(Held { rod, supports, loads })
}

const BUCKLED: Problem = Problem {
    name: "rod, two clamps, no weight",
    held: |segments| clamped(segments, 1.0, [[V::zeros(), V::x()], [V::x() * 0.7, V::x()]], Loads::default()),
    error: |held, found| {
        let (places, _) = elastica(1.0, 0.7, 1e-2, true, &held.rod.arc_lengths());
        // without weight it may bend in any plane: heights are compared along the chord
        let inner = 1..held.rod.segments();
        let off = |v: usize| {
            let x = found.rest.vertices[v];
            (x.x - places[v][0]).hypot(x.y.hypot(x.z) - places[v][1].abs())
        };
        Ok(inner.map(off).fold(0.0, f64::max))
    },
};

/// Ends of the heavy rod: places and tangents.
fn heavy_ends() -> [[V; 2]; 2] {
    [[V::zeros(), V::x()], [V::new(0.75, 0.0, 0.2), V::new(0.8, 0.0, 0.6)]]
}

const HEAVY: Problem = Problem {
    name: "rod, two clamps, heavy",
    held: |segments| clamped(segments, 1.0, heavy_ends(), weight()),
    error: |held, found| {
        let ends = heavy_ends().map(|[place, tangent]| End { place, tangent, director: V::y() });
        let kirchhoff = Kirchhoff { ei: 1e-2, gj: 1e-2, ea: 1e5, weight: WEIGHT, ends };
        let (force, moment) = (found.reactions[0].force, found.reactions[0].moment);
        let near = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
        let (places, _) =
            kirchhoff.near(near, &held.rod.arc_lengths()).ok_or("no solution of Kirchhoff's equations")?;
        Ok(held.farthest(found, &places))
    },
};
