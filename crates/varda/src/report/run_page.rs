//! The page of the run of one window: its order, tiles, tables and words.

use std::fmt::Write;

use super::chart::Figure;
use super::markup::{
    error_name, escape, folded_numbers, in_brackets, list, scene_section, short, status_words, table,
    tile_list, verdict,
};
use super::page::rod::RodView;
use super::page::{Page, PageData};
use super::{Summary, estimates, figures, sources};
use crate::outcome::{ConvergenceRow, Fit, Forecast, KnownConstants, Outcome, Quantity, Withheld};
use crate::state::{StateGroup, StateLayout};

/// The page of a run. `figures` are its charts but those of single markers and of covariances by group;
/// `picture` is the rod as SVG.
pub(super) fn page(
    outcome: &Outcome,
    summary: &Summary,
    figures: Vec<Figure>,
    covariances: Vec<(String, Figure)>,
    picture: &str,
) -> PageData {
    let experiment = &outcome.experiment;
    let title = match experiment.scene.title.as_str() {
        "" => experiment.name.as_str(),
        title => title,
    };
    let mut page = Page::new(title);
    page.push(&format!(
        "<header><h1>{}</h1><p class=\"sub\">scene <code>{}</code> · seed {} · {} by {} · <span \
         class=\"status {}\">{}</span></p></header>",
        escape(title),
        escape(&experiment.name),
        summary.seed,
        summary.method,
        summary.minimizer,
        summary.status,
        status_words(outcome.status),
    ));
    page.push(&verdict(&outcome.judgement));
    page.push(&tiles(summary, &experiment.state));
    if !summary.warnings.is_empty() {
        let notes = list(&summary.warnings);
        page.push(&format!("<section class=\"notes\"><h2>What to know</h2>{notes}</section>"));
    }
    let mut figures: Vec<Option<Figure>> = figures.into_iter().map(Some).collect();
    let mut show = |page: &mut Page, names: &[&str]| {
        for name in names {
            let of_name = figures.iter_mut().find(|f| f.as_ref().is_some_and(|f| f.name == *name));
            if let Some(figure) = of_name.and_then(Option::take) {
                page.figure(figure);
            }
        }
    };
    if let Some(view) = RodView::of_outcome(outcome) {
        page.rod(view, &rod_caption(outcome), picture);
    }
    show(&mut page, &["field", "components"]);
    let markers = figures::markers(outcome);
    if !markers.is_empty() {
        page.one_of("Against time:", markers);
    }
    show(&mut page, &["departures"]);
    page.push(&fit_section(outcome, summary));
    page.push(&estimates::section(&outcome.estimates));
    show(&mut page, &["fields", "constants", "convergence", "spread"]);
    if !covariances.is_empty() {
        page.one_of("Covariance of", covariances);
    }
    show(&mut page, &["information", "next-marker"]);
    page.push(&sources::section(&outcome.sources));
    page.push(&sources::considered(&outcome.considered));
    page.push(&format!(
        "<section><h2>What was left out</h2><p>Not needed by this scene, and not computed:</p>{}</section>",
        list(&summary.left_out)
    ));
    page.push(&table_section(outcome, summary));
    page.push(&convergence_section(outcome));
    page.push(&scene_section(&experiment.scene));
    page.push(&format!(
        "<footer><p>Made by Varda {}. Files beside this page: summary.json, analysis.csv, trajectory.csv, \
         observations.csv, {}figures/{}.</p></footer>",
        summary.version,
        if outcome.convergence.is_empty() { "" } else { "convergence.csv, " },
        if experiment.state.geometry.is_some() {
            "; of the rod also its forces, moments and reactions"
        } else {
            ""
        },
    ));
    page.finish()
}

/// What is shown of the rod, and how it is turned.
fn rod_caption(outcome: &Outcome) -> String {
    let sigma = if outcome.sigma_states.is_empty() { "" } else { " with ±2σ around it" };
    let forecast = match outcome.experiment.grid.forecast {
        0 => String::new(),
        _ => format!(
            "; after {} s it is a forecast",
            short(outcome.experiment.grid.time(outcome.experiment.grid.steps))
        ),
    };
    format!(
        "The rod through time, the analysis{sigma}{forecast}. Drag to turn it, scroll to zoom; with the \
         keyboard: arrow keys, plus and minus, Home, and the space bar to play. x is red, y green, z blue."
    )
}

/// The numbers one looks for first.
fn tiles(s: &Summary, layout: &StateLayout) -> String {
    let mut tiles = vec![(
        "Cost J".to_string(),
        format!("{} → {}", short(s.j_background), short(s.j_analysis)),
        format!("2J/m = {:.3}, about 1 is expected", s.chi2),
    )];
    for (group, rmse) in layout.groups.iter().zip(&s.rmse.0) {
        if let Some([b, a]) = rmse.known() {
            tiles.push((
                error_name(group),
                format!("{} → {}{}", short(b), short(a), group.unit_after()),
                format!("{:.0} % of the background's error left", 100.0 * a / b),
            ));
        }
    }
    for w in &s.withheld {
        tiles.push((
            format!("Kept back: {}", w.label),
            {
                let [b, a] = [w.rms_background, w.rms_analysis].map(|d| shown(w.quantity, d));
                format!("{b} → {a} {}", w.quantity.shown().1)
            },
            format!("rms distance over {} times", w.count),
        ));
    }
    if let Some(f) = s.forecast.iter().find(|f| !f.assimilated).or(s.forecast.first()) {
        tiles.push((
            format!("Forecast of {}", f.label),
            format!("{} {}", shown(f.quantity, f.analysis), f.quantity.shown().1),
            {
                let [p, m] = [f.persistence, f.static_model].map(|d| shown(f.quantity, d));
                format!("persistence {p}, static model {m} {}", f.quantity.shown().1)
            },
        ));
    }
    if let Some(a) = &s.accepted_steps {
        let largest = a.largest_error.map_or("not known".into(), |e| format!("{e:.1e}"));
        tiles.push((
            "Adaptive time steps".into(),
            a.accepted.to_string(),
            format!(
                "largest error {largest} at a tolerance of {:e}, chosen again: {}",
                a.tolerance, a.refreshed
            ),
        ));
    }
    tiles.push((
        "Time".into(),
        format!("{:.2} s", s.seconds.total),
        format!("{} outer iterations", s.outer_iterations),
    ));
    tile_list(&tiles)
}

/// "σ of the place of the tip at 1 s, and with the constants known": "2.1 mm, 0.8 mm".
fn with_constants_known(of: &KnownConstants) -> (String, String) {
    let (factor, unit) = match of.unit {
        "m" => (1e3, " mm".to_string()),
        "1" => (1.0, String::new()),
        unit => (1.0, format!(" {unit}")),
    };
    let sigma = [of.sigma, of.sigma_known].map(|s| format!("{}{unit}", short(factor * s)));
    let name = format!("σ of the {} at {} s, and with the constants known", of.of, short(of.time));
    (name, sigma.join(", "))
}

fn table_section(outcome: &Outcome, s: &Summary) -> String {
    let optional = |v: Option<f64>| v.map_or("–".to_string(), short);
    let c = &s.counts;
    let parts: Vec<&str> = s.j_shares.iter().map(|share| share.part).collect();
    let parts = format!("of it {} (to expect)", parts.join(", "));
    let shares: Vec<String> = s
        .j_shares
        .iter()
        .map(|share| match share.expected {
            Some(expected) => format!("{} ({})", short(share.j), short(expected)),
            None => short(share.j),
        })
        .collect();
    let known: Vec<(String, String)> = s.with_constants_known.iter().map(with_constants_known).collect();
    let grid = &outcome.experiment.grid;
    let mut further = None;
    let unit = if outcome.experiment.state.geometry.is_some() { (1e3, "mm") } else { (1.0, "") };
    let mut rows: Vec<(&str, String, &str)> = vec![
        ("State, control", format!("{}, {}", s.n_state, s.n_control), "numbers"),
        ("Observed values m", s.n_obs.to_string(), ""),
        match grid.last_step() {
            0 => ("Window", "one instant".to_string(), ""),
            _ => ("Window", format!("{} steps of {}", grid.steps, short(grid.step)), "s"),
        },
        ("J at the background", short(s.j_background), ""),
        ("J at the analysis", short(s.j_analysis), ""),
        (&parts, shares.join("; "), ""),
        (
            "Gradient norm, first and last",
            format!("{:.2e}, {:.2e}", s.gradient_norm_first, s.gradient_norm_last),
            "",
        ),
        ("Iterations, outer and inner", format!("{}, {}", s.outer_iterations, s.inner_iterations), ""),
        ("2J/m", format!("{:.4}", s.chi2), ""),
        ("Degrees of freedom for signal", optional(s.degrees_of_freedom), ""),
    ];
    if let Some((next, best)) = s.next_observation.as_ref().and_then(|n| Some((n, n.best()?))) {
        let place = match (best.arc_length, &best.component) {
            (Some(arc), _) => {
                format!("One more marker helps most at {} m: σ of places at the end", short(arc))
            }
            (None, component) => {
                format!(
                    "One more component helps most: {}; σ at the end",
                    component.as_deref().unwrap_or_default()
                )
            }
        };
        further = Some((place, [next.sigma_now, best.sigma].map(|s| short(unit.0 * s)).join(" → ")));
    }
    if let Some((place, sigma)) = &further {
        rows.push((place, sigma.clone(), unit.1));
    }
    for (name, sigma) in &known {
        rows.push((name, sigma.clone(), ""));
    }
    if let Some(e) = s.exact_hessian {
        rows.push(("Smallest eigenvalue of the exact Hessian", optional(e.smallest_eigenvalue), ""));
        let percent = |share: Option<f64>| optional(share.map(|s| 100.0 * s));
        rows.push(("σ against Gauss–Newton's, at most", percent(e.sigma_change), "%"));
        rows.push(("Draws of the posterior that count", percent(e.effective_share), "%"));
    }
    if let Some(e) = s.model_error {
        rows.push(("J_q to expect", optional(e.j_q_expected), ""));
        rows.push(("σ of the model error, times that of Q", optional(e.sigma_factor), ""));
    }
    let labels: Vec<String> = outcome.experiment.state.groups.iter().map(rmse_label).collect();
    for ((group, rmse), label) in outcome.experiment.state.groups.iter().zip(&s.rmse.0).zip(&labels) {
        if let Some(pair) = rmse.known() {
            let unit = if group.unit == "1" { "" } else { group.unit };
            rows.push((label, pair.map(short).join(", "), unit));
        }
    }
    if let Some(a) = &s.amplification {
        rows.push((
            "Amplification by the window, gradient right to about",
            format!("{:.1e}, {:.0e}", a.norm, a.gradient_error),
            "",
        ));
    }
    rows.extend([
        (
            "Model steps, tangent, adjoint",
            format!("{}, {}, {}", c.model_steps, c.tangent_steps, c.adjoint_steps),
            "",
        ),
        ("Factorizations, Newton iterations", format!("{}, {}", c.factorizations, c.newton_iterations), ""),
        ("Time", format!("{:.3}", s.seconds.total), "s"),
    ]);
    // of one of several recordings they are those of all, on the page of all
    if s.seconds.minimizer > 0.0 {
        rows.extend([
            (
                "of it set-up, minimization, posterior, diagnostics, finer mesh",
                format!(
                    "{:.3}, {:.3}, {:.3}, {:.3}, {:.3}",
                    s.seconds.set_up,
                    s.seconds.minimizer,
                    s.seconds.posterior,
                    s.seconds.diagnostics,
                    s.seconds.mesh
                ),
                "s",
            ),
            (
                "of minimization and posterior: forward, tangent, adjoint",
                format!("{:.3}, {:.3}, {:.3}", s.seconds.forward, s.seconds.tangent, s.seconds.adjoint),
                "s",
            ),
        ]);
    }
    rows.extend([(
        "Peak memory",
        s.peak_bytes.map_or("–".into(), |b| format!("{:.1}", b as f64 / 1e6)),
        "MB",
    )]);
    folded_numbers(&rows)
}

fn rmse_label(group: &StateGroup) -> String {
    match group.part() {
        None | Some("position") => "RMSE before and after".to_string(),
        Some(name) => format!("RMSE of {name} before and after"),
    }
}

fn fit_section(outcome: &Outcome, s: &Summary) -> String {
    let mut out = String::from("<section><h2>What fits and what does not</h2>");
    if !s.innovations.is_empty() {
        let shown = s.innovations.len().min(40);
        let row = |f: &Fit| {
            let class = if f.is_bad() { " class=\"bad\"" } else { "" };
            let d = [f.sigma, f.rms_background, f.rms_analysis, f.mean_analysis].map(short);
            let brought = f.information.map_or("–".into(), |i| format!("{i:.1}"));
            let cells =
                cells(&[&[f.count.to_string()], &d[..], &[format!("{:.2}", f.ratio), brought]].concat());
            format!("<tr{class}><th scope=\"row\">{}</th>{cells}</tr>", escape(&f.label))
        };
        let unit = in_brackets(s.innovations.iter().map(|f| f.quantity.unit()));
        let in_unit = |name: &str| format!("{name}{unit}");
        let [sigma, background, analysis, mean] =
            ["σ", "rms d, background", "rms d, analysis", "mean d, analysis"].map(in_unit);
        let headings =
            ["Observed", "values", &sigma, &background, &analysis, &mean, "rms d/σ", "information"];
        let _ = write!(
            out,
            "<p>Innovations d = y − H(x) compared with their assumed σ. An rms of d/σ near 1 at the \
             analysis means that both are right. Information: the degrees of freedom for signal that a \
             marker's values brought.</p>{}",
            table(&headings, &s.innovations[..shown].iter().map(row).collect::<String>())
        );
        if shown < s.innovations.len() {
            let _ = write!(out, "<p>{} more in summary.json.</p>", s.innovations.len() - shown);
        }
    }
    if !s.withheld.is_empty() {
        let row = |w: &Withheld| {
            let d = [w.rms_background, w.rms_analysis, w.moving_analysis].map(|d| shown(w.quantity, d));
            let cells = cells(&[&[w.count.to_string()], &d[..]].concat());
            format!("<tr><th scope=\"row\">{}</th>{cells}</tr>", escape(&w.label))
        };
        let unit = in_brackets(s.withheld.iter().map(|w| w.quantity.shown().1));
        let [background, analysis, moving] =
            ["background", "analysis", "analysis without constant offset"].map(|h| format!("{h}{unit}"));
        let headings = ["Marker", "times", &background, &analysis, &moving];
        let _ = write!(
            out,
            "<h3>Markers kept back</h3><p>They were not assimilated. Distance between the marker as seen and \
             its place in the model, rms over the window.</p>{}",
            table(&headings, &s.withheld.iter().map(row).collect::<String>())
        );
    }
    if !s.forecast.is_empty() {
        let row = |f: &Forecast| {
            let used = if f.assimilated { "assimilated" } else { "kept back" };
            let distances = [
                f.analysis,
                f.persistence,
                f.static_model,
                f.background,
                f.moving_analysis,
                f.moving_constant,
            ];
            let first = [used.to_string(), f.count.to_string()];
            let cells = cells(&[&first[..], &distances.map(|d| shown(f.quantity, d))].concat());
            format!("<tr><th scope=\"row\">{}</th>{cells}</tr>", escape(&f.label))
        };
        let unit = in_brackets(s.forecast.iter().map(|f| f.quantity.shown().1));
        let headings = [
            "analysis",
            "persistence",
            "static model",
            "background",
            "analysis without offset",
            "best constant",
        ]
        .map(|heading| format!("{heading}{unit}"));
        let headings = [
            "Marker",
            "in the window",
            "times",
            &headings[0],
            &headings[1],
            &headings[2],
            &headings[3],
            &headings[4],
            &headings[5],
        ];
        let _ = write!(
            out,
            "<h3>Forecast</h3><p>Distance to the markers over {} s after the window, rms, compared with \
             simpler forecasts: the marker stays where it was last seen (persistence), the model at rest in \
             its static equilibrium, and the model run from the background. The last two columns remove \
             constant offsets (a marker or mount not quite where the scene puts it): the analysis less its \
             mean error, and the best constant place.</p>{}",
            outcome.experiment.scene.report.forecast,
            table(&headings, &s.forecast.iter().map(row).collect::<String>())
        );
    }
    out.push_str("</section>");
    out
}

/// Cells of a row of a table.
fn cells(values: &[String]) -> String {
    values.iter().map(|v| format!("<td>{v}</td>")).collect()
}

/// A distance in millimetres, or pixels.
fn shown(quantity: Quantity, distance: f64) -> String {
    format!("{:.2}", quantity.shown().0 * distance)
}

/// Iteration by iteration; nothing of one of several recordings, which has none of its own.
fn convergence_section(outcome: &Outcome) -> String {
    if outcome.convergence.is_empty() {
        return String::new();
    }
    let row = |r: &ConvergenceRow| {
        format!(
            "<tr><td>{}</td><td>{:.3}</td><td>{}</td><td>{}</td><td>{}</td><td>{:.2e}</td>{}</tr>",
            r.iteration,
            r.seconds,
            short(r.j),
            short(r.j_b),
            short(r.j_o),
            r.gradient_norm,
            r.rmse.iter().map(|e| format!("<td>{}</td>", short(*e))).collect::<String>()
        )
    };
    let errors: Vec<String> = match &outcome.truth {
        Some(_) => {
            let heading = |g: &StateGroup| format!("{}{}", g.labelled("RMSE"), g.unit_in_heading());
            outcome.experiment.state.groups.iter().map(heading).collect()
        }
        None => Vec::new(),
    };
    let first = ["iteration", "seconds", "J", "J_b", "J_o", "gradient norm"];
    let headings: Vec<&str> = first.into_iter().chain(errors.iter().map(String::as_str)).collect();
    let rows: String = outcome.convergence.iter().map(row).collect();
    format!(
        "<section><h2>Convergence</h2><details><summary>Iteration by \
         iteration</summary>{}</details></section>",
        table(&headings, &rows)
    )
}
