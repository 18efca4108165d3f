//! The builder gives what the layers below it give, bit for bit, and refuses what they refuse.

use crate::models::all_of;
use rand::SeedableRng;
use std::ops::ControlFlow;
use std::sync::Arc;
use varda_assimilation::{
    Analysis, Assimilation, ControlTransform, CostFunction, Error, Minimizer, Observation, ObservationSet,
    Posterior, Selection, StrongConstraint,
};
use varda_covariance::Diagonal;
use varda_implicit::{Rk4, lorenz::Lorenz63};

const BACKGROUND: [f64; 3] = [1.5, 1.7, 20.0];

fn model() -> Rk4<Lorenz63> {
    Rk4::new(Lorenz63::default(), 0, 0.01)
}

fn by_layers() -> (Analysis, Vec<f64>) {
    let seen = vec![
        Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1),
        Observation::new(30, vec![0], vec![15.4], 0.1).between(0.5),
    ];
    let mut set = ObservationSet::new(40, vec![all_of(3)], seen).unwrap();
    let b = Diagonal::uniform(3, 1.0).unwrap();
    let transform = ControlTransform::new(BACKGROUND.to_vec(), &b).unwrap();
    let mut model = model();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    let mut v = vec![0.0; 3];
    let minimum =
        Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    cost.evaluate(&v, Some(&mut [0.0; 3])).unwrap();
    let posterior = Posterior::new(&mut cost).unwrap();
    (Analysis::new(&transform, &v, &minimum, &posterior, 3), cost.state(31).to_vec())
}

#[test]
fn steps_and_times_owned_and_borrowed_are_one_problem() {
    let (expected, state) = by_layers();
    let b = Arc::new(Diagonal::uniform(3, 1.0).unwrap());
    let owned = Assimilation::new(model())
        .background(BACKGROUND, Arc::clone(&b))
        .observe(20, [0, 2], [8.1, 14.9], 0.1)
        .observation(Observation::new(30, vec![0], vec![15.4], 0.1).between(0.5))
        .steps(40)
        .analyse()
        .unwrap();
    let mut borrowed_model = model();
    // Times on which half way between two is a half exactly.
    let times = (0..=40).map(|k| 0.25 * k as f64).collect();
    let borrowed = Assimilation::borrowing(&mut borrowed_model)
        .background(BACKGROUND.to_vec(), &b)
        .operator(Selection::new(vec![2, 0], 3).unwrap())
        .on_times(times)
        .observation(Observation::new(20, vec![1, 0], vec![8.1, 14.9], 0.1).operator(1))
        .observe_at(7.625, [0], [15.4], 0.1)
        .analyse()
        .unwrap();
    for result in [&owned, &borrowed] {
        assert!(result.converged());
        assert_eq!(result.trajectory().len(), 41);
        assert_eq!(result.terms(), expected.terms);
    }
    assert_eq!(*owned.analysis(), expected);
    assert_eq!(owned.trajectory()[31], state);
    assert_eq!(owned.state(), borrowed.state());
    // Draws scatter as σ_a says: 400 of them, 5 standard errors of a standard deviation.
    let mut rng = rand::rngs::ChaCha8Rng::seed_from_u64(1);
    let mut sum = [0.0; 3];
    for _ in 0..400 {
        let draw = owned.draw(&mut rng);
        (0..3).for_each(|i| sum[i] += (draw[i] - owned.state()[i]).powi(2) / 400.0);
    }
    for (sum, sigma) in sum.iter().zip(owned.sigma()) {
        assert!((sum.sqrt() / sigma - 1.0).abs() < 5.0 / 800f64.sqrt(), "{sum} {sigma}");
    }
}

#[test]
fn what_is_missing_or_outside_is_an_error() {
    let b = || Diagonal::uniform(3, 1.0).unwrap();
    let none = Assimilation::new(model()).observe(2, [0], [1.0], 0.1).analyse();
    assert!(matches!(none.err(), Some(Error::Length { expected: 3, found: 0, .. })));
    let no_grid = Assimilation::new(model()).background(BACKGROUND, b()).observe_at(2.0, [0], [1.0], 0.1);
    assert!(matches!(no_grid.analyse().err(), Some(Error::Setting { .. })));
    for time in [-0.1, 3.1, f64::NAN] {
        let outside = Assimilation::new(model())
            .background(BACKGROUND, b())
            .on_times(vec![0.0, 1.0, 3.0])
            .observe_at(time, [0], [1.0], 0.1);
        assert!(outside.analyse().is_err(), "{time}");
    }
    let outside = Assimilation::new(model()).background(BACKGROUND, b()).steps(3).observe(4, [0], [1.0], 0.1);
    assert!(matches!(outside.analyse().err(), Some(Error::OutsideWindow { .. })));
    let three = [1.0; 3];
    let row = Assimilation::new(model()).background(BACKGROUND, b()).observe(0, [1, 2, 3], three, 0.1);
    assert!(matches!(row.analyse().err(), Some(Error::UnknownRow { row: 3, .. })));
    let nothing = Assimilation::new(model()).background(BACKGROUND, b()).analyse().unwrap();
    assert_eq!((nothing.state(), nothing.sigma()), (&BACKGROUND[..], &[1.0; 3][..]));
}
