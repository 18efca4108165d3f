//! What the uncertainty of a result comes from: sensitivities of some numbers of the run to observed values
//! and priors, from the posterior carried along it.
//!
//! With P_a = W Wᵀ, H the rows of an observed value y and E that of a number s of the run,
//!
//! ```text
//!     ∂s/∂y = E W (H W)ᵀ/σ²,    ∂s/∂p_b = E W (W_p)ᵀ/σ_p²
//!     ∂s/∂ln σ = −2 (y − h(x_a)) ∂s/∂y,  of all values and priors that have this σ
//!     Var s = Σ (∂s/∂y σ)² + Σ (∂s/∂p_b σ_p)² + what is left: the background of the state
//! ```
//!
//! (P_a = K R Kᵀ + (I − K H) B (I − K H)ᵀ), for independent errors. Of one of several
//! recordings what is left is also what the others leave open. With the exact Hessian the derivatives are
//! exact, and what is left is also what second derivatives do to P_a.

use varda_assimilation::sensitivity;

use crate::outcome::{Rejected, Sensitivity, SourceShare, Sources};
use crate::scene::{Hessian, TimeGrid};
use crate::setup::Problem;
use crate::setup::memory::{FURTHER_COLUMNS, SOURCE_NUMBERS};
use crate::state::StateLayout;

/// What is gathered on the way.
pub(super) struct SourcesOfSpread<'a> {
    problem: &'a Problem,
    rejected: &'a [Rejected],
    columns: usize,
    /// What the rest of a variance comes from.
    rest: &'static str,
    /// Values that were assimilated.
    rows: Vec<Row>,
    /// What is asked of, with its unit, and E W.
    numbers: Vec<(String, &'static str, Vec<f64>)>,
}

/// A value that was assimilated.
struct Row {
    /// Its place among what was seen, and its component.
    seen: (usize, usize),
    sigma: f64,
    /// y − h(x_a).
    departure: f64,
    /// H W.
    of_columns: Vec<f64>,
}

impl<'a> SourcesOfSpread<'a> {
    /// For a root of so many columns; `None` where it is too large, or its P_a is not that of the observed
    /// values with their σ: correlated errors, Huber's norm.
    pub(super) fn new(
        problem: &'a Problem,
        rejected: &'a [Rejected],
        columns: usize,
        is_one_of_several: bool,
    ) -> Option<Self> {
        let scene = &problem.experiment.scene;
        let simple = scene.observations.correlation().is_none()
            && scene.algorithm.robust.is_none()
            && scene.algorithm.method.is_strong();
        let values = problem.observed.sizes(&problem.experiment.grid)[0];
        let fits = columns <= FURTHER_COLUMNS && values.saturating_mul(columns) <= SOURCE_NUMBERS;
        let rows = Vec::new();
        let is_exact = scene.algorithm.hessian == Hessian::Exact;
        let rest = match (is_one_of_several, is_exact) {
            (true, false) => "background of the state, other recordings",
            (true, true) => "background of the state, other recordings, second derivatives",
            (false, false) => "background of the state",
            (false, true) => "background of the state, second derivatives",
        };
        let numbers = Vec::new();
        (simple && fits && values > 0).then_some(Self { problem, rejected, columns, rest, rows, numbers })
    }

    /// A row H W of component c of what was seen, and h(x_a).
    pub(super) fn see(&mut self, seen: usize, c: usize, analysis: f64, row: impl Iterator<Item = f64>) {
        let observed = &self.problem.observed;
        let one = &observed.seen[seen];
        let label = &observed.sites[one.site].label;
        let refused = self.rejected.iter().any(|r| r.label == *label && r.step == one.step);
        let used = observed.is_assimilated(one, &self.problem.experiment.grid) && !refused;
        if let Some(value) = one.values.get(c).copied().flatten().filter(|_| used) {
            let departure = value - analysis;
            let (sigma, of_columns) = (one.sigma, row.collect());
            self.rows.push(Row { seen: (seen, c), sigma, departure, of_columns });
        }
    }

    /// The end of the window: the place, or the component, that is known least, of states of n numbers.
    pub(super) fn end(&mut self, n: usize, w: &[f64]) {
        let (layout, grid) = (&self.problem.experiment.state, self.problem.experiment.grid);
        let square = |i: usize| w.chunks_exact(n).map(|column| column[i].powi(2)).sum::<f64>();
        for (i, name, unit) in least_known(layout, &grid, square) {
            self.add(name, unit, w.chunks_exact(n).map(|column| column[i]).collect());
        }
    }

    /// One more number of the run.
    pub(super) fn add(&mut self, name: String, unit: &'static str, row: Vec<f64>) {
        if row.len() == self.columns && row.iter().any(|e| *e != 0.0) {
            self.numbers.push((name, unit, row));
        }
    }

    /// The shares, with the control of the analysis and the root of its P_a.
    pub(super) fn answer(self, control: &[f64], root: &[f64]) -> (Vec<Sources>, Vec<Sensitivity>) {
        let length = control.len();
        let Self { problem, rest: of_rest, rows, numbers, .. } = self;
        let (observed, grid) = (&problem.observed, problem.experiment.grid);
        let constants = &problem.system.estimates().constants;
        let mut sensitivities: Vec<Sensitivity> = rows
            .iter()
            .map(|row| {
                let (seen, c) = row.seen;
                let one = &observed.seen[seen];
                Sensitivity {
                    time: grid.start + one.at() * grid.step,
                    label: observed.sites[one.site].label.clone(),
                    axis: observed.sites[one.site].quantity.axes()[c],
                    by_value: Vec::new(),
                }
            })
            .collect();
        let mut sources = Vec::new();
        for (of, unit, scalar) in numbers {
            let variance = scalar.iter().map(|e| e * e).sum::<f64>();
            let mut shares: Vec<SourceShare> = Vec::new();
            // a value, or the prior of a constant
            let mut add = |source: &str, by_value: f64, sigma: f64, departure: f64| {
                let share = (by_value * sigma).powi(2) / variance;
                let by_relative_sigma = -2.0 * departure * by_value;
                match shares.iter_mut().find(|s| s.source == source) {
                    Some(known) => {
                        known.share += share;
                        known.by_relative_sigma += by_relative_sigma;
                    }
                    None => {
                        shares.push(SourceShare { source: source.to_string(), share, by_relative_sigma });
                    }
                }
            };
            for (row, sensitivity_of) in rows.iter().zip(&mut sensitivities) {
                let by_value = sensitivity(&scalar, &row.of_columns, row.sigma);
                sensitivity_of.by_value.push(by_value);
                add(&sensitivity_of.label, by_value, row.sigma, row.departure);
            }
            for (j, constant) in constants.iter().enumerate() {
                let at = length - constants.len() + j;
                let row: Vec<f64> = root.chunks_exact(length).map(|column| column[at]).collect();
                let by_prior = sensitivity(&scalar, &row, constant.sigma);
                let name = constant.name.split("(s = ").next().unwrap_or_default();
                let name = name.split("(t = ").next().unwrap_or_default();
                let departure = problem.background[at] - control[at];
                add(&format!("prior of {name}"), by_prior, constant.sigma, departure);
            }
            let rest = 1.0 - shares.iter().map(|s| s.share).sum::<f64>();
            let by_rest = -shares.iter().map(|s| s.by_relative_sigma).sum::<f64>();
            let source = of_rest.into();
            shares.push(SourceShare { source, share: rest, by_relative_sigma: by_rest });
            sources.push(Sources { of, unit, sigma: variance.sqrt(), shares });
        }
        (sources, sensitivities)
    }
}

/// Components of the place, or the component, with the largest variance at the end of the window: place
/// in the state, name and unit.
pub(super) fn least_known(
    layout: &StateLayout,
    grid: &TimeGrid,
    variance: impl Fn(usize) -> f64,
) -> Vec<(usize, String, &'static str)> {
    let Some(group) = layout.groups.first() else { return Vec::new() };
    let first = |v: usize| group.range.start + v * group.width;
    let of_vector = |v: usize| (first(v)..first(v) + group.width).map(&variance).sum::<f64>();
    let vectors = 0..group.range.len() / group.width;
    let Some(least) = vectors.max_by(|a, b| of_vector(*a).total_cmp(&of_vector(*b))) else {
        return Vec::new();
    };
    let t = grid.time(grid.steps);
    let when = if grid.last_step() > 0 { format!(", t = {t:.4} s") } else { String::new() };
    let named = |c: usize| {
        let i = first(least) + c;
        let name = match &layout.geometry {
            Some(geometry) => {
                format!("{} at s = {:.4} m{when}", ["x", "y", "z"][c % 3], geometry.place(group, least))
            }
            None => format!("{}{when}", layout.names[i]),
        };
        (i, name, group.unit)
    };
    (0..group.width).map(named).collect()
}
