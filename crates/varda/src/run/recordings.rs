//! Several recordings of one system in one estimate.

use std::ops::ControlFlow;
use std::time::Instant;

use varda_assimilation::{Iteration, highest_j_of_a_fit};
use varda_implicit::Model;

use super::mesh::{self, Coarse, Finest};
use super::window::{Ended, Listener, described, row, seconds_so_far};
use crate::Error;
use crate::outcome::{
    ConvergenceRow, Estimated, JointOutcome, Judgement, Outcome, Seconds, Share, Status, Verdict, WorkCounts,
    in_words, remarks_on_estimates,
};
use crate::scene::SceneFile;
use crate::setup::{Inputs, Problem, Recordings};
use crate::solve::Iterate;
use crate::solve::joint::{JointPart, JointSolution, joint};
use crate::solve::timed::{Clock, Timed};

/// Minimises the cost of several recordings that share constants, J = Σ_r J_r less what it has too often of
/// the prior of what is shared ([`Joint`](varda_assimilation::Joint)), and collects for each what
/// [`assimilate`](super::assimilate) collects of one. The same recordings give the same bits every time.
///
/// # Errors
/// As for [`assimilate`](super::assimilate).
pub fn assimilate_recordings(all: &Recordings, listener: &mut Listener) -> Result<JointOutcome, Error> {
    let mut outcome = minimized(all, listener)?;
    let (of_mesh, seconds) = allow_for_mesh(all, &mut outcome, listener);
    outcome.warnings.extend(of_mesh);
    let fits = outcome.judgement.verdict == Verdict::Fits;
    let names: Vec<String> = outcome.recordings.iter().map(|one| one.experiment.name.clone()).collect();
    let (shared, mut own) = (shared_of(&outcome.recordings[0], &all.shared[0]), Vec::new());
    for ((one, shared), name) in outcome.recordings.iter_mut().zip(&all.shared).zip(&names) {
        let of_one = one.estimates.iter().enumerate().filter(|(i, _)| !shared.contains(i));
        own.extend(of_one.map(|(_, e)| Estimated {
            name: format!("{} ({name})", e.name),
            correlations: Vec::new(),
            ..e.clone()
        }));
        one.warnings.extend(remarks_on_estimates(&one.estimates, fits));
    }
    outcome.warnings.extend(remarks_on_estimates(&shared, fits));
    outcome.estimates = [shared, own].concat();
    outcome.seconds.mesh = seconds;
    outcome.seconds.total = listener.started.elapsed().as_secs_f64();
    Ok(outcome)
}

/// Constants of all recordings as one of them has them, their correlations among each other.
fn shared_of(one: &Outcome, shared: &[usize]) -> Vec<Estimated> {
    let of = |i: &usize| {
        let e = &one.estimates[*i];
        let correlations = shared.iter().filter_map(|j| e.correlations.get(*j).copied()).collect();
        Estimated { correlations, ..e.clone() }
    };
    shared.iter().map(of).collect()
}

fn minimized(all: &Recordings, listener: &mut Listener) -> Result<JointOutcome, Error> {
    let (scene, problems) = (&all.file.scene, &all.problems);
    let began = Instant::now();
    let mut convergence: Vec<ConvergenceRow> = Vec::new();
    let mut late = false;
    let clock = Clock::default();
    let mut models: Vec<Box<dyn Model + Send>> = problems.iter().map(Problem::model).collect();
    let mut timed: Vec<Timed<_>> =
        models.iter_mut().map(|model| Timed::new(model.as_mut(), &clock)).collect();
    let mut sets = problems.iter().map(Problem::observations).collect::<Result<Vec<_>, _>>()?;
    let window = sets.iter().map(|set| set.steps()).max().unwrap_or(0);
    let mut parts = Vec::new();
    for (((problem, shared), model), observations) in
        problems.iter().zip(&all.shared).zip(&mut timed).zip(&mut sets)
    {
        let constants = problem.system.estimates().len();
        parts.push(JointPart {
            model,
            observations,
            background: &problem.background,
            covariance: &problem.covariance,
            shared: shared.iter().map(|i| constants - 1 - i).collect(),
            constants: problem.single_constants(),
            memory: problem.memory,
        });
    }
    let mut on_iteration = |iteration: &Iteration| {
        let before = (0, WorkCounts::default());
        let row = row(&Iterate { iteration, control: &[], window, before }, began, Vec::new(), 0);
        (listener.on_iteration)(&row);
        convergence.push(row);
        late = late || scene.limits.over(listener.started.elapsed());
        match late || (listener.interrupted)() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    };
    // of a finer mesh the posterior is not asked for
    let posterior = problems[0].experiment.scene.report.posterior;
    let solution = joint(&scene.algorithm, posterior, parts, &mut on_iteration)?;
    let logs: Vec<_> = timed.iter().map(|model| model.log().clone()).collect();
    drop(timed);
    let seconds = seconds_so_far([listener.started, began], &convergence, &clock);
    let described_from = Instant::now();
    let JointSolution { minimum, parts, shared, spread, no_spread, counts } = solution;
    let status = Status::from(minimum.status);
    let late = late && status == Status::Interrupted;
    let mut recordings = Vec::new();
    for ((((problem, solution), observations), model), log) in
        problems.iter().zip(parts).zip(sets).zip(models).zip(logs)
    {
        let ended = Ended {
            solution,
            observations,
            second: None,
            convergence: Vec::new(),
            seconds: Seconds::default(),
            log,
            late,
            early: false,
            model,
            models: None,
            accepted_steps: None,
            remarks_on_steps: Vec::new(),
            is_one_of_several: true,
        };
        recordings.push(described(problem, ended, listener)?);
    }
    let observations: usize = recordings.iter().map(|one| one.analysis.observations).sum();
    let j = minimum.value;
    let chi2 = if observations == 0 { 0.0 } else { 2.0 * j / observations as f64 };
    let mut warnings: Vec<String> = minimum.failure.iter().map(ToString::to_string).collect();
    warnings.extend(no_spread.map(|reason| format!("there is no posterior: {reason}")));
    warnings.extend(late.then(|| scene.limits.remark()).flatten());
    let known = scene.algorithm.robust.is_none();
    let [signal, of_shared] = match &spread {
        Some(spread) if known => [Some(0.5 * spread.degrees_of_freedom), Some(0.5 * spread.of_shared)],
        _ => [None, None],
    };
    let own = minimum.terms.background - shared;
    let share = |part, j, expected| Share { part, j, expected };
    let shares = vec![
        share("background of the states", own, signal.zip(of_shared).map(|(all, p)| all - p)),
        share("prior of the shared constants", shared, of_shared),
        share("observations", minimum.terms.observation, signal.map(|d| 0.5 * observations as f64 - d)),
    ];
    let widths: Vec<usize> = all.shared.iter().map(Vec::len).collect();
    let unknowns: usize = problems.iter().map(|problem| problem.experiment.n_unknown()).sum();
    Ok(JointOutcome {
        name: all.file.name.clone(),
        scene: scene.clone(),
        status,
        judgement: judged(&recordings, j, observations),
        late,
        j_background: recordings.iter().map(|one| one.j_background).sum(),
        recordings,
        j,
        unknowns: unknowns - widths.iter().skip(1).sum::<usize>(),
        observations,
        chi2,
        degrees_of_freedom: spread.as_ref().map(|spread| spread.degrees_of_freedom),
        shares,
        estimates: Vec::new(),
        gradient_norms: [minimum.gradient_norm_first, minimum.gradient_norm],
        iterations: [minimum.outer_iterations, minimum.inner_iterations],
        convergence,
        counts,
        seconds: Seconds { diagnostics: described_from.elapsed().as_secs_f64(), ..seconds },
        warnings,
    })
}

/// All fit, and J of all is no larger than chance makes it; nothing fits where nothing is seen.
fn judged(recordings: &[Outcome], j: f64, m: usize) -> Judgement {
    let of = |verdict: Verdict| -> Vec<&Outcome> {
        recordings.iter().filter(|one| one.judgement.verdict == verdict).collect()
    };
    let count = in_words(recordings.len());
    let numbers = format!("2J/m = {:.3} of {m} values in {count}", 2.0 * j / m.max(1) as f64);
    if m == 0 {
        let text = "no value is observed: the analyses are the backgrounds".to_string();
        return Judgement { verdict: Verdict::NothingObserved, text };
    }
    for verdict in [Verdict::NothingObserved, Verdict::NotConverged, Verdict::DoesNotFit] {
        if let Some(first) = of(verdict).first() {
            let names: Vec<&str> = of(verdict).iter().map(|one| one.experiment.name.as_str()).collect();
            let which = match names.len() > 1 && names.len() == recordings.len() {
                true => "all".to_string(),
                false => names.join(", "),
            };
            let text = format!("{which} ({numbers}); {}: {}", names[0], first.judgement.text);
            return Judgement { verdict, text };
        }
    }
    match j <= highest_j_of_a_fit(m) {
        true if recordings.len() == 1 => Judgement { verdict: Verdict::Fits, text: numbers },
        true => Judgement { verdict: Verdict::Fits, text: format!("{numbers}; each fits") },
        false => {
            let text = format!("{numbers}: each by itself is within chance, all together are not");
            Judgement { verdict: Verdict::DoesNotFit, text }
        }
    }
}

/// The allowance for the mesh: all recordings on a finer one.
fn allow_for_mesh(all: &Recordings, outcome: &mut JointOutcome, listener: &Listener) -> (Vec<String>, f64) {
    let run = Coarse {
        status: outcome.status,
        verdict: outcome.judgement.verdict,
        iterations: outcome.iterations[0],
        chi2: outcome.chi2,
    };
    let problems: Vec<&Problem> = all.problems.iter().collect();
    let mut estimates: Vec<&mut Vec<Estimated>> =
        outcome.recordings.iter_mut().map(|one| &mut one.estimates).collect();
    mesh::allow(&problems, &mut estimates, run, |files| {
        let problem = |file: &SceneFile| Problem::new(Inputs::read(file)?);
        let problems = files.iter().map(problem).collect::<Result<Vec<_>, _>>()?;
        let finer = minimized(&Recordings::of(all.file.clone(), problems)?, &mut listener.quiet())?;
        let estimates = finer.recordings.into_iter().map(|one| one.estimates).collect();
        Ok(Finest { status: finer.status, chi2: finer.chi2, estimates })
    })
}
