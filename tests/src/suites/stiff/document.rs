//! The rows as a document to read: `docs/results/stability.md`.

use crate::Row;
use std::fmt::Write;

const HEAD: &str = "\
# Stiff and extreme cases

What happens at the edges: every line ends in the right answer within its bound, or in a typed error that names step, vertex or
field. The bounds and their reasons stand in the code, `tests/src/suites/stiff`. Made by

    cargo xtask verify stiff --stability docs/results/stability.md

(one thread; seconds are wall-clock time of all checks of the case, derivatives included, on a machine shared with other work).

What others do, where that is known:

- PyElastica (explicit, position Verlet): NaN above steps of 2e-4 s at 25 segments. Here steps of 1.6e-6 s to 16 s (1e-6 to 10 periods)
  give the root of the step's equations, with its tangent and adjoint.
- dismech (implicit, no globalization): diverges at 400 segments of 0.02 s when the clamp moves 2.5 segments in a step. Here 0.1 to 10
  segments in a step, at 25, 400 and 1600 segments.

*Error* is the case's first measured number, *others* how many further checks it has (all of them passed unless said), *notes* what
it took or how it ended: condition of ∂G/∂u (Hager's estimate in the step's own units), Newton iterations and extra parts of steps.
";

/// One line per case.
pub(super) fn document(rows: &[Row]) -> String {
    let mut text = format!(
        "{HEAD}\n| case | measured | error | bound | unit | others | s | notes |\n|---|---|---|---|---|---|---|---|\n"
    );
    let mut rest = rows;
    while let Some(first) = rest.first() {
        let count = rest.iter().take_while(|r| r.case == first.case).count();
        let (case, after) = rest.split_at(count);
        rest = after;
        let seconds: f64 = case.iter().map(|r| r.seconds).sum();
        let failed = case[1..].iter().filter(|r| !r.pass).count();
        let others =
            if failed > 0 { format!("{} ({failed} FAILED)", count - 1) } else { (count - 1).to_string() };
        let bound = if first.bound.is_finite() { format!("{:.0e}", first.bound) } else { "–".to_string() };
        let verdict = if first.pass { "" } else { " FAILED" };
        let note = first.note.replace('|', "\\|");
        let _ = writeln!(
            text,
            "| {} | {} | {:.1e}{verdict} | {bound} | {} | {others} | {seconds:.3} | {note} |",
            first.case, first.what, first.value, first.unit
        );
    }
    let mut ends: Vec<&Row> = rows
        .iter()
        .filter(|r| {
            r.what.contains("refused") || r.what.contains("did not converge") || r.what.contains("an error")
        })
        .collect();
    ends.sort_by(|a, b| (&a.case, &a.what).cmp(&(&b.case, &b.what)));
    text.push_str("\nWhat ends in an error or says that it did not converge, word for word:\n\n| case | what | it says |\n|---|---|---|\n");
    for row in ends {
        let _ = writeln!(
            text,
            "| {} | {} | {} |",
            row.case,
            row.what,
            row.note.replace('|', "\\|").replace('\n', " ")
        );
    }
    text
}
