//! The tables the commands print.

use std::fmt::Write;
use std::path::Path;

use crate::outcome::{Outcome, Quantity, RodModes, Simulation, Status};
use crate::run::compare::Compared;

/// Most notes in a table; the report has all of them.
const MOST_NOTES: usize = 6;
/// Most markers of a recording in a table; summary.json has all of them.
const MOST_DISTANCES: usize = 12;

pub(super) fn outcome(o: &Outcome, folder: &Path, seconds: f64) -> String {
    let experiment = &o.experiment;
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<14} {text}");
    };
    let algorithm = &experiment.scene.algorithm;
    line(o.judgement.verdict.heading(), o.judgement.text.clone());
    line("scene", format!("{} (seed {})", experiment.name, experiment.scene.seed));
    line("method", format!("{}, {}: {}", algorithm.method.name(), algorithm.solver_name(), o.status.name()));
    line(
        "sizes",
        format!(
            "{} unknowns, {} observed values, {} steps",
            experiment.n_unknown(),
            o.analysis.observations,
            experiment.grid.steps
        ),
    );
    line(
        "J",
        format!(
            "{:.6} -> {:.6}  (background {:.4}, observations {:.4}{}; 2J/m = {:.3})",
            o.j_background,
            o.analysis.value,
            o.analysis.terms.background,
            o.analysis.terms.observation,
            if algorithm.method.is_weak() {
                let expected = o.model_errors.as_ref().and_then(|e| e.expected_j_q);
                let expected = expected.map_or(String::new(), |e| format!(" where {e:.4} is expected"));
                format!(", model error {:.4}{expected}", o.analysis.terms.model_error)
            } else {
                String::new()
            },
            o.analysis.chi2
        ),
    );
    line(
        "gradient",
        format!(
            "{:.2e} -> {:.2e} in {} outer iterations",
            o.gradient_norms[0], o.gradient_norms[1], o.iterations[0]
        ),
    );
    for (group, rmse) in experiment.state.groups.iter().zip(&o.rmse.0) {
        if let Some([b, a]) = rmse.known() {
            let text = format!("{b:.4e} -> {a:.4e}{}  (x {:.3})", group.unit_after(), a / b);
            line(&group.labelled("RMSE"), text);
        }
    }
    // a field has a value at every vertex: estimates.csv has all
    for e in o.estimates.iter().filter(|e| !e.is_of_field()) {
        line(&e.name, e.in_words());
    }
    for of in &o.considered {
        line("[consider]", of.in_words());
    }
    for w in &o.withheld {
        let (scale, unit) = w.quantity.shown();
        let of_all = match w.count {
            1 => String::new(),
            n => {
                let aside = scale * w.moving_analysis;
                format!(" rms over {n} times ({aside:.2} with its constant offset aside)")
            }
        };
        let [b, a] = [w.rms_background, w.rms_analysis].map(|d| scale * d);
        line("withheld", format!("{}: {b:.2} {unit} -> {a:.2} {unit}{of_all}", w.label));
    }
    for f in &o.forecast {
        let (scale, unit) = f.quantity.shown();
        line(
            "forecast",
            format!(
                "{}: {:.2} {unit} rms; persistence {:.2}, static model {:.2} (offset aside: {:.2}, best \
                 constant {:.2})",
                f.label,
                scale * f.analysis,
                scale * f.persistence,
                scale * f.static_model,
                scale * f.moving_analysis,
                scale * f.moving_constant
            ),
        );
    }
    line(
        "work",
        format!(
            "{} model steps, {} tangent, {} adjoint, {} factorizations",
            o.counts.model_steps, o.counts.tangent_steps, o.counts.adjoint_steps, o.counts.factorizations
        ),
    );
    let s = &o.seconds;
    line(
        "time",
        format!(
            "{seconds:.2} s: set-up {:.2}, minimization {:.2}, posterior {:.2}, diagnostics {:.2}{}, files \
             {:.2}",
            s.set_up,
            s.minimizer,
            s.posterior,
            s.diagnostics,
            if s.mesh > 0.0 { format!(", finer mesh {:.2}", s.mesh) } else { String::new() },
            seconds - s.total
        ),
    );
    for w in o.warnings.iter().take(MOST_NOTES) {
        line("note", w.clone());
    }
    if o.warnings.len() > MOST_NOTES {
        line("note", format!("{} more in summary.json", o.warnings.len() - MOST_NOTES));
    }
    let shown = if o.status == Status::Failed { "what was reached" } else { "report" };
    line(shown, folder.join("report.html").display().to_string());
    out
}

pub(super) fn comparison(rows: &[Compared], folder: &Path) -> String {
    let number = |x: Option<f64>| x.map_or("-".to_string(), |x| format!("{x:.3e}"));
    let mut out = format!(
        "{:<18} {:<23} {:<15} {:>9} {:>10} {:>9} {:>9} {:>9} {:>9}\n",
        "method", "solver", "status", "gap", "RMSE", "seconds", "model", "tangent", "adjoint"
    );
    for r in rows {
        let _ = writeln!(
            out,
            "{:<18} {:<23} {:<15} {:>9} {:>10} {:>9} {:>9} {:>9} {:>9}{}{}",
            r.method,
            r.solver,
            r.status,
            number(r.gap),
            number(r.rmse),
            number(r.seconds),
            r.counts.model_steps,
            r.counts.tangent_steps,
            r.counts.adjoint_steps,
            if r.reason.is_empty() { "" } else { "  " },
            r.reason
        );
    }
    let _ = writeln!(
        out,
        "gap = (J - J*)/(J0 - J*), J* the lowest found (not for weak constraint and ensembles, whose J is \
         another); written to {}",
        folder.display()
    );
    out
}

pub(super) fn modes(modes: &RodModes, folder: &Path) -> String {
    let mut out = format!("{:>4} {:>14} {:>12}\n", "mode", "frequency (Hz)", "period (s)");
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let _ = match mode.frequency() {
            Some(0.0) => {
                let least = modes.found.resolution.sqrt() / std::f64::consts::TAU;
                writeln!(out, "{:>4} {:>14} it moves freely, or slower than {least:.2e} Hz", i + 1, 0)
            }
            Some(f) if modes.spins() => {
                let spin = 100.0 * modes.spin_share(mode);
                writeln!(out, "{:>4} {f:>14.6} {:>12.6} {spin:>5.1} % spin", i + 1, 1.0 / f)
            }
            Some(f) => writeln!(out, "{:>4} {f:>14.6} {:>12.6}", i + 1, 1.0 / f),
            None => {
                let time = 1.0 / (-mode.omega_squared).sqrt();
                writeln!(out, "{:>4} grows e-fold in {time:.6} s: the shape at rest is not stable", i + 1)
            }
        };
    }
    let _ = writeln!(out, "shapes: {}", folder.join("mode_shapes.csv").display());
    out
}

pub(super) fn simulation(s: &Simulation, folder: &Path, seconds: f64) -> String {
    let experiment = &s.experiment;
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<14} {text}");
    };
    let w = &experiment.grid;
    line("scene", format!("{} (seed {})", experiment.name, experiment.scene.seed));
    line("run", format!("of the {}: {} steps of {:.6} s from t = {:.6} s", s.of, s.steps, w.step, w.start));
    if let Some(tip) = s.tip() {
        line("tip at the end", format!("({:.6}, {:.6}, {:.6}) m", tip[0], tip[1], tip[2]));
    }
    if let Some(first) = s.distances.first() {
        let shown = |quantity: Quantity, rms: f64| match quantity.shown() {
            (_, "") => format!("{rms:.3e} rms"),
            (scale, unit) => format!("{:.2} {unit} rms", scale * rms),
        };
        let count: usize = s.distances.iter().map(|d| d.count).sum();
        let all =
            s.rms_distance().map_or(String::new(), |rms| format!("{} over ", shown(first.quantity, rms)));
        line("off recording", format!("{all}{count} sightings"));
        for d in s.distances.iter().take(MOST_DISTANCES) {
            line("", format!("{}: {} over {}", d.label, shown(d.quantity, d.rms), d.count));
        }
        if s.distances.len() > MOST_DISTANCES {
            line("", format!("{} more in summary.json", s.distances.len() - MOST_DISTANCES));
        }
    }
    line(
        "work",
        format!(
            "{} Newton iterations, {} factorizations",
            s.counts.newton_iterations, s.counts.factorizations
        ),
    );
    line("time", format!("{seconds:.2} s"));
    for w in &s.warnings {
        line("note", w.clone());
    }
    line("trajectory", folder.join("trajectory.csv").display().to_string());
    out
}
