//! Pieces of HTML that pages share.

use std::collections::BTreeSet;

use crate::outcome::{Judgement, Status};
use crate::scene::Scene;
use crate::state::StateGroup;

/// The scene as it was run, folded.
pub(super) fn scene_section(scene: &Scene) -> String {
    let text = toml::to_string(scene).unwrap_or_default();
    format!(
        "<section><h2>The scene as it was run</h2><details><summary>TOML, overrides and defaults \
         included</summary><pre>{}</pre></details></section>",
        escape(&text)
    )
}

/// The verdict in words, first on a page.
pub(super) fn verdict(judgement: &Judgement) -> String {
    format!(
        "<p class=\"verdict {}\"><strong>{}</strong> {}</p>",
        judgement.verdict.name(),
        judgement.verdict.heading(),
        escape(&judgement.text)
    )
}

pub(super) fn status_words(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::MaxIterations => "out of iterations",
        Status::LinearizedOnce => "linearized once",
        Status::Stalled => "stalled",
        Status::Interrupted => "interrupted",
        Status::Failed => "failed",
    }
}

/// Tiles of name, value and note.
pub(super) fn tile_list(tiles: &[(String, String, String)]) -> String {
    let tile = |(name, value, note): &(String, String, String)| {
        format!(
            "<div class=\"tile\"><dt>{}</dt><dd>{}</dd><dd class=\"note\">{}</dd></div>",
            escape(name),
            escape(value),
            escape(note)
        )
    };
    format!("<dl class=\"tiles\">{}</dl>", tiles.iter().map(tile).collect::<String>())
}

/// The name of the error of a group of the state: "Position error (RMSE)".
pub(super) fn error_name(group: &StateGroup) -> String {
    let Some(name) = group.part() else { return "Error (RMSE)".to_string() };
    let (first, rest) = name.split_at(1);
    format!("{}{rest} error (RMSE)", first.to_uppercase())
}

/// A table of quantities, their values and units, folded.
pub(super) fn folded_numbers(rows: &[(&str, String, &str)]) -> String {
    let row = |(name, value, unit): &(&str, String, &str)| {
        format!("<tr><th scope=\"row\">{}</th><td>{}</td><td>{unit}</td></tr>", escape(name), escape(value))
    };
    let rows: String = rows.iter().map(row).collect();
    format!(
        "<section><h2>In numbers</h2><details><summary>Sizes, cost, work, seconds, \
         memory</summary>{}</details></section>",
        table(&["Quantity", "Value", "Unit"], &rows)
    )
}

/// A table that scrolls where the page is narrow.
pub(super) fn table(headings: &[&str], rows: &str) -> String {
    let names = headings.iter().map(|n| format!("<th scope=\"col\">{n}</th>")).collect::<String>();
    format!("<div class=\"scroll\"><table><thead><tr>{names}</tr></thead><tbody>{rows}</tbody></table></div>")
}

/// " [m]", " [m, px]", or nothing.
pub(super) fn in_brackets<'a>(units: impl Iterator<Item = &'a str>) -> String {
    let units: BTreeSet<&str> = units.filter(|unit| !unit.is_empty()).collect();
    match units.is_empty() {
        true => String::new(),
        false => format!(" [{}]", units.into_iter().collect::<Vec<_>>().join(", ")),
    }
}

pub(super) fn list(items: &[String]) -> String {
    format!("<ul>{}</ul>", items.iter().map(|i| format!("<li>{}</li>", escape(i))).collect::<String>())
}

/// A number in five significant digits.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        "–".into()
    } else if size != 0.0 && !(1e-3..1e5).contains(&size) {
        format!("{value:.4e}")
    } else {
        let digits = if size == 0.0 { 0 } else { (4.0 - size.log10().floor()).max(0.0) as usize };
        format!("{value:.digits$}")
    }
}

/// Text that is safe between tags and in attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_a_user_cannot_become_markup() {
        assert_eq!(
            escape("<script>alert('&\"')</script>"),
            "&lt;script&gt;alert(&#39;&amp;&quot;&#39;)&lt;/script&gt;"
        );
    }

    #[test]
    fn numbers_have_five_digits() {
        assert_eq!(short(61.844234), "61.844");
        assert_eq!(short(0.0123456), "0.012346");
        assert_eq!(short(-1234567.0), "-1.2346e6");
        assert_eq!(short(f64::NAN), "–");
    }
}
