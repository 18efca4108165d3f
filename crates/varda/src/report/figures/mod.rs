//! Which figures a run draws.

mod images;
mod observed;

pub(super) use images::{covariances, field};
pub(super) use observed::{AgainstTime, markers};

use std::collections::HashMap;

use crate::outcome::{
    ConvergenceRow, CyclesOutcome, Estimated, NextObservation, Outcome, Shapes, Sight, Track, Trajectories,
};
use crate::run::compare::{Compared, lowest};
use crate::scene::TimeGrid;
use crate::state::{Geometry, StateGroup};

use super::chart::{Band, Corner, Figure, Panel, Series, Style};

/// All figures of a run but those of every marker and of covariances.
pub(super) fn all(outcome: &Outcome) -> Vec<Figure> {
    let mut figures = Vec::new();
    let grid = &outcome.experiment.grid;
    match &outcome.shapes {
        Some(shapes) => {
            figures.push(snapshots(shapes, outcome));
            let track = shapes.track.as_ref().filter(|_| grid.last_step() > 0);
            figures.extend(track.map(|track| tracks(track, shapes, grid)));
        }
        None => {
            figures.extend(images::field(&outcome.experiment, &outcome.trajectories, &outcome.sigma_states));
            let seen = outcome.seen.iter().map(|s| (s.component, s.time, s.value)).collect();
            figures.push(components(&outcome.into(), seen));
        }
    }
    figures.extend(observed::departures(outcome));
    figures.extend(fields(&outcome.estimates));
    figures.extend(constants(outcome));
    // one of several recordings has no iterations of its own
    if !outcome.convergence.is_empty() {
        figures.push(convergence(outcome));
    }
    let known = outcome.experiment.scene.background.covariance.is_of_known_state();
    if outcome.has_posterior && !known {
        figures.push(spread(outcome));
    }
    figures.extend(observed::information(outcome));
    figures.extend(outcome.next_observation.as_ref().and_then(next_observation));
    figures
}

/// Constants that are estimated against iterations, as their distance from the prior in σ of the prior.
fn constants(outcome: &Outcome) -> Option<Figure> {
    let (rows, estimates) = (&outcome.convergence, &outcome.estimates);
    let first = outcome.experiment.state.len() - outcome.experiment.state.constants.len();
    let prior = |i: usize| {
        Some((
            *outcome.analysis.background.get(first + i)?,
            *outcome.analysis.sigma_background.get(first + i)?,
        ))
    };
    let followed = |i: &usize| !estimates[*i].is_of_field() && prior(*i).is_some_and(|(_, s)| s > 0.0);
    let shown: Vec<usize> = (0..estimates.len()).filter(followed).collect();
    let line = |(colour, i): (usize, &usize)| {
        let e = &estimates[*i];
        let at = |r: &ConvergenceRow| {
            let (background, sigma) = prior(*i)?;
            Some((r.iteration as f64, (r.constants.get(*i)? - background) / sigma))
        };
        Series {
            label: e.name.clone(),
            style: Style::Line(colour),
            points: rows.iter().filter_map(at).collect(),
        }
    };
    let series: Vec<Series> = shown.iter().enumerate().map(line).filter(|s| s.points.len() > 1).collect();
    (!series.is_empty()).then(|| Figure {
        name: "constants".into(),
        title: "Estimated constants against iterations: distance from the prior, in σ of the prior".into(),
        panels: vec![Panel {
            x_label: "outer iterations".into(),
            y_label: "(value − prior)/σ of the prior".into(),
            legend: Some(Corner::Top),
            series,
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (760, 300),
    })
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
        r.convergence.iter().filter_map(|c| Some((c.seconds, *c.rmse.first()?))).collect()
    });
    let mut panels = vec![gap];
    if rmse.series.iter().any(|s| !s.points.is_empty()) {
        panels.push(rmse);
    }
    // Too many names for a corner of a plot: they have a panel of their own.
    panels.push(Panel { is_key: true, ..panel("", &|_| Vec::new()) });
    Figure {
        name: "compare".into(),
        title: "Error of every method and minimizer against seconds".into(),
        columns: panels.len(),
        panels,
        panel_size: (460, 420.max(22 * rows.len() as u32 + 40)),
    }
}

/// J, ‖∇J‖ and RMSE against iteration and against seconds, relative to their first values.
fn convergence(outcome: &Outcome) -> Figure {
    let rows = &outcome.convergence;
    let panel = |x_label: &str, x: &dyn Fn(&ConvergenceRow) -> f64, legend: Option<Corner>| {
        let series = |label: &str, style, y: &dyn Fn(&ConvergenceRow) -> f64| {
            let first = rows.first().map_or(1.0, y);
            Series { label: label.into(), style, points: rows.iter().map(|r| (x(r), y(r) / first)).collect() }
        };
        let mut all = vec![
            series("J", Style::Line(0), &|r| r.j),
            series("gradient norm", Style::Line(1), &|r| r.gradient_norm),
        ];
        if outcome.truth.is_some() {
            for (i, group) in outcome.experiment.state.groups.iter().enumerate() {
                let error = move |r: &ConvergenceRow| r.rmse.get(i).copied().unwrap_or(f64::NAN);
                all.push(series(&group.labelled("RMSE"), Style::Line(2 + i), &error));
            }
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
        name: "convergence".into(),
        title: "Convergence: cost, gradient norm and error against iterations and against seconds".into(),
        panels: vec![
            panel("outer iterations", &|r| r.iteration as f64, Some(Corner::LowerLeft)),
            panel("seconds", &|r| r.seconds, None),
        ],
        columns: 2,
        panel_size: (460, 320),
    }
}

/// The runs as they are drawn: style and name.
const KINDS: [(Style, &str); 3] =
    [(Style::Truth, "truth"), (Style::Background, "background"), (Style::Analysis, "analysis")];

/// The runs that exist, each with its style and name.
fn drawn<T>(truth: T, background: T, analysis: T, is_empty: fn(&T) -> bool) -> Vec<(Style, &'static str, T)> {
    let runs = KINDS.into_iter().zip([truth, background, analysis]);
    runs.filter(|(_, run)| !is_empty(run)).map(|((style, name), run)| (style, name, run)).collect()
}

/// Their names in a title.
fn names<T>(runs: &[(Style, &'static str, T)]) -> String {
    runs.iter().map(|(_, name, _)| *name).collect::<Vec<_>>().join(", ")
}

/// How a run is drawn, its name, and its points.
type DrawnRun<Point> = (Style, &'static str, Vec<Point>);

const AXES: [&str; 3] = ["x", "y", "z"];

/// Snapshots of a rod, seen from the side: the vertical against the horizontal in which it extends most.
fn snapshots(shapes: &Shapes, outcome: &Outcome) -> Figure {
    let grid = &outcome.experiment.grid;
    let count = outcome.experiment.scene.report.snapshots.min(grid.steps + 1);
    let steps: Vec<usize> =
        (0..count).map(|i| if count > 1 { i * grid.steps / (count - 1) } else { 0 }).collect();
    let runs = drawn(&shapes.truth, &shapes.background, &shapes.analysis, |run| run.is_empty());
    let at = |k: usize| -> Vec<DrawnRun<[f64; 3]>> {
        runs.iter().filter_map(|(style, name, run)| Some((*style, *name, run.get(k)?.clone()))).collect()
    };
    let instants: Vec<(usize, Vec<DrawnRun<[f64; 3]>>)> = steps.iter().map(|&k| (k, at(k))).collect();
    let near = |s: &Sight| steps.iter().copied().find(|k| (s.at() - *k as f64).abs() < 0.5);
    let seen: Vec<(usize, bool, [f64; 3])> =
        shapes.seen.iter().filter_map(|s| Some((near(s)?, s.withheld, s.position))).collect();
    let extent = |c: usize| {
        let vertices = instants.iter().flat_map(|(_, here)| here).flat_map(|(_, _, shape)| shape).copied();
        let all = vertices.chain(seen.iter().map(|(_, _, p)| *p)).map(move |p| p[c]);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        (low, high)
    };
    let width = |c: usize| extent(c).1 - extent(c).0;
    // the two axes along which there is most to see, z upwards where it is one of them
    let least = if width(2) < width(0).min(width(1)) { 2 } else { usize::from(width(0) >= width(1)) };
    let [across, up] = [[1, 2], [0, 2], [0, 1]][least];
    let (x, z) = (extent(across), extent(up));
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
    let panels = instants
        .into_iter()
        .enumerate()
        .map(|(i, (k, here))| {
            let line = |(style, label, shape): DrawnRun<[f64; 3]>| Series {
                label: label.into(),
                style,
                points: shape.iter().map(|p| (p[across], p[up])).collect(),
            };
            let mut series: Vec<Series> = here.into_iter().map(line).collect();
            for (withheld, style, label) in
                [(false, Style::Observation, "observed"), (true, Style::Withheld, "kept back")]
            {
                let here = seen.iter().filter(|(at, kind, _)| *at == k && *kind == withheld);
                let points: Vec<(f64, f64)> = here.map(|(_, _, p)| (p[across], p[up])).collect();
                if !points.is_empty() {
                    series.push(Series { label: label.into(), style, points });
                }
            }
            Panel {
                title: format!("t = {:.3} s", grid.time(k)),
                x_label: format!("{} [m]", AXES[across]),
                y_label: if i % columns == 0 { format!("{} [m]", AXES[up]) } else { String::new() },
                equal: Some(ranges),
                legend: (i + 1 == count).then_some(Corner::LowerLeft),
                series,
                ..Panel::default()
            }
        })
        .collect();
    Figure {
        name: "snapshots".into(),
        title: format!(
            "The rod{}, {}-{} plane: {} and observations",
            if count > 1 { format!(" at {count} instants of the window") } else { String::new() },
            AXES[across],
            AXES[up],
            names(&runs)
        ),
        panels,
        columns,
        panel_size,
    }
}

/// The coordinates of one marker against time, forecast included.
fn tracks(track: &Track, shapes: &Shapes, grid: &TimeGrid) -> Figure {
    let runs = drawn(&track.truth, &track.background, &track.analysis, |run| run.is_empty());
    let name = &track.label;
    let of_site = shapes.seen.iter().filter(|s| s.site == track.site);
    let seen: Vec<(f64, [f64; 3])> = of_site.map(|s| (grid.start + s.at() * grid.step, s.position)).collect();
    let panel = |c: usize| {
        let line = |(style, label, run): &(Style, &str, &Vec<[f64; 3]>)| Series {
            label: label.to_string(),
            style: *style,
            points: run.iter().enumerate().map(|(k, p)| (grid.time(k), p[c])).collect(),
        };
        let mut series: Vec<Series> = runs.iter().map(line).collect();
        series.push(Series {
            label: if track.withheld { "kept back" } else { "observed" }.into(),
            style: if track.withheld { Style::Withheld } else { Style::Observation },
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
    let after = if grid.forecast > 0 {
        format!("; the window ends at {:.3} s, the rest is forecast", grid.time(grid.steps))
    } else {
        String::new()
    };
    Figure {
        name: "tracks".into(),
        title: format!("Coordinates of {name} against time{after}"),
        panels: (0..3).map(panel).collect(),
        columns: 3,
        panel_size: (360, 290),
    }
}

/// Up to six components against time, with values of components at times.
fn components(of: &AgainstTime, seen: Vec<(usize, f64, f64)>) -> Figure {
    let all = of.trajectories;
    let runs = drawn(&all.truth, &all.background, &all.analysis, |run| run.is_empty());
    let (grid, layout) = (&of.experiment.grid, &of.experiment.state);
    // without constants, which stand behind the state
    let names_of = &layout.names[..layout.names.len() - layout.constants.len()];
    let chosen: Vec<usize> = (0..names_of.len()).step_by(names_of.len().div_ceil(6).max(1)).collect();
    let panel = |(i, &c): (usize, &usize)| {
        let line = |(style, label, states): &(Style, &str, &Vec<f64>)| Series {
            label: label.to_string(),
            style: *style,
            points: values(all, states, c, grid),
        };
        let mut series: Vec<Series> = runs.iter().map(line).collect();
        let band = |(k, x): (usize, &[f64])| {
            let two = 2.0 * all.state(of.sigma, k)?[c];
            two.is_finite().then(|| (grid.time(k), x[c] - two, x[c] + two))
        };
        let band: Vec<_> = all.analysis.chunks_exact(all.dim).enumerate().filter_map(band).collect();
        let bands = match band.is_empty() {
            true => Vec::new(),
            false => vec![Band { label: "analysis ± 2σ".into(), style: Style::Analysis, points: band }],
        };
        let seen = seen.iter().filter(|(component, ..)| *component == c);
        let points: Vec<(f64, f64)> = seen.map(|(_, time, value)| (*time, *value)).collect();
        if !points.is_empty() {
            series.push(Series { label: "observed".into(), style: Style::Observation, points });
        }
        Panel {
            x_label: "time".into(),
            y_label: names_of[c].clone(),
            legend: (i == 0).then_some(Corner::Top),
            bands,
            series,
            ..Panel::default()
        }
    };
    Figure {
        name: "components".into(),
        title: format!("Components of the state against time: {} and observations", names(&runs)),
        panels: chosen.iter().enumerate().map(panel).collect(),
        columns: chosen.len().min(3),
        panel_size: (360, 270),
    }
}

/// The same of a sequence of windows, of models that are not in space.
pub(super) fn components_of_cycles(outcome: &CyclesOutcome) -> Option<Figure> {
    if outcome.shapes.is_some() || outcome.trajectories.analysis.is_empty() {
        return None;
    }
    let names = &outcome.experiment.state.names;
    let place: HashMap<&str, usize> = names.iter().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
    let used = outcome.observed.iter().filter(|v| v.used);
    let seen = used.filter_map(|v| Some((*place.get(v.label.as_str())?, v.time, v.value))).collect();
    Some(components(&outcome.into(), seen))
}

/// Component c of a run against time.
fn values(runs: &Trajectories, states: &[f64], c: usize, grid: &TimeGrid) -> Vec<(f64, f64)> {
    states.chunks_exact(runs.dim).enumerate().map(|(k, x)| (grid.time(k), x[c])).collect()
}

/// σ_b and σ_a of every group of the state: along the curve for models in space, by component for others.
fn spread(outcome: &Outcome) -> Figure {
    let layout = &outcome.experiment.state;
    let geometry = layout.geometry.as_ref();
    let panel = |(i, group): (usize, &StateGroup)| {
        let series = |label: &str, style, sigma: &[f64]| Series {
            label: label.into(),
            style,
            points: deviations(group, geometry, sigma),
        };
        let corner = if geometry.is_some() { Corner::LowerRight } else { Corner::Top };
        Panel {
            x_label: if geometry.is_some() { "arc length [m]" } else { "component" }.into(),
            y_label: match group.part() {
                Some(name) => format!("σ of {name}{}", group.unit_in_heading()),
                None => "σ".to_string(),
            },
            legend: (i == 0).then_some(corner),
            series: vec![
                series("before (background)", Style::Background, &outcome.analysis.sigma_background),
                series("after (analysis)", Style::Analysis, &outcome.analysis.sigma_analysis),
            ],
            ..Panel::default()
        }
    };
    let parts: Vec<&str> = layout.groups.iter().filter_map(StateGroup::part).collect();
    let title = if geometry.is_some() {
        format!("Standard deviation of initial {} along the rod, before and after", parts.join(" and "))
    } else {
        "Standard deviation of every component of the initial state, before and after".to_string()
    };
    let columns = layout.groups.len();
    Figure {
        name: "spread".into(),
        title,
        panels: layout.groups.iter().enumerate().map(panel).collect(),
        columns,
        panel_size: if columns > 1 { (460, 300) } else { (760, 300) },
    }
}

/// The fields along the rod that were estimated, with their 95 % intervals.
fn fields(all: &[Estimated]) -> Option<Figure> {
    let mut panels: Vec<Panel> = Vec::new();
    for e in all {
        let (Some(field), Some(s)) = (e.field(), e.arc_length) else { continue };
        let y_label = format!("{field} [{}]", e.unit);
        if panels.last().is_none_or(|panel| panel.y_label != y_label) {
            let series = |(label, style)| Series { label: String::from(label), style, points: Vec::new() };
            let known = [("analysis", Style::Analysis), ("prior", Style::Background)];
            let ends = [("95 % interval", Style::Line(2)), ("", Style::Line(2))];
            let ends = ends.into_iter().take(if e.interval.is_some() { 2 } else { 0 });
            panels.push(Panel {
                x_label: "arc length [m]".into(),
                y_label,
                legend: panels.is_empty().then_some(Corner::Top),
                series: known.into_iter().chain(ends).map(series).collect(),
                ..Panel::default()
            });
        }
        let values = [e.value, e.prior].into_iter().chain(e.interval.into_iter().flatten());
        let series = panels.last_mut().into_iter().flat_map(|panel| &mut panel.series);
        series.zip(values).for_each(|(series, value)| series.points.push((s, value)));
    }
    (!panels.is_empty()).then(|| Figure {
        name: "fields".into(),
        title: "Fields along the rod that were estimated".into(),
        columns: panels.len().min(2),
        panel_size: if panels.len() > 1 { (460, 300) } else { (760, 300) },
        panels,
    })
}

/// σ of the places at the end of the window with one more marker, against where it sits; of rods only.
fn next_observation(next: &NextObservation) -> Option<Figure> {
    let places: Option<Vec<(f64, f64)>> =
        next.candidates.iter().map(|c| Some((c.arc_length?, 1e3 * c.sigma))).collect();
    let places = places.filter(|places| !places.is_empty())?;
    let now = places.iter().map(|(s, _)| (*s, 1e3 * next.sigma_now)).collect();
    let series = |label: &str, style, points| Series { label: label.into(), style, points };
    Some(Figure {
        name: "next-marker".into(),
        title: format!(
            "Standard deviation of the places at the end of the window with one more marker, seen {} times \
             with σ = {} m, against its place",
            next.times, next.sigma_seen
        ),
        panels: vec![Panel {
            x_label: "arc length of the marker [m]".into(),
            y_label: "σ of places at the end [mm]".into(),
            legend: Some(Corner::Top),
            series: vec![
                series("as it is", Style::Background, now),
                series("with one more marker", Style::Analysis, places),
            ],
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (760, 300),
    })
}

/// The root mean square of σ over each vector of a group, against arc length or index.
fn deviations(group: &StateGroup, geometry: Option<&Geometry>, sigma: &[f64]) -> Vec<(f64, f64)> {
    let place = |i: usize| geometry.map_or(i as f64, |g| g.place(group, i));
    let rms = |v: &[f64]| (v.iter().map(|x| x * x).sum::<f64>() / group.width as f64).sqrt();
    let vectors = sigma[group.range.clone()].chunks_exact(group.width).enumerate();
    vectors.map(|(i, v)| (place(i), rms(v))).collect()
}
