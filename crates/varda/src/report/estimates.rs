//! Estimated constants: a table with intervals and correlations for the page, and estimates.csv.

use std::fmt::Write;

use super::html::{escape, short, table};
use super::tables::{number, optional};
use crate::outcome::Estimated;

/// More constants than this have no table of correlations.
const MOST_CORRELATED: usize = 12;

/// The section of the page; empty where nothing was estimated.
pub(super) fn section(all: &[Estimated]) -> String {
    if all.is_empty() {
        return String::new();
    }
    let rows: String = all.iter().map(row).collect();
    let headings = [
        "constant",
        "unit",
        "prior ± σ",
        "analysis ± σ",
        "95 % interval",
        "",
        "of σ for the \
        mesh",
    ];
    format!(
        "<section><h2>Estimated constants</h2>{}<p>The bar is the 95 % interval within that of the prior; \
         the mark is the analysis.</p>{}</section>",
        table(&headings, &rows),
        correlations(all)
    )
}

fn row(e: &Estimated) -> String {
    let with = |value: f64, sigma: Option<f64>| match sigma {
        Some(sigma) => format!("{} ± {}", short(value), short(sigma)),
        None => short(value),
    };
    let seen = e.identifiable != Some(false);
    let analysis = if seen { with(e.value, e.sigma) } else { "not identifiable".to_string() };
    let interval = e.interval.filter(|_| seen);
    format!(
        "<tr><th \
            scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
        escape(&e.name),
        if e.unit == "1" { "–" } else { e.unit },
        with(e.prior, Some(e.prior_sigma)),
        analysis,
        interval.map_or("–".into(), |[low, high]| format!("{} to {}", short(low), short(high))),
        interval.map_or(String::new(), |interval| bar(e, interval)),
        e.mesh.map_or("–".into(), short)
    )
}

/// An interval within ± 2σ of the prior.
fn bar(e: &Estimated, [low, high]: [f64; 2]) -> String {
    let width = 4.0 * e.prior_sigma;
    let place = |v: f64| (100.0 * ((v - e.prior) / width + 0.5)).clamp(0.0, 100.0);
    let (from, to) = (place(low.min(high)), place(high.max(low)));
    let text = format!("{}: {} to {}", e.name, short(low), short(high));
    format!(
        "<svg viewBox=\"0 0 100 10\" width=\"120\" height=\"12\" style=\"max-width:none\" role=\"img\" \
         aria-label=\"{0}\"><title>{0}</title><line x1=\"0\" y1=\"5\" x2=\"100\" y2=\"5\" \
         stroke=\"currentColor\" stroke-opacity=\"0.25\"/><rect x=\"{from:.1}\" y=\"3\" width=\"{1:.1}\" \
         height=\"4\" fill=\"#0072b2\"/><line x1=\"{2:.1}\" y1=\"1\" x2=\"{2:.1}\" y2=\"9\" \
         stroke=\"currentColor\"/></svg>",
        escape(&text),
        (to - from).max(0.8),
        place(e.value)
    )
}

/// The lower triangle of their correlations.
fn correlations(all: &[Estimated]) -> String {
    let n = all.len();
    if !(2..=MOST_CORRELATED).contains(&n) || all.iter().any(|e| e.correlations.len() != n) {
        return String::new();
    }
    let mut rows = String::new();
    for (i, e) in all.iter().enumerate() {
        let _ = write!(rows, "<tr><th scope=\"row\">{}</th>", escape(&e.name));
        for (j, c) in e.correlations.iter().enumerate() {
            let text = if j < i { format!("{c:.3}") } else { String::new() };
            let shade = if j < i { c.abs() } else { 0.0 };
            let colour = if *c < 0.0 { "213,94,0" } else { "0,114,178" };
            let _ = write!(rows, "<td style=\"background:rgba({colour},{:.2})\">{text}</td>", 0.6 * shade);
        }
        rows.push_str("</tr>");
    }
    let names: Vec<String> = all.iter().map(|e| escape(&e.name)).collect();
    let headings: Vec<&str> =
        std::iter::once("correlation").chain(names.iter().map(String::as_str)).collect();
    format!("<h3>Correlations of the analysis</h3>{}", table(&headings, &rows))
}

/// estimates.csv: prior, analysis and interval of every constant.
pub(super) fn csv(all: &[Estimated]) -> String {
    let mut out = String::from(
        "name,unit,prior,prior_sigma,value,sigma,sigma_on_mesh,mesh,low_95,high_95,identifiable,truth\n",
    );
    for e in all {
        let (low, high) = (e.interval.map(|i| i[0]), e.interval.map(|i| i[1]));
        let numbers =
            [Some(e.prior), Some(e.prior_sigma), Some(e.value), e.sigma, e.sigma_on_mesh, e.mesh, low, high];
        let identifiable = e.identifiable.map_or("", |i| if i { "yes" } else { "no" });
        let _ = writeln!(
            out,
            "\"{}\",{},{},{identifiable},{}",
            e.name,
            e.unit,
            numbers.map(optional).join(","),
            e.truth.map_or(String::new(), number)
        );
    }
    out
}
