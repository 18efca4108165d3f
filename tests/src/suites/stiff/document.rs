//! The rows as a document to read: `docs/results/stability.md`.

use crate::Row;
use std::fmt::Write;

const HEAD: &str = "\
# Stiff and extreme cases

What happens at the edges: every case ends in the right answer within a bound that has its reason beside it, \
or in a typed error that
names step, vertex or field. Made by

```sh
cargo xtask verify stiff --full --stability docs/results/stability.md
```

on a machine of two cores shared with other work: seconds are wall-clock time of all checks of the case, \
derivatives included, on one
thread (those of case 4 are sums over its minimizations, two of which run at a time).

## What others do, where that is known

| case | peer | here |
|---|---|---|
| 25 segments, steps above 2e-4 s | PyElastica (explicit, position Verlet): NaN | steps of 1.6e-6 s to 16 s \
(1e-6 to 10 periods) give the root of the step's equations, with its tangent and adjoint, by three schemes |
| 400 segments, 0.02 s, clamp moves 2.5 segments in a step | dismech (implicit, no globalization): diverges \
| 0.1 to 10 segments in a step, at 25, 400 and 1600 segments, by three schemes |

## How to read the tables

One line per case. *Measured*, *error*, *bound* and *why this bound* are those of its first check; *others* \
says how many further checks
the case has and how much of its bound the closest of them uses (all passed unless it says FAILED). A bound \
of 0 is exact: a count, or
the text of an error that must name what it should. *Condition* is that of ∂G/∂u in the step's own units \
(Hager's estimate, Higham 2002),
of B, or ‖M‖ of a chaotic window. *Iterations* are Newton's, of all steps together, or outer ones of a \
minimizer; *parts* the extra parts that
steps were cut into.

`unsafe` is forbidden in the library crates, `varda` and `xtask`, so that neither Miri nor sanitizers are \
needed; test builds check integer
overflow.
";

const AREAS: [(&str, &str, &str); 6] = [
    (
        "rod",
        "Rod",
        "The distance from the root is that of the accepted state: forces computed anew by formulas that \
         share no code with the library, times the inverse of the step's Jacobian. Convergence being \
         quadratic where a step ends, mostly rounding alone is left. Rods have 25 segments, E = 1e6 Pa and \
         steps of 0.01 s by backward Euler unless said.",
    ),
    ("implicit", "Implicit layer", ""),
    (
        "chaos",
        "Chaos",
        "Minima are counted along the line truth + s (1, 1, 1)/√3, |s| ≤ 5; every case shows the count \
            at T = 2 first, the others in the rows.",
    ),
    ("covariance", "Covariance", ""),
    (
        "assimilation",
        "Assimilation",
        "Every minimizer and method that applies is tried on every case. Case 4 is solved where it converged \
         to 2J/m < 1.6: down to σ_y = 1e-6 L, but for one seed in five at 1e-3 L, which says that it \
         stalled. From 1e-8 L on it is not: ‖∇J‖ falls to 1e-8 of the first, which is what was asked \
         for and is called converged, and leaves 2J/m in the hundreds and more.",
    ),
    ("beyond", "Beyond the list", "Found by trying to break the libraries through their public interface."),
];

/// One line per case.
pub(super) fn document(rows: &[Row]) -> String {
    let mut text = HEAD.to_string();
    for (area, title, remark) in AREAS {
        let own: Vec<&Row> = rows.iter().filter(|r| split(r).0 == area).collect();
        let _ = write!(text, "\n## {title}\n\n");
        if !remark.is_empty() {
            let _ = write!(text, "{remark}\n\n");
        }
        text.push_str(
            "| case | measured | error | bound | why this bound | others | condition | iterations | parts | \
             s | notes |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
        );
        for case in own.chunk_by(|a, b| a.case == b.case) {
            text.push_str(&line(case));
        }
    }
    text.push_str(
        "\n## Word for word\n\nWhat ends in an error, or says that it did not converge:\n\n| case \
        | what | it says |\n|---|---|---|\n",
    );
    for row in rows.iter().filter(|r| {
        let ends = ["refused", "did not converge", "an error"];
        ends.iter().any(|end| r.what.contains(end))
    }) {
        let _ = writeln!(text, "| {} | {} | {} |", row.case, row.what, cell(&row.note));
    }
    text
}

/// Area and name of a case.
fn split(row: &Row) -> (&str, &str) {
    row.case.split_once(": ").unwrap_or(("", &row.case))
}

fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

fn line(case: &[&Row]) -> String {
    let first = case[0];
    let seconds: f64 = case.iter().map(|r| r.seconds).sum();
    let others = &case[1..];
    let failed = others.iter().filter(|r| !r.pass).count();
    // the share of its bound that the closest one uses; exact ones and those that only inform have none
    let bounded = others.iter().filter(|r| r.bound.is_finite() && r.bound > 0.0);
    let closest = bounded.map(|r| r.value / r.bound).fold(f64::NAN, f64::max);
    let mut count = others.len().to_string();
    if failed > 0 {
        let _ = write!(count, " ({failed} FAILED)");
    } else if closest.is_finite() {
        let _ = write!(count, " (≤ {closest:.0e})");
    }
    let bound = if first.bound.is_finite() { format!("{:.0e}", first.bound) } else { "–".to_string() };
    let verdict = if first.pass { "" } else { " FAILED" };
    let unit = if first.unit == "-" { String::new() } else { format!(" {}", first.unit) };
    let work = |number: fn(&Row) -> Option<String>| case.iter().find_map(|r| number(r)).unwrap_or_default();
    format!(
        "| {} | {} | {:.1e}{unit}{verdict} | {bound} | {} | {count} | {} | {} | {} | {seconds:.3} | {} |\n",
        split(first).1,
        cell(&first.what),
        first.value,
        cell(&first.reason),
        work(|r| r.work.condition.map(|c| format!("{c:.0e}"))),
        work(|r| r.work.iterations.map(|n| n.to_string())),
        work(|r| r.work.extra_parts.map(|n| n.to_string())),
        cell(&first.note),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::Rows;

    #[test]
    fn failures_show_in_the_document() {
        let mut rows = Rows::new("stiff");
        rows.area("rod");
        rows.case("right", |case| {
            case.at_most("error", 1e-12, 1e-11, "m").because("ε | a reason");
            case.at_most("another", 1.0, 4.0, "-");
            Ok(())
        });
        rows.case("wrong", |case| {
            case.at_most("error", 1e-10, 1e-11, "m");
            case.at_most("another", f64::NAN, 4.0, "-");
            Ok(())
        });
        rows.case("broken", |_| panic!("out of range"));
        let text = document(&rows.finish());
        let line = |name: &str| text.lines().find(|l| l.starts_with(&format!("| {name} |"))).unwrap();
        assert!(line("right").contains("| ε \\| a reason | 1 (≤ 2e-1) |"), "{}", line("right"));
        assert!(!line("right").contains("FAILED"));
        assert_eq!(line("wrong").matches("FAILED").count(), 2, "{}", line("wrong"));
        assert!(line("broken").contains("NaN FAILED") && line("broken").contains("panicked: out of range"));
    }
}
