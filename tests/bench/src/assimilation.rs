//! From the background to the converged analysis: every method and minimizer that applies to a scene.

use super::clock::Timing;
use super::{Cell, Options, Page, Result, Table};
use varda::report::chart::{Corner, Panel, Series, Style};
use varda::run::compare::{Compared, compare, lowest};
use varda::scene::SceneFile;

/// Scenes, keys of their tables too. Those whose slow minimizers take long are run once after the warm-up.
const SCENES: [(&str, bool); 6] = [
    ("hanging-rod-case1", true),
    ("lorenz63", true),
    ("lorenz96", true),
    ("hanging-rod-case2", false),
    ("hanging-rod-case3", false),
    ("hanging-rod-case4", false),
];

const COLUMNS: [&str; 13] = [
    "method",
    "minimizer",
    "status",
    "J",
    "gap",
    "RMSE",
    "s",
    "s (least)",
    "model runs",
    "tangent runs",
    "adjoint runs",
    "Newton iterations",
    "reason",
];

pub(super) fn run(options: &Options) -> Result<Page> {
    let scenes = if options.quick { &SCENES[1..2] } else { &SCENES[..] };
    let (mut tables, mut panels) = (Vec::new(), Vec::new());
    for &(scene, often) in scenes {
        let file = SceneFile::open(scene, &[])?;
        let steps = varda::setup::Problem::from_scene(&file)?.observations()?.last_step().unwrap_or(0).max(1);
        let mut rows = Vec::new();
        let mut seconds: Vec<Vec<f64>> = Vec::new();
        // The first run warms up.
        let samples = if often { options.samples() } else { 1 };
        for _ in 0..=samples {
            rows = compare(&file, &mut |_| {}, &|| false)?;
            seconds.push(rows.iter().map(|r| r.seconds.unwrap_or(f64::NAN)).collect());
        }
        let title = format!("{scene}, samples: {samples}");
        tables.push(table(scene, title, steps, &rows, &seconds[1..]));
        panels.push(panel(scene, &rows));
    }
    Ok(Page {
        title: "Assimilation: error against seconds",
        text: TEXT.into(),
        tables,
        panels,
        remarks: String::new(),
    })
}

const TEXT: &str = "\
Each table is `varda compare SCENE` after a warm-up: every method and minimizer from the scene's \
background to its own end.

- *Seconds*: wall-clock time of the minimization, as varda reports it (other pages give CPU time).
- *Gap*: (J − J*)/(J₀ − J*), with J₀ at the background and J* the lowest J of any row of the \
scene.
- *RMSE*: of the initial positions [m] (for Lorenz models of the state) against the truth. Observations \
have errors, so it does not vanish at the minimum.
- *Runs*: steps divided by the steps of the window; linearizations are not counted.
- *converged*: the gradient fell by the scene's tolerance.

Curves show the gap after every outer iteration of the last sample; the end at gap 0 is not on the axis. \
[Target](../reference-problems.md#targets): the default (4dvar, auto) on case 1 ≤ 0.5 s.";

fn table(scene: &'static str, title: String, steps: usize, rows: &[Compared], seconds: &[Vec<f64>]) -> Table {
    let mut table = Table::new(scene, title, &COLUMNS);
    let runs = |count: usize| Cell::from(count as f64 / steps as f64);
    for (i, row) in rows.iter().enumerate() {
        let timing = Timing::of(seconds.iter().map(|s| s[i]).collect());
        table.push(vec![
            row.method.into(),
            row.solver.as_str().into(),
            row.status.into(),
            row.j.into(),
            row.gap.into(),
            row.rmse.into(),
            timing.median.into(),
            timing.least.into(),
            runs(row.counts.model_steps),
            runs(row.counts.tangent_steps),
            runs(row.counts.adjoint_steps),
            row.counts.newton_iterations.into(),
            row.reason.as_str().into(),
        ]);
    }
    table
}

fn panel(scene: &str, rows: &[Compared]) -> Panel {
    let lowest = lowest(rows);
    let all = rows.iter().enumerate().map(|(i, r)| Series {
        label: format!("{} {}", r.method, r.solver),
        style: Style::Marked(i),
        points: r.gaps(lowest),
    });
    // Rows without a gap (costs of another kind, failures) have no curve.
    let series = all.filter(|s| !s.points.is_empty());
    Panel {
        title: scene.into(),
        x_label: "seconds".into(),
        y_label: "(J − J*)/(J₀ − J*)".into(),
        log_x: true,
        log_y: true,
        legend: Some(Corner::Top),
        series: series.collect(),
        ..Panel::default()
    }
}
