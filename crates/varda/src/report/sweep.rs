//! The tables and the page of a study: sweep.csv, sweep-means.csv, report.html, summary.json.

use std::path::Path;

use super::chart::{Band, Corner, Figure, Panel, Series, Style};
use super::markup::{escape, short, table as html_table};
use super::page::{Page, PageData};
use super::plot::{PAGE, PAGE_DATA};
use super::tables::{number, optional};
use crate::Error;
use crate::sweep::grid::Plan;
use crate::sweep::runs::write_whole;
use crate::sweep::table::{Combination, Mean, Row, Table};

/// Most failures on the page; sweep.csv has all.
const MOST_FAILURES: usize = 20;

/// Most curves that are drawn with their intervals.
const MOST_BANDS: usize = 4;

/// Writes the tables and the page of a study into its folder, each file whole or not at all.
///
/// # Errors
/// [`Error::Write`].
pub fn write_sweep(plan: &Plan, table: &Table, folder: &Path) -> Result<(), Error> {
    write_whole(&folder.join("sweep.csv"), &runs_csv(table))?;
    write_whole(&folder.join("sweep-means.csv"), &means_csv(table))?;
    let page = page(plan, table);
    let mut data = Vec::new();
    page.write(&mut data).map_err(|reason| Error::Write { path: folder.join(PAGE_DATA), reason })?;
    write_whole(&folder.join(PAGE_DATA), &String::from_utf8_lossy(&data))?;
    write_whole(&folder.join(PAGE), &page.html())?;
    write_whole(&folder.join("summary.json"), &format!("{:#}\n", summary_of_sweep(plan, table)))
}

/// summary.json of a study.
pub fn summary_of_sweep(plan: &Plan, table: &Table) -> serde_json::Value {
    serde_json::json!({
        "scene": plan.scene,
        "version": plan.version,
        "method": "sweep",
        "status": "converged",
        "swept": plan.swept,
        "seeds": plan.seeds,
        "runs": table.rows.len(),
        "failures": table.failures(),
        "table": table,
    })
}

/// sweep.csv: a row for every run. Seconds, which no two studies have alike, are in the last column.
fn runs_csv(table: &Table) -> String {
    let mut header = vec!["run".to_string()];
    header.extend(table.keys.iter().cloned());
    header.extend(["seed", "verdict", "status", "chi2"].map(String::from));
    header.extend(table.rmse.iter().map(|name| format!("rmse_{name}")));
    for name in &table.constants {
        header.extend([name.clone()]);
        header.extend(["sigma", "truth", "within"].map(|what| format!("{name}_{what}")));
    }
    let last = ["forecast_background", "forecast_analysis", "state_within", "state_values", "exit_code"];
    header.extend(last.map(String::from));
    header.extend(["error", "seconds"].map(String::from));
    let row = |r: &Row| {
        let mut cells = vec![r.index.to_string()];
        cells.extend(r.values.iter().cloned());
        cells.extend([r.seed.to_string(), r.verdict.clone(), r.status.clone(), optional(r.chi2)]);
        cells.extend(r.rmse.iter().map(|error| optional(*error)));
        for constant in &r.constants {
            let numbers = [constant.map(|c| c.value), constant.and_then(|c| c.sigma)];
            cells.extend(numbers.map(optional));
            cells.push(optional(constant.and_then(|c| c.truth)));
            let within = constant.and_then(|c| c.within);
            cells.push(within.map_or(String::new(), |within| u8::from(within).to_string()));
        }
        cells.extend(r.forecast.map(optional));
        cells.extend([0, 1].map(|i| r.state_within.map_or(String::new(), |n| n[i].to_string())));
        cells.push(r.exit_code.map_or(String::new(), |code| code.to_string()));
        cells.extend([r.error.clone().unwrap_or_default(), number(r.seconds)]);
        cells
    };
    csv_of(std::iter::once(header).chain(table.rows.iter().map(row)))
}

/// sweep-means.csv: a row for every combination; `_se` is the standard error of a mean.
fn means_csv(table: &Table) -> String {
    let mut header = table.keys.clone();
    header.extend(["runs", "failures", "fits"].map(String::from));
    let of_mean = |name: &str| [name.to_string(), format!("{name}_se")];
    header.extend(of_mean("chi2"));
    table.rmse.iter().for_each(|name| header.extend(of_mean(&format!("rmse_{name}"))));
    for name in &table.constants {
        header.extend(of_mean(name));
        header.extend(of_mean(&format!("{name}_error")));
        header.push(format!("{name}_coverage"));
    }
    ["forecast_background", "forecast_analysis"].iter().for_each(|name| header.extend(of_mean(name)));
    header.extend(["state_coverage", "seconds_median"].map(String::from));
    let mean = |m: &Mean| [optional(m.mean), optional(m.standard_error)];
    let row = |c: &Combination| {
        let mut cells = c.values.clone();
        cells.extend([c.runs, c.failures, c.fits].map(|n| n.to_string()));
        cells.extend(mean(&c.chi2));
        cells.extend(c.rmse.iter().flat_map(mean));
        for constant in &c.constants {
            cells.extend(mean(&constant.value).into_iter().chain(mean(&constant.error)));
            cells.push(optional(constant.coverage));
        }
        cells.extend(c.forecast.iter().flat_map(mean));
        cells.extend([c.state_coverage, c.seconds_median].map(optional));
        cells
    };
    csv_of(std::iter::once(header).chain(table.combinations.iter().map(row)))
}

fn csv_of(rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        // Memory can be written to, and all rows have the cells of the header.
        let _ = writer.write_record(row);
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

fn page(plan: &Plan, table: &Table) -> PageData {
    let title = if plan.title.is_empty() { &plan.scene } else { &plan.title };
    let mut page = Page::new(title);
    let fits: usize = table.combinations.iter().map(|c| c.fits).sum();
    page.push(&format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · {} combinations · {} seeds \
         each</p></header><p class=\"verdict\"><strong>SWEPT</strong> {} runs: {fits} fit, {} failed.</p>",
        escape(title),
        escape(&plan.scene),
        table.combinations.len(),
        plan.seeds.len(),
        table.rows.len(),
        table.failures(),
    ));
    let errors = errors(table);
    for key in 0..table.keys.len() {
        against_key(table, key, &errors).into_iter().for_each(|figure| page.figure(figure));
    }
    against_seconds(table, &errors).into_iter().for_each(|figure| page.figure(figure));
    page.push(&combinations(table));
    page.push(&failures(table));
    page.push(&format!(
        "<section><h2>The scene before keys were set</h2><details><summary>TOML</summary><pre>{}</pre>\
         </details></section><footer><p>Made by Varda {}. Files beside this page: summary.json, sweep.csv, \
         sweep-means.csv, sweep.json, and runs with the summary of every run.</p></footer>",
        escape(&plan.text),
        env!("CARGO_PKG_VERSION")
    ));
    page.finish()
}

/// What a chart shows of the combinations: its label and a mean of each.
struct Measure {
    label: String,
    means: Vec<Mean>,
}

/// RMSE of analyses where the truth is known; else the constants; else 2J/m.
fn errors(table: &Table) -> Vec<Measure> {
    let of = |label: String, mean: &dyn Fn(&Combination) -> Mean| Measure {
        label,
        means: table.combinations.iter().map(mean).collect(),
    };
    let rmse = table.rmse.iter().enumerate().filter(|(_, name)| name.ends_with("_analysis"));
    let rmse = rmse.map(|(i, name)| of(format!("RMSE, {}", name.replace('_', " ")), &|c| c.rmse[i]));
    let constants = table.constants.iter().enumerate();
    let constants = constants.map(|(i, name)| of(name.clone(), &|c| c.constants[i].value));
    let mut all: Vec<Measure> = rmse.chain(constants).collect();
    all.retain(|measure| measure.means.iter().any(|m| m.mean.is_some()));
    if all.is_empty() {
        all.push(of("2J/m".into(), &|c| c.chi2));
    }
    all
}

/// Errors and seconds against a key whose values are two numbers at least; a curve for each combination of
/// the other keys.
fn against_key(table: &Table, key: usize, errors: &[Measure]) -> Option<Figure> {
    let value = |c: &Combination| c.values[key].parse::<f64>().ok().filter(|x| x.is_finite());
    let x: Option<Vec<f64>> = table.combinations.iter().map(value).collect();
    let x = x.filter(|x| x.iter().any(|v| *v != x[0]))?;
    let others = |c: &Combination| {
        let all = table.keys.iter().zip(&c.values).enumerate().filter(|(i, _)| *i != key);
        all.map(|(_, (name, value))| format!("{name} = {value}")).collect::<Vec<_>>().join(", ")
    };
    let mut curves: Vec<(String, Vec<usize>)> = Vec::new();
    for (i, c) in table.combinations.iter().enumerate() {
        let name = others(c);
        match curves.iter_mut().find(|(known, _)| *known == name) {
            Some((_, members)) => members.push(i),
            None => curves.push((name, vec![i])),
        }
    }
    curves.iter_mut().for_each(|(_, members)| members.sort_by(|a, b| x[*a].total_cmp(&x[*b])));
    let name = &table.keys[key];
    let (least, largest) = x.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
    let is_wide = least > 0.0 && largest >= 10.0 * least;
    let named = curves.len() > 1;
    // More areas than this hide one another.
    let shown = if curves.len() <= MOST_BANDS { &curves[..] } else { &[] };
    let panel = |y_label: &str, mean: &dyn Fn(usize) -> Mean| {
        let points = |members: &[usize]| -> Vec<(f64, f64)> {
            members.iter().filter_map(|i| Some((x[*i], mean(*i).mean?))).collect()
        };
        let band = |members: &[usize]| -> Vec<(f64, f64, f64)> {
            let ends = |i: &usize| {
                let m = mean(*i);
                let half = 1.96 * m.standard_error?;
                Some((x[*i], m.mean? - half, m.mean? + half))
            };
            members.iter().filter_map(ends).collect()
        };
        let curve = |(i, (name, members)): (usize, &(String, Vec<usize>))| Series {
            label: if named { name.clone() } else { y_label.to_string() },
            style: Style::Marked(i),
            points: points(members),
        };
        let area = |(i, (name, members)): (usize, &(String, Vec<usize>))| Band {
            label: if named { format!("{name}, 95 % interval") } else { "95 % interval".into() },
            style: Style::Marked(i),
            points: band(members),
        };
        Panel {
            x_label: name.clone(),
            y_label: y_label.to_string(),
            log_x: is_wide,
            legend: named.then_some(Corner::Top),
            bands: shown.iter().enumerate().map(area).filter(|band| band.points.len() > 1).collect(),
            series: curves.iter().enumerate().map(curve).collect(),
            ..Panel::default()
        }
    };
    let mut panels: Vec<Panel> =
        errors.iter().map(|measure| panel(&measure.label, &|i| measure.means[i])).collect();
    let seconds = |i: usize| Mean {
        count: table.combinations[i].runs,
        mean: table.combinations[i].seconds_median,
        standard_error: None,
    };
    panels.push(panel("seconds, median", &seconds));
    Some(Figure {
        name: format!("against-{name}"),
        title: format!("Means over seeds with their 95 % intervals, and seconds, against {name}"),
        columns: panels.len().min(2),
        panels,
        panel_size: (460, 320),
    })
}

/// The first error against seconds, a point for each combination.
fn against_seconds(table: &Table, errors: &[Measure]) -> Option<Figure> {
    let measure = errors.first()?;
    let point = |(c, mean): (&Combination, &Mean)| Some((c.seconds_median?, mean.mean?));
    let points: Vec<(f64, f64)> = table.combinations.iter().zip(&measure.means).filter_map(point).collect();
    (points.len() > 1).then(|| Figure {
        name: "against-seconds".into(),
        title: format!("{} against the median of seconds, a point for each combination", measure.label),
        panels: vec![Panel {
            x_label: "seconds, median".into(),
            y_label: measure.label.clone(),
            series: vec![Series { label: measure.label.clone(), style: Style::Observation, points }],
            ..Panel::default()
        }],
        columns: 1,
        panel_size: (760, 320),
    })
}

/// The table of combinations.
fn combinations(table: &Table) -> String {
    let mean = |m: &Mean| match (m.mean, m.standard_error) {
        (Some(mean), Some(error)) => format!("{} ± {}", short(mean), rough(error)),
        (Some(mean), None) => short(mean),
        (None, _) => "–".into(),
    };
    let share = |share: Option<f64>| share.map_or("–".into(), |s| format!("{:.1} %", 100.0 * s));
    let mut headings: Vec<String> = table.keys.iter().map(|key| escape(key)).collect();
    headings.extend(["runs", "failed", "fit", "2J/m"].map(String::from));
    headings.extend(table.rmse.iter().map(|name| format!("RMSE {}", escape(&name.replace('_', " ")))));
    for name in &table.constants {
        headings.extend([escape(name), format!("{}: truth in 95 %", escape(name))]);
    }
    let has_forecast = table.combinations.iter().any(|c| c.forecast[1].mean.is_some());
    if has_forecast {
        headings.push("forecast [m]".into());
    }
    headings.extend(["state: truth in 95 %", "seconds"].map(String::from));
    let row = |c: &Combination| {
        let mut cells: Vec<String> = c.values.iter().map(|value| escape(value)).collect();
        cells.extend([c.runs, c.failures, c.fits].map(|n| n.to_string()));
        cells.push(mean(&c.chi2));
        cells.extend(c.rmse.iter().map(mean));
        for constant in &c.constants {
            cells.extend([mean(&constant.value), share(constant.coverage)]);
        }
        if has_forecast {
            cells.push(mean(&c.forecast[1]));
        }
        cells.extend([share(c.state_coverage), c.seconds_median.map_or("–".into(), short)]);
        let cells: String = cells.iter().map(|cell| format!("<td>{cell}</td>")).collect();
        format!("<tr>{cells}</tr>")
    };
    let headings: Vec<&str> = headings.iter().map(String::as_str).collect();
    format!(
        "<section><h2>In numbers</h2>{}<p>Means over seeds ± standard errors; seconds are a \
         median.</p></section>",
        html_table(&headings, &table.combinations.iter().map(row).collect::<String>())
    )
}

/// A standard error in two significant digits.
fn rough(value: f64) -> String {
    let digits = (1.0 - value.log10().floor()).max(0.0) as usize;
    if (1e-3..1e5).contains(&value) { format!("{value:.digits$}") } else { format!("{value:.1e}") }
}

/// The runs without a result.
fn failures(table: &Table) -> String {
    let failed = table.rows.iter().filter_map(|row| Some((row, row.error.as_ref()?)));
    let row = |(row, error): (&Row, &String)| {
        format!(
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td class=\"words\">{}</td></tr>",
            row.index,
            escape(&row.values.join(", ")),
            row.seed,
            escape(error)
        )
    };
    let rows: String = failed.take(MOST_FAILURES).map(row).collect();
    if rows.is_empty() {
        return String::new();
    }
    let more = table.failures().saturating_sub(MOST_FAILURES);
    let more = if more > 0 { format!("<p>{more} more in sweep.csv.</p>") } else { String::new() };
    let table = html_table(&["run", "values", "seed", "error"], &rows);
    format!("<section><h2>Runs that failed</h2>{table}{more}</section>")
}
