//! The page of a comparison: error against run time of every method and minimizer.

use super::chart::Figure;
use super::markup::{escape, scene_section, short, table};
use super::page::{Page, PageData};
use crate::run::compare::Compared;
use crate::scene::SceneFile;

/// The page, with the figure that is drawn of these rows.
pub(super) fn page(file: &SceneFile, rows: &[Compared], interrupted: bool, mut figure: Figure) -> PageData {
    let scene = &file.scene;
    let title = if scene.title.is_empty() { &file.name } else { &scene.title };
    let mut page = Page::new(title);
    let ended = rows.iter().filter(|r| r.status == "converged").count();
    page.push(&format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · seed {} · every method and minimizer \
         that applies</p></header><p class=\"verdict\"><strong>{}</strong> {ended} of {} converged.</p>",
        escape(title),
        escape(&file.name),
        scene.seed,
        if interrupted { "INTERRUPTED" } else { "COMPARED" },
        rows.len(),
    ));
    // The page has a legend of its own.
    figure.panels.retain(|panel| !panel.is_key);
    figure.columns = figure.panels.len().max(1);
    page.figure(figure);
    let optional = |v: Option<f64>| v.map_or("–".to_string(), short);
    let row = |r: &Compared| {
        let numbers = [r.j, r.gap, r.rmse, r.seconds].map(|v| format!("<td>{}</td>", optional(v))).concat();
        format!(
            "<tr><th scope=\"row\">{} {}</th><td>{}</td>{numbers}<td>{}</td><td>{}</td><td \
             class=\"words\">{}</td></tr>",
            r.method,
            escape(&r.solver),
            r.status,
            r.counts.model_steps,
            r.counts.tangent_steps + r.counts.adjoint_steps,
            escape(&r.reason)
        )
    };
    let headings = [
        "method and minimizer",
        "ended",
        "J",
        "gap",
        "RMSE",
        "seconds",
        "model steps",
        "tangent and adjoint steps",
        "remark",
    ];
    page.push(&format!(
        "<section><h2>In numbers</h2>{}<p>gap = (J − J*)/(J₀ − J*): J₀ at the background, J* the \
         lowest of all. Weak-constraint and ensemble methods minimize another J and have none.</p></section>",
        table(&headings, &rows.iter().map(row).collect::<String>())
    ));
    page.push(&scene_section(scene));
    page.push(&format!(
        "<footer><p>Made by Varda {}. Files beside this page: summary.json, compare.csv, \
         compare.svg.</p></footer>",
        env!("CARGO_PKG_VERSION")
    ));
    page.finish()
}
