//! The report of a sequence of windows.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use varda_assimilation::Departures;

use crate::Error;
use crate::outcome::{CycleRow, CyclesOutcome, Status};
use crate::state::StateGroup;

use super::chart::{Corner, Figure, Panel, Series, Style};
use super::dataset::Dataset;
use super::figures::{components_of_cycles, field, markers};
use super::folder::ResultFolder;
use super::formats::write_formats;
use super::markup::{
    error_name, escape, folded_numbers, list, scene_section, short, status_words, tile_list, verdict,
};
use super::page::rod::RodView;
use super::page::{Page, PageData};
use super::plot::write_page;
use super::summary::{WindowAmplification, peak_bytes};
use super::tables::{self, number, optional};

/// Writes the result of a sequence to `folder`, whole or not at all: summary.json, cycles.csv, analysis.csv
/// of the last window, trajectory.csv and observations.csv of the sequence, report.html and its figures.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Write`], [`Error::Plot`].
pub fn write_cycles(outcome: &CyclesOutcome, folder: &Path) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    let figures = figures(outcome);
    for figure in &figures {
        out.write(&format!("figures/{}.svg", figure.name), &figure.svg()?)?;
    }
    let summary = summary_of_cycles(outcome);
    write_page(&out, "", &page(outcome, figures))?;
    out.write("summary.json", &format!("{summary:#}\n"))?;
    out.write("cycles.csv", &rows(outcome))?;
    out.write("analysis.csv", &analysis(outcome))?;
    let shapes = outcome.shapes.as_ref();
    out.write(
        "trajectory.csv",
        &tables::trajectory(&outcome.experiment, &outcome.trajectories, &outcome.sigma_states, shapes),
    )?;
    out.write("observations.csv", &tables::observed_values(&outcome.observed))?;
    write_formats(&out, "", &outcome.experiment.scene.output, || Dataset::of_cycles(outcome))?;
    out.publish()
}

/// Errors and spread of a group of the state, by column of cycles.csv.
type Columns<'a> = [(&'static str, &'a dyn Fn(&CycleRow) -> &[f64]); 5];

const COLUMNS: Columns = [
    ("spread", &|r| &r.spread),
    ("increment", &|r| &r.increment),
    ("rmse_background", &|r| &r.rmse_background),
    ("rmse_start", &|r| &r.rmse_start),
    ("rmse_end", &|r| &r.rmse_end),
];

/// cycles.csv. The columns of the first group of the state have no prefix, those of others their name: RMSE
/// and spread are those of positions \[m\] of a rod, `velocity_` columns those of velocities [m/s].
fn rows(outcome: &CyclesOutcome) -> String {
    let mut out = String::from(
        "cycle,first_step,time_s,j,j_b,j_o,j_q,observations,chi2,status,outer_iterations,\
         model_steps,tangent_steps,adjoint_steps",
    );
    let groups = &outcome.experiment.state.groups;
    for (i, group) in groups.iter().enumerate() {
        let prefix = if i == 0 { String::new() } else { format!("{}_", group.name) };
        COLUMNS.iter().for_each(|(name, _)| out.push_str(&format!(",{prefix}{name}")));
    }
    out.push_str(",innovation_ratio,observation_ratio,background_ratio,inflation,drawn_again,");
    out.push_str("columns,dropped_variance,seconds\n");
    for r in &outcome.cycles {
        let costs = [r.time, r.j, r.j_b, r.j_o, r.j_q].map(number).join(",");
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
        for i in 0..groups.len() {
            COLUMNS.iter().for_each(|(_, of)| {
                out.push_str(&format!(",{}", optional(of(r).get(i).copied())));
            });
        }
        let of = r.departures.map(Departures::from).unwrap_or_default();
        for ratio in [of.innovation_ratio(), of.observation_ratio(), of.background_ratio()] {
            let _ = write!(out, ",{}", optional(ratio));
        }
        let _ = write!(out, ",{},{},{}", number(r.inflation), r.drawn_again, r.columns);
        let _ = writeln!(out, ",{},{}", number(r.dropped), number(r.seconds));
    }
    out
}

/// analysis.csv: x_b, x_a and, where it is known, the truth at the start of the last window.
fn analysis(outcome: &CyclesOutcome) -> String {
    let Some(last) = outcome.cycles.last() else { return String::new() };
    let truth = outcome.truth_at(last);
    let mut out = String::from("index,name,unit,x_b,x_a");
    out.push_str(if truth.is_some() { ",truth\n" } else { "\n" });
    for (i, (name, unit)) in outcome.experiment.state.components().enumerate() {
        let _ = write!(out, "{i},{name},{unit},{},{}", number(last.background[i]), number(last.analysis[i]));
        if let Some(truth) = truth {
            let _ = write!(out, ",{}", number(truth[i]));
        }
        out.push('\n');
    }
    out
}

/// summary.json of a sequence.
pub fn summary_of_cycles(outcome: &CyclesOutcome) -> serde_json::Value {
    let experiment = &outcome.experiment;
    let algorithm = &experiment.scene.algorithm;
    let means = &outcome.means;
    let mut rmse = serde_json::Map::new();
    for (i, group) in experiment.state.groups.iter().enumerate() {
        let name = group.name;
        rmse.insert(format!("{name}_background"), means.rmse_background[i].into());
        rmse.insert(format!("{name}_analysis"), means.rmse_start[i].into());
        rmse.insert(format!("{name}_end"), means.rmse_end[i].into());
        rmse.insert(format!("{name}_spread"), means.spread[i].into());
    }
    let departures = Departures::from(means.departures);
    let first = |all: &[Option<f64>]| all.first().copied().flatten();
    serde_json::json!({
        "scene": experiment.name,
        "seed": experiment.scene.seed,
        "verdict": outcome.judgement.verdict,
        "verdict_text": outcome.judgement.text,
        "version": env!("CARGO_PKG_VERSION"),
        "method": algorithm.method.name(),
        "minimizer": algorithm.solver_name(),
        "status": outcome.status.name(),
        "n_state": experiment.n_state,
        "n_control": experiment.n_control(),
        "n_obs": outcome.observed_values(),
        "counts": outcome.counts(),
        "chi2": means.chi2,
        "rmse": rmse,
        "cycles": {
            "count": outcome.cycles.len(),
            "asked_for": outcome.asked_for,
            "window": outcome.window,
            "shift": outcome.shift,
            "covariance": outcome.covariance,
            "spin_up": outcome.spin_up,
            "counted": means.count,
            "rmse_background": first(&means.rmse_background),
            "rmse_start": first(&means.rmse_start),
            "rmse_end": first(&means.rmse_end),
            "spread": first(&means.spread),
            "chi2": means.chi2,
            "chi2_of_all": means.chi2_of_all,
            "innovation_ratio": departures.innovation_ratio(),
            "observation_ratio": departures.observation_ratio(),
            "background_ratio": departures.background_ratio(),
            "inflation": means.inflation,
            "drawn_again": outcome.cycles.iter().map(|r| r.drawn_again).sum::<usize>(),
            "columns": outcome.cycles.last().map_or(0, |r| r.columns),
            "dropped_variance": outcome.cycles.iter().map(|r| r.dropped).fold(0.0, f64::max),
            "not_converged": outcome.cycles.iter().filter(|r| r.status != Status::Converged).count(),
            "failures": failures(outcome),
            "seconds_each": means.seconds,
        },
        "amplification": outcome.amplification.map(WindowAmplification::from),
        "seconds": { "total": outcome.seconds },
        "peak_bytes": peak_bytes(),
        "left_out": experiment.left_out,
        "warnings": outcome.warnings,
    })
}

/// Minimizations that failed or stalled because the model did.
fn failures(outcome: &CyclesOutcome) -> Vec<serde_json::Value> {
    let failed = outcome.cycles.iter().filter_map(|r| Some((r.cycle, r.failure.as_ref()?)));
    failed.map(|(cycle, reason)| serde_json::json!({ "cycle": cycle, "reason": reason })).collect()
}

/// RMSE and spread against the cycle, a panel for each group of the state; χ² with its mean; ratios of
/// departures; the state over space and time.
fn figures(outcome: &CyclesOutcome) -> Vec<Figure> {
    let rows = &outcome.cycles;
    let line = |label: &str, style, of: &dyn Fn(&CycleRow) -> Option<f64>| Series {
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
    let of_group = |(i, group): (usize, &StateGroup)| {
        let unit = group.part().map_or(String::new(), |n| format!(" of {n}{}", group.unit_in_heading()));
        panel(
            format!("RMSE, spread{unit}"),
            vec![
                line("background, start of the window", Style::Background, &|r| {
                    r.rmse_background.get(i).copied()
                }),
                line("analysis, start of the window", Style::Line(2), &|r| r.rmse_start.get(i).copied()),
                line("analysis, end of the window", Style::Analysis, &|r| r.rmse_end.get(i).copied()),
                line("spread expected at the end", Style::Truth, &|r| r.spread.get(i).copied()),
            ],
        )
    };
    let groups = outcome.experiment.state.groups.iter().enumerate();
    let errors: Vec<Panel> = groups.map(of_group).filter(|p| !p.series.is_empty()).collect();
    let observed = |r: &CycleRow| (r.observations > 0).then_some(r.chi2);
    let mut chi2 = vec![
        line("2J/m", Style::Analysis, &observed),
        line("expected: 1", Style::Truth, &|r| observed(r).map(|_| 1.0)),
    ];
    if let Some(mean) = outcome.means.chi2 {
        let label = format!("mean {mean:.3}");
        chi2.push(line(&label, Style::Background, &|r| (r.cycle >= outcome.spin_up).then_some(mean)));
    }
    let wide = |columns: usize| (if columns > 1 { 460 } else { 920 }, 320);
    let mut figures = Vec::new();
    if !errors.is_empty() {
        let columns = errors.len();
        figures.push(Figure {
            name: "errors".into(),
            title: "Error and spread against the cycle".into(),
            panels: errors,
            columns,
            panel_size: wide(columns),
        });
    }
    figures.push(Figure {
        name: "chi2".into(),
        title: "Cost against the number of observations: 2J/m is about 1 where B and R are right".into(),
        panels: vec![panel("2J/m".into(), chi2)],
        columns: 1,
        panel_size: wide(1),
    });
    let ratio = |of: fn(&Departures) -> Option<f64>| {
        move |r: &CycleRow| of(&Departures::from(r.departures?)).filter(|v| v.is_finite())
    };
    let consistency = panel(
        "ratio".into(),
        vec![
            line("innovations", Style::Analysis, &ratio(Departures::innovation_ratio)),
            line("observations: R", Style::Line(2), &ratio(Departures::observation_ratio)),
            line("background: B", Style::Background, &ratio(Departures::background_ratio)),
            line("expected: 1", Style::Truth, &|r| r.departures.map(|_| 1.0)),
        ],
    );
    if consistency.series.len() > 1 {
        figures.push(Figure {
            name: "consistency".into(),
            title: "Consistency of every window: what departures say of innovations, R and B over what was \
                    assumed (Desroziers)"
                .into(),
            panels: vec![consistency],
            columns: 1,
            panel_size: wide(1),
        });
    }
    figures.extend(field(&outcome.experiment, &outcome.trajectories, &outcome.sigma_states));
    figures.extend(components_of_cycles(outcome));
    figures
}

fn page(outcome: &CyclesOutcome, figures: Vec<Figure>) -> PageData {
    let experiment = &outcome.experiment;
    let scene = &experiment.scene;
    let title = if scene.title.is_empty() { &experiment.name } else { &scene.title };
    let (done, asked) = (outcome.cycles.len(), outcome.asked_for);
    let mut page = Page::new(title);
    page.push(&format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · seed {} · {} by {}, {done} of {asked} \
         cycles, B {} · <span class=\"status {}\">{}</span></p></header>",
        escape(title),
        escape(&experiment.name),
        scene.seed,
        scene.algorithm.method.name(),
        scene.algorithm.solver_name(),
        outcome.covariance,
        outcome.status.name(),
        status_words(outcome.status),
    ));
    page.push(&verdict(&outcome.judgement));
    page.push(&tiles(outcome));
    if !outcome.warnings.is_empty() {
        let notes = list(&outcome.warnings);
        page.push(&format!("<section class=\"notes\"><h2>What to know</h2>{notes}</section>"));
    }
    let sigma = if outcome.sigma_states.is_empty() { "" } else { " with ±2σ around it" };
    if let Some(view) = RodView::of_cycles(outcome) {
        let caption = format!(
            "The rod through the whole sequence, the analysis{sigma}. Drag to turn it, scroll to zoom; with \
             the keyboard: arrow keys, plus and minus, Home, and the space bar to play. x is red, y green, z \
             blue."
        );
        page.rod(view, &caption, "");
    }
    let against_time = markers(outcome);
    if !against_time.is_empty() {
        page.push(&format!("<h2>The whole recording{}</h2>", sigma.replace(" around it", "")));
        page.one_of("Against time:", against_time);
    }
    figures.into_iter().for_each(|figure| page.figure(figure));
    page.push(&format!("<section><h2>What was left out</h2>{}</section>", list(&experiment.left_out)));
    page.push(&in_numbers(outcome));
    page.push(&scene_section(scene));
    page.push(&format!(
        "<footer><p>Made by Varda {}. Files beside this page: summary.json, cycles.csv, analysis.csv (last \
         window), trajectory.csv and observations.csv (whole sequence), figures/.</p></footer>",
        env!("CARGO_PKG_VERSION"),
    ));
    page.finish()
}

fn tiles(outcome: &CyclesOutcome) -> String {
    let means = &outcome.means;
    let mut tiles = Vec::new();
    for (i, group) in outcome.experiment.state.groups.iter().enumerate() {
        if let (Some(b), Some(e)) = (means.rmse_background[i], means.rmse_end[i]) {
            let note = match means.spread[i] {
                Some(spread) => format!("background, analysis at the end; spread {}", short(spread)),
                None => "background, analysis at the end of a window".into(),
            };
            let value = format!("{}, {}{}", short(b), short(e), group.unit_after());
            tiles.push((error_name(group), value, note));
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

fn in_numbers(outcome: &CyclesOutcome) -> String {
    let (experiment, means) = (&outcome.experiment, &outcome.means);
    let shown = |v: Option<f64>| v.map_or("–".to_string(), short);
    let c = outcome.counts();
    let mut rows: Vec<(&str, String, &str)> = vec![
        ("State, control", format!("{}, {}", experiment.n_state, experiment.n_control()), "numbers"),
        (
            "Window, shift",
            format!("{}, {} steps of {}", outcome.window, outcome.shift, short(experiment.grid.step)),
            "s",
        ),
        ("Cycles done, in the means", format!("{}, {}", outcome.cycles.len(), means.count), ""),
        ("Observed values m, in all", outcome.observed_values().to_string(), ""),
        ("2J/m, mean", shown(means.chi2), ""),
    ];
    let groups = &experiment.state.groups;
    let labels: Vec<[String; 2]> = groups.iter().map(labels).collect();
    for (i, (group, [rmse, spread])) in groups.iter().zip(&labels).enumerate() {
        let unit = if group.unit == "1" { "" } else { group.unit };
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
    folded_numbers(&rows)
}

/// Names of the RMSE and of the spread of a group.
fn labels(group: &StateGroup) -> [String; 2] {
    let of = group.part().map_or(String::new(), |name| format!(" of {name}"));
    [format!("RMSE{of}: background, start, end"), format!("Spread{of}")]
}
