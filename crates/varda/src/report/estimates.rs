//! Estimated constants: a table with intervals and correlations for the page, and estimates.csv.

use std::fmt::Write;

use super::markup::{escape, short, table};
use super::tables::{number, optional};
use crate::outcome::Estimated;

/// More constants than this have no table of correlations.
const MOST_CORRELATED: usize = 12;

/// The section of the page; empty where nothing was estimated.
pub(super) fn section(all: &[Estimated]) -> String {
    if all.iter().all(Estimated::is_of_input) {
        return String::new();
    }
    // errors in time are in estimates.csv, and a remark has their size
    let rows: String = all.iter().filter(|e| !e.is_of_field()).map(row).collect();
    let fields = match all.iter().any(|e| e.arc_length.is_some()) {
        true => "<p>Fields along the rod are drawn below; their numbers are in estimates.csv.</p>",
        false => "",
    };
    let headings = ["constant", "analysis", "prior", "95 % interval", "", "mesh"];
    format!(
        "<section><h2>Estimated constants</h2>{}<p>Values ± σ. The bar is the 95 % interval within that of \
         the prior; the mark is the analysis. mesh: the part of σ that allows for the \
         mesh.</p>{fields}{}</section>",
        table(&headings, &rows),
        correlations(all)
    )
}

fn row(e: &Estimated) -> String {
    let seen = e.identifiable != Some(false);
    let analysis = match e.sigma {
        _ if !seen => "not identifiable".to_string(),
        Some(_) if e.by_interval_alone => format!("{}, not Gaussian", short(e.value)),
        Some(sigma) => with_sigma(e.value, sigma),
        None => short(e.value),
    };
    let interval = e.interval.filter(|_| seen);
    let unit = if e.unit == "1" { String::new() } else { format!(" [{}]", e.unit) };
    format!(
        "<tr><th scope=\"row\">{}{unit}</th><td>{analysis}</td><td>{}</td><td>{}</td><td>{}</td>\
         <td>{}</td></tr>",
        escape(&e.name),
        with_sigma(e.prior, e.prior_sigma),
        interval.map_or("–".into(), |[low, high]| between(low, high)),
        interval.map_or(String::new(), |interval| bar(e, interval)),
        e.mesh.map_or("–".into(), |mesh| format!("{mesh:.1e}"))
    )
}

/// "0.2951 ± 0.0061": two digits of σ, and as many decimals of the value.
fn with_sigma(value: f64, sigma: f64) -> String {
    let (power, decimals) = digits(value.abs().max(sigma), sigma);
    let [v, s] = [value, sigma].map(|v| format!("{:.decimals$}", v / 10_f64.powi(power)));
    if power == 0 { format!("{v} ± {s}") } else { format!("({v} ± {s})e{power}") }
}

/// "0.283 to 0.307": two digits of the length of the interval.
fn between(low: f64, high: f64) -> String {
    let (power, decimals) = digits(low.abs().max(high.abs()), (high - low).abs());
    let [l, h] = [low, high].map(|v| format!("{:.decimals$}", v / 10_f64.powi(power)));
    if power == 0 { format!("{l} to {h}") } else { format!("({l} to {h})e{power}") }
}

/// A power of ten to take out of numbers up to `size`, and the decimals after that with two digits of
/// `width`.
fn digits(size: f64, width: f64) -> (i32, usize) {
    let order = |v: f64| if v > 0.0 && v.is_finite() { v.log10().floor() as i32 } else { 0 };
    let power = if (-3..5).contains(&order(size)) { 0 } else { order(size) };
    (power, (1 - order(width) + power).clamp(0, 9) as usize)
}

/// An interval within ± 2σ of the prior.
fn bar(e: &Estimated, [low, high]: [f64; 2]) -> String {
    let width = 4.0 * e.prior_sigma;
    let place = |v: f64| (100.0 * ((v - e.prior) / width + 0.5)).clamp(0.0, 100.0);
    let (from, to) = (place(low.min(high)), place(high.max(low)));
    let text = format!("{}: {} to {}", e.name, short(low), short(high));
    format!(
        "<svg viewBox=\"0 0 100 10\" width=\"110\" height=\"12\" style=\"max-width:none\" role=\"img\" \
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
    // σ of observations has none: it is no number of the control
    let all: Vec<&Estimated> = all.iter().filter(|e| !e.correlations.is_empty()).collect();
    let n = all.len();
    if !(2..=MOST_CORRELATED).contains(&n) || all.iter().any(|e| e.correlations.len() != n) {
        return String::new();
    }
    let mut rows = String::new();
    for (i, e) in all.iter().enumerate() {
        let _ = write!(rows, "<tr><th scope=\"row\">{} {}</th>", i + 1, escape(&e.name));
        for (j, c) in e.correlations.iter().enumerate() {
            let text = if j < i { format!("{c:.3}") } else { String::new() };
            let shade = if j < i { c.abs() } else { 0.0 };
            let colour = if *c < 0.0 { "213,94,0" } else { "0,114,178" };
            let _ = write!(rows, "<td style=\"background:rgba({colour},{:.2})\">{text}</td>", 0.6 * shade);
        }
        rows.push_str("</tr>");
    }
    let numbers: Vec<String> = (1..=n).map(|i| i.to_string()).collect();
    let headings: Vec<&str> =
        std::iter::once("correlation with").chain(numbers.iter().map(String::as_str)).collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_their_sigma_allows() {
        assert_eq!(with_sigma(0.295_13, 0.006_07), "0.2951 ± 0.0061");
        assert_eq!(with_sigma(123.4, 45.6), "123 ± 46");
        assert_eq!(with_sigma(6.96e-5, 8.88e-4), "(0.7 ± 8.9)e-4");
        assert_eq!(with_sigma(2.1e9, 3.4e7), "(2.100 ± 0.034)e9");
        assert_eq!(with_sigma(0.0, 0.5), "0.00 ± 0.50");
        assert_eq!(between(0.283_2, 0.306_98), "0.283 to 0.307");
        assert_eq!(between(-0.001_7, 0.001_8), "-0.0017 to 0.0018");
    }
}
