//! The paper's experiment, from the shipped scenes, five seeds each: where its full-step Newton converges,
//! where the default ends, and how good the analyses are.

use super::{Options, Report};
use crate::row::{Case, Rows};
use std::error::Error;
use std::fmt::Write;
use std::ops::ControlFlow;
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{
    ControlTransform, Iteration, Minimizer, Minimum, NewtonOptions, Status, StrongConstraint,
};

/// What the paper says, and what is found here.
const WORDS: &str = "\
The paper, section 3.3: \"For Cases 1 to 3, Newton's method performed well\"; \"the 4th case led to \
divergence\";
\"the initial velocities are assimilated much faster and more effectively than the initial positions, which \
undergo very
little change\"; \"the loss and gradient plateaus after about a dozen iterations\". It has one draw a case, \
the plain prior.
Newton: dense Hessian (2.18), full steps, at most 50; converged means |g| ≤ 1e-6 |g₀|. Default: that of \
scenes, a trust region on
the true J; where J_o > 10 m at the background or it did not converge, also through inflated σ and from \
draws, while further starts pay. RMSE over components, mean over seeds, background → analysis.
";

/// Seeds of a full run.
const SEEDS: u64 = 5;

pub(super) fn run(options: &Options) -> Report {
    // Seeds on which the default takes few iterations with the plain prior, so that a quick run stays quick.
    let seeds: Vec<u64> = if options.quick { vec![1, 3] } else { (0..SEEDS).collect() };
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
                let runs = seeds.iter().map(|&seed| experiment(case, conditioned, seed)).collect::<Result<
                    Vec<Run>,
                    _,
                >>(
                )?;
                check(row, case, conditioned, &runs);
                line(&mut text, summary(&name, &runs), &listed(&runs, |r| format!("{:.1}", r.value)));
                all.extend(runs.into_iter().map(|run| (case, conditioned, run)));
                Ok(())
            });
        }
    }
    rows.case("all cases", |row| {
        let share =
            |q: usize| all.iter().map(|(.., r)| r.after[q] / r.before[q]).sum::<f64>() / all.len() as f64;
        row.at_most(GAIN, share(1) / share(0), 1.0, "-")
            .note(format!("{:.0} % of {:.0} %", 100.0 * share(1), 100.0 * share(0)))
            .because(MORE_EFFECTIVELY);
        Ok(())
    });
    text.push_str(&beside_the_paper(&all));
    Report { rows: rows.finish(), text, ..Report::default() }
}

/// The findings of one case as rows.
fn check(row: &mut Case, case: usize, conditioned: bool, runs: &[Run]) {
    let seeds = runs.len();
    let worst = runs.iter().map(|r| r.default.0).fold(0.0, |m: f64, g| if g <= m { m } else { g });
    row.at_most("default: worst |g|/|g₀|", worst, 1e-6, "-")
        .computed(worst)
        .because("the scene asks for 1e-8; a hundred times that is a minimum for every purpose here");

    let converged = runs.iter().filter(|r| r.newton.is_some()).count();
    let note = format!("{converged} of {seeds} runs converge");
    match (case, conditioned) {
        (1, false) => row
            .at_most("Newton: runs converged", converged as f64, 0.0, "-")
            .note(note)
            .because("found in every seed here; the paper's one draw converged"),
        (4, false) => row
            .at_most("Newton: runs converged", converged as f64, 0.0, "-")
            .note(note)
            .because("the paper: \"the 4th case led to divergence\""),
        (4, true) => row
            .inform("Newton: runs converged", converged as f64, "-")
            .note(format!("{note}; the paper has no such prior")),
        _ => row
            .at_most("Newton: runs that do not converge", (seeds - converged) as f64, 0.0, "-")
            .note(note)
            .because("the paper: \"for Cases 1 to 3, Newton's method performed well\""),
    };
    // NaN where Newton's method did not converge in any run.
    let left = runs.iter().filter_map(|r| r.left_after_a_dozen).fold(f64::NAN, f64::max);
    if case < 4 && converged > 0 {
        row.at_most("Newton: (J₁₂ − J_a)/(J_b − J_a) where it converges", left, 1e-3, "-")
            .computed(left)
            .because(
                "the paper: \"the loss and gradient plateaus after about a dozen iterations\": a \
                thousandth of the fall is not seen",
            );
    }

    let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(f).sum::<f64>() / seeds as f64;
    let value = mean(&|r| r.value);
    row.at_most(
        "|mean of J at the analysis − \
        m/2|",
        (value - 60.0).abs(),
        31.0 / (seeds as f64).sqrt(),
        "-",
    )
    .computed(value)
    .because(
        "2J has mean m = 120 and variance 2m: J has σ = 7.7; four standard errors of a mean over \
            the seeds",
    );
    let of = |q: usize| mean(&|r| r.after[q]) / mean(&|r| r.before[q]);
    let (position, velocity) = (of(0), of(1));
    row.at_most("position RMSE, analysis / background", position, 1.0, "-")
        .note(format!("{:.4} → {:.4} m", mean(&|r| r.before[0]), mean(&|r| r.after[0])))
        .because("an analysis that is no better than its background is none");
    row.at_most("velocity RMSE, analysis / background", velocity, 1.0, "-")
        .note(format!("{:.3} → {:.3} m/s", mean(&|r| r.before[1]), mean(&|r| r.after[1])))
        .because("an analysis that is no better than its background is none");
    let gain = velocity / position;
    if seeds < SEEDS as usize {
        row.inform(GAIN, gain, "-").note("a mean over fewer seeds than its bound is for");
    } else if conditioned && case == 4 {
        row.inform(GAIN, gain, "-").note(
            "the paper has no such prior; exact observations help positions as \
            much",
        );
    } else {
        row.at_most(GAIN, gain, 1.0, "-").because(MORE_EFFECTIVELY);
    }
}

const GAIN: &str = "share left of velocities / of positions";
const MORE_EFFECTIVELY: &str =
    "the paper: velocities are assimilated \"more effectively than the initial positions\"";

/// What a run gives, for each seed.
fn listed(runs: &[Run], what: impl Fn(&Run) -> String) -> String {
    runs.iter().map(what).collect::<Vec<String>>().join(" ")
}

/// The cells of a case's line.
fn summary(name: &str, runs: &[Run]) -> [String; 7] {
    let converged = runs.iter().filter(|r| r.newton.is_some()).count();
    let worst = runs.iter().map(|r| r.default.0).fold(0.0, |m: f64, g| if g <= m { m } else { g });
    let mean = |f: &dyn Fn(&Run) -> f64| runs.iter().map(f).sum::<f64>() / runs.len() as f64;
    [
        name.to_string(),
        format!("{converged} of {}", runs.len()),
        listed(runs, |r| r.newton.map_or("-".into(), |n| n.to_string())),
        format!("{worst:.1e}"),
        listed(runs, |r| r.default.1.to_string()),
        format!("{:.1} → {:.1}", 1e3 * mean(&|r| r.before[0]), 1e3 * mean(&|r| r.after[0])),
        format!("{:.3} → {:.3}", mean(&|r| r.before[1]), mean(&|r| r.after[1])),
    ]
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
        "\nHere: Newton converges in {} runs of cases 1 to 3 with the plain prior ({} in case 1 alone) and \
         in {} of case 4 (the clamp prior: {} and {}).\nOf the background's RMSE the analysis leaves {:.0} % \
         in positions and {:.0} % in velocities (mean ratio over all runs): velocities gain more, positions \
         are not \"virtually unchanged\".\n",
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
    /// (J₁₂ − J_a)/(J_b − J_a) of Newton's twelfth iterate (its last, where it needs fewer), where it
    /// converged.
    left_after_a_dozen: Option<f64>,
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
    let problem = Problem::from_scene(&SceneFile::open(&format!("hanging-rod-case{case}"), &set)?)?;
    let background = problem.background.clone();
    let truth = problem.truth.as_ref().ok_or("a twin experiment knows its truth")?;
    let truth = &truth[..background.len()];
    let transform = ControlTransform::new(background.clone(), problem.covariance.as_ref())?;
    let (mut model, mut observations) = (problem.model(), problem.observations()?);
    let mut cost = StrongConstraint::new(model.as_mut(), transform.clone(), &mut observations)?;
    let go_on = &mut |_: &Iteration| ControlFlow::Continue(());

    let mut v = vec![0.0; transform.dim()];
    let newton =
        Minimizer::Newton(NewtonOptions::default().with_gradient_tolerance(1e-6).with_max_iterations(50));
    let mut values = Vec::new();
    let found: Minimum = newton.minimize(&mut cost, &mut v, &mut |at: &Iteration| {
        values.push(at.value);
        ControlFlow::Continue(())
    })?;
    let newton = (found.status == Status::Converged).then_some(found.outer_iterations);
    let after_a_dozen = values.get(12).copied().unwrap_or(found.value);
    let left = (after_a_dozen - found.value) / (values.first().copied().unwrap_or(f64::NAN) - found.value);

    v.fill(0.0);
    let default = Minimizer::named(problem.experiment.scene.algorithm.minimizer.name())
        .ok_or("the scene's minimizer has a name")?;
    let found = default.minimize(&mut cost, &mut v, go_on)?;
    let mut analysis = vec![0.0; truth.len()];
    transform.control(&v, &mut analysis);
    Ok(Run {
        newton,
        left_after_a_dozen: newton.map(|_| left),
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
