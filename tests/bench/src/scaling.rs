//! Cost of a step against the size of the model: seconds and bytes.

use std::time::Instant;

use super::clock::timed;
use super::{Options, Page, Result, Table};
use crate::cells;
use problems::allocations::heap;
use problems::long_rod::{self, slope};
use problems::rods::DrivenRod;
use varda::report::chart::{Corner, Panel, Series, Style};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::{Plan, Problem};
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Model, Rk4};
use varda_rod::TwistUnknowns;

pub(super) fn run(options: &Options) -> Result<Page> {
    let (rods, mut rod_series) = rods(options)?;
    let (lorenz, lorenz_series) = lorenz96(options)?;
    rod_series.push(lorenz_series);
    let (assimilation, slopes) = assimilations(options)?;
    Ok(Page {
        title: "Scaling: seconds and bytes against size",
        text: TEXT.into(),
        tables: vec![rods, lorenz, assimilation],
        panels: vec![Panel {
            x_label: "segments, variables".into(),
            y_label: "µs per segment and Newton iteration, or per variable and step".into(),
            log_x: true,
            log_y: true,
            legend: Some(Corner::Top),
            series: rod_series,
            ..Panel::default()
        }],
        remarks: format!("{slopes}\n\n{PEERS}"),
    })
}

const TEXT: &str = "\
The [driven rod](../reference-problems.md#driven-rod) with more and more segments; \"with angles\" keeps \
one angle for each segment among the unknowns. *Per segment and Newton iteration*: seconds of all \
steps/(segments × linear solves); every Newton iteration is one solve. *Working memory*: heap of the \
model after its first step, the description of the rod included. *Linearization*: what one kept step \
adds, for tangent and adjoint sweeps. Both are counted by the allocator.

[Targets](../reference-problems.md#targets): at most 0.25 µs without angles and 0.8 µs with them; at \
100 000 segments at most twice the value at 100; at 25 segments at most 0.1 ms a step.";

const PEERS: &str = "\
Other programs, measured elsewhere on comparable machines ([targets](../reference-problems.md#targets)): the \
best C++ program 1.4 ms a step at 25 segments, 8 to 11 µs per segment and Newton iteration; a compiled \
reference 7 µs per iteration without angles, 0.28 µs per segment; the flagship's window in JAX 34 ms \
forward.";

fn rods(options: &Options) -> Result<(Table, Vec<Series>)> {
    let mut table = Table::new(
        "rod",
        "Rod, backward Euler",
        &[
            "unknowns",
            "segments",
            "steps",
            "iterations per step",
            "ms per step",
            "ms per step (least)",
            "µs per segment and iteration",
            "µs (least)",
            "working bytes per segment",
            "linearization, bytes per segment",
        ],
    );
    let sizes = [(25, 100), (100, 100), (400, 50), (1600, 20), (10_000, 5), (100_000, 3)];
    let mut series = Vec::new();
    let kinds = [("without angles", TwistUnknowns::WhereNeeded), ("with angles", TwistUnknowns::Always)];
    for (i, (kind, twist)) in kinds.into_iter().enumerate() {
        let mut points = Vec::new();
        for &(segments, steps) in &sizes[..if options.quick { 2 } else { 6 }] {
            let rod = DrivenRod { segments, twist, ..DrivenRod::SOFT };
            let (working, model) = heap(|| -> Result<_> {
                let (mut model, x) = rod.model(0.02)?;
                let mut next = x.clone();
                model.step(0, &x, &mut next)?;
                Ok((model, x, next))
            });
            let (mut model, start, mut next) = model?;
            let (kept, linearized) = heap(|| model.linearize(0, 0, &start, &next));
            linearized?;
            let mut iterations = 0;
            let mut x = start.clone();
            let timing = timed(options.samples(), || {
                x.copy_from_slice(&start);
                iterations = 0;
                for k in 0..steps {
                    iterations += model.step(k, &x, &mut next)?.newton_iterations;
                    std::mem::swap(&mut x, &mut next);
                }
                Ok::<(), varda_implicit::Error>(())
            })?;
            let micro = 1e6 / (segments * iterations) as f64;
            table.push(cells![
                kind,
                segments,
                steps,
                iterations as f64 / steps as f64,
                1e3 * timing.median / steps as f64,
                1e3 * timing.least / steps as f64,
                timing.median * micro,
                timing.least * micro,
                working.kept as f64 / segments as f64,
                kept.kept as f64 / segments as f64
            ]);
            points.push((segments as f64, timing.least * micro));
        }
        series.push(Series { label: format!("rod {kind}"), style: Style::Marked(i), points });
    }
    Ok((table, series))
}

fn lorenz96(options: &Options) -> Result<(Table, Series)> {
    let mut table = Table::new(
        "lorenz96",
        "Lorenz-96, RK4",
        &[
            "variables",
            "steps",
            "µs per step",
            "µs per step (least)",
            "ns per variable (least)",
            "linearization, bytes per variable",
        ],
    );
    let mut points = Vec::new();
    let sizes = [40, 400, 4000, 40_000, 400_000];
    for &n in &sizes[..if options.quick { 2 } else { 5 }] {
        let start: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
        let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
        let mut next = start.clone();
        model.step(0, &start, &mut next)?;
        let (kept, linearized) = heap(|| model.linearize(0, 0, &start, &next));
        linearized?;
        let steps = 10;
        let mut x = start.clone();
        let timing = timed(options.samples(), || {
            x.copy_from_slice(&start);
            for k in 0..steps {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
            }
            Ok::<(), varda_implicit::Error>(())
        })?;
        let micro = 1e6 / steps as f64;
        let each = 1e3 * timing.least * micro / n as f64;
        table.push(cells![
            n,
            steps,
            timing.median * micro,
            timing.least * micro,
            each,
            kept.kept as f64 / n as f64
        ]);
        points.push((n as f64, 1e-3 * each));
    }
    Ok((table, Series { label: "Lorenz-96, RK4".into(), style: Style::Marked(2), points }))
}

/// A scene of a rod assimilated: seconds by part, and the most memory, as counted by the allocator.
fn assimilations(options: &Options) -> Result<(Table, String)> {
    let mut table = Table::new(
        "assimilation",
        "A window assimilated from a scene",
        &[
            "segments",
            "unknowns",
            "set-up, s",
            "minimization, s",
            "posterior and rest, s",
            "total, s",
            "factorizations",
            "heap, MB",
            "check says, MB",
        ],
    );
    let (mut seconds, mut bytes) = (Vec::new(), Vec::new());
    let sizes = [1250, 5000, 20_000];
    for &segments in &sizes[..if options.quick { 1 } else { 3 }] {
        let sets = long_rod::segments(segments);
        let file = SceneFile::parse("long-rod", "long-rod.toml", long_rod::SCENE, None, &sets)?;
        let plan = Plan::new(&file)?;
        let began = Instant::now();
        let mut built = 0.0;
        let (memory, outcome) = heap(|| {
            let problem = Problem::from_scene(&file)?;
            built = began.elapsed().as_secs_f64();
            assimilate(&problem, &mut Listener::silent())
        });
        let (outcome, total) = (outcome?, began.elapsed().as_secs_f64());
        let minimization = outcome.seconds.minimizer;
        table.push(cells![
            segments,
            plan.n_control,
            built,
            minimization,
            total - built - minimization,
            total,
            outcome.counts.factorizations,
            memory.peak as f64 / 1e6,
            plan.bytes as f64 / 1e6
        ]);
        seconds.push((segments as f64, total));
        bytes.push((segments as f64, memory.peak as f64));
    }
    let text = match options.quick {
        true => String::new(),
        false => format!(
            "A window of ten steps with two places observed at two times, B a Matérn 5/2 kernel \
             conditioned on the clamp (by recursion), Gauss–Newton with conjugate gradients, a posterior \
             of low rank: total seconds grow like segments^{:.2}, memory like segments^{:.2}.",
            slope(&seconds),
            slope(&bytes)
        ),
    };
    Ok((table, text))
}
