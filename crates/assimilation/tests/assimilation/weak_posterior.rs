//! σ of the errors of a model, the J_q to expect, and how large Q should be.

use crate::cost::{coupled, curved_problem};
use crate::family::ignore;
use crate::matrix::*;
use crate::models::*;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal};

/// A linear window of 60 steps: an error of σ = 0.3 every third step, everything seen after every step.
const STEPS: usize = 60;
const SIGMA_Q: f64 = 0.3;

fn forcing() -> Forcing {
    Forcing { steps: 3, ..Forcing::every_step(4) }
}

/// The window's truth with errors of `truth` times σ, seen with σ_o = 0.2; x_b off by a draw of B = I.
fn drawn(seed: u64, truth: f64) -> (Rk4<Linear>, Vec<f64>, ObservationSet) {
    // two oscillators, slightly damped
    let field = vec![-0.1, 1.0, 0.0, 0.0, -1.0, -0.1, 0.0, 0.3, 0.0, 0.0, -0.1, 2.0, 0.0, 0.0, -2.0, -0.1];
    let mut model = Rk4::new(Linear(4, field), 0.1);
    let background = vec![0.5, -0.3, 0.2, 0.8];
    let mut x: Vec<f64> = background.iter().zip(normals(seed, 4)).map(|(b, e)| b + e).collect();
    let (errors, noise) = (normals(1000 + seed, 4 * STEPS), normals(2000 + seed, 4 * STEPS));
    let mut seen = Vec::new();
    for k in 0..STEPS {
        x = run(&mut model, &x, 1).pop().unwrap();
        if (k + 1) % 3 == 0 {
            x.iter_mut().zip(&errors[4 * k..]).for_each(|(x, e)| *x += truth * SIGMA_Q * e);
        }
        let y = x.iter().zip(&noise[4 * k..]).map(|(x, e)| x + 0.2 * e).collect();
        seen.push(Observation::new(k + 1, (0..4).collect(), y, 0.2));
    }
    (model, background, ObservationSet::new(STEPS, vec![all_of(4)], seen).unwrap())
}

/// Minimum and posterior with σ_q = `factor` of the true one for truth 1; J_q beside them.
fn analysed(seed: u64, truth: f64, factor: f64) -> (f64, WeakPosterior) {
    let (mut model, background, mut set) = drawn(seed, truth);
    let (b, q) = (Diagonal::uniform(4, 1.0).unwrap(), Diagonal::uniform(4, factor * SIGMA_Q).unwrap());
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = WeakForcing::new(&mut model, transform, &q, forcing(), &mut set).unwrap();
    let mut v = vec![0.0; cost.dim()];
    let options = OuterLoopOptions::default().with_inner(InnerSolver::Primal).with_gradient_tolerance(1e-10);
    outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
    cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
    let posterior = WeakPosterior::new(&mut cost).unwrap();
    (cost.terms().model_error, posterior)
}

/// Against the inverse of the dense Hessian of both forms, on a curved problem.
#[test]
fn sigma_of_errors_is_that_of_the_dense_inverse() {
    let (b, q) = (coupled(6, 0.5), coupled(3, 0.2));
    let forcing = Forcing { components: vec![0, 2, 4], steps: 3, held: false };
    let check = |cost: &mut dyn LeastSquares| {
        let r = cost.dim();
        let posterior = WeakPosterior::new(cost).unwrap();
        let mut hessian = vec![0.0; r * r];
        cost.hessian(&mut hessian).unwrap();
        let unit = Matrix::diagonal(&vec![1.0; r]);
        let inverse = Matrix::new(r, r, |i, j| hessian[i + j * r]).solve(&unit);
        let root = posterior.root();
        for i in 0..r {
            let row: f64 = (0..r).map(|j| root[i + j * r] * root[i + j * r]).sum();
            // the condition number of the Hessian is about 1e5
            assert!((row - inverse.at(i, i)).abs() <= 1e-10, "{i}: {row} {}", inverse.at(i, i));
        }
        let first = posterior.initial().control_variable_variance();
        for (i, v) in first.iter().enumerate() {
            assert!((v - inverse.at(i, i)).abs() <= 1e-10);
        }
        let mut signal = 0.0;
        for j in 0..(r - 6) / 3 {
            let block = Matrix::new(3, 3, |a, b| inverse.at(6 + 3 * j + a, 6 + 3 * j + b));
            let half = root_of(&q);
            let expected = half.times(&block).times(&half.transpose());
            let variance = posterior.error_variance(&q, j);
            for (i, v) in variance.iter().enumerate() {
                assert!((v - expected.at(i, i)).abs() <= 1e-11, "{j} {i}: {v} {}", expected.at(i, i));
            }
            signal += (0..3).map(|i| 1.0 - inverse.at(6 + 3 * j + i, 6 + 3 * j + i)).sum::<f64>();
        }
        assert!((2.0 * posterior.expected_model_error() - signal).abs() <= 1e-10 && signal > 0.1);
    };
    let (mut model, background, mut set) = curved_problem();
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = WeakForcing::new(&mut model, transform, &q, forcing.clone(), &mut set).unwrap();
    let n = cost.dim();
    cost.linearize(&normals(60, n), &mut vec![0.0; n]).unwrap();
    check(&mut cost);
    drop(cost);
    let (mut model, background, mut set) = curved_problem();
    let mut cost = WeakState::new(&mut model, background, &b, &q, forcing, &mut set).unwrap();
    let v = cost.background().unwrap();
    cost.linearize(&v, &mut vec![0.0; n]).unwrap();
    check(&mut cost);
}

/// Over 40 draws from the B, Q and R assumed, 2 J_q is its expectation and the factor 1.
#[test]
fn j_q_has_its_expectation_where_q_is_right_and_the_factor_finds_a_wrong_q() {
    const DRAWS: usize = 40;
    let (mut sum, mut expected, mut inside, mut logs) = (0.0, 0.0, 0, 0.0);
    for seed in 0..DRAWS as u64 {
        let (j_q, posterior) = analysed(seed, 1.0, 1.0);
        sum += 2.0 * j_q;
        expected = 2.0 * posterior.expected_model_error();
        let scale = posterior.scale().unwrap();
        inside += usize::from(scale.low <= 1.0 && 1.0 <= scale.high);
        logs += scale.factor.ln() / DRAWS as f64;
    }
    let mean = sum / DRAWS as f64;
    // The variance of 2 J_q is below 2 tr: three standard deviations of its mean.
    assert!((mean - expected).abs() <= 3.0 * (2.0 * expected / DRAWS as f64).sqrt(), "{mean} {expected}");
    // Three binomial σ below 95 % of 40 is 33.9; ln of the factor has σ = 1/√(2 · 80) a draw at best.
    assert!(inside >= 34, "{inside}");
    assert!(logs.abs() <= 0.06, "{logs}");
    for (truth, factor) in [(3.0, 1.0), (1.0, 10.0), (1.0, 1e-3)] {
        let right = truth / factor;
        let (_, posterior) = analysed(50, truth, factor);
        let scale = posterior.scale().unwrap();
        assert!(
            scale.low < right && right < scale.high && scale.high < 2.0 * scale.low,
            "{right}: {scale:?}"
        );
        // Where L is largest, J_q is its expectation: that of another minimization, with the Q found.
        let (j_q, posterior) = analysed(50, truth, factor * scale.factor);
        let expected = posterior.expected_model_error();
        assert!((j_q / expected - 1.0).abs() <= 1e-5, "{j_q} {expected}");
        assert!((posterior.scale().unwrap().factor - 1.0).abs() <= 1e-5);
    }
}

#[test]
fn no_error_of_the_model_and_no_observation_are_said() {
    let (_, posterior) = analysed(7, 0.0, 1.0);
    let scale = posterior.scale().unwrap();
    assert!(scale.low == 0.0 && scale.factor < 0.1 && scale.high < 0.3, "{scale:?}");

    let (mut model, background, set) = drawn(7, 1.0);
    let mut nothing = ObservationSet::new(STEPS, set.into_parts().0, Vec::new()).unwrap();
    let (b, q) = (Diagonal::uniform(4, 1.0).unwrap(), Diagonal::uniform(4, 0.3).unwrap());
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = WeakForcing::new(&mut model, transform, &q, forcing(), &mut nothing).unwrap();
    let v = vec![0.0; cost.dim()];
    cost.linearize(&v, &mut v.clone()).unwrap();
    let posterior = WeakPosterior::new(&mut cost).unwrap();
    assert_eq!((posterior.scale(), posterior.expected_model_error()), (None, 0.0));
}

fn root_of(q: &dyn Covariance) -> Matrix {
    let columns: Vec<Vec<f64>> = (0..q.root_dim())
        .map(|j| {
            let (mut unit, mut column) = (vec![0.0; q.root_dim()], vec![0.0; q.dim()]);
            unit[j] = 1.0;
            q.root(&unit, &mut column);
            column
        })
        .collect();
    Matrix::new(q.dim(), columns.len(), |i, j| columns[j][i])
}
