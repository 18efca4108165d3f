//! Cycling on Lorenz-96, the benchmark of many filters: N = 40, F = 8, RK4 with Δt = 0.05, 1000 observation
//! times 0.05 apart, the first 400 left out of the means; the error is that of the analysis at the last time
//! of each window, windows do not overlap. Static B is 0.02 times the full climatological covariance, but
//! where a row says otherwise: another factor, or the covariance of the errors that the backgrounds of the
//! same windows had with the B before it, over a truth of its own.
//!
//! `cargo xtask bench lorenz96-cycling [SEEDS [PART OF A NAME]]` prints the table of
//! docs/results/lorenz96-cycling.md (6 seeds by default: 0 … 5).
#![allow(clippy::print_stdout)]

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::ControlFlow;
use std::time::Instant;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense, Localization, Taper, sample};
use varda_implicit::{Model, Rk4, lorenz::Lorenz96};

const N: usize = 40;
const TIMES: usize = 1000;
const LEFT_OUT: usize = 400;

type Failure = Box<dyn std::error::Error>;

/// Which components are seen, and with which σ.
struct Network {
    name: &'static str,
    rows: Vec<usize>,
    sigma: f64,
}

/// What assimilates.
#[derive(Clone, Copy)]
enum Method<'a> {
    /// 3D-Var (window 0) or strong 4D-Var with this B.
    Static(&'a Dense),
    /// Strong 4D-Var with the covariance of the errors of its own backgrounds.
    OfItsErrors,
    /// Strong 4D-Var, B from the propagated posterior and a little static B.
    Propagated { inflation: f64, static_weight: f64 },
    /// The iterative ensemble smoother, carried by its square root; `support` localizes; `static_weight`
    /// makes it a hybrid.
    Ensemble { members: usize, inflation: f64, support: Option<f64>, static_weight: f64, outer: usize },
}

#[derive(Clone, Copy)]
struct Case<'a> {
    name: &'static str,
    window: usize,
    method: Method<'a>,
    bound: f64,
}

/// Prints the table: arguments are the number of seeds and a part of the names of the rows wanted.
///
/// # Errors
/// A number of seeds that is none, a window that cannot be set up.
pub fn table(arguments: &[String]) -> Result<(), Failure> {
    let seeds: u64 = arguments.first().map_or(Ok(6), |s| s.parse())?;
    let wanted = arguments.get(1).map_or("", String::as_str);
    let (mean, covariance) = climatology()?;
    let times = |factor: f64| Dense::new(N, &covariance.iter().map(|c| factor * c).collect::<Vec<f64>>());
    let (b, wider, wide) = (times(1.0)?, times(1.5)?, times(2.0)?);
    let all = Network { name: "all, R = I", rows: (0..N).collect(), sigma: 1.0 };
    let half = Network { name: "every second, R = 1.5² I", rows: (0..N).step_by(2).collect(), sigma: 1.5 };
    let envar = |members, inflation, outer| Method::Ensemble {
        members,
        inflation,
        support: None,
        static_weight: 0.0,
        outer,
    };
    let localized =
        Method::Ensemble { members: 20, inflation: 1.02, support: Some(20.0), static_weight: 0.0, outer: 4 };
    let hybrid = |members, inflation| Method::Ensemble {
        members,
        inflation,
        support: None,
        static_weight: 0.05,
        outer: 4,
    };
    let carried = || Method::Propagated { inflation: 1.04, static_weight: 0.1 };
    let case = |name, window, method, bound| Case { name, window, method, bound };
    let dense = [
        case("3D-Var", 0, Method::Static(&b), 0.43),
        case("4D-Var", 4, Method::Static(&b), 0.33),
        case("4D-Var", 8, Method::Static(&b), 0.29),
        case("4D-Var, B = P_a carried + 0.1² B_s", 4, carried(), f64::NAN),
        case("4D-EnVar, one linearization", 4, envar(40, 1.03, 1), 0.2),
        case("4D-EnVar, at most 4", 1, envar(40, 1.02, 4), 0.2),
        case("4D-EnVar, at most 4", 4, envar(40, 1.02, 4), 0.2),
        case("4D-EnVar, at most 4", 8, envar(40, 1.02, 4), 0.2),
        case("4D-EnVar, at most 4, localized to 20", 2, localized, 0.2),
        case("hybrid 4D-EnVar, β_s = 0.05, at most 4", 4, hybrid(30, 1.03), 0.2),
    ];
    let sparse = [
        case("4D-Var", 4, Method::Static(&b), 0.75),
        case("4D-Var", 8, Method::Static(&b), 0.6),
        case("4D-Var, B_s = 0.03 × climatology", 4, Method::Static(&wider), 0.75),
        case("4D-Var, B_s = 0.03 × climatology", 8, Method::Static(&wider), 0.6),
        case("4D-Var, B_s = 0.04 × climatology", 4, Method::Static(&wide), 0.75),
        case("4D-Var, B_s = 0.04 × climatology", 8, Method::Static(&wide), 0.6),
        case("4D-Var, B_s of its background errors", 4, Method::OfItsErrors, 0.75),
        case("4D-Var, B_s of its background errors", 8, Method::OfItsErrors, 0.6),
        case("4D-Var, B = P_a carried + 0.1² B_s", 4, carried(), 0.75),
        case("4D-Var, B = P_a carried + 0.1² B_s", 8, carried(), 0.6),
        case("4D-EnVar, at most 4", 2, envar(40, 1.04, 4), 0.48),
        case("4D-EnVar, at most 4", 4, envar(40, 1.05, 4), 0.48),
        case("hybrid 4D-EnVar, β_s = 0.05, at most 4", 4, hybrid(40, 1.05), 0.48),
    ];
    println!(
        "| observed | method | window | members | inflation | RMSE, mean ± spread of seeds | bound | worst \
         seed | RMSE at the start | expected spread | background off, seen and not | σ_b, seen and not | \
         CPU ms a window | a time | not converged |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (network, cases) in [(&all, &dense[..]), (&half, &sparse[..])] {
        for case in cases.iter().filter(|case| format!("{}: {}", network.name, case.name).contains(wanted)) {
            row(network, case, seeds, &mean, &b)?;
        }
    }
    Ok(())
}

/// The covariance of the errors that the backgrounds of a case have, over a truth and observations that no
/// row is about: twice, the second time with what the first found. Errors of the same place in the pattern of
/// what is seen are one sample, and correlations beyond 12 points are noise.
fn of_its_errors(network: &Network, window: usize, mean: &[f64], b: &Dense) -> Result<Dense, Failure> {
    const TRAINING: u64 = 1000;
    let repeat = N / network.rows.len();
    let mut found = b.clone();
    for _ in 0..2 {
        let case = Case { name: "", window, method: Method::Static(&found), bound: f64::NAN };
        let Run { errors, .. } = run(network, &case, TRAINING, mean, &found)?;
        let mut sums = vec![0.0; N * N];
        for e in &errors {
            for (i, j) in (0..N * N).map(|ij| (ij % N, ij / N)) {
                sums[i + j * N] += e[i] * e[j] / errors.len() as f64;
            }
        }
        let taper = |d: f64| (1.0 - d / 12.0).max(0.0);
        let of = |i: usize, j: usize| -> f64 {
            let moved = (0..N / repeat).map(|s| (i + s * repeat) % N + (j + s * repeat) % N * N);
            moved.map(|ij| sums[ij]).sum::<f64>() * taper(ring(i, j)) / (N / repeat) as f64
        };
        found = Dense::new(N, &(0..N * N).map(|ij| of(ij % N, ij / N)).collect::<Vec<f64>>())?;
    }
    Ok(found)
}

/// Runs a case over all seeds and prints its row.
fn row(network: &Network, case: &Case, seeds: u64, mean: &[f64], b: &Dense) -> Result<(), Failure> {
    let own = match case.method {
        Method::OfItsErrors => Some(of_its_errors(network, case.window, mean, b)?),
        _ => None,
    };
    let case = &match &own {
        Some(own) => Case { method: Method::Static(own), ..*case },
        None => Case { method: case.method, ..*case },
    };
    let (mut off, mut count) = (vec![0.0; N], 0.0);
    let (mut ends, mut starts, mut spreads, mut seconds, mut cycles, mut stopped) =
        (Vec::new(), 0.0, 0.0, 0.0, 0, 0);
    for seed in 0..seeds {
        let run = run(network, case, seed, mean, b)?;
        for e in &run.errors {
            off.iter_mut().zip(e).for_each(|(off, e)| *off += e * e);
            count += 1.0;
        }
        ends.push(run.end);
        starts += run.start / seeds as f64;
        spreads += run.spread / seeds as f64;
        seconds += run.seconds;
        cycles += run.cycles;
        stopped += run.stopped;
    }
    let average = ends.iter().sum::<f64>() / seeds as f64;
    let variance = ends.iter().map(|e| (e - average).powi(2)).sum::<f64>() / (seeds.max(2) - 1) as f64;
    off.iter_mut().for_each(|off| *off /= count);
    let sigma = match case.method {
        Method::Static(b) => {
            let mut variance = vec![0.0; N];
            b.variance(&mut variance);
            by_seen(network, &variance)
        }
        _ => "–".into(),
    };
    let (members, inflation) = match case.method {
        Method::Static(_) | Method::OfItsErrors => (String::from("–"), String::from("–")),
        Method::Propagated { inflation, .. } => (String::from("–"), format!("{inflation}")),
        Method::Ensemble { members, inflation, .. } => (format!("{members}"), format!("{inflation}")),
    };
    let time = 1e3 * seconds / cycles as f64;
    println!(
        "| {} | {} | {} | {members} | {inflation} | {average:.3} ± {:.3} | {} | {:.3} | {starts:.3} | {} | \
            {} | {sigma} | {time:.2} | {:.2} | {stopped} |",
        network.name,
        case.name,
        case.window,
        variance.sqrt(),
        shown(case.bound),
        ends.iter().fold(0.0, |m: f64, e| m.max(*e)),
        shown(spreads),
        by_seen(network, &off),
        time / case.window.max(1) as f64,
    );
    Ok(())
}

/// Root means of the squares of components that are seen, and of those that are not.
fn by_seen(network: &Network, squares: &[f64]) -> String {
    let mean = |seen: bool| {
        let of: Vec<f64> = (0..N).filter(|i| network.rows.contains(i) == seen).map(|i| squares[i]).collect();
        (of.iter().sum::<f64>() / of.len() as f64).sqrt()
    };
    format!("{}, {}", shown(mean(true)), shown(mean(false)))
}

/// A number, or nothing.
fn shown(value: f64) -> String {
    if value.is_nan() { String::from("–") } else { format!("{value:.3}") }
}

/// Processor time of this program so far, all threads [s]; where the system does not tell, wall time.
fn cpu_seconds(start: Instant) -> f64 {
    let ticks = std::fs::read_to_string("/proc/self/stat").ok().and_then(|stat| {
        let after_name = stat.rsplit(')').next()?;
        let field = |i: usize| after_name.split_whitespace().nth(i)?.parse::<f64>().ok();
        Some(field(11)? + field(12)?)
    });
    ticks.map_or(start.elapsed().as_secs_f64(), |ticks| 0.01 * ticks)
}

/// Means over the windows that count.
struct Run {
    end: f64,
    start: f64,
    spread: f64,
    seconds: f64,
    cycles: usize,
    stopped: usize,
    /// Of the backgrounds.
    errors: Vec<Vec<f64>>,
}

fn run(network: &Network, case: &Case, seed: u64, mean: &[f64], b: &Dense) -> Result<Run, Failure> {
    // Independent streams for the truth, the background, the observations and the ensemble.
    let stream = |s: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(s);
        rng
    };
    let mut rng = stream(0);
    let mut model = model();
    let start: Vec<f64> = mean
        .iter()
        .map(|m| {
            let e: f64 = StandardNormal.sample(&mut rng);
            m + e
        })
        .collect();
    let truth = trajectory(&mut model, &start, 1000 + TIMES)?.split_off(1000);
    let mut rng = stream(2);
    let values: Vec<Vec<f64>> = truth
        .iter()
        .map(|x| {
            let mut see = |&r: &usize| {
                let e: f64 = StandardNormal.sample(&mut rng);
                x[r] + network.sigma * e
            };
            network.rows.iter().map(&mut see).collect()
        })
        .collect();
    let observations = |first: usize| {
        let steps = case.window;
        let seen =
            (0..=steps).filter(|k| (1..=TIMES).contains(&(first + k)) && (*k > 0 || steps == 0)).map(|k| {
                let rows = (0..network.rows.len()).collect();
                Observation::new(k, rows, values[first + k].clone(), network.sigma)
            });
        ObservationSet::new(steps, vec![Box::new(Selection::new(network.rows.clone(), N)?)], seen.collect())
    };
    let make_model = |_: usize| -> Box<dyn Model + Send> { Box::new(self::model()) };
    let true_state = |k: usize| truth[k].clone();
    let shift = case.window.max(1);
    let cycling = Cycling {
        first: usize::from(case.window == 0),
        window: case.window,
        shift,
        cycles: TIMES / shift,
        make_model: &make_model,
        observations: &observations,
        truth: Some(&true_state),
        model_error: None,
        posterior: false,
    };
    let mut rng = stream(1);
    let background: Vec<f64> =
        truth[cycling.first].iter().zip(sample(b, &mut rng)).map(|(x, e)| x + e).collect();
    let mut state = CycleState::new(background.clone());
    let mut rng = stream(3);
    let anchors = |set: &ObservationSet| -> Vec<usize> {
        set.observations().iter().flat_map(|o| o.rows.iter().map(|r| network.rows[*r])).collect()
    };
    let covariance = match case.method {
        Method::Static(b) => CycledCovariance::Static(b),
        Method::OfItsErrors => return Err("a B that is not there yet".into()),
        Method::Propagated { inflation, static_weight } => CycledCovariance::Propagated {
            first: b,
            inflation,
            static_part: Some((b, static_weight)),
            dropped: 0.0,
        },
        Method::Ensemble { members, inflation, support, static_weight, outer } => {
            let members: Vec<f64> = (0..members)
                .flat_map(|_| {
                    background.iter().zip(sample(b, &mut rng)).map(|(x, e)| x + e).collect::<Vec<_>>()
                })
                .collect();
            state = CycleState::from_members(members, N);
            CycledCovariance::Ensemble(CycledEnsemble {
                inflation: CycledInflation::Fixed(inflation),
                spread: 1.0,
                rotation: None,
                localization: match support {
                    Some(support) => {
                        Localization::by_distance(Taper::GaspariCohn { support }, N, ring, 0.01)?
                    }
                    None => Localization::none(N),
                },
                anchors: &anchors,
                static_part: (static_weight > 0.0).then_some((b as &dyn Covariance, static_weight, 1.0)),
                update: CycledUpdate::SquareRoot,
                options: EnVarOptions::default().with_max_outer(outer).with_step_tolerance(0.05),
            })
        }
    };
    let minimizer = Minimizer::TrustRegion(TrustRegionOptions::default().with_gradient_tolerance(1e-4));
    let clock = Instant::now();
    let before = cpu_seconds(clock);
    let cycles = cycle(&cycling, &mut state, &covariance, &minimizer, &mut |_, _| ControlFlow::Continue(()))?;
    let seconds = cpu_seconds(clock) - before;
    let counted: Vec<&Cycle> = cycles.iter().filter(|c| c.first_step + case.window > LEFT_OUT).collect();
    let average =
        |f: &dyn Fn(&Cycle) -> f64| counted.iter().map(|c| f(c)).sum::<f64>() / counted.len() as f64;
    Ok(Run {
        end: average(&|c| c.errors.map_or(f64::NAN, |e| e.end)),
        start: average(&|c| c.errors.map_or(f64::NAN, |e| e.start)),
        spread: average(&|c| c.spread().unwrap_or(f64::NAN)),
        seconds,
        cycles: cycles.len(),
        errors: counted
            .iter()
            .map(|c| c.background.iter().zip(&truth[c.first_step]).map(|(b, x)| b - x).collect())
            .collect(),
        stopped: cycles.iter().filter(|c| matches!(c.status, Status::Stalled | Status::Failed)).count(),
    })
}

fn model() -> Rk4<Lorenz96> {
    Rk4::new(Lorenz96::new(N, 8.0), 0, 0.05)
}

/// Distance along the circle.
fn ring(i: usize, j: usize) -> f64 {
    i.abs_diff(j).min(N - i.abs_diff(j)) as f64
}

fn trajectory(model: &mut dyn Model, start: &[f64], steps: usize) -> Result<Vec<Vec<f64>>, Failure> {
    let mut states = vec![start.to_vec()];
    for k in 0..steps {
        let mut next = vec![0.0; N];
        model.step(k, &states[k], &mut next)?;
        states.push(next);
    }
    Ok(states)
}

/// The mean of a long run and 0.02 times its full covariance.
fn climatology() -> Result<(Vec<f64>, Vec<f64>), Failure> {
    let start: Vec<f64> = (0..N).map(|i| 8.0 + (i as f64).sin()).collect();
    let climate = Climatology::of_run(&mut model(), &start, 1000, 100_000)?;
    Ok((climate.mean, climate.covariance.iter().map(|c| 0.02 * c).collect()))
}
