//! Several windows that share constants, as one cost.

use nalgebra::{DMatrix, DVector};
use varda_assimilation::{
    ControlTransform, CostFunction, Joint, LeastSquares, Observation, ObservationSet, Posterior, Selection,
    StrongConstraint, TrustRegionOptions, trust_region,
};
use varda_covariance::{BlockDiagonal, Diagonal};
use varda_implicit::{Model, ParametricRhs, Rhs, RhsWithParameters, Rk4, lorenz::Lorenz63};

use super::filter::{N, Pushed};
use crate::row::{Case, Outcome, Rows};

pub(super) fn run(rows: &mut Rows) {
    rows.area("several windows");
    rows.case("a forcing in two of a linear model", stacked);
    rows.case("one window", alone);
    rows.case("derivatives of three windows", derivatives);
    rows.case("what is refused", refused);
}

const STEPS: usize = 16;
const SIGMA: f64 = 0.1;
const SIGMA_STATE: f64 = 0.5;
const SIGMA_FORCING: f64 = 0.8;

/// What is seen in window r: component 0 and 2, every second step, other numbers in each.
fn seen(r: usize) -> Vec<(usize, Vec<f64>)> {
    let value = |k: usize, c: usize| (0.7 * k as f64 + c as f64 + 1.3 * r as f64).sin();
    (1..=STEPS / 2 - r).map(|k| (2 * k, (0..2).map(|c| value(k, c)).collect())).collect()
}

fn set(r: usize, n: usize) -> Result<ObservationSet, varda_assimilation::Error> {
    let list = seen(r).into_iter().map(|(k, y)| Observation::new(k, vec![0, 1], y, SIGMA)).collect();
    ObservationSet::new(STEPS, vec![Box::new(Selection::new(vec![0, 2], n)?)], list)
}

fn background(r: usize) -> Vec<f64> {
    let state = (0..N).map(|i| 0.3 * (1.0 + 2.1 * i as f64 + r as f64).cos());
    state.chain([0.2]).collect()
}

/// Both initial states and F of the normal equations of both windows at once, and their covariance: G from
/// the response of runs to single numbers, B diagonal.
fn closed() -> Result<(DVector<f64>, DMatrix<f64>), Box<dyn std::error::Error>> {
    let n = 2 * N + 1;
    let mut precision = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| {
        if i < 2 * N { SIGMA_STATE.powi(-2) } else { SIGMA_FORCING.powi(-2) }
    }));
    let mut right = DVector::zeros(n);
    let place = |r: usize, i: usize| if i < N { r * N + i } else { 2 * N };
    let mut model = Rk4::new(RhsWithParameters::new(Pushed::default(), 0), 0, 0.1);
    for r in 0..2 {
        let mut predicted = |z: &[f64]| -> Result<Vec<f64>, varda_implicit::Error> {
            let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
            model.initial_state(z, &mut x)?;
            let mut all = Vec::new();
            for k in 0..STEPS {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
                if seen(r).iter().any(|(step, _)| *step == k + 1) {
                    all.extend([x[0], x[2]]);
                }
            }
            Ok(all)
        };
        let z = background(r);
        let at = predicted(&z)?;
        let values: Vec<f64> = seen(r).into_iter().flat_map(|(_, y)| y).collect();
        // the model is linear: a difference is the derivative
        let mut columns = Vec::new();
        for i in 0..=N {
            let mut moved = z.clone();
            moved[i] += 1.0;
            columns.push(predicted(&moved)?.iter().zip(&at).map(|(a, b)| a - b).collect::<Vec<f64>>());
        }
        for (i, a) in columns.iter().enumerate() {
            let residual = values.iter().zip(&at).map(|(y, h)| (y - h) / (SIGMA * SIGMA));
            right[place(r, i)] += a.iter().zip(residual).map(|(a, d)| a * d).sum::<f64>();
            for (j, b) in columns.iter().enumerate() {
                let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                precision[(place(r, i), place(r, j))] += product / (SIGMA * SIGMA);
            }
        }
    }
    let covariance = precision.try_inverse().ok_or("no inverse")?;
    let start = background(0).into_iter().take(N).chain(background(1));
    let z = DVector::from_iterator(n, start) + &covariance * right;
    Ok((z, covariance))
}

fn stacked(case: &mut Case) -> Outcome {
    let (expected, covariance) = closed()?;
    let b =
        BlockDiagonal::new(vec![Diagonal::uniform(N, SIGMA_STATE)?, Diagonal::uniform(1, SIGMA_FORCING)?]);
    let transforms = [0, 1].map(|r| ControlTransform::new(background(r), &b));
    let transforms = transforms.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut models = [0, 1].map(|_| Rk4::new(RhsWithParameters::new(Pushed::default(), 0), 0, 0.1));
    let mut sets = [set(0, N + 1)?, set(1, N + 1)?];
    let mut costs = Vec::new();
    for ((model, set), transform) in models.iter_mut().zip(&mut sets).zip(&transforms) {
        costs.push(StrongConstraint::new(model, transform.clone(), set)?);
    }
    let mut all =
        Joint::new(costs.iter_mut().map(|c| c as &mut dyn LeastSquares).collect(), &[vec![N], vec![N]])?;
    let mut v = vec![0.0; all.dim()];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13);
    trust_region(&mut all, &mut v, &options, &mut |_| std::ops::ControlFlow::Continue(()))?;
    let posterior = Posterior::new(&mut all)?;
    let (mut off, mut off_covariance) = (0.0_f64, 0.0_f64);
    for (r, transform) in transforms.iter().enumerate() {
        let own: Vec<f64> = all.places(r).iter().map(|i| v[*i]).collect();
        let mut z = vec![0.0; N + 1];
        transform.control(&own, &mut z);
        let place = |i: usize| if i < N { r * N + i } else { 2 * N };
        let marginal = posterior.marginal(all.places(r))?.covariance(transform);
        for i in 0..=N {
            off = off.max((z[i] - expected[place(i)]).abs() / expected.amax());
            for j in 0..=N {
                let of_closed = covariance[(place(i), place(j))];
                off_covariance = off_covariance.max((marginal[i + j * (N + 1)] - of_closed).abs());
            }
        }
    }
    case.at_most("both states and the forcing off the closed form", off, 1e-10, "-")
        .because("two ways to one linear answer, and a gradient of 1e-13")
        .computed(expected[2 * N]);
    case.at_most("covariances off the closed form", off_covariance / covariance.amax(), 1e-10, "-")
        .because("rounding of two inverses");
    drop(all);
    let mut one = Joint::new(vec![&mut costs[0] as &mut dyn LeastSquares], &[vec![N]])?;
    let mut v = vec![0.0; N + 1];
    trust_region(&mut one, &mut v, &options, &mut |_| std::ops::ControlFlow::Continue(()))?;
    let alone = Posterior::new(&mut one)?.variance(&transforms[0])[N].sqrt();
    let both = covariance[(2 * N, 2 * N)].sqrt();
    case.at_most("σ of the forcing from both over that from one", both / alone, 0.85, "-")
        .because("the second window knows nearly as much as the first, or this case shows nothing");
    Ok(())
}

/// J, its gradient and Hessian of one window are those of its cost.
fn alone(case: &mut Case) -> Outcome {
    let b =
        BlockDiagonal::new(vec![Diagonal::uniform(N, SIGMA_STATE)?, Diagonal::uniform(1, SIGMA_FORCING)?]);
    let transform = ControlTransform::new(background(0), &b)?;
    let mut models = [0, 1].map(|_| Rk4::new(RhsWithParameters::new(Pushed::default(), 0), 0, 0.1));
    let mut sets = [set(0, N + 1)?, set(0, N + 1)?];
    let mut costs = Vec::new();
    for (model, set) in models.iter_mut().zip(&mut sets) {
        costs.push(StrongConstraint::new(model, transform.clone(), set)?);
    }
    let (first, second) = costs.split_at_mut(1);
    let (plain, n) = (&mut first[0], N + 1);
    let mut joint = Joint::new(vec![&mut second[0] as &mut dyn LeastSquares], &[vec![N]])?;
    let v: Vec<f64> = (0..n).map(|i| (1.0 + 1.7 * i as f64).sin()).collect();
    let [mut g, mut h, mut p, mut q] = std::array::from_fn(|_| vec![0.0; n]);
    let value = plain.evaluate(&v, Some(&mut g))?;
    let same = joint.evaluate(&v, Some(&mut h))?;
    plain.hessian_apply(&v, &mut p)?;
    joint.hessian_apply(&v, &mut q)?;
    let unlike = [&g, &p].into_iter().flatten().zip([&h, &q].into_iter().flatten()).filter(|(a, b)| a != b);
    case.count(
        "numbers of J, gradient and product that differ",
        usize::from(value != same) + unlike.count(),
        0,
    )
    .because("the same sums in the same order");
    Ok(())
}

/// Lorenz-63 with ρ unknown, three windows: products against each other and against J.
fn derivatives(case: &mut Case) -> Outcome {
    #[derive(Clone)]
    struct Heated(Lorenz63);
    impl Rhs for Heated {
        fn dim(&self) -> usize {
            3
        }
        fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
            self.0.eval(t, x, f);
        }
        fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
            self.0.tangent(t, x, dx, df);
        }
        fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
            self.0.adjoint_add(t, x, lambda, dx);
        }
    }
    impl ParametricRhs for Heated {
        fn parameters(&self) -> usize {
            1
        }
        fn set_parameters(&mut self, p: &[f64]) {
            self.0.rho = 28.0 + p[0];
        }
        fn parameter_jacobian(&mut self, _t: f64, x: &[f64], columns: &mut [f64]) {
            columns.copy_from_slice(&[0.0, x[0], 0.0]);
        }
    }
    let b = BlockDiagonal::new(vec![Diagonal::uniform(3, 0.7)?, Diagonal::uniform(1, 2.0)?]);
    let start = |r: usize| vec![1.5 + r as f64, -1.5 + 0.3 * r as f64, 25.0 - 2.0 * r as f64, 0.1];
    let rhs = || RhsWithParameters::new(Heated(Lorenz63::default()), 0);
    let mut models = [0, 1, 2].map(|_| Rk4::new(rhs(), 0, 0.01));
    let mut sets = Vec::new();
    for r in 0..3 {
        let row = |k: usize| Observation::new(7 * k, vec![0, 1], vec![2.0 + k as f64, 24.0 + r as f64], 0.5);
        let list = (1..=2 + r).map(row).collect();
        sets.push(ObservationSet::new(30, vec![Box::new(Selection::new(vec![0, 2], 4)?)], list)?);
    }
    let mut costs = Vec::new();
    for (r, (model, set)) in models.iter_mut().zip(&mut sets).enumerate() {
        costs.push(StrongConstraint::new(model, ControlTransform::new(start(r), &b)?, set)?);
    }
    let mut all =
        Joint::new(costs.iter_mut().map(|c| c as &mut dyn LeastSquares).collect(), &vec![vec![3]; 3])?;
    let (n, m) = (all.dim(), all.observation_dim());
    case.count("unknowns and values", 100 * n + m, 1018).because("3 × 3 + 1, and 4 + 6 + 8");
    let wave =
        |count: usize, w: f64| -> Vec<f64> { (0..count).map(|i| (1.0 + w * i as f64).sin()).collect() };
    let (v, p, w) = (wave(n, 1.7), wave(n, 2.3), wave(m, 0.9));
    let mut g = vec![0.0; n];
    all.evaluate(&v, Some(&mut g))?;
    let (mut dy, mut back, mut product) = (vec![0.0; m], vec![0.0; n], vec![0.0; n]);
    all.jacobian(&p, &mut dy)?;
    all.jacobian_transpose(&w, &mut back)?;
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let size = dot(&dy, &dy).sqrt() * dot(&w, &w).sqrt();
    case.at_most("Gᵀ off G", (dot(&dy, &w) - dot(&p, &back)).abs() / size, 1e-14, "-")
        .because("rounding of sums");
    all.hessian_apply(&p, &mut product)?;
    let (mut hessian, mut jacobian) = (vec![0.0; n * n], vec![0.0; m * n]);
    all.hessian(&mut hessian)?;
    all.dense_jacobian(&mut jacobian)?;
    let (hessian, jacobian) = (DMatrix::from_vec(n, n, hessian), DMatrix::from_vec(m, n, jacobian));
    let gauss_newton = DMatrix::identity(n, n) + jacobian.transpose() * &jacobian;
    let vector = DVector::from_column_slice(&p);
    case.at_most("A off I + GᵀG", (&hessian - &gauss_newton).amax() / hessian.amax(), 1e-13, "-")
        .because("sums in another order");
    let by_product = DVector::from_vec(product.clone());
    case.at_most("A p off the matrix", (&hessian * &vector - by_product).amax() / hessian.amax(), 1e-13, "-")
        .because("sums in another order");
    case.at_most("G p off the matrix", (jacobian * &vector - DVector::from_vec(dy)).amax(), 1e-10, "-")
        .because("sums in another order");
    let (mut b_here, mut d_here) = (vec![0.0; n], vec![0.0; m]);
    all.departures(&mut b_here, &mut d_here);
    all.jacobian_transpose(&d_here, &mut back)?;
    let off = g.iter().zip(b_here.iter().zip(&back)).map(|(g, (b, gd))| (g - (b - gd)).abs());
    case.at_most("∇J off b − Gᵀd", off.fold(0.0, f64::max) / dot(&g, &g).sqrt(), 1e-13, "-")
        .because("one definition, two ways");
    let value = all.evaluate(&v, None)?;
    let parts: f64 = (0..3).map(|r| all.terms_of(r).total()).sum();
    let of_shared = 0.5 * v[n - 1] * v[n - 1];
    case.at_most("parts off J", (parts + of_shared - value).abs() / value, 1e-14, "-").because("a sum");
    let mut along = |h: f64| -> Result<f64, varda_assimilation::Error> {
        let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + h * p).collect();
        all.evaluate(&moved, None)
    };
    let mut central = |h: f64| Ok::<f64, varda_assimilation::Error>((along(h)? - along(-h)?) / (2.0 * h));
    let difference = (4.0 * central(1e-3)? - central(2e-3)?) / 3.0;
    let slope = dot(&g, &p);
    case.at_most("∇J·p off its difference", (slope - difference).abs() / slope.abs(), 1e-8, "-")
        .because("h⁴ of the fifth derivative, and rounding of J over h")
        .computed(slope);
    Ok(())
}

fn refused(case: &mut Case) -> Outcome {
    let b = Diagonal::uniform(N + 1, 1.0)?;
    let mut model = Rk4::new(RhsWithParameters::new(Pushed::default(), 0), 0, 0.1);
    let mut set = set(0, N + 1)?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(background(0), &b)?, &mut set)?;
    for (what, shared) in [
        ("no list for it", vec![]),
        ("an unknown that it has not", vec![vec![N + 1]]),
        ("one named twice", vec![vec![2, 2]]),
    ] {
        let wrong = Joint::new(vec![&mut cost as &mut dyn LeastSquares], &shared).err();
        case.count(what, usize::from(wrong.is_some()), 1)
            .note(wrong.map_or(String::new(), |error| error.to_string()));
    }
    case.count("no costs", usize::from(Joint::new(Vec::new(), &[]).is_err()), 1);
    Ok(())
}
