//! Dot products: every adjoint is the transpose of its tangent.

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use problems::costs::for_each_cost;
use problems::methods::{Assembled, for_each_method};
use problems::rods::{HangingRod, rod_scale, rods, wave};
use varda_assimilation::LeastSquares;
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{ControlMap, Error, ImplicitModel, Keep, Model, OneLeg, Rk4, Trajectory, Work, check};

/// Reason of the bound of every dot product.
const ROUNDING: &str =
    "50 ε times the condition of the product: a few roundings for every number that enters";

/// Reason of the bound of assembled costs.
const OF_STEPS: &str =
    "50 ε times the condition of the product a step; over 100 steps they add up as a random walk does";
/// ε of a product, and of one with a window of 100 steps.
const OF_PRODUCT: f64 = 50.0;
const OF_WINDOW: f64 = 500.0;

/// Reason of the bound of the flagship's dot product.
const WINDOW: &str = "100 steps of condition up to 50, 50 ε each: 1e-12 holds every sweep to its rounding";

/// Steps of the short windows.
const STEPS: usize = 8;

pub(super) fn run(_options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("adjoint");
    rows.case("flagship window", flagship);
    match rods() {
        Ok(rods) => {
            for mut rod in rods {
                rows.case(rod.name, |case| {
                    let scale = rod_scale(rod.model.step_ref());
                    let mut x = vec![0.0; rod.model.dim()];
                    rod.model.initial_state(&rod.control, &mut x)?;
                    initial_map(case, &mut rod.model, &scale)?;
                    model_rows(case, &mut rod.model, &x, &scale)
                });
            }
        }
        Err(error) => rows.case("rods", |_| Err(error)),
    }
    let x63 = [1.2, -0.7, 10.3];
    let x96: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * wave(i, 0)).collect();
    let mut ordinary = |name: &str, model: &mut dyn Model, x: &[f64]| {
        rows.case(name, |case| model_rows(case, model, x, &vec![1.0; x.len()]));
    };
    ordinary("lorenz63 rk4", &mut Rk4::new(Lorenz63::default(), 0, 0.01), &x63);
    ordinary("lorenz96 rk4", &mut Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125), &x96);
    let euler = OneLeg::implicit_euler(Lorenz63::default(), 1e-13);
    ordinary("lorenz63 implicit euler", &mut ImplicitModel::new(euler, 0, 0.01), &x63);
    let midpoint = OneLeg::implicit_midpoint(Lorenz96::new(40, 8.0), 1e-13);
    ordinary("lorenz96 implicit midpoint", &mut ImplicitModel::new(midpoint, 0, 0.0125), &x96);

    // The whole chain B^{1/2}, initial state, window, observations on and between steps.
    let outcome = for_each_cost(&mut |name, cost| {
        rows.case(name, |case| assembled(case, cost));
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("assembled costs", |_| Err(error));
    }
    let outcome = for_each_method(&mut |name, origin, cost| {
        rows.case(name, |case| match cost {
            Assembled::Products(cost) => assembled(case, cost),
            Assembled::Increments(cost) => increments(case, origin, cost),
        });
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("methods", |_| Err(error));
    }
    rows.case("guard", guard);
    rows.finish()
}

fn flagship(case: &mut Case) -> Outcome {
    let (rod, truth) = HangingRod::flagship(2, true)?;
    let mut model = rod.model(rod.first_step)?;
    let scale = rod_scale(model.step_ref());
    let test = check::window(&mut model, &truth, rod.steps, &scale, 1)?;
    let note = format!("condition {:.1e}", test.condition);
    case.at_most("dot product", test.value, 1e-12, "-").computed(test.forward).note(note).because(WINDOW);
    Ok(())
}

/// One step in every respect but its Taylor slope (suite taylor), then a short window.
fn model_rows(case: &mut Case, model: &mut dyn Model, x: &[f64], scale: &[f64]) -> Outcome {
    for outcome in check::conformance(model, 2, x, scale, 3)? {
        if !outcome.what.contains("Taylor") {
            case.at_most(&outcome.what, outcome.value, outcome.bound, "-").because(ROUNDING);
        }
    }
    Trajectory::new().run(model, x, STEPS, Keep::Linearizations)?;
    let test = check::dot_product(model, 0..STEPS, scale, 5)?;
    let note = format!("condition {:.1e}", test.condition);
    case.at_most("window: dot product", test.value, test.bound, "-")
        .computed(test.forward)
        .note(note)
        .because(ROUNDING);
    Ok(())
}

/// ∂x₀/∂z: for a rod with twist, θ₀(X₀) with its transpose. In units of `scale`.
fn initial_map(case: &mut Case, model: &mut dyn Model, scale: &[f64]) -> Outcome {
    let (n, m) = (model.control_dim(), model.dim());
    let scaled = |v: &[f64]| v.iter().zip(scale).map(|(v, s)| v * s).collect::<Vec<_>>();
    let unscaled = |v: &mut [f64]| v.iter_mut().zip(scale).for_each(|(v, s)| *v /= s);
    // Both maps borrow the model, one after the other.
    let model = std::cell::RefCell::new(model);
    let mut forward = |dz: &[f64], dx: &mut [f64]| {
        model.borrow_mut().initial_tangent(&scaled(dz), dx);
        unscaled(dx);
        Ok(())
    };
    let mut backward = |lambda: &[f64], dz: &mut [f64]| {
        let lambda: Vec<f64> = lambda.iter().zip(scale).map(|(l, s)| l / s).collect();
        model.borrow_mut().initial_adjoint(&lambda, dz);
        dz.iter_mut().zip(scale).for_each(|(z, s)| *z *= s);
        Ok(())
    };
    dot_product_row(case, ("initial state: dot product", OF_PRODUCT), [n, m], &mut forward, &mut backward)
}

/// G and Gᵀ of an assembled cost, at two successive controls.
fn assembled(case: &mut Case, cost: &mut dyn LeastSquares) -> Outcome {
    let (n, m) = (cost.dim(), cost.observation_dim());
    for (what, size) in AT {
        let v: Vec<f64> = (0..n).map(|i| size * wave(i, 11)).collect();
        cost.evaluate(&v, Some(&mut vec![0.0; n]))?;
        let cost = std::cell::RefCell::new(&mut *cost);
        let mut forward = |dv: &[f64], dy: &mut [f64]| Ok(cost.borrow_mut().jacobian(dv, dy)?);
        let mut backward = |dy: &[f64], dv: &mut [f64]| Ok(cost.borrow_mut().jacobian_transpose(dy, dv)?);
        dot_product_row(case, (what, OF_WINDOW), [n, m], &mut forward, &mut backward)?;
    }
    Ok(())
}

/// Size of the two controls.
const AT: [(&str, f64); 2] =
    [("assembled: dot product, first control", 0.3), ("assembled: dot product, second control", 0.5)];

/// The same of a cost whose products are in its increments.
fn increments(case: &mut Case, origin: &[f64], cost: &mut dyn LeastSquares) -> Outcome {
    let (n, m) = (cost.dim(), cost.observation_dim());
    for (what, size) in AT {
        let v: Vec<f64> = origin.iter().enumerate().map(|(i, o)| o + size * wave(i, 11)).collect();
        cost.linearize(&v, &mut vec![0.0; n])?;
        let cost = std::cell::RefCell::new(&mut *cost);
        let mut forward = |p: &[f64], dy: &mut [f64]| Ok(cost.borrow_mut().jacobian(p, dy)?);
        let mut backward = |dy: &[f64], p: &mut [f64]| Ok(cost.borrow_mut().jacobian_transpose(dy, p)?);
        dot_product_row(case, (what, OF_WINDOW), [n, m], &mut forward, &mut backward)?;
    }
    Ok(())
}

type Map<'a> = dyn FnMut(&[f64], &mut [f64]) -> Outcome + 'a;

/// |⟨A u, w⟩ − ⟨u, Aᵀ w⟩| / (‖A u‖ ‖w‖) against so many ε times the condition
/// ‖A‖ ‖u‖ / ‖A u‖ of the product, ‖A‖ by power iteration.
fn dot_product_row(
    case: &mut Case,
    (what, roundings): (&str, f64),
    [n, m]: [usize; 2],
    a: &mut Map,
    at: &mut Map,
) -> Outcome {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = |a: &[f64]| dot(a, a).sqrt();
    let u: Vec<f64> = (0..n).map(|i| wave(i, 21)).collect();
    let w: Vec<f64> = (0..m).map(|i| wave(i, 22)).collect();
    let (mut au, mut atw) = (vec![0.0; m], vec![0.0; n]);
    let (mut v, mut av, mut size) = (u.clone(), vec![0.0; m], 0.0);
    for _ in 0..12 {
        a(&v, &mut av)?;
        size = norm(&av) / norm(&v);
        at(&av, &mut v)?;
    }
    a(&u, &mut au)?;
    at(&w, &mut atw)?;
    let condition = size * norm(&u) / norm(&au);
    if !(condition < 1e10) || norm(&atw) == 0.0 {
        return Err(format!("{what}: an empty test, condition {condition:e}").into());
    }
    let (forward, backward) = (dot(&au, &w), dot(&u, &atw));
    let value = (forward - backward).abs() / (norm(&au) * norm(&w));
    let bound = roundings * f64::EPSILON * condition.max(1.0);
    case.at_most(what, value, bound, "-")
        .computed(forward)
        .note(format!("condition {condition:.1e}"))
        .because(if roundings > OF_PRODUCT { OF_STEPS } else { ROUNDING });
    Ok(())
}

/// A model that forgets its state has a tangent and an adjoint of zero, which agree; the test must refuse to
/// judge.
fn guard(case: &mut Case) -> Outcome {
    struct Forgetful;
    impl Model for Forgetful {
        fn dim(&self) -> usize {
            3
        }
        fn step(&mut self, _: usize, _: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
            x_next.fill(1.0);
            Ok(Work::default())
        }
        fn linearize(&mut self, _: usize, _: usize, _: &[f64], _: &[f64]) -> Result<Work, Error> {
            Ok(Work::default())
        }
        fn tangent(&mut self, _: usize, dx: &mut [f64]) {
            dx.fill(0.0);
        }
        fn adjoint(&mut self, _: usize, lambda: &mut [f64]) {
            lambda.fill(0.0);
        }
        fn release(&mut self, _: usize) {}
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
    let refused = matches!(
        check::window(&mut Forgetful, &[1.0, 2.0, 3.0], 2, &[1.0; 3], 1),
        Err(Error::EmptyTest { .. })
    );
    case.count("empty tests refused", usize::from(refused), 1);
    Ok(())
}
