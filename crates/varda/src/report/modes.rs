//! Tables and the page of the natural modes of a rod.

use std::fmt::Write;

use varda_rod::Mode;

use super::chart::{Corner, Figure, Panel, Series, Style};
use super::markup::{escape, short, table};
use super::page::{Page, PageData};
use super::tables::{number, optional};
use crate::outcome::RodModes;

/// modes.csv: ω² and the frequency of every mode; no frequency for one that grows. With twist inertia the
/// share of spins in its kinetic energy, one for a mode of twist alone.
pub(super) fn frequencies(modes: &RodModes) -> String {
    let mut out = String::from("mode,omega_squared_1_s2,frequency_hz");
    out.push_str(if modes.spins() { ",spin_share\n" } else { "\n" });
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let frequency = optional(mode.frequency());
        let _ = write!(out, "{},{},{frequency}", i + 1, number(mode.omega_squared));
        if modes.spins() {
            let _ = write!(out, ",{}", number(modes.spin_share(mode)));
        }
        out.push('\n');
    }
    out
}

/// mode_shapes.csv: the rod at rest, and the displacement of every vertex in every mode, the greatest of a
/// mode being 1. With twist inertia also the turn of the edge after the vertex, as the way r φ of a point at
/// the radius of gyration r; the greatest of both is then 1.
pub(super) fn shapes(modes: &RodModes) -> String {
    let mut out = String::from("mode,vertex,s_m,x_m,y_m,z_m,dx,dy,dz");
    out.push_str(if modes.spins() { ",r_turn\n" } else { "\n" });
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let (scale, turns) = scaled(modes, mode);
        let places = modes.arc_lengths.iter().zip(&modes.vertices).zip(&mode.displacements);
        for (v, ((s, x), d)) in places.enumerate() {
            let values = [*s, x[0], x[1], x[2], scale * d.x, scale * d.y, scale * d.z];
            let _ = write!(out, "{},{v},{}", i + 1, values.map(number).join(","));
            if modes.spins() {
                let _ = write!(out, ",{}", optional(turns.get(v).copied()));
            }
            out.push('\n');
        }
    }
    out
}

/// The factor that makes the greatest displacement of a mode 1, and the scaled turns r φ.
fn scaled(modes: &RodModes, mode: &Mode) -> (f64, Vec<f64>) {
    let turns = mode.turns.iter().filter(|_| modes.spins()).map(|turn| modes.gyration * turn);
    let turns: Vec<f64> = turns.collect();
    let sizes = mode.displacements.iter().map(|d| d.norm()).chain(turns.iter().map(|turn| turn.abs()));
    let greatest = sizes.fold(0.0, f64::max);
    let scale = if greatest > 0.0 { 1.0 / greatest } else { 0.0 };
    (scale, turns.iter().map(|turn| scale * turn).collect())
}

/// The displacements of every mode along the rod, each with the name of the mode.
pub(super) fn figures(modes: &RodModes) -> Vec<(String, Figure)> {
    let figure = |(i, mode): (usize, &Mode)| {
        let (scale, turns) = scaled(modes, mode);
        let along = |c: usize| {
            modes.arc_lengths.iter().zip(&mode.displacements).map(move |(s, d)| (*s, scale * d[c]))
        };
        let axis = |c: usize| Series {
            label: ["x", "y", "z"][c].into(),
            style: Style::Line(c),
            points: along(c).collect(),
        };
        let mut series: Vec<Series> = (0..3).map(axis).collect();
        if modes.spins() {
            let s = modes.arc_lengths.windows(2).map(|s| 0.5 * (s[0] + s[1]));
            series.push(Series {
                label: "turn times radius of gyration".into(),
                style: Style::Line(3),
                points: s.zip(turns).collect(),
            });
        }
        let name = match mode.frequency() {
            Some(frequency) => format!("{}: {} Hz", i + 1, short(frequency)),
            None => format!("{}: grows", i + 1),
        };
        let figure = Figure {
            name: format!("mode-{}", i + 1),
            title: format!("Displacement along the rod in mode {name}; the greatest is 1"),
            panels: vec![Panel {
                x_label: "arc length [m]".into(),
                y_label: "displacement".into(),
                legend: Some(Corner::Top),
                series,
                ..Panel::default()
            }],
            columns: 1,
            panel_size: (760, 300),
        };
        (name, figure)
    };
    modes.found.modes.iter().enumerate().map(figure).collect()
}

/// The page: frequencies, and the shape of the mode that a reader chooses.
pub(super) fn page(modes: &RodModes, figures: Vec<(String, Figure)>) -> PageData {
    let mut page = Page::new(&format!("Modes of {}", modes.name));
    let verdict = match modes.found.unstable {
        0 => "<p class=\"verdict fits\"><strong>STABLE</strong> No mode grows.</p>".to_string(),
        n => format!("<p class=\"verdict does_not_fit\"><strong>NOT STABLE</strong> {n} modes grow.</p>"),
    };
    page.push(&format!(
        "<header><h1>Natural modes</h1><p class=\"sub\">scene <code>{}</code> · about the shape at rest, \
         supports as at {} s</p></header>{verdict}",
        escape(&modes.name),
        short(modes.time)
    ));
    if !figures.is_empty() {
        page.one_of("Mode", figures);
    }
    let row = |(i, mode): (usize, &Mode)| {
        let frequency = mode.frequency();
        let shown = |v: Option<f64>| v.map_or("–".to_string(), short);
        let spins = match modes.spins() {
            true => format!("<td>{}</td>", short(modes.spin_share(mode))),
            false => String::new(),
        };
        format!(
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td>{spins}</tr>",
            i + 1,
            shown(frequency),
            shown(frequency.filter(|f| *f > 0.0).map(|f| 1.0 / f)),
            short(mode.omega_squared)
        )
    };
    let headings =
        ["mode", "frequency [Hz]", "period [s]", "ω² [1/s²]", "share of spins in the kinetic energy"];
    let shown = if modes.spins() { 5 } else { 4 };
    page.push(&format!(
        "<section><h2>Frequencies</h2>{}</section><footer><p>Made by Varda {}. Files beside this page: \
         summary.json, modes.csv, mode_shapes.csv, figures/.</p></footer>",
        table(&headings[..shown], &modes.found.modes.iter().enumerate().map(row).collect::<String>()),
        env!("CARGO_PKG_VERSION")
    ));
    page.finish()
}
