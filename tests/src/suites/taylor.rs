//! Taylor tests: what is called a derivative is one. The remainder of first order must fall like h².

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use problems::costs::for_each_cost;
use problems::methods::for_each_method;
use problems::rods::{rod_scale, rods, wave};
use varda_assimilation::CostFunction;
use varda_implicit::check::{self, Taylor};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{ImplicitModel, Model, OneLeg, Rk4};

const BOUND: f64 = 0.05;
const REASON: &str = "fitted over ten halvings of the step, the term of third order moves a slope by less";

pub(super) fn run(_options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("taylor");
    rows.reason(REASON);
    let outcome = for_each_cost(&mut |name, cost| {
        rows.case(name, |case| gradient(case, &vec![0.0; cost.dim()], cost));
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("assembled costs", |_| Err(error));
    }
    let outcome = for_each_method(&mut |name, origin, mut cost| {
        rows.case(name, |case| gradient(case, origin, cost.cost()));
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("methods", |_| Err(error));
    }
    match rods() {
        Ok(rods) => {
            for mut rod in rods {
                rows.case(rod.name, |case| {
                    let scale = rod_scale(rod.model.step_ref());
                    let mut x = vec![0.0; rod.model.dim()];
                    rod.model.initial_state(&rod.control, &mut x)?;
                    step(case, &mut rod.model, &x, &scale)
                });
            }
        }
        Err(error) => rows.case("rods", |_| Err(error)),
    }
    let x63 = [1.2, -0.7, 10.3];
    let x96: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * wave(i, 0)).collect();
    let mut ordinary = |name: &str, model: &mut dyn Model, x: &[f64]| {
        rows.case(name, |case| step(case, model, x, &vec![1.0; x.len()]));
    };
    ordinary("lorenz63 rk4", &mut Rk4::new(Lorenz63::default(), 0, 0.01), &x63);
    ordinary("lorenz96 rk4", &mut Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125), &x96);
    let euler = OneLeg::implicit_euler(Lorenz63::default(), 1e-13);
    ordinary("lorenz63 implicit euler", &mut ImplicitModel::new(euler, 0, 0.01), &x63);
    let midpoint = OneLeg::implicit_midpoint(Lorenz96::new(40, 8.0), 1e-13);
    ordinary("lorenz96 implicit midpoint", &mut ImplicitModel::new(midpoint, 0, 0.0125), &x96);
    rows.finish()
}

fn slope_row(case: &mut Case, what: &str, taylor: &Taylor) {
    let steps = taylor.points.iter().map(|p| p.0);
    let (largest, smallest) = steps.fold((0.0_f64, f64::INFINITY), |(a, b), h| (a.max(h), b.min(h)));
    let note = format!("slope {:.4} over h = {smallest:.0e} … {largest:.0e}", taylor.slope);
    case.at_most(what, (taylor.slope - 2.0).abs(), BOUND, "-").computed(taylor.slope).note(note);
}

fn step(case: &mut Case, model: &mut dyn Model, x: &[f64], scale: &[f64]) -> Outcome {
    let direction: Vec<f64> = scale.iter().enumerate().map(|(i, s)| s * wave(i, 31)).collect();
    let taylor = check::taylor_step(model, 2, x, &direction, scale)?;
    slope_row(case, "step", &taylor);
    Ok(())
}

/// The gradient of the assembled cost at two successive controls: state kept from the first must not leak
/// into the second.
fn gradient(case: &mut Case, origin: &[f64], cost: &mut dyn CostFunction) -> Outcome {
    let n = cost.dim();
    for (what, size) in [("gradient at the first control", 0.1), ("gradient at the second control", 0.5)] {
        let v: Vec<f64> = origin.iter().enumerate().map(|(i, o)| o + size * wave(i, 41)).collect();
        let direction: Vec<f64> = (0..n).map(|i| wave(i, 42)).collect();
        let mut g = vec![0.0; n];
        cost.evaluate(&v, Some(&mut g))?;
        let mut function = |v: &[f64]| {
            let refused =
                |e| varda_implicit::Error::Refused { step: 0, reason: varda_implicit::Refusal::new(e) };
            cost.evaluate(v, None).map_err(refused)
        };
        slope_row(case, what, &check::taylor(&mut function, &g, &v, &direction)?);
    }
    Ok(())
}
