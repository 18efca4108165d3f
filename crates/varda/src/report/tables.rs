//! The CSV files of a result.

use std::fmt::Write;

use crate::Error;
use crate::run::compare::Compared;
use crate::run::window::{ConvergenceRow, Outcome, Trajectories};
use crate::setup::problem::{Problem, RodView, View};
use crate::setup::rod_observations::Window;

/// A number as the shortest text that reads back to the same bits; nothing for one that is not there.
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

/// Name and unit of every component of the control.
pub(super) fn components(problem: &Problem) -> Vec<(String, &'static str)> {
    match &problem.view {
        View::Components(names) => names.iter().map(|n| (n.clone(), "1")).collect(),
        View::Rod(rod) => {
            let free = rod.dynamics.free_vertices();
            let of = |prefix: &'static str, unit: &'static str| {
                free.iter().flat_map(move |v| ["x", "y", "z"].map(|c| (format!("{prefix}{c}[{v}]"), unit)))
            };
            of("", "m").chain(of("v", "m/s")).collect()
        }
    }
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
pub(super) fn analysis(problem: &Problem, outcome: &Outcome) -> String {
    let a = &outcome.analysis;
    let mut out = String::from("index,name,unit,x_b,x_a,sigma_b,sigma_a");
    out.push_str(if outcome.truth.is_some() { ",truth\n" } else { "\n" });
    for (i, (name, unit)) in components(problem).iter().enumerate() {
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

/// convergence.csv.
pub(super) fn convergence(rows: &[ConvergenceRow]) -> String {
    let mut out = String::from(
        "iteration,seconds,j,j_b,j_o,j_q,gradient_norm,rmse_position,rmse_velocity,sigma_factor,window,\
         model_steps,tangent_steps,adjoint_steps,factorizations,newton_iterations\n",
    );
    for r in rows {
        let values = [r.seconds, r.j, r.j_b, r.j_o, r.j_q, r.gradient_norm].map(number).join(",");
        let c = &r.counts;
        let _ = writeln!(
            out,
            "{},{values},{},{},{},{},{},{},{},{},{}",
            r.iteration,
            optional(r.rmse_position),
            optional(r.rmse_velocity),
            number(r.sigma_factor),
            r.window,
            c.model_steps,
            c.tangent_steps,
            c.adjoint_steps,
            c.factorizations,
            c.newton_iterations
        );
    }
    out
}

/// trajectory.csv: the analysis, the background and, where it is known, the truth, step by step. Vertices of a rod
/// \[m\], or components.
pub(super) fn trajectory(problem: &mut Problem, runs: &Trajectories) -> Result<String, Error> {
    let window = problem.window;
    let all =
        [("", "x_a", &runs.analysis), ("b_", "x_b", &runs.background), ("truth_", "truth", &runs.truth)];
    let series: Vec<_> = all.iter().filter(|(_, _, states)| !states.is_empty()).collect();
    let mut out = String::from(match problem.view {
        View::Rod(_) => "step,time_s,vertex,s_m",
        View::Components(_) => "step,time_s,component",
    });
    for (prefix, name, _) in &series {
        let _ = match problem.view {
            View::Rod(_) => write!(out, ",x_{prefix}m,y_{prefix}m,z_{prefix}m"),
            View::Components(_) => write!(out, ",{name}"),
        };
    }
    out.push('\n');
    for k in 0..=window.steps + window.forecast {
        let states: Vec<Option<&[f64]>> = series.iter().map(|(_, _, s)| runs.state(s, k)).collect();
        let time = number(window.time(k));
        match &mut problem.view {
            View::Rod(rod) => {
                let s = rod.parts.rod.arc_lengths();
                let mut shapes = Vec::new();
                for state in &states {
                    shapes.push(state.map(|x| rod.vertices(&window, k, x)).transpose()?);
                }
                for (v, s) in s.iter().enumerate() {
                    let _ = write!(out, "{k},{time},{v},{}", number(*s));
                    for shape in &shapes {
                        for c in 0..3 {
                            let _ = write!(out, ",{}", optional(shape.as_ref().map(|x| x[v][c])));
                        }
                    }
                    out.push('\n');
                }
            }
            View::Components(names) => {
                for (i, name) in names.iter().enumerate() {
                    let _ = write!(out, "{k},{time},{name}");
                    for state in &states {
                        let _ = write!(out, ",{}", optional(state.map(|x| x[i])));
                    }
                    out.push('\n');
                }
            }
        }
    }
    Ok(out)
}

/// background.csv: the background of a rod, in the form `[background] file` reads.
pub(super) fn background(rod: &RodView, background: &[f64]) -> String {
    let mut out = String::from("vertex,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n");
    let (x, v) = background.split_at(background.len() / 2);
    for ((vertex, x), v) in rod.dynamics.free_vertices().iter().zip(x.chunks_exact(3)).zip(v.chunks_exact(3))
    {
        let values: Vec<String> = x.iter().chain(v).map(|c| number(*c)).collect();
        let _ = writeln!(out, "{vertex},{}", values.join(","));
    }
    out
}

/// observations.csv: what was seen of a rod in the model's axes and time, in the form `[observations] file` reads.
pub(super) fn observations(rod: &RodView, window: &Window) -> String {
    let mut out = String::from("time_s,s_m,x_m,y_m,z_m,sigma_m\n");
    for seen in &rod.sightings.seen {
        if let Some(p) = seen.position(&rod.sightings.rotation) {
            let s = rod.sightings.sites[seen.site].marker.s;
            let fields =
                [window.start + seen.at() * window.step, s, p[0], p[1], p[2], seen.sigma].map(number);
            let _ = writeln!(out, "{}", fields.join(","));
        }
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
