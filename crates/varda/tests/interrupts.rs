//! Runs that are asked to end in the middle of a long calculation: they end with the lowest point so far, and
//! what is done after that is counted, not timed.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use varda::outcome::{Outcome, Status, Verdict};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

/// A run that ends when it is asked for the n-th time after its k-th row; with the rows, and how often it was
/// asked after that.
fn ended(sets: &[&str], row: usize, question: usize) -> (Outcome, Vec<f64>, usize) {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let problem = Problem::from_scene(&SceneFile::open("lorenz96", &sets).unwrap()).unwrap();
    let armed = Arc::new(AtomicBool::new(false));
    let (asked, after) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let (is_armed, count, late) = (Arc::clone(&armed), Arc::clone(&asked), Arc::clone(&after));
    let rows = RefCell::new(Vec::new());
    let mut listener = Listener {
        on_iteration: Box::new(|r| {
            rows.borrow_mut().push(r.j);
            armed.store(rows.borrow().len() >= row, Ordering::SeqCst);
        }),
        interrupted: Box::new(|| false),
        ends: Some(Arc::new(move || {
            let now = is_armed.load(Ordering::SeqCst) && count.fetch_add(1, Ordering::SeqCst) >= question;
            if now {
                late.fetch_add(1, Ordering::SeqCst);
            }
            now
        })),
        started: Instant::now(),
    };
    let outcome = assimilate(&problem, &mut listener).unwrap();
    drop(listener);
    (outcome, rows.into_inner(), after.load(Ordering::SeqCst))
}

/// Every step, tangent, adjoint and large decomposition asks. 300 variables make dense Hessians large.
#[test]
fn the_lowest_point_is_the_result_wherever_a_run_is_left() {
    let size: &[&str] = &["model.variables=300", "time.spin_up=20", "time.window=8"];
    for (more, what) in [
        ("algorithm.minimizer=newton", "dense"),
        ("algorithm.minimizer=trust-region", "dense"),
        ("algorithm.minimizer=lbfgs", "the posterior"),
        ("algorithm.method=4d-psas", "the dual"),
    ] {
        let sets: Vec<&str> = size.iter().copied().chain([more]).collect();
        for question in [0, 3, 40] {
            let (outcome, rows, after) = ended(&sets, 2, question);
            let lowest = rows.iter().copied().fold(f64::INFINITY, f64::min);
            assert_eq!(outcome.status, Status::Interrupted, "{more}, {what}, {question}");
            assert_eq!(outcome.analysis.value, lowest, "{more}, {question}");
            assert!(!outcome.has_posterior && outcome.judgement.verdict == Verdict::NotConverged);
            // J of the run that is written is that J
            let said = outcome.analysis.value;
            let fit: f64 = outcome.fit.iter().map(|f| f.count as f64 * f.ratio * f.ratio).sum();
            let j = outcome.analysis.terms.background + 0.5 * fit;
            assert!((j - said).abs() <= 1e-9 * said, "{more}, {question}: {j} {said}");
            // A trial point is left at its first step, and a minimizer tries some ten more; sweeps of 8 steps
            // that compute nothing ask once a step. To the end these runs ask more than ten thousand times.
            assert!(after <= 3000, "{more}, {question}: asked {after} times after it was to end");
        }
    }
}

/// One that is asked and never to end has the bits of one that is not asked.
#[test]
fn being_asked_changes_nothing() {
    let (asked, ..) = ended(&[], 0, usize::MAX);
    let problem = Problem::from_scene(&SceneFile::open("lorenz96", &[]).unwrap()).unwrap();
    let alone = assimilate(&problem, &mut Listener::silent()).unwrap();
    assert_eq!(asked.analysis, alone.analysis);
    assert_eq!((asked.status, asked.model_counts), (alone.status, alone.model_counts));
}

/// Told after the analysis, a run leaves out σ along the window, says so, and keeps all else.
#[test]
fn what_goes_beyond_the_analysis_is_left_out() {
    let ended = |question: usize| {
        let sets: Vec<String> = ["time.window=8", "observations.components=[]"].map(String::from).to_vec();
        let problem = Problem::from_scene(&SceneFile::open("lorenz96", &sets).unwrap()).unwrap();
        let asked = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&asked);
        let ends = Arc::new(move || count.fetch_add(1, Ordering::SeqCst) >= question);
        let mut listener = Listener { ends: Some(ends), ..Listener::silent() };
        let outcome = assimilate(&problem, &mut listener).unwrap();
        (outcome, asked.load(Ordering::SeqCst))
    };
    let (whole, questions) = ended(usize::MAX);
    assert!(!whole.sigma_states.is_empty() && whole.next_observation.is_some());
    // the last questions are one at each candidate for one more observation, and before them one a step
    let (left, _) = ended(questions - 28);
    assert_eq!((left.status, left.has_posterior), (whole.status, true));
    assert_eq!(left.analysis, whole.analysis);
    assert!(left.sigma_states.is_empty() && left.next_observation.is_none());
    let said = left.warnings.iter().any(|w| w.contains("interrupted after the analysis"));
    assert!(said, "{:?}", left.warnings);
}
