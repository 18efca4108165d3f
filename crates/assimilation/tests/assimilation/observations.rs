//! Observation sets: times between steps, missing rows, operators, bad input.

use crate::models::{Products, all_of, normals, observation};
use varda_assimilation::{Error, LinearObservation, ObservationOperator, ObservationSet, Selection};

#[test]
fn a_time_between_steps_weighs_both_and_rows_left_out_are_not_predicted() {
    let mut set = ObservationSet::new(
        3,
        vec![all_of(3)],
        vec![
            observation(&[2], 2, 0.25, &[7.0], 0.5),
            observation(&[0, 2], 0, 0.0, &[1.0, 2.0], 0.1),
            observation(&[1], 2, 0.0, &[5.0], 2.0),
        ],
    )
    .unwrap();
    // In order of time, whatever the order given.
    assert_eq!(
        set.observations().iter().map(|o| (o.step, o.weight)).collect::<Vec<_>>(),
        [(0, 0.0), (2, 0.0), (2, 0.25)]
    );
    assert_eq!((set.dim(), set.last_step(), set.rows(0), set.rows(2)), (4, Some(3), 0..2, 3..4));
    assert_eq!(set.sigma(), [0.1, 0.1, 2.0, 0.5]);
    let states = [[1.0, 2.0, 3.0], [9.0, 9.0, 9.0], [4.0, 5.0, 6.0], [7.0, 8.0, 10.0]];
    let mut y = set.prediction();
    for (k, x) in states.iter().enumerate() {
        set.observe_add(k, x, &mut y).unwrap();
    }
    assert_eq!(y.values(), [1.0, 3.0, 5.0, 0.75 * 6.0 + 0.25 * 10.0]);
    let mut d = vec![0.0; 4];
    set.innovations(y.values(), &mut d);
    assert_eq!(d, [0.0, -1.0, 0.0, 0.0]);
}

#[test]
fn adjoint_is_the_transpose_of_the_tangent_with_shared_operators() {
    let (n, steps) = (4, 5);
    // Rows 0, 1, 2, 0, … of columns 0, 2, 0, 2, …: the seventh adds to the first.
    let entries: Vec<_> =
        normals(1, 7).into_iter().enumerate().map(|(i, h)| (i % 3, (2 * i) % n, h)).collect();
    let reversed: Vec<_> = entries.iter().rev().copied().collect();
    for entries in [entries, reversed] {
        let operators: Vec<Box<dyn ObservationOperator>> = vec![
            Box::new(LinearObservation::new(3, n, &entries).unwrap()),
            Box::new(Products(n)),
            Box::new(Selection::new(vec![3, 0], n).unwrap()),
        ];
        let mut observations = Vec::new();
        for (i, weight) in [0.0, 0.5, 0.9, 0.3, 0.0].into_iter().enumerate() {
            let mut o = observation(&[1, 0, 1], i, weight, &[0.0; 3], 1.0);
            o.operator = i % 3;
            observations.push(o.clone());
            o.operator = (i + 1) % 3;
            observations.push(o);
        }
        let mut set = ObservationSet::new(steps, operators, observations).unwrap();
        let x = normals(2, n * (steps + 1));
        let dx = normals(3, n * (steps + 1));
        let w = normals(4, set.dim());
        let run = set.prediction();
        let (mut dy, mut back) = (vec![0.0; set.dim()], vec![0.0; x.len()]);
        for k in 0..=steps {
            set.tangent_add(k, &x[k * n..(k + 1) * n], &dx[k * n..(k + 1) * n], &run, &mut dy);
            set.adjoint_add(k, &x[k * n..(k + 1) * n], &w, &run, &mut back[k * n..(k + 1) * n]);
        }
        let (left, right) = (crate::models::dot(&dy, &w), crate::models::dot(&dx, &back));
        assert!(left.abs() > 0.1);
        // Some hundred terms of size 1: 1e-13 is a few hundred roundings.
        assert!((left - right).abs() <= 1e-13 * left.abs().max(10.0), "{left} {right}");
    }
}

#[test]
fn bad_observations_are_refused_by_name() {
    let good = || observation(&[0, 1], 2, 0.0, &[1.0, 2.0], 0.1);
    let refuse = |change: &dyn Fn(&mut varda_assimilation::Observation)| {
        let mut bad = good();
        change(&mut bad);
        ObservationSet::new(3, vec![all_of(3)], vec![good(), bad]).err().expect("refused")
    };
    assert!(matches!(
        refuse(&|o| o.operator = 1),
        Error::UnknownOperator { observation: 1, operator: 1, operators: 1 }
    ));
    assert!(matches!(refuse(&|o| o.rows[1] = 3), Error::UnknownRow { observation: 1, row: 3, rows: 3 }));
    assert!(matches!(refuse(&|o| o.step = 4), Error::OutsideWindow { observation: 1, step: 4, .. }));
    assert!(matches!(
        refuse(&|o| (o.step, o.weight) = (3, 0.5)),
        Error::OutsideWindow { observation: 1, step: 3, .. }
    ));
    for weight in [1.0, -0.1, f64::NAN] {
        assert!(matches!(refuse(&|o| o.weight = weight), Error::Weight { observation: 1, .. }));
    }
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refuse(&|o| o.sigma[1] = sigma), Error::Sigma { observation: 1, entry: 1, .. }));
    }
    assert!(matches!(refuse(&|o| o.values[0] = f64::NAN), Error::Value { observation: 1, entry: 0, .. }));
    assert!(matches!(
        refuse(&|o| o.values.truncate(1)),
        Error::Lengths { observation: 1, rows: 2, values: 1, .. }
    ));
    assert_eq!(refuse(&|o| o.rows[1] = 3).to_string(), "observation 1: row 3 of an operator with 3 rows");
    assert!(matches!(Selection::new(vec![0, 5], 3), Err(Error::OperatorEntry { row: 1, column: 5, .. })));
    for entry in [(0, 1, f64::NAN), (1, 0, 1.0), (0, 2, 1.0)] {
        let refused = LinearObservation::new(1, 2, &[(0, 0, 1.0), entry]).err();
        let (row, column, _) = entry;
        assert!(matches!(
            refused,
            Some(Error::OperatorEntry { row: r, rows: 1, column: c, columns: 2, .. })
                if (r, c) == (row, column)
        ));
    }
}

#[test]
fn the_shipped_operators_pass_the_check_for_users() {
    use varda_implicit::{At, check};
    let entries = [(0, 1, 2.0), (1, 0, -1.0), (1, 3, 1e3), (2, 2, 0.5)];
    let mut linear = LinearObservation::new(3, 4, &entries).unwrap();
    let mut selection = Selection::new(vec![3, 0, 3], 4).unwrap();
    let mut products = Products(4);
    let operators: [&mut dyn ObservationOperator; 3] = [&mut linear, &mut selection, &mut products];
    for operator in operators {
        let n = operator.state_dim();
        let x: Vec<f64> = (0..n).map(|i| 0.7 + i as f64).collect();
        let at = At { step: 4, time: 0.4 };
        let report = check::operator(operator, at, &x, &vec![0.1; n], 3).unwrap();
        assert!(report.passed(), "{report}");
    }
}
