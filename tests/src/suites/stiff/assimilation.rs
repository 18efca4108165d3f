//! Assimilation at its limits: nothing seen, everything seen, contradictions, useless operators, models that
//! fail.
//!
//! Every minimizer and method that applies is tried. One that cannot get there must say so: a status other
//! than `Converged`, or a typed error; those named in [`MUST`] have to get there.

use super::common::refused;
use crate::row::{Case, Outcome, Rows, Work};
use problems::small_problems::{Linear, all_of, observation, spanning};
use std::ops::ControlFlow;
use varda_assimilation::{
    Blue, ControlTransform, CostFunction, CostTerms, Counts, EnVar, EnVarOptions, Error, Forcing, Gain,
    InnerSolver, Iteration, LeastSquares, LinearObservation, Minimizer, Observation, ObservationSet,
    OuterLoopOptions, Posterior, Status, StrongConstraint, WeakForcing, outer_loop,
};
use varda_covariance::{Diagonal, Ensemble, Localization};
use varda_implicit::{ControlMap, Model, Rk4};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Those without which nothing works: second-order minimizers, incremental methods, closed forms.
const MUST: [&str; 12] = [
    "auto",
    "trust-region",
    "gauss-newton-cg",
    "newton",
    "incremental",
    "4d-psas",
    "direct",
    "blue, observations",
    "blue, information",
    "3dvar",
    "weak-forcing",
    "4denvar",
];

pub(super) fn run(rows: &mut Rows) {
    static_cases(rows);
    rows.case("cost with an indefinite Hessian", indefinite);
    for failure in [Failure::Refuses, Failure::NotANumber] {
        let name = if failure == Failure::Refuses { "returns an error" } else { "returns NaN" };
        rows.case(&format!("model that {name} at some trials"), |case| failing(case, failure));
    }
}

fn go_on(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// A window on four variables that stay as they are, B = I, seen at step 0 only, and its analysis in closed
/// form.
struct Static {
    /// Rows of H and its entries.
    operator: Option<(usize, Vec<(usize, usize, f64)>)>,
    seen: Vec<Observation>,
    expected: Vec<f64>,
    /// Standard deviations of the analysis.
    sigma: Vec<f64>,
    /// No iteration is needed.
    at_background: bool,
}

const BACKGROUND: [f64; 4] = [1.0, -0.5, 2.0, 0.25];

impl Static {
    /// Components seen as they are: (component, value, σ).
    fn direct(seen: &[(usize, f64, f64)]) -> Static {
        let precision = |i: usize| 1.0 + seen.iter().filter(|s| s.0 == i).map(|s| s.2.powi(-2)).sum::<f64>();
        let pull = |i: usize| {
            seen.iter().filter(|s| s.0 == i).map(|s| (s.1 - BACKGROUND[i]) * s.2.powi(-2)).sum::<f64>()
        };
        Static {
            operator: None,
            seen: seen.iter().map(|&(i, y, sigma)| observation(&[i], 0, 0.0, &[y], sigma)).collect(),
            expected: (0..4).map(|i| BACKGROUND[i] + pull(i) / precision(i)).collect(),
            sigma: (0..4).map(|i| precision(i).powf(-0.5)).collect(),
            at_background: seen.iter().all(|s| s.1 == BACKGROUND[s.0]),
        }
    }

    /// Multiples c_j of one row h = (1, 1, 0, 0)/√2, each seen as y_j with σ = 0.5.
    fn one_row(multiples: &[f64], values: &[f64]) -> Static {
        let h = 0.5_f64.sqrt();
        let along = h * (BACKGROUND[0] + BACKGROUND[1]);
        let weight = 4.0 * multiples.iter().map(|c| c * c).sum::<f64>();
        let pull = 4.0 * multiples.iter().zip(values).map(|(c, y)| c * (y - c * along)).sum::<f64>();
        let rows = multiples.iter().enumerate().filter(|(_, c)| **c != 0.0);
        let entries = rows.flat_map(|(row, c)| [(row, 0, c * h), (row, 1, c * h)]).collect();
        let rows: Vec<usize> = (0..multiples.len()).collect();
        let mut expected = BACKGROUND.to_vec();
        expected[..2].iter_mut().for_each(|x| *x += h * pull / (1.0 + weight));
        Static {
            operator: Some((multiples.len(), entries)),
            seen: vec![observation(&rows, 0, 0.0, values, 0.5)],
            expected,
            sigma: vec![(0.5 + 0.5 / (1.0 + weight)).sqrt(), (0.5 + 0.5 / (1.0 + weight)).sqrt(), 1.0, 1.0],
            at_background: weight == 0.0,
        }
    }

    fn set(&self) -> Result<ObservationSet> {
        let operator: Box<dyn varda_assimilation::ObservationOperator> = match &self.operator {
            Some((rows, entries)) => Box::new(LinearObservation::new(*rows, 4, entries)?),
            None => all_of(4)?,
        };
        Ok(ObservationSet::new(0, vec![operator], self.seen.clone())?)
    }
}

fn static_cases(rows: &mut Rows) {
    let squared = [("R = 1e-12", 1e-6), ("R = 1e12", 1e6)];
    let plain = [("σ_y/σ_b = 1e-8", 1e-8), ("σ_y/σ_b = 1e8", 1e8)];
    let sigmas = rows.grid("σ_y", squared.into_iter().chain(plain));
    let mut add = |name: &str, problem: Static| rows.case(name, |case| every_way(case, &problem));
    add("no observations", Static::direct(&[]));
    let all =
        |sigma: f64| Static::direct(&[(0, 3.0, sigma), (1, -3.0, sigma), (2, 0.5, sigma), (3, 1.0, sigma)]);
    for (name, sigma) in sigmas {
        add(name, all(sigma));
    }
    add("1000 identical observations", Static::direct(&[(0, 3.0, 2.0); 1000]));
    add("one observation of variance r/1000", Static::direct(&[(0, 3.0, 2.0 / 1000.0_f64.sqrt())]));
    add("σ ratios 1e8", Static::direct(&[(0, 3.0, 1e-4), (1, -3.0, 1.0), (2, 0.5, 1e4)]));
    add("contradictory observations", Static::direct(&[(0, 5.0, 1e-2), (0, -5.0, 1e-2), (2, 0.5, 0.1)]));
    add(
        "redundant rows of H",
        Static::one_row(&[1.0, 1.0, 2.0, 2.0, -1.0, 0.0], &[0.9, 1.1, 1.8, 2.2, -1.0, 7.0]),
    );
    add("H = 0", Static::one_row(&[0.0, 0.0, 0.0], &[1.0, -2.0, 3.0]));
    let zero: Vec<(usize, f64, f64)> = (0..4).map(|i| (i, BACKGROUND[i], 0.1)).collect();
    add("zero residual", Static::direct(&zero));
}

/// Every minimizer and method on a static problem.
fn every_way(case: &mut Case, problem: &Static) -> Outcome {
    let b = Diagonal::uniform(4, 1.0)?;
    let transform = ControlTransform::new(BACKGROUND.to_vec(), &b)?;
    let still = || Rk4::new(Linear(4, vec![0.0; 16]), 0, 0.1);
    let error_of = |v: &[f64]| {
        let mut z = vec![0.0; 4];
        transform.control(v, &mut z);
        (0..4)
            .map(|i| (z[i] - problem.expected[i]).abs() / problem.sigma[i])
            .fold(0.0, |m: f64, e| if e <= m { m } else { e })
    };
    let mut add = |name: &str, error: f64, ended: std::result::Result<(Status, usize), Error>| {
        judge(case, name, error, ended, problem.at_background);
    };

    for name in Minimizer::NAMES {
        let mut minimizer = Minimizer::named(name).ok_or("a name it lists")?;
        minimizer.stopping_mut().gradient_tolerance = 1e-12;
        let (mut set, mut model, mut v) = (problem.set()?, still(), vec![0.0; 4]);
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
        let ended = minimizer.minimize(&mut cost, &mut v, &mut go_on).map(|m| (m.status, m.outer_iterations));
        add(name, error_of(&v), ended);
    }
    for (name, inner) in [
        ("incremental", InnerSolver::Primal),
        ("4d-psas", InnerSolver::Dual),
        ("direct", InnerSolver::Direct),
    ] {
        let (mut set, mut model, mut v) = (problem.set()?, still(), vec![0.0; 4]);
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
        let options = OuterLoopOptions::default()
            .with_gradient_tolerance(1e-12)
            .with_inner(inner)
            .with_inner_tolerance(1e-12);
        let ended =
            outer_loop(&mut cost, &mut v, &options, &mut go_on).map(|m| (m.status, m.outer_iterations));
        add(name, error_of(&v), ended);
    }
    for (name, gain) in [("blue, observations", Gain::Observation), ("blue, information", Gain::Information)]
    {
        let (mut set, mut model) = (problem.set()?, still());
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
        match Blue::new(&mut cost, &[0.0; 4], gain) {
            Ok(blue) => add(name, error_of(&blue.control_variable), Ok((Status::Converged, 0))),
            Err(error) => add(name, f64::NAN, Err(error)),
        }
    }
    let mut default = Minimizer::default();
    default.stopping_mut().gradient_tolerance = 1e-12;
    let (mut set, mut v) = (problem.set()?, vec![0.0; 4]);
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set)?;
    let ended = default.minimize(&mut cost, &mut v, &mut go_on).map(|m| (m.status, m.outer_iterations));
    add("3dvar", error_of(&v), ended);

    let (mut set, mut model) = (problem.set()?, still());
    let mut cost = WeakForcing::new(&mut model, transform.clone(), &b, Forcing::every_step(4), &mut set)?;
    let mut v = vec![0.0; cost.dim()];
    let ended = default.minimize(&mut cost, &mut v, &mut go_on).map(|m| (m.status, m.outer_iterations));
    add("weak-forcing", error_of(&v[..4]), ended);

    let ensemble = Ensemble::new(&spanning(&b, &BACKGROUND), Localization::none(4))?;
    let of_ensemble = ControlTransform::new(BACKGROUND.to_vec(), &ensemble)?;
    let make = || -> Box<dyn Model + Send> { Box::new(still()) };
    let mut set = problem.set()?;
    let mut cost = EnVar::new(&make, BACKGROUND.to_vec(), &ensemble, &mut set, &[])?;
    let mut v = vec![0.0; cost.dim()];
    let options = EnVarOptions::default().with_max_outer(10).with_step_tolerance(1e-6);
    let ended = cost.minimize(&mut v, &options, &mut go_on).map(|m| (m.status, m.outer_iterations));
    let mut z = vec![0.0; 4];
    of_ensemble.control(&v, &mut z);
    let in_b: Vec<f64> = z.iter().zip(BACKGROUND).map(|(z, b)| z - b).collect();
    add("4denvar", error_of(&in_b), ended);
    Ok(())
}

/// One way's row: converged and right, or honest about it.
///
/// Right is a thousandth of the analysis' own standard deviation: gradients fall by 1e-12, of which a
/// condition of up to 1e8 may leave 1e-4 of a standard deviation.
fn judge(
    case: &mut Case,
    name: &str,
    error: f64,
    ended: std::result::Result<(Status, usize), Error>,
    at_background: bool,
) {
    match ended {
        Ok((Status::Converged, iterations)) => {
            case.at_most(&format!("{name}: error in σ of the analysis"), error, 1e-3, "σ")
                .because("gradients fall by 1e-12, of which a condition of up to 1e8 may leave 1e-4 σ")
                .work(Work { iterations: Some(iterations), ..Work::default() });
            // an ensemble and a closed form make their one step whatever they find
            if at_background && !["4denvar", "blue, observations", "blue, information"].contains(&name) {
                case.count(&format!("{name}: outer iterations"), iterations, 0);
            }
        }
        Ok((status, iterations)) => {
            let value = if MUST.contains(&name) { f64::NAN } else { 0.0 };
            case.at_most(&format!("{name}: says that it did not converge"), value, 0.0, "-")
                .note(format!("{status:?} after {iterations} outer iterations, error {error:.1e} σ"));
        }
        Err(error) => {
            let value = if MUST.contains(&name) { f64::NAN } else { 0.0 };
            let text = error.to_string();
            // step, observation, eigenvalue or field: an error says where
            let says = ["step ", "observation ", "eigenvalue ", " = "].iter().any(|word| text.contains(word));
            let value = if says { value } else { f64::NAN };
            case.at_most(&format!("{name}: an error that says where"), value, 0.0, "-").note(text);
        }
    }
}

/// J = ¼v₀⁴ − ½v₀² + ½v₁²: two wells at v₀ = ±1, J = −¼, a saddle at the origin. Its
/// "Gauss–Newton" products are those of the true Hessian, which is indefinite between the wells.
struct Wells {
    base: [f64; 2],
    terms: CostTerms,
}

impl CostFunction for Wells {
    fn dim(&self) -> usize {
        2
    }
    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> std::result::Result<f64, Error> {
        let value = 0.25 * v[0].powi(4) - 0.5 * v[0] * v[0] + 0.5 * v[1] * v[1];
        if let Some(g) = gradient {
            (g[0], g[1]) = (v[0].powi(3) - v[0], v[1]);
            self.base = [v[0], v[1]];
        }
        self.terms = CostTerms { background: value, ..CostTerms::default() };
        Ok(value)
    }
    fn terms(&self) -> CostTerms {
        self.terms
    }
    fn set_observation_scale(&mut self, _scale: f64) {}
    fn counts(&self) -> Counts {
        Counts::default()
    }
}

impl LeastSquares for Wells {
    fn background_dim(&self) -> usize {
        self.dim()
    }

    fn observation_dim(&self) -> usize {
        0
    }
    /// No sum of squares: products alone are asked for by the minimizers of this test.
    fn departures(&self, b: &mut [f64], _d: &mut [f64]) {
        b.copy_from_slice(&self.base);
    }
    fn jacobian(&mut self, _dv: &[f64], _dy: &mut [f64]) -> std::result::Result<(), Error> {
        Ok(())
    }
    fn jacobian_transpose(&mut self, _dy: &[f64], dv: &mut [f64]) -> std::result::Result<(), Error> {
        dv.fill(0.0);
        Ok(())
    }
    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> std::result::Result<(), Error> {
        (out[0], out[1]) = ((3.0 * self.base[0].powi(2) - 1.0) * dv[0], dv[1]);
        Ok(())
    }
    fn hessian(&mut self, out: &mut [f64]) -> std::result::Result<(), Error> {
        out.copy_from_slice(&[3.0 * self.base[0].powi(2) - 1.0, 0.0, 0.0, 1.0]);
        Ok(())
    }
}

/// A user's cost between its wells: down into one, or a status or an error that says why not; never a saddle
/// called a minimum.
fn indefinite(case: &mut Case) -> Outcome {
    for name in Minimizer::NAMES {
        let minimizer = Minimizer::named(name).ok_or("a name it lists")?;
        let mut cost = Wells { base: [0.0; 2], terms: CostTerms::default() };
        let mut v = [0.1, 1.0];
        match minimizer.minimize(&mut cost, &mut v, &mut go_on) {
            Ok(minimum) if minimum.status == Status::Converged => {
                // |∇J| fell to 1e-6 at the least, and the wells have curvature 2; full-step Newton goes to
                // the saddle, as it must
                if *name == "newton" {
                    let stationary = (v[0].powi(3) - v[0]).hypot(v[1]);
                    case.at_most("newton: gradient (any stationary point)", stationary, 1e-5, "-")
                        .because("|∇J| fell to 1e-6 of the first at the least")
                        .note(format!("v = {v:?}"));
                } else {
                    case.at_most(
                        &format!("{name}: distance from a well"),
                        (v[0].abs() - 1.0).hypot(v[1]),
                        1e-4,
                        "-",
                    )
                    .because(
                        "|∇J| fell to 1e-6 of the first at the least, and the wells have curvature 2 and 1",
                    );
                }
            }
            Ok(minimum) => {
                case.at_most(&format!("{name}: says that it did not converge"), 0.0, 0.0, "-")
                    .note(format!("{:?}, v = {v:?}", minimum.status));
            }
            Err(error) => {
                refused(case, &format!("{name}: an error that says where"), Err::<(), _>(error), " = ");
            }
        }
    }
    let mut cost = Wells { base: [0.0; 2], terms: CostTerms::default() };
    cost.evaluate(&[0.1, 1.0], Some(&mut [0.0; 2]))?;
    refused(
        case,
        "posterior there refused, with the eigenvalue",
        Posterior::new(&mut cost),
        "not positive definite",
    );
    Ok(())
}

#[derive(Clone, Copy, PartialEq)]
enum Failure {
    Refuses,
    NotANumber,
}

/// x_{k+1} = x_k, but not where x₀ exceeds 3.
struct Brittle {
    failure: Failure,
}

impl Model for Brittle {
    fn dim(&self) -> usize {
        2
    }
    fn step(
        &mut self,
        k: usize,
        x: &[f64],
        x_next: &mut [f64],
    ) -> std::result::Result<varda_implicit::Work, varda_implicit::Error> {
        x_next.copy_from_slice(x);
        if x[0].abs() > 3.0 {
            match self.failure {
                Failure::Refuses => {
                    return Err(varda_implicit::Error::NonFinite { step: k, what: "x_{k+1}" });
                }
                Failure::NotANumber => x_next.fill(f64::NAN),
            }
        }
        Ok(varda_implicit::Work::default())
    }
    fn linearize(
        &mut self,
        _slot: usize,
        _k: usize,
        _x: &[f64],
        _x_next: &[f64],
    ) -> std::result::Result<varda_implicit::Work, varda_implicit::Error> {
        Ok(varda_implicit::Work::default())
    }
    fn tangent(&mut self, _k: usize, _dx: &mut [f64]) {}
    fn adjoint(&mut self, _k: usize, _lambda: &mut [f64]) {}
    fn release(&mut self, _from_slot: usize) {}
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

/// x₀² seen at step 2 as 1 from a background of 0.1: the first Gauss–Newton step goes to 5, where the
/// model fails.
fn failing(case: &mut Case, failure: Failure) -> Outcome {
    let b = Diagonal::uniform(2, 10.0)?;
    let set = || {
        ObservationSet::new(
            3,
            vec![Box::new(problems::small_problems::Products { state_dim: 2 })],
            vec![observation(&[0], 2, 0.0, &[1.0], 0.01)],
        )
    };
    // minimize ½((x − 0.1)/10)² + ½((x² − 1)/0.01)² near 1: x = 1 − (0.9/100)(1e-4)/4 to first
    // order
    let expected = 1.0 - 0.9e-2 * 1e-4 / 4.0;
    let transform = ControlTransform::new(vec![0.1, 0.5], &b)?;
    for name in Minimizer::NAMES {
        let minimizer = Minimizer::named(name).ok_or("a name it lists")?;
        let (mut model, mut seen, mut v) = (Brittle { failure }, set()?, [0.0; 2]);
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut seen)?;
        let ended = minimizer.minimize(&mut cost, &mut v, &mut go_on).map(|m| (m.status, m.outer_iterations));
        let error = (0.1 + 10.0 * v[0]).abs() - expected;
        // full-step Newton has no safeguard: `Failed` is its answer
        if *name == "newton" {
            let said = matches!(ended, Ok((status, _)) if status != Status::Converged) || ended.is_err();
            case.at_most("newton: says that the model failed", if said { 0.0 } else { f64::NAN }, 0.0, "-");
        } else {
            judge(case, name, error.abs() / 0.005, ended, false);
        }
    }
    for (name, inner) in [
        ("incremental", InnerSolver::Primal),
        ("4d-psas", InnerSolver::Dual),
        ("direct", InnerSolver::Direct),
    ] {
        let (mut model, mut seen, mut v) = (Brittle { failure }, set()?, [0.0; 2]);
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut seen)?;
        let options = OuterLoopOptions::default().with_inner(inner);
        let ended =
            outer_loop(&mut cost, &mut v, &options, &mut go_on).map(|m| (m.status, m.outer_iterations));
        judge(case, name, ((0.1 + 10.0 * v[0]).abs() - expected).abs() / 0.005, ended, false);
    }
    // a background at which it fails is an error at once, whatever the minimizer
    let beyond = ControlTransform::new(vec![5.0, 0.5], &b)?;
    for name in Minimizer::NAMES {
        let minimizer = Minimizer::named(name).ok_or("a name it lists")?;
        let (mut model, mut seen, mut v) = (Brittle { failure }, set()?, [0.0; 2]);
        let mut cost = StrongConstraint::new(&mut model, beyond.clone(), &mut seen)?;
        let ended = minimizer.minimize(&mut cost, &mut v, &mut go_on);
        refused(
            case,
            &format!("{name}: background at which the model fails, naming the step"),
            ended,
            "step",
        );
    }
    Ok(())
}
