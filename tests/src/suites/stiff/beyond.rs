//! Beyond the list: absurd numbers, empty and tiny problems, through the public interface alone.
//!
//! What is refused must say where; what is answered must be right. Each of those marked "found" once ended in
//! a NaN, a wrong answer or a panic.

use super::common::{condition, refused};
use super::rod_shapes::{DOWN, SILICONE, fixed_clamp, held, section, weight};
use crate::row::{Case, Outcome, Rows, Work};
use problems::small_problems::{Linear, all_of, observation};
use std::ops::ControlFlow;
use std::sync::Arc;
use varda_assimilation::{
    ControlTransform, CostFunction, Minimizer, Observation, ObservationSet, Posterior, Status,
    StrongConstraint,
};
use varda_covariance::{
    Banded, Covariance, CovarianceFunction, Dense, Diagonal, Ensemble, Kernel, Localization, Precision,
    Taper, Truncated,
};
use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{ImplicitModel, Keep, Model, Rk4, Scheme, Structure, Trajectory};
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Marker, Markers, Material, Rod, RodStep, Section, Supports,
    TwistUnknowns, straight_guess,
};

pub(super) fn run(rows: &mut Rows) {
    rod_numbers(rows);
    covariances(rows);
    windows(rows);
}

const SCHEMES: [(&str, Scheme); 3] =
    [("backward Euler", Scheme::BackwardEuler), ("midpoint", Scheme::Midpoint), ("BDF2", Scheme::Bdf2)];

/// Ten segments hanging from a clamp, angles kept; three steps there and their adjoint back. The last state,
/// and the adjoint of ones.
fn there_and_back(
    section: &Section,
    (loads, damping): (Loads, Damping),
    (dt, scheme): (f64, Scheme),
    change: &dyn Fn(&mut [f64]),
) -> Result<(Vec<f64>, Vec<f64>), Box<dyn std::error::Error>> {
    let rod = Rod::uniform(1.0, 10, section)?;
    let supports = Supports::clamped_start(fixed_clamp());
    let step = RodStep::with_twist(rod, supports, loads, damping, TwistUnknowns::Always)?;
    let mut model = ImplicitModel::new(step.with_scheme(scheme), 0, dt);
    let mut z: Vec<f64> = (2..=10).flat_map(|v| [0.0, 0.0, -0.1 * v as f64]).collect();
    z.resize(model.control_dim(), 0.0);
    change(&mut z);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &x, 3, Keep::Linearizations)?;
    let mut lambda = vec![1.0; x.len()];
    trajectory.adjoint(&mut model, &mut lambda, &mut |_, _, _| {})?;
    x.copy_from_slice(trajectory.state(3));
    Ok((x, lambda))
}

fn wild(values: &[f64]) -> usize {
    values.iter().filter(|v| !v.is_finite()).count()
}

fn rod_numbers(rows: &mut Rows) {
    let round = |youngs_modulus: f64, density: f64| {
        Section::circle(&Material { youngs_modulus, shear_modulus: youngs_modulus / 3.0, density }, 0.01)
    };
    let usual = || (weight(), Damping::default());
    let pulled = |g: f64| (Loads { gravity: [0.0, 0.0, g].into(), ..Loads::default() }, Damping::default());
    let damped = |stiffness: f64, mass: f64| (weight(), Damping { stiffness, mass });
    for (name, scheme) in SCHEMES {
        rows.case(&format!("absurd numbers, {name}"), |case| {
            let still = |_: &mut [f64]| {};
            let place = |value: f64| move |z: &mut [f64]| z[4] = value;
            let velocity = |value: f64| move |z: &mut [f64]| z[z.len() - 3] = value;
            let by = (0.01, scheme);
            // (what, the attempt, what its error names)
            let plain = section();
            for (what, attempt, names) in [
                ("step of 1e-300 s", there_and_back(&plain, usual(), (1e-300, scheme), &still), "step 0"),
                ("gravity of 1e300", there_and_back(&plain, pulled(-1e300), by, &still), "step 0"),
                ("gravity NaN", there_and_back(&plain, pulled(f64::NAN), by, &still), "gravity"),
                ("place NaN", there_and_back(&plain, usual(), by, &place(f64::NAN)), "edge 2"),
                ("place of 1e160 m", there_and_back(&plain, usual(), by, &place(1e160)), "edge 2"),
                ("velocity NaN", there_and_back(&plain, usual(), by, &velocity(f64::NAN)), "initial state"),
                ("velocity of 1e300 m/s", there_and_back(&plain, usual(), by, &velocity(1e300)), "step 0"),
                (
                    "negative damping",
                    there_and_back(&plain, damped(-1.0, 0.0), by, &still),
                    "damping.stiffness",
                ),
                ("damping NaN", there_and_back(&plain, damped(0.0, f64::NAN), by, &still), "damping.mass"),
                ("damping of 1e300 s", there_and_back(&plain, damped(1e300, 0.0), by, &still), "step 0"),
                ("negative E", there_and_back(&round(-1e6, 1100.0), usual(), by, &still), "section EA"),
                (
                    "density NaN",
                    there_and_back(&round(1e6, f64::NAN), usual(), by, &still),
                    "mass per length",
                ),
                // found: pivots below 1e-308, whose inverse overflows, gave adjoints that are NaN
                ("E = 1e-300 Pa", there_and_back(&round(1e-300, 1100.0), usual(), by, &still), "step 0"),
                ("E = 1e200 Pa", there_and_back(&round(1e200, 1100.0), usual(), by, &still), "EI"),
            ] {
                refused(case, &format!("{what}: refused by name"), attempt, names);
            }
            // huge steps end in statics: z of the tip by the weight below every edge
            let rod = Rod::uniform(1.0, 10, &section())?;
            let below = |e: usize| rod.masses[e + 1..].iter().sum::<f64>();
            // the clamp holds the first edge at its rest length
            let tip: f64 = -0.1 - (1..10).map(|e| 0.1 * (1.0 + 9.81 * below(e) / rod.ea[e])).sum::<f64>();
            if scheme == Scheme::BackwardEuler {
                for dt in [1e6, 1e30, 1e300] {
                    let (x, lambda) = there_and_back(&section(), usual(), (dt, scheme), &still)?;
                    let what = format!("steps of {dt:e} s: error of the tip");
                    case.at_most(&what, (x[26] - tip).abs(), 1e-11, "m")
                        .because("a step without inertia is statics, solved to 1e-11 L");
                    case.count(
                        "numbers of state and adjoint that are not finite",
                        wild(&x) + wild(&lambda),
                        0,
                    );
                }
            }
            let (x, lambda) = there_and_back(&section(), pulled(0.0), (0.01, scheme), &still)?;
            let moved = (0..9).map(|f| (x[3 * f + 2] + 0.1 * (f + 2) as f64).abs()).fold(0.0, f64::max);
            case.at_most("no gravity: moved", moved, 1e-14, "m").because("at rest: roundings of 1 m");
            case.count("numbers of state and adjoint that are not finite", wild(&x) + wild(&lambda), 0);
            for (what, section) in
                [("E = 1e100 Pa", round(1e100, 1100.0)), ("density of 1e-100", round(1e6, 1e-100))]
            {
                let (x, lambda) = there_and_back(&section, usual(), (0.01, scheme), &still)?;
                let numbers = wild(&x) + wild(&lambda);
                case.count(&format!("{what}: numbers that are not finite"), numbers, 0);
            }
            Ok(())
        });
    }
    rows.case("absurd descriptions of a rod", |case| {
        let build = |supports: Supports, loads: Loads| {
            RodStep::new(Rod::uniform(1.0, 3, &section())?, supports, loads, Damping::default()).map(|_| ())
        };
        let force = |s: f64| Loads { point_forces: vec![(s, Arc::new([0.0; 3]))], ..Loads::default() };
        let clamp = Supports::clamped_start(fixed_clamp());
        let twice = Supports { prescribed: vec![held(1, [0.0; 3])], ..clamp.clone() };
        let beyond = Supports { prescribed: vec![held(99, [0.0; 3])], ..Supports::default() };
        refused(case, "no segments", Rod::uniform(1.0, 0, &section()), "segments");
        refused(case, "length NaN", Rod::uniform(f64::NAN, 3, &section()), "rod length");
        refused(case, "vertex 1 held twice", build(twice, Loads::default()), "vertex 1");
        refused(case, "vertex 99 of 3 held", build(beyond.clone(), Loads::default()), "vertex 99");
        refused(case, "force beyond the end", build(clamp.clone(), force(1.5)), "point force");
        refused(case, "force at NaN", build(clamp.clone(), force(f64::NAN)), "point force");
        let rod = Rod::uniform(1.0, 3, &section())?;
        let step = RodStep::new(rod.clone(), clamp.clone(), Loads::default(), Damping::default())?;
        refused(
            case,
            "marker at NaN",
            Markers::new(&step, &[Marker { s: f64::NAN, offset: [0.0; 3].into() }]),
            "marker",
        );
        let aside = Marker { s: 0.5, offset: [f64::NAN; 3].into() };
        refused(case, "marker aside by NaN", Markers::new(&step, &[aside]), "marker 0");
        // found: a direction whose length overflows gave all vertices at one place
        let free = Supports::default();
        let guess = |direction| straight_guess(&rod, &free, 0.0, direction);
        refused(case, "guess along zero", guess([0.0; 3]), "direction");
        refused(case, "guess along 1e300", guess([1e300, 0.0, 0.0]), "direction");
        // found: an index out of bounds
        refused(case, "guess from vertex 99 of 3", straight_guess(&rod, &beyond, 0.0, DOWN), "vertex 99");
        for (what, clamp, names) in [
            (
                "clamp without tangent",
                Clamp::new(ClampAt::Edge, [0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]),
                "tangent",
            ),
            ("director along the tangent", Clamp::new(ClampAt::Edge, [0.0; 3], DOWN, DOWN), "director"),
            ("clamp at NaN", Clamp::new(ClampAt::Edge, [f64::NAN; 3], DOWN, [1.0, 0.0, 0.0]), "position"),
        ] {
            let supports = Supports::clamped_start(clamp);
            refused(case, what, straight_guess(&rod, &supports, 0.0, DOWN), names);
        }
        Ok(())
    });
    rows.case("clamp that is not a number from step 1 on", |case| {
        let position = |t: f64| if t < 0.015 { [0.0; 3] } else { [f64::NAN; 3] };
        let clamp = Clamp::new(ClampAt::Edge, position, DOWN, [1.0, 0.0, 0.0]);
        let rod = Rod::uniform(1.0, 5, &Section::circle(&SILICONE, 0.01))?;
        let step = RodStep::new(rod, Supports::clamped_start(clamp), weight(), Damping::default())?;
        let mut model = ImplicitModel::new(step, 0, 0.01);
        let z: Vec<f64> = (2..=5).flat_map(|v| [0.0, 0.0, -0.2 * v as f64]).chain([0.0; 12]).collect();
        let mut next = z.clone();
        model.step(0, &z, &mut next)?;
        let again = next.clone();
        refused(
            case,
            "refused, naming step and support",
            model.step(1, &again, &mut next),
            "step 1: a clamp's position",
        );
        Ok(())
    });
    rows.case("pivots whose inverse overflows", |case| {
        // found: factored without a word, solutions infinite
        for structure in [Structure::SymmetricBand { half_bandwidth: 0 }, Structure::Dense] {
            let kind = if matches!(structure, Structure::Dense) { "dense" } else { "band" };
            for (value, usable) in [(1e-310, false), (3e-308, true)] {
                let found = condition(1, &structure, &[value]);
                let expected = if usable { 1.0 } else { f64::INFINITY };
                let off = if found == expected { 0.0 } else { (found - expected).abs() };
                case.at_most(&format!("{kind} {value:e}: condition, or refused"), off, 1e-15, "-")
                    .because("one division and one product");
            }
        }
        Ok(())
    });
}

fn covariances(rows: &mut Rows) {
    rows.case("absurd covariances", |case| {
        let f = |sigma: f64, length: f64, support: f64| CovarianceFunction {
            sigma,
            kernel: Kernel::Gaussian { length },
            taper: Taper::GaspariCohn { support },
        };
        let places = [0.0, 0.4, 0.9];
        for (what, function, names) in [
            ("σ = 0", f(0.0, 1.0, 1.0), "standard deviation"),
            ("σ NaN", f(f64::NAN, 1.0, 1.0), "standard deviation"),
            ("σ² overflows", f(1e200, 1.0, 1.0), "entry (0, 0)"),
            ("σ² underflows", f(1e-200, 1.0, 1.0), "pivot 0"),
            ("length 0", f(1.0, 0.0, 1.0), "correlation length"),
            ("infinite length", f(1.0, f64::INFINITY, 1.0), "correlation length"),
            ("support NaN", f(1.0, 1.0, f64::NAN), "support"),
        ] {
            refused(
                case,
                &format!("{what}: band, refused by name"),
                Banded::along(&function, &places),
                names,
            );
            let dense = function.matrix(&places).and_then(|matrix| Dense::new(3, &matrix));
            refused(case, &format!("{what}: dense, refused by name"), dense, names);
        }
        let tiny = f(1.0, 1e-310, 1.0);
        let mut y = [0.0; 3];
        Banded::along(&tiny, &places)?.solve(&[1.0, 2.0, 3.0], &mut y);
        let off = y.iter().zip([1.0, 2.0, 3.0]).map(|(y, x)| (y - x).abs()).fold(0.0, f64::max);
        case.at_most("length 1e-310: B⁻¹ x − x", off, 0.0, "-");
        refused(case, "places that descend", Banded::along(&tiny, &[1.0, 0.0]), "place along the line");
        refused(case, "place NaN", Banded::along(&tiny, &[0.0, f64::NAN]), "place along the line");
        refused(case, "no places", Banded::along(&tiny, &[]), "0 values");
        refused(case, "truncation NaN", Truncated::eigen(1, &[1.0], f64::NAN), "truncation tolerance");
        // found: B⁻¹ x of a subnormal B was NaN, B x of huge members infinite
        refused(case, "subnormal variance", Dense::new(1, &[1e-310]), "pivot 0");
        let members = [1e300, 2.0, -1e300, 2.0];
        refused(
            case,
            "members whose variance overflows",
            Ensemble::new(&members, Localization::none(2)),
            "entry (0, 0)",
        );
        refused(case, "one member", Ensemble::new(&[1.0, 2.0], Localization::none(2)), "an ensemble");
        let same = Ensemble::new(&[1.0, 2.0, 1.0, 2.0], Localization::none(2))?;
        let mut y = [9.0; 2];
        same.apply(&[1.0, 1.0], &mut y);
        case.at_most("identical members: B x", y[0].abs().max(y[1].abs()), 0.0, "-");
        Ok(())
    });
}

/// ẋ = −x over steps of 0.1 by RK4: x_{k+1} = DECAY x_k.
const DECAY: f64 = 1.0 - 0.1 + 0.1 * 0.1 / 2.0 - 1e-3 / 6.0 + 1e-4 / 24.0;

/// Minimizers that must get there; the others may say that they did not.
const MUST: [&str; 4] = ["auto", "trust-region", "gauss-newton-cg", "newton"];

fn windows(rows: &mut Rows) {
    let seen = |step: usize, y: f64, sigma: f64| observation(&[0], step, 0.0, &[y], sigma);
    rows.case("one state, one step, seen at both ends", |case| {
        let expected = (2.0 + DECAY) * 4.0 / (1.0 + 4.0 * (1.0 + DECAY * DECAY));
        one_state(case, 1, &[seen(0, 2.0, 0.5), seen(1, 1.0, 0.5)], 1.0, Ok(expected))
    });
    rows.case("one state, a window of no steps", |case| {
        one_state(case, 0, &[seen(0, 2.0, 0.5)], 1.0, Ok(1.6))
    });
    rows.case("one state, an observation without rows", |case| {
        one_state(case, 1, &[observation(&[], 1, 0.0, &[], 1.0)], 1.0, Ok(0.0))
    });
    rows.case("one state, σ_y = 1e300", |case| one_state(case, 1, &[seen(1, 2.0, 1e300)], 1.0, Ok(0.0)));
    rows.case("one state, subnormal observation", |case| {
        one_state(case, 1, &[seen(1, 5e-324, 1.0)], 1.0, Ok(0.0))
    });
    rows.case("one state, σ_b = 1e-150", |case| {
        one_state(case, 1, &[seen(1, 2.0, 0.5)], 1e-150, Ok(8.0 * DECAY * 1e-300))
    });
    // found: gradients whose norm overflows passed for converged, at a J of 1e297
    rows.case("one state, σ_b = 1e150", |case| {
        one_state(case, 1, &[seen(1, 2.0, 0.5)], 1e150, Ok(2.0 / DECAY))
    });
    rows.case("one state, first gradient beyond 1e154", |case| {
        one_state(case, 1, &[seen(1, 2.0, 1e-4)], 1e150, Err("the norm of the gradient"))
    });
    let far = "step 1: the cost is not finite";
    rows.case("one state, σ_y = 1e-200", |case| one_state(case, 1, &[seen(1, 2.0, 1e-200)], 1.0, Err(far)));
    rows.case("one state, observation of 1e300", |case| {
        one_state(case, 1, &[seen(1, 1e300, 1.0)], 1.0, Err(far))
    });
    rows.case("sets of observations", |case| {
        let set =
            |steps, o: Observation| ObservationSet::new(steps, vec![all_of(1).expect("one row")], vec![o]);
        let between = observation(&[0], 1, 0.5, &[1.0], 1.0);
        refused(case, "between the last step and the next", set(1, between), "observation 0: step 1");
        refused(case, "beyond the window", set(1, seen(2, 1.0, 1.0)), "observation 0: step 2");
        refused(
            case,
            "at the last step there can be",
            set(1, seen(usize::MAX, 1.0, 1.0)),
            "observation 0: step",
        );
        refused(case, "value NaN", set(1, seen(1, f64::NAN, 1.0)), "observation 0, entry 0");
        refused(case, "σ = 0", set(1, seen(1, 1.0, 0.0)), "observation 0, entry 0");
        // found: an overflow
        let longest = set(usize::MAX, seen(1, 1.0, 1.0))?;
        case.count("window of all steps there can be: rows", longest.dim(), 1);
        Ok(())
    });
    rows.case("settings of minimizers", |case| {
        for name in Minimizer::NAMES {
            for tolerance in [f64::NAN, -1.0, f64::INFINITY, 2.0] {
                let ended = minimized(name, 1, &[seen(1, 2.0, 0.5)], 1.0, &mut |m| {
                    m.stopping_mut().gradient_tolerance = tolerance
                });
                refused(case, &format!("{name}: tolerance {tolerance}"), ended, "gradient_tolerance");
            }
            let none =
                minimized(name, 1, &[seen(1, 2.0, 0.5)], 1.0, &mut |m| m.stopping_mut().max_iterations = 0)?;
            let said = if none.0 == Status::MaxIterations { 0.0 } else { f64::NAN };
            case.at_most(&format!("{name}: no iterations, and says so"), said, 0.0, "-");
        }
        Ok(())
    });
    rows.case("posterior of nothing seen", |case| {
        let b = Diagonal::uniform(1, 2.0)?;
        let mut set = ObservationSet::new(1, vec![all_of(1)?], Vec::new())?;
        let mut model = Rk4::new(Linear(1, vec![-1.0]), 0, 0.1);
        let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(vec![0.0], &b)?, &mut set)?;
        cost.evaluate(&[0.0], Some(&mut [0.0]))?;
        let variance = Posterior::new(&mut cost)?.control_variable_variance()[0];
        case.at_most("variance − 1", (variance - 1.0).abs(), 0.0, "-");
        Ok(())
    });
    rows.case("models that run away", |case| {
        let mut lorenz = Rk4::new(Lorenz63::default(), 0, 0.01);
        let away = lorenz.step(5, &[1e200, 1.0, 1e200], &mut [0.0; 3]);
        refused(case, "Lorenz-63 from 1e200, naming the step", away, "step 5");
        let b = Diagonal::uniform(1, 1.0)?;
        let mut set = ObservationSet::new(400, vec![all_of(1)?], vec![seen(400, 1.0, 1.0)])?;
        let mut model = Rk4::new(Linear(1, vec![30.0]), 0, 0.1);
        let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(vec![1.0], &b)?, &mut set)?;
        refused(case, "growth by 16 a step, naming the step", cost.evaluate(&[0.0], None), "step 252");
        Ok(())
    });
}

fn minimized(
    name: &str,
    steps: usize,
    seen: &[Observation],
    sigma: f64,
    set_up: &mut dyn FnMut(&mut Minimizer),
) -> Result<(Status, usize, f64), varda_assimilation::Error> {
    let b = Diagonal::uniform(1, sigma)?;
    let operator = all_of(1).expect("one row of one");
    let mut set = ObservationSet::new(steps, vec![operator], seen.to_vec())?;
    let mut model = Rk4::new(Linear(1, vec![-1.0]), 0, 0.1);
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(vec![0.0], &b)?, &mut set)?;
    let mut minimizer = Minimizer::named(name).expect("a name it lists");
    set_up(&mut minimizer);
    let mut v = [0.0];
    let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    Ok((minimum.status, minimum.outer_iterations, sigma * v[0]))
}

/// Every minimizer on x_b = 0 with one state: the analysis expected, or the error.
fn one_state(
    case: &mut Case,
    steps: usize,
    seen: &[Observation],
    sigma: f64,
    expected: Result<f64, &str>,
) -> Outcome {
    for name in Minimizer::NAMES {
        // with the usual floor of the gradient a gain of 1e-150 standard deviations is none
        let without_floor = &mut |minimizer: &mut Minimizer| {
            let stopping = minimizer.stopping().with_gradient_floor(0.0);
            *minimizer = minimizer.clone().with_stopping(stopping);
        };
        match (minimized(name, steps, seen, sigma, without_floor), expected) {
            (Ok((Status::Converged, iterations, x)), Ok(expected)) => {
                let error = if x == expected { 0.0 } else { (x / expected - 1.0).abs() };
                // nothing seen of a size that matters: the background, where the right answer has no digits
                let error = if expected == 0.0 { x.abs() } else { error };
                case.at_most(&format!("{name}: relative error of the analysis"), error, 1e-6, "-")
                    .because("gradients fall to 1e-6 of the first at the least, the Hessian being one number")
                    .work(Work { iterations: Some(iterations), ..Work::default() });
            }
            (Ok((status, iterations, x)), Ok(_)) => {
                let value = if MUST.contains(name) { f64::NAN } else { 0.0 };
                case.at_most(&format!("{name}: says that it did not converge"), value, 0.0, "-")
                    .note(format!("{status:?} after {iterations} outer iterations at {x:e}"));
            }
            (ended, Err(names)) => refused(case, &format!("{name}: refused by name"), ended, names),
            (Err(error), Ok(_)) => return Err(error.into()),
        }
    }
    Ok(())
}
