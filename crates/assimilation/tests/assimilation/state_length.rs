//! Operators that read another state than the model's are refused when a cost is made; operators are given
//! the time.

use crate::models::{all_of, observation};
use std::sync::{Arc, Mutex};
use varda_assimilation::{At, ControlTransform, EnVar, Error, Observation, ObservationOperator};
use varda_assimilation::{ObservationSet, Refusal, StrongConstraint};
use varda_covariance::{Diagonal, Ensemble, Localization};
use varda_implicit::{Model, Rk4, lorenz::Lorenz63};

#[test]
fn a_state_of_another_length_is_refused_before_a_run() {
    let seen = || vec![observation(&[0], 2, 0.0, &[1.0], 0.1)];
    let mut set = ObservationSet::new(4, vec![all_of(4)], seen()).unwrap();
    let b = Diagonal::uniform(3, 1.0).unwrap();
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let transform = || ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
    let wrong = |error: Option<Error>| {
        matches!(error, Some(Error::StateLength { operator: 0, expected: 3, found: 4 }))
    };
    assert!(wrong(StrongConstraint::new(&mut model, transform(), &mut set).err()));
    let columns = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let ensemble = Ensemble::from_perturbations(&columns, Localization::none(3)).unwrap();
    let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz63::default(), 0, 0.01)) };
    assert!(wrong(EnVar::new(&make, vec![1.5, 1.7, 20.0], &ensemble, &mut set, &[]).err()));
    let at_once = vec![observation(&[0], 0, 0.0, &[1.0], 0.1)];
    let mut set = ObservationSet::new(0, vec![all_of(4)], at_once).unwrap();
    assert!(wrong(StrongConstraint::without_model(transform(), &mut set).err()));
    let two = ObservationSet::new(4, vec![all_of(4), all_of(3)], seen());
    assert!(matches!(two.err(), Some(Error::StateLength { operator: 1, expected: 4, found: 3 })));
}

/// Writes down when it was called.
struct Clock(Arc<Mutex<Vec<At>>>);

impl ObservationOperator for Clock {
    fn dim(&self) -> usize {
        1
    }
    fn state_dim(&self) -> usize {
        1
    }
    fn observe(&mut self, at: At, _: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.0.lock().unwrap().push(at);
        y[0] = at.time;
        Ok(())
    }
    fn tangent(&mut self, _: At, _: &[f64], _: &[f64], dy: &mut [f64]) {
        dy[0] = 0.0;
    }
    fn adjoint_add(&mut self, _: At, _: &[f64], _: &[f64], _: &mut [f64]) {}
}

#[test]
fn operators_are_given_step_and_time_and_prefixes_keep_the_grid() {
    let calls = Arc::new(Mutex::new(Vec::new()));
    let times = vec![1.0, 1.5, 3.0, 7.0];
    let seen = vec![Observation::new(1, vec![0], vec![2.25], 1.0).between(0.5)];
    let clock = || -> Vec<Box<dyn ObservationOperator>> { vec![Box::new(Clock(Arc::clone(&calls)))] };
    let set = ObservationSet::on_times(times.clone(), clock(), seen).unwrap();
    let mut set = set.without(&[]).unwrap();
    let mut y = set.prediction();
    (0..4).for_each(|k| set.observe_add(k, &[0.0], &mut y).unwrap());
    assert_eq!(y.values(), [2.25]);
    let at = |step: usize| At { step, time: times[step] };
    assert_eq!(*calls.lock().unwrap(), [at(1), at(2)]);

    for bad in [vec![], vec![0.0, 0.0], vec![0.0, f64::NAN], vec![f64::NAN], vec![0.0, f64::INFINITY]] {
        assert!(ObservationSet::on_times(bad, clock(), Vec::new()).is_err());
    }
}
