//! Runs of several models side by side, over threads and over processes.

use crate::Error;
use crate::ranks::{self, Ranks};
#[cfg(feature = "rayon")]
use rayon::prelude::*;
#[cfg(feature = "rayon")]
use std::sync::Arc;
use varda_implicit::{Counts, Log, Model, Warning};
#[cfg(feature = "rayon")]
use varda_linalg::interrupt;

/// What a run went through, and how it ended.
type Ended = (Log, Result<(), varda_implicit::Error>);

/// Runs every model from its control over `steps` steps, in parallel with the feature `rayon`, and divided
/// among processes where there are several ([`ranks`]). A run is a pure function of its control, so that who
/// runs it does not matter; the error is that of the first model that failed.
pub(super) fn run_all<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
    steps: usize,
    log: &mut Log,
) -> Result<(), Error> {
    Ok(run_each(models, controls, states, steps, log).into_iter().try_for_each(|ended| ended)?)
}

/// The same, with how each of them ended.
pub(crate) fn run_each<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
    steps: usize,
    log: &mut Log,
) -> Vec<Result<(), varda_implicit::Error>> {
    let states = &mut states[..models.len() * (steps + 1) * models[0].dim()];
    let ended = match ranks::current() {
        // one run takes as long wherever it is
        Some(ranks) if models.len() > 1 => run_divided(&*ranks, models, controls, states),
        _ => run_here(models, controls, states),
    };
    for (run, _) in &ended {
        log.add(run);
    }
    ended.into_iter().map(|(_, ended)| ended).collect()
}

/// Runs the models of this process, gathers the runs of all, and runs again what failed elsewhere: it fails
/// here in the same way.
fn run_divided<'m>(
    ranks: &dyn Ranks,
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
) -> Vec<Ended> {
    let (runs, n, n_z) = (models.len(), models[0].dim(), models[0].control_dim());
    let length = states.len() / runs;
    let own = ranks::share(runs, ranks.rank(), ranks.count());
    let controls = &controls[..runs * n_z];
    let mut mine = Vec::new();
    if !own.is_empty() {
        let of_own = |length: usize| own.start * length..own.end * length;
        let states = &mut states[of_own(length)];
        let ended = run_here(&mut models[own.clone()], &controls[of_own(n_z)], states);
        for ((log, ended), states) in ended.iter().zip(states.chunks_exact(length)) {
            mine.push(f64::from(u8::from(ended.is_ok())));
            mine.extend(numbers_of(log));
            mine.extend(states);
        }
    }
    let all = ranks.all_gather(controls, &mine);
    let mut rest = all.iter().copied();
    let mut number = || rest.next().expect("as many numbers as all processes have put together");
    let mut ended = Vec::new();
    for ((model, z), states) in
        models.iter_mut().zip(controls.chunks_exact(n_z)).zip(states.chunks_exact_mut(length))
    {
        let has_ended_well = number() == 1.0;
        let log = log_of(&mut number);
        states.iter_mut().for_each(|x| *x = number());
        ended.push(if has_ended_well { (log, Ok(())) } else { run_one(&mut **model, z, states, n) });
    }
    ended
}

/// A log as numbers: its counts, how many warnings, and of each its step, its length and its bytes.
fn numbers_of(log: &Log) -> Vec<f64> {
    let mut numbers = log.counts.to_array().to_vec();
    numbers.push(log.warnings.len());
    for warning in &log.warnings {
        numbers.extend([warning.step, warning.text.len()]);
        numbers.extend(warning.text.bytes().map(usize::from));
    }
    // exact: none of them comes near 2⁵³
    numbers.into_iter().map(|number| number as f64).collect()
}

/// The log of these numbers.
fn log_of(next: &mut dyn FnMut() -> f64) -> Log {
    let mut number = || next() as usize;
    let counts = Counts::from_array(std::array::from_fn(|_| number()));
    let warnings = (0..number())
        .map(|_| {
            let (step, length) = (number(), number());
            let text: Vec<u8> = (0..length).map(|_| number() as u8).collect();
            Warning { step, text: String::from_utf8_lossy(&text).into_owned() }
        })
        .collect();
    Log { counts, warnings }
}

/// Runs every model in this process.
fn run_here<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
) -> Vec<Ended> {
    let (n, n_z) = (models[0].dim(), models[0].control_dim());
    let length = states.len() / models.len();
    #[cfg(feature = "rayon")]
    {
        let asked = interrupt::asked();
        models
            .par_iter_mut()
            .zip(controls.par_chunks_exact(n_z))
            .zip(states.par_chunks_exact_mut(length))
            .map(|((model, z), states)| {
                let mut run = || run_one(&mut **model, z, states, n);
                // a question is one of a thread: the others ask it too
                match &asked {
                    Some(ends) => interrupt::within(Arc::clone(ends), run),
                    None => run(),
                }
            })
            .collect()
    }
    #[cfg(not(feature = "rayon"))]
    models
        .iter_mut()
        .zip(controls.chunks_exact(n_z))
        .zip(states.chunks_exact_mut(length))
        .map(|((model, z), states)| run_one(&mut **model, z, states, n))
        .collect()
}

/// Fills `states`, x₀ first, with the run from the control z.
fn run_one(model: &mut dyn Model, z: &[f64], states: &mut [f64], n: usize) -> Ended {
    let mut log = Log::default();
    let ended = model.initial_state(z, &mut states[..n]).and_then(|()| {
        (0..states.len() / n - 1).try_for_each(|k| {
            let (x, x_next) = states[k * n..(k + 2) * n].split_at_mut(n);
            log.step(k, model.step(k, x, x_next)?);
            Ok(())
        })
    });
    (log, ended)
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;
    use std::sync::{Barrier, Mutex};

    use varda_implicit::{ControlMap, Error, Refusal, Work};

    use super::*;

    /// x ↦ 1.5 x + sin k, which warns above 4 and fails above 8.
    struct Growing;

    impl Model for Growing {
        fn dim(&self) -> usize {
            2
        }

        fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
            if x[0] > 8.0 {
                return Err(Error::Refused { step: k, reason: Refusal::new("it has grown") });
            }
            x_next.iter_mut().zip(x).for_each(|(next, x)| *next = 1.5 * x + (k as f64).sin());
            let warnings = if x[0] > 4.0 { vec![format!("x is {:.2} α", x[0])] } else { Vec::new() };
            Ok(Work { newton_iterations: k, warnings, ..Work::default() })
        }

        fn linearize(&mut self, _: usize, _: usize, _: &[f64], _: &[f64]) -> Result<Work, Error> {
            unreachable!("an ensemble has forward runs only")
        }

        fn tangent(&mut self, _: usize, _: &mut [f64]) {}

        fn adjoint(&mut self, _: usize, _: &mut [f64]) {}

        fn release(&mut self, _: usize) {}

        fn slot_bytes(&self) -> usize {
            0
        }

        fn bytes(&self) -> usize {
            0
        }

        fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
            None
        }
    }

    /// Threads in the place of processes.
    struct Threads<'a> {
        rank: usize,
        barrier: &'a Barrier,
        sent: &'a Mutex<Vec<Vec<f64>>>,
    }

    impl Ranks for Threads<'_> {
        fn rank(&self) -> usize {
            self.rank
        }

        fn count(&self) -> usize {
            self.sent.lock().unwrap().len()
        }

        fn all_gather(&self, _: &[f64], mine: &[f64]) -> Vec<f64> {
            self.sent.lock().unwrap()[self.rank] = mine.to_vec();
            self.barrier.wait();
            let all = self.sent.lock().unwrap().concat();
            self.barrier.wait();
            all
        }
    }

    const RUNS: usize = 5;
    const STEPS: usize = 4;

    /// States, log and ends of five runs; the fourth and the last fail.
    fn run(ranks: Option<&dyn Ranks>) -> (Vec<f64>, Log, Vec<Option<String>>) {
        let mut models: Vec<Box<dyn Model + Send>> = (0..RUNS).map(|_| Box::new(Growing) as _).collect();
        let controls = [0.1, -0.3, 1.0, f64::MIN_POSITIVE, 1.5, 0.2, 3.0, 0.0, 9.0, 1.0];
        let mut states = vec![0.0; RUNS * (STEPS + 1) * 2];
        let ended = match ranks {
            None => run_here(&mut models, &controls, &mut states),
            Some(ranks) => run_divided(ranks, &mut models, &controls, &mut states),
        };
        let mut log = Log::default();
        ended.iter().for_each(|(run, _)| log.add(run));
        (states, log, ended.into_iter().map(|(_, ended)| ended.err().map(|e| e.to_string())).collect())
    }

    #[test]
    fn runs_are_the_same_on_any_number_of_ranks() {
        let here = run(None);
        assert!(here.1.warnings.len() > 2 && here.2.iter().flatten().count() == 2, "{here:?}");
        for count in [1, 2, 3, 5, 7] {
            let (barrier, sent) = (Barrier::new(count), Mutex::new(vec![Vec::new(); count]));
            let (barrier, sent) = (&barrier, &sent);
            std::thread::scope(|scope| {
                let all: Vec<_> = (0..count)
                    .map(|rank| scope.spawn(move || run(Some(&Threads { rank, barrier, sent }))))
                    .collect();
                for (rank, one) in all.into_iter().enumerate() {
                    assert_eq!(one.join().unwrap(), here, "rank {rank} of {count}");
                }
            });
        }
    }

    #[test]
    fn a_scope_is_left_with_its_work() {
        struct First;
        impl Ranks for First {
            fn rank(&self) -> usize {
                1
            }
            fn count(&self) -> usize {
                2
            }
            fn all_gather(&self, _: &[f64], _: &[f64]) -> Vec<f64> {
                unreachable!("nothing is divided")
            }
        }
        assert!(ranks::is_first());
        assert!(!ranks::within(Rc::new(First), ranks::is_first));
        let left = std::panic::catch_unwind(|| ranks::within(Rc::new(First), || panic!("out of cheese")));
        assert!(left.is_err() && ranks::is_first());
    }
}
