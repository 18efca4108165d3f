//! Figures of what was observed: every marker against time, departures against their σ, and information by
//! time.

use crate::outcome::{CyclesOutcome, Experiment, ObservedValue, Outcome, Shapes, Trajectories};
use crate::report::chart::{Band, Corner, Figure, Panel, Series, Style};

/// Most values of all markers in a page; of more, only some markers are shown.
const MOST_VALUES: usize = 60_000;
/// Most markers that have a colour of their own among departures.
const MOST_COLOURS: usize = 8;

/// What is drawn against time: of a window, or of a sequence of windows.
#[derive(Clone, Copy)]
pub(in crate::report) struct AgainstTime<'a> {
    pub(super) experiment: &'a Experiment,
    pub(super) trajectories: &'a Trajectories,
    pub(super) shapes: Option<&'a Shapes>,
    /// σ of the states of the analysis; empty where it is not known.
    pub(super) sigma: &'a [f64],
    observed: &'a [ObservedValue],
}

impl<'a> From<&'a Outcome> for AgainstTime<'a> {
    fn from(of: &'a Outcome) -> Self {
        AgainstTime {
            experiment: &of.experiment,
            trajectories: &of.trajectories,
            shapes: of.shapes.as_ref(),
            sigma: &of.sigma_states,
            observed: &of.observed,
        }
    }
}

impl<'a> From<&'a CyclesOutcome> for AgainstTime<'a> {
    fn from(of: &'a CyclesOutcome) -> Self {
        AgainstTime {
            experiment: &of.experiment,
            trajectories: &of.trajectories,
            shapes: of.shapes.as_ref(),
            sigma: &of.sigma_states,
            observed: &of.observed,
        }
    }
}

/// What was seen of one marker, place or component, in order of time.
struct Track<'a> {
    label: &'a str,
    values: Vec<&'a ObservedValue>,
}

/// The observed values by marker, in the order in which they were first seen.
fn tracks(observed: &[ObservedValue]) -> Vec<Track<'_>> {
    let mut place: std::collections::HashMap<&str, usize> = std::collections::HashMap::new();
    let mut all: Vec<Track> = Vec::new();
    for value in observed {
        let at = *place.entry(value.label.as_str()).or_insert(all.len());
        if at == all.len() {
            all.push(Track { label: &value.label, values: Vec::new() });
        }
        all[at].values.push(value);
    }
    all.iter_mut().for_each(|t| t.values.sort_by(|a, b| a.time.total_cmp(&b.time)));
    all
}

/// Every marker against time with the analysis ± 2σ, each with its name.
pub(in crate::report) fn markers<'a>(of: impl Into<AgainstTime<'a>>) -> Vec<(String, Figure)> {
    let of = of.into();
    if of.experiment.grid.last_step() == 0 {
        return Vec::new();
    }
    let all = tracks(of.observed);
    let every = of.observed.len().div_ceil(MOST_VALUES).max(1);
    let mut figures: Vec<(String, Figure)> = rod_through_time(&of).into_iter().collect();
    let shown = all.iter().step_by(every);
    figures.extend(shown.map(|track| (track.label.to_string(), marker(track, of.shapes.is_some()))));
    figures
}

fn marker(track: &Track, in_space: bool) -> Figure {
    let mut axes: Vec<&str> = track.values.iter().map(|v| v.axis).collect();
    axes.sort_unstable();
    axes.dedup();
    let panel = |axis: &str| {
        let values: Vec<&ObservedValue> = track.values.iter().copied().filter(|v| v.axis == axis).collect();
        let of = |label: &str, style, keep: &dyn Fn(&ObservedValue) -> bool| Series {
            label: label.into(),
            style,
            points: values.iter().filter(|v| keep(v)).map(|v| (v.time, v.value)).collect(),
        };
        let run = |label: &str, style, y: fn(&ObservedValue) -> f64| Series {
            label: label.into(),
            style,
            points: values.iter().map(|v| (v.time, y(v))).collect(),
        };
        let band = |v: &&ObservedValue| {
            let two = 2.0 * v.sigma_analysis?;
            Some((v.time, v.analysis - two, v.analysis + two))
        };
        let band: Vec<_> = values.iter().filter_map(band).collect();
        let series = [
            run("background", Style::Background, |v| v.background),
            run("analysis", Style::Analysis, |v| v.analysis),
            of("observed", Style::Observation, &|v| v.used),
            of("kept back or later", Style::Withheld, &|v| !v.used && v.reason != "background check"),
            of("refused", Style::Refused, &|v| v.reason == "background check"),
        ];
        let unit = match values.first().map_or("", |v| v.unit) {
            "" => String::new(),
            unit => format!(" [{unit}]"),
        };
        let name = if axis.is_empty() { track.label } else { axis };
        Panel {
            x_label: if in_space { "time [s]" } else { "time" }.into(),
            y_label: format!("{name}{unit}"),
            bands: bands("analysis ± 2σ", band),
            series: series.into_iter().filter(|s| !s.points.is_empty()).collect(),
            ..Panel::default()
        }
    };
    let panels: Vec<Panel> = axes.into_iter().map(panel).collect();
    Figure {
        name: "marker".into(),
        title: format!("{} against time, at the times at which it was seen", track.label),
        columns: panels.len().min(3),
        panels,
        panel_size: (360, 290),
    }
}

fn bands(label: &str, points: Vec<(f64, f64, f64)>) -> Vec<Band> {
    match points.is_empty() {
        true => Vec::new(),
        false => vec![Band { label: label.into(), style: Style::Analysis, points }],
    }
}

/// A point of the rod at every step: its free end, or its middle where the end is held.
fn rod_through_time(of: &AgainstTime) -> Option<(String, Figure)> {
    let (shapes, geometry) = (of.shapes?, of.experiment.state.geometry.as_ref()?);
    let grid = &of.experiment.grid;
    let last = geometry.arc_lengths.len().checked_sub(1)?;
    let (vertex, at) = match geometry.free.binary_search(&last) {
        Ok(at) => (last, at),
        Err(_) => {
            let at = geometry.free.len() / 2;
            (*geometry.free.get(at)?, at)
        }
    };
    let s = geometry.arc_lengths[vertex];
    let name = match vertex == last {
        true => "the free end, every step".to_string(),
        false => format!("the rod at s = {s:.4} m, every step"),
    };
    let runs = [
        ("truth", Style::Truth, &shapes.truth),
        ("background", Style::Background, &shapes.background),
        ("analysis", Style::Analysis, &shapes.analysis),
    ];
    let panel = |c: usize| {
        let line = |(label, style, run): &(&str, Style, &Vec<Vec<[f64; 3]>>)| Series {
            label: (*label).into(),
            style: *style,
            points: run.iter().enumerate().map(|(k, shape)| (grid.time(k), shape[vertex][c])).collect(),
        };
        let band = |(k, shape): (usize, &Vec<[f64; 3]>)| {
            let two = 2.0 * of.trajectories.state(of.sigma, k)?.get(3 * at + c)?;
            two.is_finite().then(|| (grid.time(k), shape[vertex][c] - two, shape[vertex][c] + two))
        };
        let band: Vec<_> = shapes.analysis.iter().enumerate().filter_map(band).collect();
        Panel {
            x_label: "time [s]".into(),
            y_label: format!("{} [m]", ["x", "y", "z"][c]),
            bands: bands("analysis ± 2σ", band),
            series: runs.iter().map(line).filter(|s| !s.points.is_empty()).collect(),
            ..Panel::default()
        }
    };
    let figure = Figure {
        name: "end".into(),
        title: format!("Place of {name}"),
        panels: (0..3).map(panel).collect(),
        columns: 3,
        panel_size: (360, 290),
    };
    Some((name, figure))
}

/// (y − H(x_a))/σ of every value against time: 95 % are expected between −2 and 2.
pub(super) fn departures(outcome: &Outcome) -> Option<Figure> {
    let all = tracks(&outcome.observed);
    if outcome.experiment.grid.last_step() == 0 || all.is_empty() {
        return None;
    }
    let departure = |v: &&ObservedValue| (v.time, (v.value - v.analysis) / v.sigma);
    let mut series: Vec<Series> = Vec::new();
    for (i, track) in all.iter().enumerate() {
        let points = track.values.iter().filter(|v| v.used).map(departure);
        if i < MOST_COLOURS {
            series.push(Series {
                label: track.label.into(),
                style: Style::Dots(i),
                points: points.collect(),
            });
        } else if i == MOST_COLOURS {
            series.push(Series { label: "others".into(), style: Style::Dots(i), points: points.collect() });
        } else {
            series[MOST_COLOURS].points.extend(points);
        }
    }
    let mut add = |label: &str, style, keep: &dyn Fn(&ObservedValue) -> bool| {
        let points: Vec<_> = outcome.observed.iter().filter(|v| keep(v)).map(|v| departure(&v)).collect();
        if !points.is_empty() {
            series.push(Series { label: label.into(), style, points });
        }
    };
    add("kept back or later", Style::Withheld, &|v| !v.used && v.reason != "background check");
    add("refused", Style::Refused, &|v| v.reason == "background check");
    series.retain(|s| !s.points.is_empty());
    let times = outcome.observed.iter().map(|v| v.time);
    let (first, last) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), t| (l.min(t), h.max(t)));
    let expected = vec![(first, -2.0, 2.0), (last, -2.0, 2.0)];
    Some(Figure {
        name: "departures".into(),
        title: "Departures of the analysis, (y − H)/σ, against time: 95 % are expected between −2 and \
                2. Far from 0 the scale is logarithmic"
            .into(),
        panels: vec![Panel {
            x_label: if outcome.shapes.is_some() { "time [s]" } else { "time" }.into(),
            y_label: "(y − H)/σ".into(),
            legend: Some(Corner::Top),
            bands: bands("expected", expected),
            symlog_y: true,
            series,
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (920, 320),
    })
}

/// Degrees of freedom for signal that the values of each time brought.
pub(super) fn information(outcome: &Outcome) -> Option<Figure> {
    let brought = |v: &ObservedValue| Some((v.time, (v.sigma_analysis? / v.sigma).powi(2)));
    let mut all: Vec<(f64, f64)> = outcome.observed.iter().filter(|v| v.used).filter_map(brought).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (time, share) in all {
        match points.last_mut() {
            Some(last) if (last.0 - time).abs() <= 1e-12 * time.abs() => last.1 += share,
            _ => points.push((time, share)),
        }
    }
    (points.len() > 1).then(|| Figure {
        name: "information".into(),
        title: "Information by time of observation: degrees of freedom for signal that the values of a time \
                brought"
            .into(),
        panels: vec![Panel {
            x_label: if outcome.shapes.is_some() { "time [s]" } else { "time" }.into(),
            y_label: "degrees of freedom".into(),
            series: vec![Series { label: "brought".into(), style: Style::Marked(0), points }],
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (760, 260),
    })
}
