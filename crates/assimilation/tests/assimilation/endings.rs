//! Where a minimization ends: at a floor of the gradient, when its iterations are used up, when a further
//! start does not pay.

use crate::cost::coupled;
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::Diagonal;

fn quiet(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Lorenz-63 seen at step 30 from its own truth, one value off.
fn nearly_perfect(minimizer: &Minimizer, off: f64) -> (Minimum, f64) {
    let truth = [1.5, 1.7, 20.0];
    let mut model = Rk4::new(Lorenz63, 0.01);
    let mut y = run(&mut model, &truth, 30).pop().unwrap();
    y[0] += off;
    let seen = observation(&[0, 1, 2], 30, 0.0, &y, 1.0);
    let mut set = ObservationSet::new(30, vec![all_of(3)], vec![seen]).unwrap();
    let b = Diagonal::uniform(3, 1.0).unwrap();
    let transform = ControlTransform::new(truth.to_vec(), &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut v = vec![0.0; 3];
    let minimum = minimizer.minimize(&mut cost, &mut v, &mut quiet).unwrap();
    (minimum, norm(&v))
}

/// A background that fits to rounding is a minimum to all minimizers; beyond the floor the relative goal
/// holds as before.
#[test]
fn a_background_that_fits_to_rounding_has_converged() {
    for name in Minimizer::NAMES.iter().filter(|name| !name.starts_with("argmin") && **name != "adam") {
        let minimizer = Minimizer::named(name).unwrap();
        for off in [0.0, 1e-16, 1e-13, 1e-9, 1e-7] {
            let (minimum, length) = nearly_perfect(&minimizer, off);
            assert_eq!(minimum.status, Status::Converged, "{name}, {off:e}: {minimum:?}");
            assert!(minimum.outer_iterations <= 12, "{name}, {off:e}: {}", minimum.outer_iterations);
            // A ≥ I: the minimum is no farther than the gradient is long
            assert!(length <= 2.0 * off + 1e-10, "{name}, {off:e}: |v| {length:e}");
            assert!(minimum.gradient_norm <= 1e-10, "{name}, {off:e}: {:e}", minimum.gradient_norm);
        }
    }
}

/// J = ½ v² with a standard deviation of a million units: a gradient in them says nothing of σ.
#[test]
fn the_floor_is_for_variables_in_units_of_the_prior() {
    let b = Diagonal::uniform(1, 1e6).unwrap();
    let mut set = ObservationSet::new(0, Vec::new(), Vec::new()).unwrap();
    let transform = ControlTransform::new(vec![0.0], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
    let mut raw = RawVariables::new(&mut cost, &transform, &b).unwrap();
    // 1e-5 standard deviations off: ∇_z J = 1e-11
    let mut z = [10.0];
    let minimum = lbfgs(&mut raw, &mut z, &LbfgsOptions::default(), &mut quiet).unwrap();
    assert!(minimum.status == Status::Converged && z[0].abs() < 1e-3, "{z:?} {minimum:?}");
    assert!(!raw.is_whitened() && cost.is_whitened());
}

/// Windows of 100 steps, whose J has several minima, from backgrounds that are far off.
fn far_off(seed: u64, options: AutoOptions) -> (Minimum, Vec<(usize, usize)>, usize) {
    let (truth, background, mut set) = lorenz63_twin(seed, 100, 10);
    let background: Vec<f64> = truth.iter().zip(&background).map(|(t, b)| t + 4.0 * (b - t)).collect();
    let b = coupled(3, 4.0);
    let m = set.dim();
    let mut model = Rk4::new(Lorenz63, 0.01);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut told = Vec::new();
    let minimum = auto(&mut cost, &mut [0.0; 3], &options, &mut |i| {
        told.push((i.index, i.attempt));
        assert!((1..=i.attempts).contains(&i.attempt) && i.gradient_goal > 0.0);
        ControlFlow::Continue(())
    })
    .unwrap();
    (minimum, told, m)
}

#[test]
fn iterations_are_counted_over_all_starts() {
    for most in [0, 1, 5, 20, 37] {
        for seed in 0..6 {
            let options = AutoOptions::default().with_threshold(0.0).with_max_iterations(most);
            let (minimum, told, _) = far_off(seed, options);
            assert!(minimum.outer_iterations <= most, "{most}: {}", minimum.outer_iterations);
            assert_eq!(told.iter().map(|t| t.0).max(), Some(minimum.outer_iterations));
            let of_attempts: usize = minimum.attempts.iter().map(|a| a.iterations).sum();
            assert_eq!(of_attempts, minimum.outer_iterations);
        }
    }
}

#[test]
fn the_stages_of_a_continuation_share_their_iterations() {
    let (_, background, mut set) = lorenz63_twin(3, 100, 10);
    let b = coupled(3, 4.0);
    let mut model = Rk4::new(Lorenz63, 0.01);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    for most in [0, 3, 7] {
        let minimizer = Minimizer::default().with_stopping(Stopping::new(1e-8, most));
        let scales = [10.0, 3.0, 1.0];
        let minimum = continuation(&minimizer, &mut cost, &mut [0.0; 3], &scales, &mut quiet).unwrap();
        assert!(minimum.outer_iterations <= most, "{most}: {}", minimum.outer_iterations);
        assert_eq!(minimum.status, Status::MaxIterations);
    }
}

/// No start after one that fits, nor after two that came to the same lowest end; each says what it gained.
#[test]
fn further_starts_are_made_while_they_pay() {
    let (mut alone, mut several) = (0, 0);
    for seed in 0..40 {
        let (minimum, _, m) = far_off(seed, AutoOptions::default().with_threshold(0.0));
        let (ends, band) = (&minimum.attempts, highest_j_of_a_fit(m));
        let fits = |a: &Attempt| a.value <= band;
        let before = &ends[..ends.len() - 1];
        assert!(!before.iter().any(fits), "seed {seed}: {ends:?}");
        assert_eq!((ends[0].from, ends[0].gain), (AttemptFrom::Given, 0.0));
        let lowest = ends.iter().map(|a| a.value).fold(f64::INFINITY, f64::min);
        let gained: f64 = ends.iter().map(|a| a.gain).sum();
        assert!((ends[0].value - gained - lowest).abs() <= 1e-9 * ends[0].value, "seed {seed}: {ends:?}");
        assert!(minimum.value <= lowest * (1.0 + 1e-3), "seed {seed}");
        alone += usize::from(ends.len() == 1);
        several += usize::from(ends.len() > 1);
    }
    assert!(alone >= 10 && several >= 3, "{alone} {several}");
}
