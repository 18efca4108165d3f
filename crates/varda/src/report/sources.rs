//! What the uncertainty of a result comes from: a table for the page, and sensitivities.csv.

use std::fmt::Write;

use super::markup::{escape, short, table};
use super::tables::number;
use crate::outcome::{Considered, Sensitivity, Sources};

/// Rows of the table, the largest first; the rest go together.
const SHOWN: usize = 12;

/// The section of the page; empty where nothing is known of it.
pub(super) fn section(all: &[Sources]) -> String {
    let Some(first) = all.first() else { return String::new() };
    let of_source = |of: &Sources, source: &str| {
        let own = of.shares.iter().filter(|s| s.source == source);
        own.fold([0.0, 0.0], |sum, s| [sum[0] + s.share, sum[1] + s.by_relative_sigma])
    };
    let mut sources: Vec<&str> = first.shares.iter().map(|s| s.source.as_str()).collect();
    let largest = |source: &str| all.iter().map(|of| of_source(of, source)[0]).fold(0.0, f64::max);
    sources.sort_by(|a, b| largest(b).total_cmp(&largest(a)));
    let (shown, rest) = sources.split_at(SHOWN.min(sources.len()));
    let row = |name: &str, sums: Vec<[f64; 2]>| {
        let cell = |(of, [share, by_sigma]): (&Sources, [f64; 2])| {
            let moves = short(0.1 * by_sigma);
            format!("<td>{:.1} %<br>{moves} {}</td>", 100.0 * share.max(0.0), of.unit)
        };
        let cells: String = all.iter().zip(sums).map(cell).collect();
        format!("<tr><th scope=\"row\">{}</th>{cells}</tr>", escape(name))
    };
    let mut rows: String = shown
        .iter()
        .map(|source| row(source, all.iter().map(|of| of_source(of, source)).collect()))
        .collect();
    if !rest.is_empty() {
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        let sum = |of| rest.iter().map(|source| of_source(of, source)).fold([0.0; 2], add);
        rows.push_str(&row(&format!("{} others", rest.len()), all.iter().map(sum).collect()));
    }
    let heads: Vec<String> =
        all.iter().map(|of| format!("{}: σ = {} {}", of.of, short(of.sigma), of.unit)).collect();
    let headings: Vec<&str> = std::iter::once("share of the variance, and how far it moves")
        .chain(heads.iter().map(String::as_str))
        .collect();
    format!(
        "<section><h2>Where the uncertainty comes from</h2>{}<p>Of what is known least at the end of the \
         window{}. Errors of each marker or component, priors of constants, background of the state; \
         below its share, how far the number moves if σ of that source is 10 % larger. \
         sensitivities.csv has the derivative by every observed value.</p></section>",
        table(&headings, &rows),
        if all.iter().any(|of| of.unit == "N") { ", and of the largest tension there" } else { "" }
    )
}

/// The section on constants that are considered; empty where there are none.
pub(super) fn considered(all: &[Considered]) -> String {
    let Some(first) = all.first() else { return String::new() };
    let heads: Vec<String> = first
        .by
        .iter()
        .map(|c| match c.unit {
            "1" => format!("{}: {} ± {}", c.name, short(c.value), short(c.sigma)),
            unit => format!("{}: {} ± {} {unit}", c.name, short(c.value), short(c.sigma)),
        })
        .collect();
    let headings: Vec<&str> =
        ["", "σ", "with these"].into_iter().chain(heads.iter().map(String::as_str)).collect();
    let sigma = |sigma: Option<f64>| sigma.map_or("–".into(), short);
    let row = |of: &Considered| {
        let unit = if of.unit == "1" { String::new() } else { format!(" [{}]", of.unit) };
        let moves: String = of.by.iter().map(|c| format!("<td>{}</td>", short(c.moves))).collect();
        format!(
            "<tr><th scope=\"row\">{}{unit}</th><td>{}</td><td>{}</td>{moves}</tr>",
            escape(&of.of),
            sigma(of.sigma),
            sigma(of.sigma_with_considered)
        )
    };
    format!(
        "<section><h2>Constants taken for known</h2>{}<p>How far each number moves with one σ of a \
         constant of [consider], the analysis moving with it; σ of the number as the run has it, and with \
         these added in squares. `considered` of summary.json has the derivatives.</p></section>",
        table(&headings, &all.iter().map(row).collect::<String>())
    )
}

/// sensitivities.csv: the derivative of each number by every observed value.
pub(super) fn csv(all: &[Sources], sensitivities: &[Sensitivity]) -> String {
    let mut out = String::from("time_s,observed,component");
    for of in all {
        let _ = write!(out, ",\"d({})\"", of.of);
    }
    out.push('\n');
    for s in sensitivities {
        let _ = write!(out, "{},\"{}\",{}", number(s.time), s.label, s.axis);
        s.by_value.iter().for_each(|v| out.push_str(&format!(",{}", number(*v))));
        out.push('\n');
    }
    out
}
