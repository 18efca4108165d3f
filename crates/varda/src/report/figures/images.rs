//! Figures of numbers as colours: a field over space and time, and covariances.

use crate::outcome::{CovarianceBlock, Experiment, Outcome, Trajectories};
use crate::report::chart::{Figure, Image, Panel};

/// Components from which on a state is drawn as a field.
const LEAST_COMPONENTS: usize = 8;
/// Cells across and up at most; a cell of more is their mean.
const MOST_CELLS: [usize; 2] = [80, 40];

/// The analysis over space and time, its distance from the truth (or from the background), and σ, of models
/// with one number a place.
pub(in crate::report) fn field(
    experiment: &Experiment,
    runs: &Trajectories,
    sigma: &[f64],
) -> Option<Figure> {
    let grid = &experiment.grid;
    let n = experiment.state.len() - experiment.state.constants.len();
    if experiment.state.geometry.is_some() || n < LEAST_COMPONENTS {
        return None;
    }
    let (other, name) = match runs.truth.is_empty() {
        false => (&runs.truth, "analysis − truth"),
        true => (&runs.background, "analysis − background"),
    };
    let steps = runs.analysis.len().min(other.len()) / runs.dim;
    if steps < 2 {
        return None;
    }
    let at = |states: &[f64], k: usize, i: usize| states.get(k * runs.dim + i).copied().unwrap_or(f64::NAN);
    let panel = |title: &str, of: &dyn Fn(usize, usize) -> f64| Panel {
        title: title.into(),
        x_label: "time".into(),
        y_label: "component".into(),
        image: Some(image([steps, n], of, [grid.time(0), grid.time(steps - 1)])),
        ..Panel::default()
    };
    let mut panels = vec![
        panel("analysis", &|k, i| at(&runs.analysis, k, i)),
        panel(name, &|k, i| at(&runs.analysis, k, i) - at(other, k, i)),
    ];
    if !sigma.is_empty() {
        panels.push(panel("σ of the analysis", &|k, i| at(sigma, k, i)));
    }
    let columns = panels.len();
    Some(Figure {
        name: "field".into(),
        title: "The state over space and time (Hovmöller diagram)".into(),
        panels,
        columns,
        panel_size: (if columns > 2 { 360 } else { 460 }, 320),
    })
}

/// n[0] instants across, n[1] components up, as means over cells.
fn image(n: [usize; 2], of: &dyn Fn(usize, usize) -> f64, times: [f64; 2]) -> Image {
    let [columns, rows] = [n[0].min(MOST_CELLS[0]), n[1].min(MOST_CELLS[1])];
    let part = |i: usize, of: usize, n: usize| (i * n / of)..((i + 1) * n / of);
    let mut values = Vec::with_capacity(rows * columns);
    for row in 0..rows {
        for column in 0..columns {
            let (ks, is) = (part(column, columns, n[0]), part(row, rows, n[1]));
            let count = (ks.len() * is.len()) as f64;
            let sum: f64 = ks.flat_map(|k| is.clone().map(move |i| (k, i))).map(|(k, i)| of(k, i)).sum();
            values.push(sum / count);
        }
    }
    let range = range(&values);
    Image { x: times, y: [0.0, n[1] as f64], downwards: false, columns, values, label: String::new(), range }
}

fn range(values: &[f64]) -> [f64; 2] {
    let finite = values.iter().filter(|v| v.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if low < high { [low, high] } else { [low.min(0.0), high.max(1.0)] }
}

/// Prior and posterior covariances of the control, a figure for each group with its name.
pub(in crate::report) fn covariances(outcome: &Outcome) -> Vec<(String, Figure)> {
    let groups =
        [("position", "covariance-position"), ("velocity", "covariance-velocity"), ("state", "covariance")];
    let figures = groups.into_iter().map(|(group, name)| {
        let blocks: Vec<_> = outcome.covariances.iter().filter(|b| b.group == group).collect();
        let prior = blocks.iter().map(|b| panel(outcome, b, "prior", &b.prior));
        let posterior = blocks.iter().map(|b| panel(outcome, b, "posterior", &b.posterior));
        let figure = Figure {
            name: name.into(),
            title: format!("Covariances of the initial {group}, before and after the observations"),
            panels: prior.chain(posterior).collect(),
            columns: blocks.len(),
            panel_size: (340, 300),
        };
        (group.to_string(), figure)
    });
    figures.filter(|(_, figure)| !figure.panels.is_empty()).collect()
}

fn panel(outcome: &Outcome, block: &CovarianceBlock, name: &str, values: &[f64]) -> Panel {
    let (first, last) = (block.places[0], block.places[block.places.len() - 1]);
    let cells = block.places.len();
    let half = 0.5 * (last - first) / (cells.max(2) - 1) as f64;
    let ends = [first - half, last + half];
    let place = if outcome.experiment.state.geometry.is_some() { "arc length [m]" } else { "component" };
    let image = Image {
        x: ends,
        y: ends,
        downwards: true,
        columns: cells,
        values: values.to_vec(),
        label: match block.unit {
            "1" => "covariance".into(),
            unit => format!("[({unit})²]"),
        },
        range: range(values),
    };
    Panel {
        title: format!("{name} {}", block.component),
        x_label: place.into(),
        y_label: place.into(),
        image: Some(image),
        ..Panel::default()
    }
}
