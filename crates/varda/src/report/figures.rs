//! Which figures a run draws.

use crate::Error;
use crate::run::compare::{Compared, lowest};
use crate::run::window::{ConvergenceRow, Outcome, Trajectories};
use crate::scene::Use;
use crate::setup::problem::{Problem, RodView, View};
use crate::setup::rod_observations::Window;

use super::plot::{Corner, Figure, Panel, Series, Style};

/// All figures of a run, in the order of the report.
pub(super) fn all(problem: &mut Problem, outcome: &Outcome) -> Result<Vec<Figure>, Error> {
    let mut figures = vec![convergence(outcome)];
    let window = problem.window;
    let snapshots = problem.scene.report.snapshots;
    let names: Vec<String> = match &problem.view {
        View::Components(names) => names.clone(),
        View::Rod(_) => Vec::new(),
    };
    match &mut problem.view {
        View::Rod(rod) => {
            figures.push(shapes(rod, outcome, &window, snapshots)?);
            figures.push(tracks(rod, outcome, &window)?);
            if outcome.has_posterior {
                figures.push(rod_spread(rod, outcome));
            }
        }
        View::Components(_) => {
            figures.push(components(problem, outcome, &names));
            if outcome.has_posterior {
                figures.push(component_spread(outcome));
            }
        }
    }
    Ok(figures)
}

/// Error against seconds, of every method that got under way.
pub(super) fn comparison(rows: &[Compared]) -> Figure {
    let lowest = lowest(rows);
    let panel = |y_label: &str, points: &dyn Fn(&Compared) -> Vec<(f64, f64)>| Panel {
        x_label: "seconds".into(),
        y_label: y_label.into(),
        log_x: true,
        log_y: true,
        series: rows
            .iter()
            .enumerate()
            .map(|(i, r)| Series {
                label: format!("{} {}", r.method, r.solver),
                style: Style::Line(i),
                points: points(r),
            })
            .collect(),
        ..Panel::default()
    };
    let gap = panel("(J − J*)/(J₀ − J*)", &|r| r.gaps(lowest));
    let rmse = panel("RMSE", &|r| {
        r.convergence.iter().filter_map(|c| Some((c.seconds, c.rmse_position?))).collect()
    });
    let mut panels = vec![gap];
    if rmse.series.iter().any(|s| !s.points.is_empty()) {
        panels.push(rmse);
    }
    // Too many names for a corner of a plot: they have a panel of their own.
    panels.push(Panel { is_key: true, ..panel("", &|_| Vec::new()) });
    Figure {
        name: "compare",
        title: "Error of every method and minimizer against seconds".into(),
        columns: panels.len(),
        panels,
        panel_size: (460, 420.max(22 * rows.len() as u32 + 40)),
    }
}

/// J, ‖∇J‖ and RMSE against iteration and against seconds, relative to their first values.
fn convergence(outcome: &Outcome) -> Figure {
    let rows = &outcome.convergence;
    let is_rod = outcome.rmse.velocity_background.is_some();
    let panel = |x_label: &str, x: &dyn Fn(&ConvergenceRow) -> f64, legend: Option<Corner>| {
        let series = |label: &str, style, y: &dyn Fn(&ConvergenceRow) -> f64| {
            let first = rows.first().map_or(1.0, y);
            Series { label: label.into(), style, points: rows.iter().map(|r| (x(r), y(r) / first)).collect() }
        };
        let mut all = vec![
            series("J", Style::Line(0), &|r| r.j),
            series("gradient norm", Style::Line(1), &|r| r.gradient_norm),
        ];
        if rows.iter().any(|r| r.rmse_position.is_some()) {
            let name = if is_rod { "RMSE position" } else { "RMSE" };
            all.push(series(name, Style::Line(2), &|r| r.rmse_position.unwrap_or(f64::NAN)));
        }
        if is_rod {
            all.push(series("RMSE velocity", Style::Line(3), &|r| r.rmse_velocity.unwrap_or(f64::NAN)));
        }
        Panel {
            x_label: x_label.into(),
            y_label: "relative to the background".into(),
            log_y: true,
            legend,
            series: all,
            ..Panel::default()
        }
    };
    Figure {
        name: "convergence",
        title: "Convergence: cost, gradient norm and error against iterations and against seconds".into(),
        panels: vec![
            panel("outer iterations", &|r| r.iteration as f64, Some(Corner::LowerLeft)),
            panel("seconds", &|r| r.seconds, None),
        ],
        columns: 2,
        panel_size: (460, 320),
    }
}

/// The runs there are, as they are drawn; a run that is not there is empty.
fn kinds(runs: &Trajectories) -> [(Style, &'static str, &[f64]); 3] {
    [
        (Style::Truth, "truth", &runs.truth),
        (Style::Background, "background", &runs.background),
        (Style::Analysis, "analysis", &runs.analysis),
    ]
}

/// The names of the runs there are.
fn drawn_names(runs: &Trajectories) -> String {
    let there = kinds(runs).into_iter().filter(|(_, _, states)| !states.is_empty());
    there.map(|(_, name, _)| name).collect::<Vec<_>>().join(", ")
}

/// How a run is drawn, its name, and its points.
type Drawn<Point> = (Style, &'static str, Vec<Point>);

/// Snapshots of a rod, seen from the side: the vertical against the horizontal in which it extends most.
fn shapes(rod: &mut RodView, outcome: &Outcome, window: &Window, count: usize) -> Result<Figure, Error> {
    let runs = &outcome.trajectories;
    let count = count.min(window.steps + 1);
    let steps: Vec<usize> =
        (0..count).map(|i| if count > 1 { i * window.steps / (count - 1) } else { 0 }).collect();
    let mut drawn: Vec<(usize, Vec<Drawn<[f64; 3]>>)> = Vec::new();
    for &k in &steps {
        let mut here = Vec::new();
        for (style, label, states) in kinds(runs) {
            if let Some(state) = runs.state(states, k) {
                here.push((style, label, rod.vertices(window, k, state)?));
            }
        }
        drawn.push((k, here));
    }
    let seen: Vec<(usize, Use, [f64; 3])> = rod
        .sightings
        .seen
        .iter()
        .filter_map(|s| {
            let k = steps.iter().copied().find(|k| (s.at() - *k as f64).abs() < 0.5)?;
            Some((k, rod.sightings.sites[s.site].used, s.position(&rod.sightings.rotation)?))
        })
        .collect();
    let extent = |c: usize| {
        let shapes = drawn.iter().flat_map(|(_, here)| here).flat_map(|(_, _, shape)| shape).copied();
        let all = shapes.chain(seen.iter().map(|(_, _, p)| *p)).map(move |p| p[c]);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low, high)
    };
    let width = |c: usize| extent(c).1 - extent(c).0;
    let across = if width(0) >= width(1) { 0 } else { 1 };
    let (x, z) = (extent(across), extent(2));
    let columns = count.min(3);
    // Equal scales in a panel: the plot's own area is the panel less labels and margins.
    let panel_size = if z.1 - z.0 >= x.1 - x.0 { (310u32, 350u32) } else { (310, 250) };
    let inner = (f64::from(panel_size.0) - 66.0, f64::from(panel_size.1) - 78.0);
    let scale = (1.1 * (x.1 - x.0) / inner.0).max(1.1 * (z.1 - z.0) / inner.1);
    let around = |(low, high): (f64, f64), pixels: f64| {
        let middle = 0.5 * (low + high);
        (middle - 0.5 * scale * pixels, middle + 0.5 * scale * pixels)
    };
    let ranges = [around(x, inner.0), around(z, inner.1)];
    let panels = drawn
        .into_iter()
        .enumerate()
        .map(|(i, (k, here))| {
            let line = |(style, label, shape): Drawn<[f64; 3]>| Series {
                label: label.into(),
                style,
                points: shape.iter().map(|p| (p[across], p[2])).collect(),
            };
            let mut series: Vec<Series> = here.into_iter().map(line).collect();
            for (used, style, label) in [
                (Use::Assimilate, Style::Observation, "observed"),
                (Use::Withhold, Style::Withheld, "kept back"),
            ] {
                let here = seen.iter().filter(|(at, kind, _)| *at == k && *kind == used);
                let points: Vec<(f64, f64)> = here.map(|(_, _, p)| (p[across], p[2])).collect();
                if !points.is_empty() {
                    series.push(Series { label: label.into(), style, points });
                }
            }
            Panel {
                title: format!("t = {:.3} s", window.time(k)),
                x_label: format!("{} [m]", ["x", "y"][across]),
                y_label: if i % columns == 0 { "z [m]".into() } else { String::new() },
                equal: Some(ranges),
                legend: (i + 1 == count).then_some(Corner::LowerLeft),
                series,
                ..Panel::default()
            }
        })
        .collect();
    Ok(Figure {
        name: "snapshots",
        title: format!(
            "The rod at {count} instants of the window, {}-z plane: {} and observations",
            ["x", "y"][across],
            drawn_names(runs)
        ),
        panels,
        columns,
        panel_size,
    })
}

/// Where the site with the most observations is, coordinate by coordinate, against time, forecast included.
fn tracks(rod: &mut RodView, outcome: &Outcome, window: &Window) -> Result<Figure, Error> {
    let runs = &outcome.trajectories;
    let sites = rod.sightings.sites.len();
    // The last site is the free end in most scenes; a marker kept back says more.
    let site =
        rod.sightings.sites.iter().position(|s| s.used == Use::Withhold).unwrap_or(sites.saturating_sub(1));
    let name = rod.sightings.sites.get(site).map_or("?".into(), |s| s.label.clone());
    let mut lines: Vec<Drawn<(f64, [f64; 3])>> = Vec::new();
    let mut places = vec![0.0; 3 * sites];
    for (style, label, states) in kinds(runs) {
        let mut line = Vec::new();
        for k in 0..=window.steps + window.forecast {
            let Some(state) = runs.state(states, k).filter(|_| sites > 0) else { break };
            rod.sites.places(k, state, &mut places)?;
            line.push((window.time(k), [places[3 * site], places[3 * site + 1], places[3 * site + 2]]));
        }
        if !line.is_empty() {
            lines.push((style, label, line));
        }
    }
    let withheld = rod.sightings.sites.get(site).is_some_and(|s| s.used == Use::Withhold);
    let seen: Vec<(f64, [f64; 3])> = rod
        .sightings
        .seen
        .iter()
        .filter(|s| s.site == site)
        .filter_map(|s| s.position(&rod.sightings.rotation).map(|p| (window.start + s.at() * window.step, p)))
        .collect();
    let panel = |c: usize| {
        let mut series: Vec<Series> = lines
            .iter()
            .map(|(style, label, line)| Series {
                label: label.to_string(),
                style: *style,
                points: line.iter().map(|(t, p)| (*t, p[c])).collect(),
            })
            .collect();
        series.push(Series {
            label: if withheld { "kept back" } else { "observed" }.into(),
            style: if withheld { Style::Withheld } else { Style::Observation },
            points: seen.iter().map(|(t, p)| (*t, p[c])).collect(),
        });
        Panel {
            x_label: "time [s]".into(),
            y_label: format!("{} of {name} [m]", ["x", "y", "z"][c]),
            legend: (c == 0).then_some(Corner::Top),
            series,
            ..Panel::default()
        }
    };
    let after = if window.forecast > 0 {
        format!("; the window ends at {:.3} s, the rest is forecast", window.time(window.steps))
    } else {
        String::new()
    };
    Ok(Figure {
        name: "tracks",
        title: format!("Coordinates of {name} against time{after}"),
        panels: (0..3).map(panel).collect(),
        columns: 3,
        panel_size: (360, 290),
    })
}

/// σ_b and σ_a along the rod: the root mean square over x, y and z.
fn rod_spread(rod: &RodView, outcome: &Outcome) -> Figure {
    let s = rod.parts.rod.arc_lengths();
    let free = rod.dynamics.free_vertices();
    let half = 3 * free.len();
    let panel = |from: usize, y_label: &str, legend: Option<Corner>| {
        let series = |label: &str, style, sigma: &[f64]| Series {
            label: label.into(),
            style,
            points: free
                .iter()
                .zip(sigma[from..from + half].chunks_exact(3))
                .map(|(&v, c)| (s[v], (c.iter().map(|x| x * x).sum::<f64>() / 3.0).sqrt()))
                .collect(),
        };
        Panel {
            x_label: "arc length [m]".into(),
            y_label: y_label.into(),
            legend,
            series: vec![
                series("before (background)", Style::Background, &outcome.analysis.sigma_background),
                series("after (analysis)", Style::Analysis, &outcome.analysis.sigma_analysis),
            ],
            ..Panel::default()
        }
    };
    Figure {
        name: "spread",
        title: "Standard deviation of initial position and velocity along the rod, before and after".into(),
        panels: vec![
            panel(0, "σ of position [m]", Some(Corner::LowerRight)),
            panel(half, "σ of velocity [m/s]", None),
        ],
        columns: 2,
        panel_size: (460, 300),
    }
}

/// Up to six components against time.
fn components(problem: &Problem, outcome: &Outcome, names: &[String]) -> Figure {
    let runs = &outcome.trajectories;
    let window = problem.window;
    let chosen: Vec<usize> = (0..names.len()).step_by(names.len().div_ceil(6).max(1)).collect();
    let panel = |(i, &c): (usize, &usize)| {
        let mut series: Vec<Series> = kinds(runs)
            .into_iter()
            .filter(|(_, _, states)| !states.is_empty())
            .map(|(style, label, states)| Series {
                label: label.into(),
                style,
                points: states
                    .chunks_exact(runs.dim)
                    .enumerate()
                    .map(|(k, x)| (window.time(k), x[c]))
                    .collect(),
            })
            .collect();
        let seen = problem.observations.observations().iter().filter(|o| o.label == names[c]);
        let points: Vec<(f64, f64)> = seen.map(|o| (window.time(o.step), o.values[0])).collect();
        if !points.is_empty() {
            series.push(Series { label: "observed".into(), style: Style::Observation, points });
        }
        Panel {
            x_label: "time".into(),
            y_label: names[c].clone(),
            legend: (i == 0).then_some(Corner::Top),
            series,
            ..Panel::default()
        }
    };
    Figure {
        name: "components",
        title: format!("Components of the state against time: {} and observations", drawn_names(runs)),
        panels: chosen.iter().enumerate().map(panel).collect(),
        columns: chosen.len().min(3),
        panel_size: (360, 270),
    }
}

/// σ_b and σ_a of every component.
fn component_spread(outcome: &Outcome) -> Figure {
    let series = |label: &str, style, sigma: &[f64]| Series {
        label: label.into(),
        style,
        points: sigma.iter().enumerate().map(|(i, s)| (i as f64, *s)).collect(),
    };
    Figure {
        name: "spread",
        title: "Standard deviation of every component of the initial state, before and after".into(),
        panels: vec![Panel {
            x_label: "component".into(),
            y_label: "σ".into(),
            legend: Some(Corner::Top),
            series: vec![
                series("before (background)", Style::Background, &outcome.analysis.sigma_background),
                series("after (analysis)", Style::Analysis, &outcome.analysis.sigma_analysis),
            ],
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (760, 300),
    }
}
