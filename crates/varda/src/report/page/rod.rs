//! What a page shows of a rod that moves: its runs, ±2σ, what was seen, and quantities along it as colours.

use serde::Serialize;

use crate::outcome::{CyclesOutcome, Outcome, Shapes, Sight, Trajectories};
use crate::scene::TimeGrid;
use crate::state::Geometry;

/// Most coordinates of all runs in a page; of more, only some vertices and instants are shown.
const MOST_NUMBERS: usize = 180_000;
/// Most instants, and vertices of one shape.
const MOST_FRAMES: usize = 300;
const MOST_VERTICES: usize = 160;

/// A rod through time. Shapes are vertex after vertex, one instant after the other.
#[derive(Serialize)]
pub(in crate::report) struct RodView {
    /// Instants shown \[s\].
    times: Vec<f64>,
    /// The end of the window; after it the run is a forecast \[s\].
    window_end: f64,
    /// Of the vertices shown \[m\].
    arc_lengths: Vec<f64>,
    runs: Vec<Run>,
    /// σ of the coordinates of the analysis \[m\], as the shapes; empty where it is not known.
    sigma: Packed,
    /// Quantities of the analysis at every vertex and instant.
    colours: Vec<Colour>,
    seen: Vec<Seen>,
}

#[derive(Serialize)]
struct Run {
    name: &'static str,
    shapes: Packed,
}

#[derive(Serialize)]
struct Colour {
    name: &'static str,
    unit: &'static str,
    values: Packed,
}

/// Markers seen near an instant \[m\].
#[derive(Serialize)]
struct Seen {
    frame: usize,
    kept_back: bool,
    place: [f32; 3],
}

/// Numbers as whole multiples of a step: short in a page.
#[derive(Default, Serialize)]
struct Packed {
    step: f64,
    values: Vec<i64>,
}

impl Packed {
    /// With 1e-5 of the largest as the step; numbers that are not known become 0.
    fn new(values: &[f64]) -> Self {
        let largest = values.iter().filter(|v| v.is_finite()).fold(0.0_f64, |m, v| m.max(v.abs()));
        let step = if largest > 0.0 { format!("{:.1e}", 1e-5 * largest).parse().unwrap_or(1.0) } else { 1.0 };
        let whole = |v: &f64| if v.is_finite() { (v / step).round() as i64 } else { 0 };
        Packed { step, values: values.iter().map(whole).collect() }
    }
}

impl RodView {
    /// The runs of a window, with σ and forces of the analysis.
    pub(in crate::report) fn of_outcome(outcome: &Outcome) -> Option<RodView> {
        let (shapes, geometry) = (outcome.shapes.as_ref()?, outcome.experiment.state.geometry.as_ref()?);
        let shown = Shown::of(shapes, geometry)?;
        let mut view = RodView::new(shapes, geometry, &outcome.experiment.grid, shown);
        view.add_sigma(geometry, &outcome.trajectories, &outcome.sigma_states, shown);
        view.add_forces(shapes, geometry, shown);
        Some(view)
    }

    /// The runs of a sequence of windows, with σ of the analysis.
    pub(in crate::report) fn of_cycles(outcome: &CyclesOutcome) -> Option<RodView> {
        let (shapes, geometry) = (outcome.shapes.as_ref()?, outcome.experiment.state.geometry.as_ref()?);
        let shown = Shown::of(shapes, geometry)?;
        let mut view = RodView::new(shapes, geometry, &outcome.experiment.grid, shown);
        view.add_sigma(geometry, &outcome.trajectories, &outcome.sigma_states, shown);
        Some(view)
    }

    fn new(shapes: &Shapes, geometry: &Geometry, grid: &TimeGrid, shown: Shown) -> RodView {
        let Shown { vertices, instants } = shown;
        let all = runs(shapes);
        let runs = all.iter().map(|(name, run)| {
            let shown = instants.all().flat_map(|k| run.get(k.min(run.len() - 1)));
            let places = shown.flat_map(|shape| vertices.all().flat_map(|v| shape[v]));
            Run { name, shapes: Packed::new(&places.collect::<Vec<f64>>()) }
        });
        let frame = |s: &Sight| {
            let at = instants.nearest(s.at());
            let near = (instants.index(at) as f64 - s.at()).abs() <= 0.5 * instants.stride().max(1.0);
            near.then_some(Seen { frame: at, kept_back: s.withheld, place: s.position.map(|c| c as f32) })
        };
        RodView {
            times: instants.all().map(|k| grid.time(k)).collect(),
            window_end: grid.time(grid.steps),
            arc_lengths: vertices.all().map(|v| geometry.arc_lengths[v]).collect(),
            runs: runs.collect(),
            sigma: Packed::default(),
            colours: Vec::new(),
            seen: shapes.seen.iter().filter_map(frame).collect(),
        }
    }

    /// Adds σ of the analysis; 0 where it is not known.
    fn add_sigma(&mut self, geometry: &Geometry, runs: &Trajectories, sigma_states: &[f64], shown: Shown) {
        if sigma_states.is_empty() {
            return;
        }
        let Shown { vertices, instants } = shown;
        let mut sigma = Vec::new();
        for k in instants.all() {
            let of_step = runs.state(sigma_states, k);
            for v in vertices.all() {
                let free = geometry.free.binary_search(&v).ok();
                for c in 0..3 {
                    sigma.push(of_step.zip(free).map_or(0.0, |(s, free)| s[3 * free + c]));
                }
            }
        }
        let size = |s: &[f64]| 1e3 * (s.iter().map(|x| x * x).sum::<f64>() / 3.0).sqrt();
        let sizes: Vec<f64> = sigma.chunks_exact(3).map(size).collect();
        self.colours.push(Colour { name: "σ of place", unit: "mm", values: Packed::new(&sizes) });
        self.sigma = Packed::new(&sigma);
    }

    /// Adds tension and bending moment of the analysis.
    fn add_forces(&mut self, shapes: &Shapes, geometry: &Geometry, shown: Shown) {
        let Shown { vertices, instants } = shown;
        let n = geometry.arc_lengths.len();
        if shapes.forces.is_empty() {
            return;
        }
        // Forces are those over the step that ends at k: the first instant shows those of the first step.
        let at = |k: usize| &shapes.forces[k.saturating_sub(1).min(shapes.forces.len() - 1)];
        let tension = |k: usize, v: usize| {
            let of_edges = &at(k).tension;
            let [before, after] = [v.saturating_sub(1), v.min(n - 2)].map(|e| of_edges.get(e).copied());
            before.zip(after).map_or(f64::NAN, |(a, b)| 0.5 * (a + b))
        };
        let moment = |k: usize, v: usize| {
            let bent = (v > 0).then(|| at(k).bending.get(v - 1)).flatten();
            bent.map_or(0.0, |m| m[0].hypot(m[1]))
        };
        let mut add = |name, unit, of: &dyn Fn(usize, usize) -> f64| {
            let values: Vec<f64> = instants
                .all()
                .flat_map(|k| vertices.all().map(move |v| (k, v)))
                .map(|(k, v)| of(k, v))
                .collect();
            self.colours.push(Colour { name, unit, values: Packed::new(&values) });
        };
        add("tension", "N", &tension);
        if shapes.forces.iter().any(|f| !f.bending.is_empty()) {
            add("bending moment", "N m", &moment);
        }
    }
}

/// The runs that exist, with their names.
fn runs(shapes: &Shapes) -> Vec<(&'static str, &Vec<Vec<[f64; 3]>>)> {
    let all = [("truth", &shapes.truth), ("background", &shapes.background), ("analysis", &shapes.analysis)];
    all.into_iter().filter(|(_, run)| !run.is_empty()).collect()
}

/// The vertices and instants that a page shows.
#[derive(Clone, Copy)]
struct Shown {
    vertices: Every,
    instants: Every,
}

impl Shown {
    /// `None` without a run.
    fn of(shapes: &Shapes, geometry: &Geometry) -> Option<Shown> {
        let all = runs(shapes);
        let last = all.iter().map(|(_, run)| run.len()).max()?;
        let vertices = Every::of(geometry.arc_lengths.len(), MOST_VERTICES);
        let frames = MOST_FRAMES.min(MOST_NUMBERS / (3 * vertices.count() * all.len()));
        Some(Shown { vertices, instants: Every::of(last, frames.max(2)) })
    }
}

/// At most so many of n things, evenly, with the first and the last.
#[derive(Clone, Copy)]
struct Every {
    n: usize,
    shown: usize,
}

impl Every {
    fn of(n: usize, most: usize) -> Self {
        Every { n, shown: n.min(most) }
    }

    fn count(self) -> usize {
        self.shown
    }

    /// Which of the n is shown in place i.
    fn index(self, i: usize) -> usize {
        if self.shown < 2 { 0 } else { (i * (self.n - 1) + (self.shown - 1) / 2) / (self.shown - 1) }
    }

    /// The mean distance of those shown.
    fn stride(self) -> f64 {
        (self.n.max(2) - 1) as f64 / (self.shown.max(2) - 1) as f64
    }

    /// The place in which the one nearest to this is shown.
    fn nearest(self, at: f64) -> usize {
        ((at / self.stride()).round().max(0.0) as usize).min(self.shown.max(1) - 1)
    }

    fn all(self) -> impl Iterator<Item = usize> {
        (0..self.shown).map(move |i| self.index(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_is_even_and_has_both_ends() {
        assert_eq!(Every::of(5, 10).all().collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        assert_eq!(Every::of(11, 6).all().collect::<Vec<_>>(), [0, 2, 4, 6, 8, 10]);
        assert_eq!(Every::of(1, 6).all().collect::<Vec<_>>(), [0]);
        assert_eq!(Every::of(11, 6).nearest(7.4), 4);
    }

    #[test]
    fn packed_numbers_are_within_half_a_step() {
        let values = [0.123_456, -0.7, 0.0, f64::NAN];
        let packed = Packed::new(&values);
        for (v, p) in values.iter().zip(&packed.values).take(3) {
            assert!((v - *p as f64 * packed.step).abs() <= 0.5 * packed.step);
        }
        assert_eq!(packed.values[3], 0);
        assert!(packed.step <= 1e-5);
    }
}
