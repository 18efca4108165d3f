//! What a sequence of windows leaves behind.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use crate::Error;
use crate::report::folder::Output;
use crate::run::cycles::{Outcome, Row, Sequence};
use crate::run::window::WorkCounts;

use super::html::{document, escape, list, numbers, short, status_words, tile_list};
use super::plot::{Corner, Figure, Panel, Series, Style};
use super::summary::{Horizon, peak_bytes};
use super::tables::{self, number, optional};

/// Writes the result of a sequence to `folder`, whole or not at all: summary.json, cycles.csv, analysis.csv of the last window,
/// trajectory.csv of the sequence, report.html and its figures.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Write`], [`Error::Plot`].
pub fn write_cycles(sequence: &mut Sequence, outcome: &Outcome, folder: &Path) -> Result<PathBuf, Error> {
    let out = Output::begin(folder)?;
    // The grid of what was done, which may be less than was asked for.
    sequence.problem.window.steps = outcome.cycles.last().map_or(0, |r| r.first_step + sequence.window);
    let mut drawn = Vec::new();
    for figure in figures(sequence, outcome) {
        let svg = figure.svg()?;
        out.write(&format!("figures/{}.svg", figure.name), &svg)?;
        drawn.push((figure.title, svg));
    }
    let summary = summary(sequence, outcome);
    out.write("report.html", &page(sequence, outcome, &drawn))?;
    out.write("summary.json", &format!("{summary:#}\n"))?;
    out.write("cycles.csv", &rows(sequence, &outcome.cycles))?;
    out.write("analysis.csv", &analysis(sequence, outcome))?;
    out.write("trajectory.csv", &tables::trajectory(&mut sequence.problem, &outcome.trajectories)?)?;
    out.publish()
}

fn is_rod(sequence: &Sequence) -> bool {
    sequence.problem.scene.model_is_rod()
}

/// The four numbers of an error or a spread, by column of cycles.csv.
type Pairs<'a> = [(&'static str, &'a dyn Fn(&Row) -> [Option<f64>; 2]); 4];

const PAIRS: Pairs = [
    ("spread", &|r| r.spread),
    ("rmse_background", &|r| r.rmse_background),
    ("rmse_start", &|r| r.rmse_start),
    ("rmse_end", &|r| r.rmse_end),
];

/// cycles.csv. A rod's RMSE and spread are those of positions \[m\]; those of velocities [m/s] are columns of their own.
fn rows(sequence: &Sequence, rows: &[Row]) -> String {
    let mut out = String::from(
        "cycle,first_step,time_s,j,j_b,j_o,observations,chi2,status,outer_iterations,model_steps,tangent_steps,adjoint_steps",
    );
    let kinds = if is_rod(sequence) { 2 } else { 1 };
    for kind in &["", "velocity_"][..kinds] {
        PAIRS.iter().for_each(|(name, _)| out.push_str(&format!(",{kind}{name}")));
    }
    out.push_str(",seconds\n");
    for r in rows {
        let costs = [r.time, r.j, r.j_b, r.j_o].map(number).join(",");
        let c = &r.counts;
        let _ = write!(
            out,
            "{},{},{costs},{},{},{},{},{},{},{}",
            r.cycle,
            r.first_step,
            r.observations,
            number(r.chi2),
            r.status.name(),
            r.outer_iterations,
            c.model_steps,
            c.tangent_steps,
            c.adjoint_steps
        );
        for kind in 0..kinds {
            PAIRS.iter().for_each(|(_, of)| out.push_str(&format!(",{}", optional(of(r)[kind]))));
        }
        let _ = writeln!(out, ",{}", number(r.seconds));
    }
    out
}

/// analysis.csv: x_b, x_a and, where it is known, the truth at the start of the last window.
fn analysis(sequence: &Sequence, outcome: &Outcome) -> String {
    let Some(last) = outcome.cycles.last() else { return String::new() };
    let truth = sequence.true_state(last.first_step);
    let mut out = String::from("index,name,unit,x_b,x_a");
    out.push_str(if truth.is_some() { ",truth\n" } else { "\n" });
    for (i, (name, unit)) in tables::components(&sequence.problem).iter().enumerate() {
        let _ = write!(out, "{i},{name},{unit},{},{}", number(last.background[i]), number(last.analysis[i]));
        if let Some(truth) = truth {
            let _ = write!(out, ",{}", number(truth[i]));
        }
        out.push('\n');
    }
    out
}

fn summary(sequence: &Sequence, outcome: &Outcome) -> serde_json::Value {
    let (problem, cycles) = (&sequence.problem, &sequence.cycles);
    let algorithm = &problem.scene.algorithm;
    let means = &outcome.means;
    let mut rmse = serde_json::Map::new();
    for (i, kind) in ["position", "velocity"].iter().enumerate() {
        rmse.insert(format!("{kind}_background"), means.rmse_background[i].into());
        rmse.insert(format!("{kind}_analysis"), means.rmse_start[i].into());
        rmse.insert(format!("{kind}_end"), means.rmse_end[i].into());
        rmse.insert(format!("{kind}_spread"), means.spread[i].into());
    }
    serde_json::json!({
        "scene": problem.name,
        "seed": problem.scene.seed,
        "version": env!("CARGO_PKG_VERSION"),
        "method": algorithm.method.name(),
        "minimizer": algorithm.solver_name(),
        "status": outcome.status.name(),
        "n_state": outcome.trajectories.dim,
        "n_control": problem.control_dim(),
        "n_obs": outcome.cycles.iter().map(|r| r.observations).sum::<usize>(),
        "counts": work(outcome),
        "chi2": means.chi2,
        "rmse": rmse,
        "cycles": {
            "count": outcome.cycles.len(),
            "asked_for": cycles.count,
            "window": sequence.window,
            "shift": sequence.shift,
            "covariance": cycles.covariance_of(algorithm.method).name(),
            "spin_up": cycles.spin_up,
            "counted": means.count,
            "rmse_background": means.rmse_background[0],
            "rmse_start": means.rmse_start[0],
            "rmse_end": means.rmse_end[0],
            "spread": means.spread[0],
            "chi2": means.chi2,
            "not_converged": outcome.cycles.iter().filter(|r| r.status != crate::run::window::Status::Converged).count(),
            "failures": failures(outcome),
            "seconds_each": means.seconds,
        },
        "amplification": outcome.amplification.map(Horizon::from),
        "seconds": { "total": outcome.seconds },
        "peak_bytes": peak_bytes(),
        "left_out": problem.left_out,
        "warnings": outcome.warnings,
    })
}

/// Minimizations that failed or stalled because the model did.
fn failures(outcome: &Outcome) -> Vec<serde_json::Value> {
    let failed = outcome.cycles.iter().filter_map(|r| Some((r.cycle, r.failure.as_ref()?)));
    failed.map(|(cycle, reason)| serde_json::json!({ "cycle": cycle, "reason": reason })).collect()
}

fn work(outcome: &Outcome) -> WorkCounts {
    outcome.cycles.iter().fold(WorkCounts::default(), |sum, r| sum + r.counts)
}

/// RMSE and spread against the cycle (of positions and of velocities for a rod), and χ² with its mean.
fn figures(sequence: &Sequence, outcome: &Outcome) -> Vec<Figure> {
    let rows = &outcome.cycles;
    let spin_up = sequence.cycles.spin_up;
    let line = |label: &str, style, of: &dyn Fn(&Row) -> Option<f64>| Series {
        label: label.into(),
        style,
        points: rows.iter().filter_map(|r| Some((r.cycle as f64, of(r)?))).collect(),
    };
    let panel = |y_label: String, series: Vec<Series>| Panel {
        x_label: "cycle".into(),
        y_label,
        legend: Some(Corner::Top),
        series: series.into_iter().filter(|s| !s.points.is_empty()).collect(),
        ..Panel::default()
    };
    let units: &[(usize, &str)] =
        if is_rod(sequence) { &[(0, " of position [m]"), (1, " of velocity [m/s]")] } else { &[(0, "")] };
    let errors: Vec<Panel> = units
        .iter()
        .map(|(i, unit)| {
            panel(
                format!("RMSE, spread{unit}"),
                vec![
                    line("background, start of the window", Style::Background, &|r| r.rmse_background[*i]),
                    line("analysis, start of the window", Style::Line(2), &|r| r.rmse_start[*i]),
                    line("analysis, end of the window", Style::Analysis, &|r| r.rmse_end[*i]),
                    line("spread expected at the end", Style::Truth, &|r| r.spread[*i]),
                ],
            )
        })
        .filter(|p| !p.series.is_empty())
        .collect();
    let observed = |r: &Row| (r.observations > 0).then_some(r.chi2);
    let mut chi2 = vec![
        line("2J/m", Style::Analysis, &observed),
        line("expected: 1", Style::Truth, &|r| observed(r).map(|_| 1.0)),
    ];
    if let Some(mean) = outcome.means.chi2 {
        let label = format!("mean {mean:.3}");
        chi2.push(line(&label, Style::Background, &|r| (r.cycle >= spin_up).then_some(mean)));
    }
    let wide = |columns: usize| (if columns > 1 { 460 } else { 920 }, 320);
    let mut figures = Vec::new();
    if !errors.is_empty() {
        let columns = errors.len();
        figures.push(Figure {
            name: "errors",
            title: "Error and spread against the cycle".into(),
            panels: errors,
            columns,
            panel_size: wide(columns),
        });
    }
    figures.push(Figure {
        name: "chi2",
        title: "Cost against the number of observations: 2J/m is about 1 where B and R are right".into(),
        panels: vec![panel("2J/m".into(), chi2)],
        columns: 1,
        panel_size: wide(1),
    });
    figures
}

fn page(sequence: &Sequence, outcome: &Outcome, figures: &[(String, String)]) -> String {
    let problem = &sequence.problem;
    let scene = &problem.scene;
    let title = if scene.title.is_empty() { &problem.name } else { &scene.title };
    let (done, asked) = (outcome.cycles.len(), sequence.cycles.count);
    let mut body = format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · seed {} · {} by {}, {done} of {asked} cycles, B {} · <span class=\"status {}\">{}</span></p></header>",
        escape(title),
        escape(&problem.name),
        scene.seed,
        scene.algorithm.method.name(),
        scene.algorithm.solver_name(),
        sequence.cycles.covariance_of(scene.algorithm.method).name(),
        outcome.status.name(),
        status_words(outcome.status),
    );
    body.push_str(&tiles(sequence, outcome));
    if !outcome.warnings.is_empty() {
        let _ = write!(
            body,
            "<section class=\"notes\"><h2>What to know</h2>{}</section>",
            list(&outcome.warnings)
        );
    }
    for (title, svg) in figures {
        let _ = write!(
            body,
            "<figure><div class=\"scroll\">{svg}</div><figcaption>{}</figcaption></figure>",
            escape(title)
        );
    }
    body.push_str(&in_numbers(sequence, outcome));
    let toml = toml::to_string(scene).unwrap_or_default();
    let _ = write!(
        body,
        "<section><h2>What was left out</h2>{}</section>\
         <section><h2>The scene as it was run</h2><details><summary>TOML, overrides and defaults included</summary><pre>{}</pre></details></section>\
         <footer><p>Made by Varda {}. Files beside this page: summary.json, cycles.csv, analysis.csv (last window), trajectory.csv (whole sequence), figures/.</p></footer>",
        list(&problem.left_out),
        escape(&toml),
        env!("CARGO_PKG_VERSION"),
    );
    document(title, &body)
}

fn tiles(sequence: &Sequence, outcome: &Outcome) -> String {
    let means = &outcome.means;
    let mut tiles = Vec::new();
    let kinds: &[(&str, &str)] = match is_rod(sequence) {
        true => &[("Position error (RMSE)", " m"), ("Velocity error (RMSE)", " m/s")],
        false => &[("Error (RMSE)", "")],
    };
    for (i, (name, unit)) in kinds.iter().enumerate() {
        if let (Some(b), Some(e)) = (means.rmse_background[i], means.rmse_end[i]) {
            let note = match means.spread[i] {
                Some(spread) => format!("background, analysis at the end; spread {}", short(spread)),
                None => "background, analysis at the end of a window".into(),
            };
            tiles.push((name.to_string(), format!("{}, {}{unit}", short(b), short(e)), note));
        }
    }
    if let Some(chi2) = means.chi2 {
        tiles.push(("2J/m".into(), format!("{chi2:.3}"), "about 1 is expected".into()));
    }
    tiles.push((
        "Cycles".into(),
        format!("{}", outcome.cycles.len()),
        format!("{} of them in the means", means.count),
    ));
    let each = means.seconds.map_or(String::new(), |s| format!("{} s a cycle", short(s)));
    tiles.push(("Time".into(), format!("{:.2} s", outcome.seconds), each));
    tile_list(&tiles)
}

fn in_numbers(sequence: &Sequence, outcome: &Outcome) -> String {
    let (problem, means) = (&sequence.problem, &outcome.means);
    let shown = |v: Option<f64>| v.map_or("–".to_string(), short);
    let c = work(outcome);
    let mut rows: Vec<(&str, String, &str)> = vec![
        ("State, control", format!("{}, {}", outcome.trajectories.dim, problem.control_dim()), "numbers"),
        (
            "Window, shift",
            format!("{}, {} steps of {}", sequence.window, sequence.shift, short(problem.window.step)),
            "s",
        ),
        ("Cycles done, in the means", format!("{}, {}", outcome.cycles.len(), means.count), ""),
        (
            "Observed values m, in all",
            outcome.cycles.iter().map(|r| r.observations).sum::<usize>().to_string(),
            "",
        ),
        ("2J/m, mean", shown(means.chi2), ""),
    ];
    let kinds: &[(&str, &str, &str)] = match is_rod(sequence) {
        true => &[
            ("RMSE of position: background, start, end", "Spread of position", "m"),
            ("RMSE of velocity: background, start, end", "Spread of velocity", "m/s"),
        ],
        false => &[("RMSE: background, start, end", "Spread", "")],
    };
    for (i, (rmse, spread, unit)) in kinds.iter().enumerate() {
        if means.rmse_end[i].is_some() {
            let three = [means.rmse_background[i], means.rmse_start[i], means.rmse_end[i]].map(shown);
            rows.push((rmse, three.join(", "), unit));
        }
        if means.spread[i].is_some() {
            rows.push((spread, shown(means.spread[i]), unit));
        }
    }
    rows.extend([
        (
            "Model steps, tangent, adjoint",
            format!("{}, {}, {}", c.model_steps, c.tangent_steps, c.adjoint_steps),
            "",
        ),
        ("Factorizations, Newton iterations", format!("{}, {}", c.factorizations, c.newton_iterations), ""),
        ("Time, a cycle of it", format!("{:.3}, {}", outcome.seconds, shown(means.seconds)), "s"),
        ("Peak memory", peak_bytes().map_or("–".into(), |b| format!("{:.1}", b as f64 / 1e6)), "MB"),
    ]);
    numbers(&rows)
}
