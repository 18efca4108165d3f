//! A run that is asked to end while it is in a long calculation: the lowest point so far is its result.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use varda_assimilation::{CostTerms, Minimum, Status};
use varda_implicit::Storage;
use varda_linalg::interrupt::Ends;

use crate::outcome::WorkCounts;
use crate::scene::Limits;
use crate::setup::Problem;
use crate::solve::{Iterate, Solution, deviations};

/// Says whether a run is to end: because it was asked to, or its seconds are over. Never before the first J:
/// there is always a result.
#[derive(Clone)]
pub(super) struct Asked {
    has_begun: Arc<AtomicBool>,
    was_told: Arc<AtomicBool>,
    ends: Ends,
}

impl Asked {
    pub(super) fn of(ends: Option<Ends>, limits: &Limits, started: Instant) -> Asked {
        let (has_begun, was_told) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let (begun, told, limits) = (Arc::clone(&has_begun), Arc::clone(&was_told), limits.clone());
        let ends = Arc::new(move || {
            let now = begun.load(Ordering::Relaxed)
                && (limits.over(started.elapsed()) || ends.as_ref().is_some_and(|ends| ends()));
            told.fetch_or(now, Ordering::Relaxed);
            now
        });
        Asked { has_begun, was_told, ends }
    }

    /// What is asked during long calculations.
    pub(super) fn ends(&self) -> Ends {
        Arc::clone(&self.ends)
    }

    /// Whether the run is to end.
    pub(super) fn requested(&self) -> bool {
        (self.ends)()
    }

    /// Whether anyone was told to end.
    pub(super) fn was_told(&self) -> bool {
        self.was_told.load(Ordering::Relaxed)
    }

    /// From now on there is a result.
    pub(super) fn begin(&self) {
        self.has_begun.store(true, Ordering::Relaxed);
    }
}

/// The lowest point of the longest window so far.
#[derive(Default)]
pub(super) struct Lowest(RefCell<Option<Point>>);

struct Point {
    control: Vec<f64>,
    value: f64,
    terms: CostTerms,
    gradient_norm: f64,
    first_gradient_norm: f64,
    iterations: usize,
    counts: WorkCounts,
    /// The cost it is a point of: the window, and what σ is multiplied by.
    cost: (usize, f64),
}

impl Lowest {
    pub(super) fn add(&self, r: &Iterate) {
        let i = r.iteration;
        let cost = (r.window, i.observation_scale);
        let mut lowest = self.0.borrow_mut();
        let same = lowest.as_ref().filter(|known| known.cost == cost);
        if same.is_some_and(|known| known.value <= i.value) {
            return;
        }
        *lowest = Some(Point {
            control: r.control.to_vec(),
            value: i.value,
            terms: i.terms,
            gradient_norm: i.gradient_norm,
            first_gradient_norm: same.map_or(i.gradient_norm, |known| known.first_gradient_norm),
            iterations: r.before.0 + i.index,
            counts: r.before.1 + WorkCounts::from(&i.counts),
            cost,
        });
    }

    /// That point as the end of a run, without a posterior; `None` before the first J.
    pub(super) fn solution(self, problem: &Problem) -> Option<Solution> {
        let point = self.0.into_inner()?;
        Some(Solution {
            minimum: Minimum {
                value: point.value,
                terms: point.terms,
                gradient_norm_first: point.first_gradient_norm,
                gradient_norm: point.gradient_norm,
                outer_iterations: point.iterations,
                inner_iterations: 0,
                status: Status::Interrupted,
                failure: None,
                ritz: Vec::new(),
                inverse_hessian: None,
                started_beside: false,
                quadratic: false,
                attempts: Vec::new(),
            },
            control: point.control,
            sigma_background: deviations(problem.covariance.as_ref()),
            spread: None,
            no_spread: None,
            exact_hessian: None,
            model_errors: None,
            states: Vec::new(),
            counts: point.counts,
            rejected: Vec::new(),
            stages: Vec::new(),
            attempts: Vec::new(),
            storage: Storage::KeepAll,
        })
    }
}
