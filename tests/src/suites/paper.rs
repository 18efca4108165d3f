//! The paper's experiment, from the shipped scenes, five seeds each: where its full-step Newton converges, where the default ends, and how good the
//! analyses are.

use super::{Options, Report};
use crate::row::Rows;
use std::error::Error;
use std::fmt::Write;
use std::ops::ControlFlow;
use varda::scene::SceneFile;
use varda::setup::problem::Problem;
use varda_assimilation::{
    ControlTransform, Iteration, Minimizer, Minimum, NewtonOptions, Status, StrongConstraint,
};

/// What the paper says, and what is found here.
const WORDS: &str = "\
The paper, section 3.3: \"For Cases 1 to 3, Newton's method performed well\"; \"the 4th case led to divergence\";
\"the initial velocities are assimilated much faster and more effectively than the initial positions, which undergo very
little change\"; \"the loss and gradient plateaus after about a dozen iterations\". It has one draw a case, the plain prior.
Newton: dense Hessian (2.18), full steps, at most 50; converged means |g| ≤ 1e-6 |g₀|. Default: that of scenes, a trust region on
the true J; where J_o > 10 m at the background or it did not converge, also through inflated σ and from draws, until two runs agree. RMSE over components, mean over seeds, background → analysis.
";

pub(super) fn run(options: &Options) -> Report {
    let seeds = if options.quick { 2 } else { 5 };
    let mut rows = Rows::new("paper");
    let mut text = format!("{WORDS}\n");
    let head =
        ["case", "Newton converged", "its", "default at |g|≤", "its", "position [mm]", "velocity [m/s]"];
    line(&mut text, head.map(String::from), "J_a (m/2 = 60), each seed");
    let mut all = Vec::new();
    for case in 1..=4 {
        for conditioned in [true, false] {
            let name = format!("case{case}-{}", if conditioned { "clamp" } else { "plain" });
            rows.case(&name, |row| {
                let mut runs = Vec::new();
                for seed in 0..seeds {
                    runs.push(experiment(case, conditioned, seed)?);
                }
                let worst = runs.iter().map(|r| r.default.0).fold(0.0, f64::max);
                let worst = if runs.iter().any(|r| r.default.0.is_nan()) { f64::NAN } else { worst };
                row.at_most("default: worst |g|/|g₀|", worst, 1e-6, "-").computed(worst);
                let converged = runs.iter().filter(|r| r.newton.is_some()).count();
                row.inform("Newton: runs converged", converged as f64, "-")
                    .note(format!("of {seeds}; informative"));
                let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(f).sum::<f64>() / runs.len() as f64;
                let rmse: Vec<[f64; 2]> =
                    (0..2).map(|q| [mean(&|r| r.before[q]), mean(&|r| r.after[q])]).collect();
                row.inform("J at the analysis, mean", mean(&|r| r.value), "-")
                    .note("expected m/2 = 60; informative");
                row.inform("position RMSE of the background", rmse[0][0], "m");
                row.inform("position RMSE of the analysis", rmse[0][1], "m");
                row.inform("velocity RMSE of the background", rmse[1][0], "m/s");
                row.inform("velocity RMSE of the analysis", rmse[1][1], "m/s");
                let newton: Vec<String> =
                    runs.iter().map(|r| r.newton.map_or("-".into(), |n| n.to_string())).collect();
                let its: Vec<String> = runs.iter().map(|r| r.default.1.to_string()).collect();
                let values: Vec<String> = runs.iter().map(|r| format!("{:.1}", r.value)).collect();
                let cells = [
                    name.clone(),
                    format!("{converged} of {seeds}"),
                    newton.join(" "),
                    format!("{worst:.1e}"),
                    its.join(" "),
                    format!("{:.1} → {:.1}", 1e3 * rmse[0][0], 1e3 * rmse[0][1]),
                    format!("{:.3} → {:.3}", rmse[1][0], rmse[1][1]),
                ];
                line(&mut text, cells, &values.join(" "));
                all.extend(runs.into_iter().map(|run| (case, conditioned, run)));
                Ok(())
            });
        }
    }
    text.push_str(&beside_the_paper(&all));
    Report { rows: rows.finish(), text }
}

fn line(text: &mut String, cells: [String; 7], last: &str) {
    let [case, newton, its, worst, more, position, velocity] = cells;
    let _ = writeln!(
        text,
        "{case:<12} {newton:>16}  {its:<16} {worst:>14}  {more:<18} {position:<14} {velocity:<16} {last}"
    );
}

/// The paper's findings in our numbers.
fn beside_the_paper(all: &[(usize, bool, Run)]) -> String {
    let newton = |cases: std::ops::RangeInclusive<usize>, conditioned: bool| {
        let some = || all.iter().filter(|(c, k, _)| cases.contains(c) && *k == conditioned);
        format!("{} of {}", some().filter(|(.., r)| r.newton.is_some()).count(), some().count())
    };
    let left = |q: usize| {
        let ratio = |(.., r): &(usize, bool, Run)| r.after[q] / r.before[q];
        100.0 * all.iter().map(ratio).sum::<f64>() / all.len() as f64
    };
    format!(
        "\nHere: Newton converges in {} runs of cases 1 to 3 with the plain prior ({} in case 1 alone) and in {} of case 4 (the clamp \
         prior: {} and {}).\nOf the background's RMSE the analysis leaves {:.0} % in positions and {:.0} % in velocities (mean ratio over all runs): velocities \
         gain more, positions are not \"virtually unchanged\".\n",
        newton(1..=3, false),
        newton(1..=1, false),
        newton(4..=4, false),
        newton(1..=3, true),
        newton(4..=4, true),
        left(0),
        left(1)
    )
}

/// One draw of a case.
struct Run {
    /// Iterations of full-step Newton, where it converged.
    newton: Option<usize>,
    /// |g|/|g₀| and iterations of the default.
    default: (f64, usize),
    /// J where the default ended.
    value: f64,
    /// RMSE of positions \[m\] and velocities \[m/s\].
    before: [f64; 2],
    after: [f64; 2],
}

fn experiment(case: usize, conditioned: bool, seed: u64) -> Result<Run, Box<dyn Error>> {
    let prior = if conditioned { "clamp" } else { "plain" };
    let set = [format!("seed={seed}"), format!("background.covariance.prior={prior}")];
    let mut problem = Problem::from_scene(&SceneFile::open(&format!("hanging-rod-case{case}"), &set)?)?;
    let background = problem.background.clone();
    let truth = problem.truth.ok_or("a twin experiment knows its truth")?;
    let truth = &truth[..background.len()];
    let transform = ControlTransform::new(background.clone(), problem.covariance.as_ref())?;
    let observations = &mut problem.observations;
    let mut cost = StrongConstraint::new(problem.model.as_mut(), transform.clone(), observations)?;
    let go_on = &mut |_: &Iteration| ControlFlow::Continue(());

    let mut v = vec![0.0; transform.dim()];
    let newton = Minimizer::Newton(NewtonOptions { gradient_tolerance: 1e-6, max_iterations: 50 });
    let found: Minimum = newton.minimize(&mut cost, &mut v, go_on)?;
    let newton = (found.status == Status::Converged).then_some(found.outer_iterations);

    v.fill(0.0);
    let default = Minimizer::named(problem.scene.algorithm.minimizer.name())
        .ok_or("the scene's minimizer has a name")?;
    let found = default.minimize(&mut cost, &mut v, go_on)?;
    let mut analysis = vec![0.0; truth.len()];
    transform.control(&v, &mut analysis);
    Ok(Run {
        newton,
        default: (found.gradient_norm / found.gradient_norm_first, found.outer_iterations),
        value: found.value,
        before: rmse(&background, truth),
        after: rmse(&analysis, truth),
    })
}

/// Root mean square over the components of positions and of velocities.
fn rmse(z: &[f64], truth: &[f64]) -> [f64; 2] {
    let n = z.len() / 2;
    let of = |a: &[f64], b: &[f64]| {
        (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
    };
    [of(&z[..n], &truth[..n]), of(&z[n..], &truth[n..])]
}
