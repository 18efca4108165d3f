//! The CSV files of a result.

use std::fmt::Write;

use crate::outcome::{
    ConvergenceRow, Experiment, ModelErrors, ObservedValue, Outcome, PixelSight, Reading, Shapes,
    Trajectories, TwinFiles,
};
use crate::run::compare::Compared;
use crate::scene::TimeGrid;
use crate::setup::rod::END_ANGLE;
use crate::state::Geometry;

/// A number as the shortest text that reads back to the same bits; nothing for one that is not finite.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if !value.is_finite() => String::new(),
        _ if size != 0.0 && !(1e-4..1e15).contains(&size) => format!("{value:e}"),
        _ => format!("{value}"),
    }
}

pub(super) fn optional(value: Option<f64>) -> String {
    value.map_or(String::new(), number)
}

/// compare.csv: one row for every method and minimizer.
pub(super) fn comparison(rows: &[Compared]) -> String {
    let mut out = String::from(
        "method,solver,status,j,gap,rmse,seconds,model_steps,tangent_steps,adjoint_steps,reason\n",
    );
    for r in rows {
        let numbers = [r.j, r.gap, r.rmse, r.seconds].map(optional).join(",");
        let c = r.counts;
        let reason = r.reason.replace('"', "\"\"");
        let _ = writeln!(
            out,
            "{},{},{},{numbers},{},{},{},\"{reason}\"",
            r.method, r.solver, r.status, c.model_steps, c.tangent_steps, c.adjoint_steps
        );
    }
    out
}

/// analysis.csv: x_b, x_a, σ_b, σ_a and, where it is known, the truth.
pub(super) fn analysis(outcome: &Outcome) -> String {
    let a = &outcome.analysis;
    let mut out = String::from("index,name,unit,x_b,x_a,sigma_b,sigma_a");
    out.push_str(if outcome.truth.is_some() { ",truth\n" } else { "\n" });
    for (i, (name, unit)) in outcome.experiment.state.components().enumerate() {
        let sigma_a = outcome.has_posterior.then(|| a.sigma_analysis[i]);
        let fields = [
            number(a.background[i]),
            number(a.analysis[i]),
            number(a.sigma_background[i]),
            optional(sigma_a),
        ];
        let _ = write!(out, "{i},{name},{unit},{}", fields.join(","));
        if let Some(truth) = &outcome.truth {
            let _ = write!(out, ",{}", number(truth[i]));
        }
        out.push('\n');
    }
    out
}

/// model_error.csv: every error η of the model with its σ, before and after anything was observed.
/// `first_step` and `last_step` are those at whose end it was added.
pub(super) fn model_errors(experiment: &Experiment, errors: &ModelErrors) -> String {
    let mut out = String::from("error,first_step,last_step,time_s,name,unit,eta,sigma_q,sigma_eta\n");
    let n = errors.sigma_prior.len();
    for (j, [first, last]) in errors.steps.iter().enumerate() {
        let time = number(experiment.grid.time(*last));
        for (i, (name, unit)) in experiment.state.components().take(n).enumerate() {
            let [eta, prior] = [errors.values[j * n + i], errors.sigma_prior[i]].map(number);
            let sigma = optional(errors.sigma.get(j * n + i).copied());
            let _ = writeln!(out, "{j},{first},{last},{time},{name},{unit},{eta},{prior},{sigma}");
        }
    }
    out
}

/// convergence.csv. Its two columns of RMSE keep their names for all models: the first group of the state
/// (positions of a rod) and the second (velocities).
pub(super) fn convergence(rows: &[ConvergenceRow]) -> String {
    let mut out = String::from(
        "iteration,seconds,j,j_b,j_o,j_q,gradient_norm,rmse_position,rmse_velocity,sigma_factor,window,\
         model_steps,tangent_steps,adjoint_steps,factorizations,newton_iterations,hessian\n",
    );
    for r in rows {
        let values = [r.seconds, r.j, r.j_b, r.j_o, r.j_q, r.gradient_norm].map(number).join(",");
        let c = &r.counts;
        let _ = writeln!(
            out,
            "{},{values},{},{},{},{},{},{},{},{},{},{}",
            r.iteration,
            optional(r.rmse.first().copied()),
            optional(r.rmse.get(1).copied()),
            number(r.sigma_factor),
            r.window,
            c.model_steps,
            c.tangent_steps,
            c.adjoint_steps,
            c.factorizations,
            c.newton_iterations,
            r.hessian.unwrap_or("")
        );
    }
    out
}

/// trajectory.csv: the analysis, the background and, where it is known, the truth, step by step. Vertices
/// \[m\] of models in space with the velocities \[m/s\] of the free ones, or components. `sigma` are standard
/// deviations of the states of the analysis, or nothing.
pub(super) fn trajectory(
    experiment: &Experiment,
    runs: &Trajectories,
    sigma: &[f64],
    shapes: Option<&Shapes>,
) -> String {
    match (shapes, &experiment.state.geometry) {
        (Some(shapes), Some(geometry)) => vertices(&experiment.grid, runs, sigma, shapes, geometry),
        _ => components(&experiment.grid, runs, sigma, &experiment.state.names),
    }
}

/// observations.csv of a run: every value that was seen, with background, analysis and σ beside it.
pub(super) fn observed_values(values: &[ObservedValue]) -> String {
    let mut out = String::from(
        "time_s,marker,component,y,h_background,h_analysis,sigma_y,sigma_h_analysis,departure_over_sigma,\
         used,reason,unit\n",
    );
    for v in values {
        let label = v.label.replace('"', "\"\"");
        let departure = (v.value - v.analysis) / v.sigma;
        let _ = writeln!(
            out,
            "{},\"{label}\",{},{},{},{},{},{},{},{},{},{}",
            number(v.time),
            v.axis,
            number(v.value),
            number(v.background),
            number(v.analysis),
            number(v.sigma),
            optional(v.sigma_analysis),
            number(departure),
            v.used,
            v.reason,
            v.unit
        );
    }
    out
}

fn vertices(
    grid: &TimeGrid,
    runs: &Trajectories,
    sigma: &[f64],
    shapes: &Shapes,
    geometry: &Geometry,
) -> String {
    let all = [("", &shapes.analysis), ("b_", &shapes.background), ("truth_", &shapes.truth)];
    let series: Vec<_> = all.iter().filter(|(_, run)| !run.is_empty()).collect();
    let mut out = String::from("step,time_s,vertex,s_m");
    for (prefix, _) in &series {
        let _ = write!(out, ",x_{prefix}m,y_{prefix}m,z_{prefix}m");
    }
    out.push_str(",vx_m_s,vy_m_s,vz_m_s");
    if !sigma.is_empty() {
        out.push_str(",sigma_x_m,sigma_y_m,sigma_z_m,sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s");
    }
    out.push('\n');
    // A state begins with the places of the free vertices and their velocities.
    let half = 3 * geometry.free.len();
    for k in 0..=grid.last_step() {
        let time = number(grid.time(k));
        let of_step = [runs.state(&runs.analysis, k), runs.state(sigma, k)];
        for (v, s) in geometry.arc_lengths.iter().enumerate() {
            let _ = write!(out, "{k},{time},{v},{}", number(*s));
            for (_, run) in &series {
                for c in 0..3 {
                    let _ = write!(out, ",{}", optional(run.get(k).map(|shape| shape[v][c])));
                }
            }
            let free = geometry.free.binary_search(&v).ok();
            let cell = |of: Option<&[f64]>, at: usize, c: usize| Some(of?[at + 3 * free? + c]);
            for c in 0..3 {
                let _ = write!(out, ",{}", optional(cell(of_step[0], half, c)));
            }
            if !sigma.is_empty() {
                for (at, c) in [0, half].into_iter().flat_map(|at| (0..3).map(move |c| (at, c))) {
                    // A held vertex is known.
                    let sigma = if free.is_none() && at == 0 { Some(0.0) } else { cell(of_step[1], at, c) };
                    let _ = write!(out, ",{}", optional(sigma));
                }
            }
            out.push('\n');
        }
    }
    out
}

fn components(grid: &TimeGrid, runs: &Trajectories, sigma: &[f64], names: &[String]) -> String {
    let all =
        [("x_a", &runs.analysis[..]), ("x_b", &runs.background), ("truth", &runs.truth), ("sigma_a", sigma)];
    let series: Vec<_> = all.iter().filter(|(_, states)| !states.is_empty()).collect();
    let mut out = String::from("step,time_s,component");
    for (name, _) in &series {
        let _ = write!(out, ",{name}");
    }
    out.push('\n');
    for k in 0..=grid.last_step() {
        let states: Vec<Option<&[f64]>> = series.iter().map(|(_, s)| runs.state(s, k)).collect();
        let time = number(grid.time(k));
        for (i, name) in names.iter().enumerate() {
            let _ = write!(out, "{k},{time},{name}");
            for state in &states {
                let _ = write!(out, ",{}", optional(state.map(|x| x[i])));
            }
            out.push('\n');
        }
    }
    out
}

/// background.csv: the background of a rod, in the form `[background] file` reads.
pub(super) fn background(geometry: &Geometry, twin: &TwinFiles) -> String {
    let (background, end_angle) = (&twin.background, twin.end_angle.map(number));
    let spins = !geometry.free_edges.is_empty();
    let mut out = String::from("vertex,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s");
    out.push_str(if spins { ",theta_rad,spin_rad_s" } else { "" });
    if end_angle.is_some() {
        let _ = write!(out, ",{END_ANGLE}");
    }
    out.push('\n');
    let (half, edges) = (3 * geometry.free.len(), geometry.free_edges.len());
    for vertex in 0..geometry.arc_lengths.len() {
        let (free, edge) = (geometry.free.binary_search(&vertex), geometry.free_edges.binary_search(&vertex));
        if free.is_err() && edge.is_err() {
            continue;
        }
        let of_vertex = |i: usize| free.ok().map(|f| background[half * (i / 3) + 3 * f + i % 3]);
        let of_edge = |i: usize| edge.ok().map(|e| background[2 * half + i * edges + e]);
        let values = (0..6).map(of_vertex).chain((0..2).filter(|_| spins).map(of_edge)).map(optional);
        let _ = writeln!(out, "{vertex},{}", values.chain(end_angle.clone()).collect::<Vec<_>>().join(","));
    }
    out
}

/// observations.csv: what was seen of a rod in the model's axes and time, in the form `[observations] file`
/// reads.
pub(super) fn observations(shapes: &Shapes, grid: &TimeGrid) -> String {
    let mut out = String::from("time_s,s_m,x_m,y_m,z_m,sigma_m\n");
    for s in &shapes.seen {
        let p = s.position;
        let fields = [grid.start + s.at() * grid.step, s.arc_length, p[0], p[1], p[2], s.sigma];
        let _ = writeln!(out, "{}", fields.map(number).join(","));
    }
    out
}

/// pixels.csv: what cameras saw of a rod, in the form `[observations] pixels` reads.
pub(super) fn pixels(seen: &[PixelSight]) -> String {
    let mut out = String::from("time_s,camera,s_m,u_px,v_px,sigma_px\n");
    for s in seen {
        let [time, place, u, v, sigma] = [s.time, s.arc_length, s.pixel[0], s.pixel[1], s.sigma].map(number);
        let camera = s.camera.replace('"', "\"\"");
        let _ = writeln!(out, "{time},\"{camera}\",{place},{u},{v},{sigma}");
    }
    out
}

/// readings.csv: what sensors on a rod read, in the form `[observations] readings` reads.
pub(super) fn readings(all: &[Reading]) -> String {
    let mut columns: Vec<&str> = Vec::new();
    for column in all.iter().flat_map(|reading| reading.columns) {
        if !columns.contains(column) {
            columns.push(column);
        }
    }
    let mut out = format!("time_s,sensor,{},sigma\n", columns.join(","));
    for reading in all {
        let of = |column: &&str| reading.columns.iter().position(|own| own == column);
        let cell = |column| of(column).and_then(|c| reading.values[c]).map(number).unwrap_or_default();
        let cells: Vec<String> = columns.iter().map(cell).collect();
        let (time, name, sigma) =
            (number(reading.time), reading.sensor.replace('"', "\"\""), number(reading.sigma));
        let _ = writeln!(out, "{time},\"{name}\",{},{sigma}", cells.join(","));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_read_back_to_the_same_bits() {
        for x in [0.1 + 0.2, -1.0 / 3.0, 1.23456789e-9, 6.02e23, 0.0, -0.0, 5e-324, 0.03125] {
            assert_eq!(number(x).parse::<f64>().unwrap().to_bits(), x.to_bits());
        }
        assert_eq!(number(f64::NAN), "");
    }
}
