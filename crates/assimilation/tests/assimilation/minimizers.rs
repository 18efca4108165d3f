//! The minimizers that need less, or more, than the trust region: what they reach, what they report, what
//! they cost.

use crate::cost::{coupled, curved_problem};
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::Dense;

fn quiet(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Rosenbrock's valley as ½‖r‖², r = (c (x₁ − x₀²), 1 − x₀); points with x₀ beyond `wall`
/// cannot be evaluated.
struct Valley {
    c: f64,
    wall: f64,
    at: [f64; 2],
    terms: CostTerms,
    counts: Counts,
}

impl Valley {
    fn new(c: f64, wall: f64) -> Self {
        Self { c, wall, at: [f64::NAN; 2], terms: CostTerms::default(), counts: Counts::default() }
    }

    fn slopes(&self) -> [[f64; 2]; 2] {
        [[-2.0 * self.c * self.at[0], self.c], [-1.0, 0.0]]
    }
}

impl CostFunction for Valley {
    fn dim(&self) -> usize {
        2
    }
    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.counts.forward_runs += 1;
        if !(v[0] < self.wall) {
            return Err(Error::NonFinite { what: "the wall", step: 0 });
        }
        let r = [self.c * (v[1] - v[0] * v[0]), 1.0 - v[0]];
        self.terms = CostTerms { background: 0.0, observation: 0.5 * dot(&r, &r), model_error: 0.0 };
        if let Some(g) = gradient {
            self.counts.gradients += 1;
            self.at = [v[0], v[1]];
            let j = self.slopes();
            (g[0], g[1]) = (j[0][0] * r[0] + j[1][0] * r[1], j[0][1] * r[0] + j[1][1] * r[1]);
        }
        Ok(self.terms.total())
    }
    fn terms(&self) -> CostTerms {
        self.terms
    }
    fn set_observation_scale(&mut self, _scale: f64) {}
    fn counts(&self) -> Counts {
        self.counts
    }
}

impl LeastSquares for Valley {
    fn background_dim(&self) -> usize {
        self.dim()
    }

    fn observation_dim(&self) -> usize {
        2
    }
    /// Both residuals, as if they were observed; nothing is known before.
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        b.fill(0.0);
        (d[0], d[1]) = (-self.c * (self.at[1] - self.at[0] * self.at[0]), self.at[0] - 1.0);
    }
    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.slopes().iter().zip(dy).for_each(|(row, dy)| *dy = dot(row, dv));
        Ok(())
    }
    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        let j = self.slopes();
        (0..2).for_each(|i| dv[i] = j[0][i] * dy[0] + j[1][i] * dy[1]);
        Ok(())
    }
    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let mut dy = [0.0; 2];
        self.jacobian(dv, &mut dy)?;
        self.jacobian_transpose(&dy, out)
    }
    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.hessian_apply(&[1.0, 0.0], &mut out[..2])?;
        self.hessian_apply(&[0.0, 1.0], &mut out[2..])
    }
}

#[test]
fn bent_valleys_are_followed_to_their_end() {
    for c in [10.0, 100.0] {
        for name in ["auto", "trust-region", "gauss-newton-cg", "lbfgs"] {
            // Gauss–Newton with step halving needs 200 iterations along the narrower valley.
            if name == "gauss-newton-cg" && c > 10.0 {
                continue;
            }
            let mut v = vec![-1.2, 1.0];
            let minimum = Minimizer::named(name)
                .unwrap()
                .minimize(&mut Valley::new(c, f64::INFINITY), &mut v, &mut quiet)
                .unwrap();
            assert_eq!(minimum.status, Status::Converged, "{name} {c}: {minimum:?}");
            assert!(norm(&[v[0] - 1.0, v[1] - 1.0]) <= 1e-5, "{name} {c}: {v:?}");
        }
    }
}

/// J = −½x² + ½y² with a wall at x = 5: the step to it is cut short where J is concave along it.
struct Concave(CostTerms);

impl CostFunction for Concave {
    fn dim(&self) -> usize {
        2
    }
    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        if !(v[0].abs() < 5.0) {
            return Err(Error::NonFinite { what: "the wall", step: 0 });
        }
        self.0 = CostTerms { observation: 0.5 * (v[1] * v[1] - v[0] * v[0]), ..CostTerms::default() };
        if let Some(g) = gradient {
            (g[0], g[1]) = (-v[0], v[1]);
        }
        Ok(self.0.total())
    }
    fn terms(&self) -> CostTerms {
        self.0
    }
    fn set_observation_scale(&mut self, _scale: f64) {}
    fn counts(&self) -> Counts {
        Counts::default()
    }
}

#[test]
fn lbfgs_stores_no_pair_of_negative_curvature() {
    let mut v = vec![0.5, 0.1];
    let minimum =
        lbfgs(&mut Concave(CostTerms::default()), &mut v, &LbfgsOptions::default(), &mut quiet).unwrap();
    assert_eq!(minimum.status, Status::Stalled);
    assert!(matches!(minimum.failure, Some(Error::NonFinite { what: "the wall", .. })));
    assert!(v[0] > 4.9 && minimum.value < -12.0, "{v:?}");
    let memory = minimum.inverse_hessian.unwrap();
    assert!(memory.skipped() > 0);

    let mut memory = InverseHessian::new(2, 3);
    assert!(!memory.store(&[1.0, 0.0], &[-1.0, 0.0]));
    assert!(!memory.store(&[1.0, 0.0], &[f64::NAN, 0.0]));
    assert!(memory.store(&[1.0, 0.0], &[4.0, 1.0]));
    assert_eq!((memory.pairs(), memory.skipped()), (1, 2));
    // The secant equation H y = s.
    let mut s = [0.0; 2];
    memory.apply(&[4.0, 1.0], &mut s);
    assert!(norm(&[s[0] - 1.0, s[1]]) <= 1e-15);
}

#[test]
fn a_failing_model_only_shrinks_the_steps_of_lbfgs() {
    let (mut model, background, mut set) = curved_problem();
    model.bound = 12.0;
    let b = coupled(6, 0.8);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let start: Vec<f64> = normals(7, 6).iter().map(|v| 0.5 * v).collect();
    let mut v = start.clone();
    let by_lbfgs = lbfgs(&mut cost, &mut v, &LbfgsOptions::default(), &mut quiet).unwrap();
    assert_eq!(by_lbfgs.status, Status::Converged, "{by_lbfgs:?}");
    let reference = Minimizer::default().minimize(&mut cost, &mut start.clone(), &mut quiet).unwrap();
    assert!((by_lbfgs.value - reference.value).abs() <= 1e-8 * reference.value);

    let mut valley = Valley::new(10.0, -1.19);
    let mut rejected = 0;
    let ended = lbfgs(&mut valley, &mut [-1.2, 1.0], &LbfgsOptions::default(), &mut |i| {
        rejected += i.rejected;
        ControlFlow::Continue(())
    });
    // Behind the wall lies the minimum: it is not reached, and the wall is named.
    let ended = ended.unwrap();
    assert!(rejected > 0 && ended.status != Status::Converged && ended.failure.is_some(), "{ended:?}");
}

fn all_named() -> Vec<Minimizer> {
    let mut all: Vec<Minimizer> =
        Minimizer::NAMES.iter().map(|name| Minimizer::named(name).unwrap()).collect();
    all.push(Minimizer::NewtonCg(NewtonCgOptions::default().with_preconditioner_pairs(50)));
    all
}

#[test]
fn every_minimizer_has_a_name_reports_equal_rows_and_is_deterministic() {
    let b = coupled(6, 0.3);
    let run = |minimizer: &Minimizer, stop_at: usize| {
        let (mut model, background, mut set) = curved_problem();
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let mut v = vec![0.0; 6];
        let mut rows: Vec<(usize, f64, f64, f64, usize)> = Vec::new();
        let minimum = minimizer
            .minimize(&mut cost, &mut v, &mut |i: &Iteration| {
                rows.push((i.index, i.value, i.gradient_norm, i.step_norm, i.counts.forward_runs));
                assert_eq!(i.value, i.terms.total());
                assert_eq!(i.v.len(), 6);
                if i.index == stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
            .unwrap();
        // The point returned is that of the numbers returned, and the last gradient was there.
        let mut g = vec![0.0; 6];
        let before = cost.counts().forward_runs;
        assert_eq!(cost.evaluate(&v, Some(&mut g)).unwrap(), minimum.value, "{}", minimizer.name());
        assert_eq!(cost.counts().forward_runs, before, "{}", minimizer.name());
        assert_eq!(norm(&g), minimum.gradient_norm);
        (rows, minimum, v)
    };
    let (_, reference, _) = run(&Minimizer::default(), usize::MAX);
    for mut minimizer in all_named() {
        assert!(Minimizer::NAMES.contains(&minimizer.name()));
        let (rows, minimum, v) = run(&minimizer, usize::MAX);
        let ladder = minimizer.name() == "auto";
        assert_eq!(rows.iter().filter(|row| row.3 > 0.0).count(), minimum.outer_iterations);
        // Rows without a step are starts: the first, and those of the stages of a ladder.
        assert!(
            rows.iter().all(|row| row.0 <= minimum.outer_iterations && (row.3 > 0.0 || row.0 == 0 || ladder))
        );
        assert!(rows.windows(2).all(|w| w[1].0 == w[0].0 + 1 || (ladder && w[1].3 == 0.0)));
        assert!(rows.windows(2).all(|w| w[0].4 <= w[1].4));
        assert_eq!(rows[0].2, minimum.gradient_norm_first);
        assert_eq!(rows[0].1, run(&Minimizer::default(), 0).0[0].1);
        if minimum.status == Status::Converged {
            assert!(ladder || rows[rows.len() - 1].1 == minimum.value);
            assert!(minimum.gradient_norm <= 1e-8 * minimum.gradient_norm_first * (1.0 + 1e-12));
            assert!(
                (minimum.value - reference.value).abs() <= 1e-8 * reference.value,
                "{}",
                minimizer.name()
            );
        } else {
            // The paper's two need not reach 1e-8, argmin's need not see the last digits; both come near.
            assert!(
                matches!(minimizer.name(), "adam" | "newton" | "argmin-lbfgs" | "argmin-trust-region"),
                "{minimum:?}"
            );
            assert!(minimum.value <= 1.01 * reference.value, "{}: {minimum:?}", minimizer.name());
        }
        let again = run(&minimizer, usize::MAX);
        assert_eq!((again.0, again.2), (rows, v));

        let (rows, minimum, _) = run(&minimizer, 1);
        assert_eq!((minimum.status, minimum.outer_iterations, rows.len()), (Status::Interrupted, 1, 2));
        minimizer.stopping_mut().max_iterations = 1;
        let (_, minimum, _) = run(&minimizer, usize::MAX);
        assert_eq!(minimum.status, Status::MaxIterations, "{}", minimizer.name());
        minimizer.stopping_mut().gradient_tolerance = -1.0;
        let (mut model, background, mut set) = curved_problem();
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let ended = minimizer.minimize(&mut cost, &mut [0.0; 6], &mut quiet);
        assert!(matches!(ended, Err(Error::Setting { what: "gradient_tolerance", .. })));
    }
    assert_eq!(Minimizer::named("gradient-descent"), None);
}

/// 40 points with smooth errors (Gaussian kernel and a little white noise: condition number 1e7), every
/// fourth seen.
fn line() -> (Dense, ObservationSet) {
    let n = 40;
    let matrix: Vec<f64> = (0..n * n)
        .map(|ij| {
            let apart = ((ij / n) as f64 - (ij % n) as f64) / 4.0;
            (-0.5 * apart * apart).exp() + if ij % (n + 1) == 0 { 1e-6 } else { 0.0 }
        })
        .collect();
    let every: Vec<usize> = (0..10).collect();
    let h = Selection::new((0..10).map(|i| 4 * i).collect(), n).unwrap();
    let seen = vec![observation(&every, 0, 0.0, &normals(5, 10), 0.05)];
    (Dense::new(n, &matrix).unwrap(), ObservationSet::new(0, vec![Box::new(h)], seen).unwrap())
}

#[test]
fn adam_works_in_control_variables_and_lags_in_raw_ones() {
    let (b, mut set) = line();
    let transform = ControlTransform::new(vec![0.0; 40], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
    let lowest = Minimizer::default().minimize(&mut cost, &mut [0.0; 40], &mut quiet).unwrap().value;

    // The raw cost is the same function, with the gradient of its own variables.
    let v = normals(6, 40);
    let mut z = vec![0.0; 40];
    transform.control(&v, &mut z);
    let value = cost.evaluate(&v, None).unwrap();
    let mut raw = RawVariables::new(&mut cost, &transform, &b).unwrap();
    let mut g = vec![0.0; 40];
    let there = raw.evaluate(&z, Some(&mut g)).unwrap();
    assert!((there - value).abs() <= 1e-12 * value);
    let d = normals(8, 40);
    // J is quadratic: central differences are exact but for rounding.
    let mut at = |h: f64| {
        let z: Vec<f64> = z.iter().zip(&d).map(|(z, d)| z + h * d).collect();
        raw.evaluate(&z, None).unwrap()
    };
    let slope = at(0.5) - at(-0.5);
    assert!((slope - dot(&g, &d)).abs() <= 1e-10 * slope.abs(), "{slope} {}", dot(&g, &d));

    let gap = |cost: &mut dyn CostFunction, learning_rate| {
        let options = AdamOptions::default().with_learning_rate(learning_rate).with_max_iterations(600);
        adam(cost, &mut [0.0; 40], &options, &mut quiet).unwrap().value / lowest - 1.0
    };
    // Either with its own best learning rate of several.
    let in_raw = [0.0025, 0.005, 0.01, 0.02, 0.04].map(|rate| gap(&mut raw, rate));
    let control = [0.01, 0.02, 0.04, 0.08].map(|rate| gap(&mut cost, rate));
    let [control, in_raw] =
        [&control[..], &in_raw].map(|gaps| gaps.iter().copied().fold(f64::INFINITY, f64::min));
    assert!(control < 1e-3 && control < 0.01 * in_raw, "{control:e} {in_raw:e}");
}

/// Lorenz-96, 40 variables, all seen over a short window with six times the error they claim (so that outer
/// iterations are many): A keeps most of its 40 large eigenvalues from one outer iteration to the next.
#[test]
fn a_spectral_preconditioner_saves_inner_iterations() {
    let b = coupled(40, 1.0);
    let truth: Vec<f64> = {
        let start: Vec<f64> = normals(31, 40).iter().map(|x| 2.0 + 3.0 * x).collect();
        run(&mut Rk4::new(Lorenz96(40), 0.0125), &start, 400).pop().unwrap()
    };
    let states = run(&mut Rk4::new(Lorenz96(40), 0.0125), &truth, 16);
    let noise = normals(32, 160);
    let every: Vec<usize> = (0..40).collect();
    let seen = (1..=4).map(|j| {
        let y: Vec<f64> =
            states[4 * j].iter().zip(&noise[40 * (j - 1)..]).map(|(x, e)| x + 0.3 * e).collect();
        observation(&every, 4 * j, 0.0, &y, 0.05)
    });
    let mut set = ObservationSet::new(16, vec![all_of(40)], seen.collect()).unwrap();
    let background: Vec<f64> = truth.iter().zip(normals(33, 40)).map(|(x, e)| x + 0.5 * e).collect();
    let mut model = Rk4::new(Lorenz96(40), 0.0125);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut inner = |preconditioner_pairs| {
        let options = NewtonCgOptions::default().with_preconditioner_pairs(preconditioner_pairs);
        let minimum = newton_cg(&mut cost, &mut [0.0; 40], &options, &mut quiet).unwrap();
        assert_eq!(minimum.status, Status::Converged, "{minimum:?}");
        (minimum.outer_iterations, minimum.inner_iterations, minimum.value)
    };
    let (without, with) = (inner(0), inner(100));
    assert!(10 * with.1 <= 8 * without.1, "{with:?} {without:?}");
    assert!((with.2 - without.2).abs() <= 1e-9 * with.2);
}

/// Lorenz-63 over 80 steps from backgrounds three standard deviations off: several minima, though none that
/// inflating R gets past (on the hanging rod it does). Never worse than the trust region alone, and the same
/// bits and no more work where the background is near.
#[test]
fn auto_is_never_worse_than_the_trust_region_and_the_same_where_the_background_is_near() {
    let (mut twice, mut same) = (0, 0);
    for seed in 0..30 {
        let (truth, background, mut set) = lorenz63_twin(seed, 80, 10);
        let far = if seed < 20 { 3.0 } else { 0.02 };
        let background = truth.iter().zip(&background).map(|(t, b)| t + far * (b - t)).collect();
        let b = coupled(3, far);
        let mut model = Rk4::new(Lorenz63, 0.01);
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let mut end = |minimizer: &Minimizer| {
            let before = cost.counts().gradients;
            let mut v = vec![0.0; 3];
            let minimum = minimizer.minimize(&mut cost, &mut v, &mut quiet).unwrap();
            (minimum.value, cost.counts().gradients - before, v)
        };
        let plain = end(&Minimizer::default());
        let auto = end(&Minimizer::Auto(AutoOptions::default().with_threshold(1.0)));
        assert!(auto.0 <= plain.0 * (1.0 + 1e-6), "seed {seed}: {} {}", auto.0, plain.0);
        twice += usize::from(auto.1 > plain.1);
        same += usize::from(seed >= 20 && auto == plain);
    }
    // all others end within the band of a fit, or are trusted
    assert!(twice >= 2, "{twice}");
    assert_eq!(same, 10);
}
