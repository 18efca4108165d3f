//! Values of the reference problems "Lorenz-96 values", "Driven rod" and "Hanging rod"
//! (docs/reference-problems.md).

use super::fixture::largest_difference;
use crate::row::{Case, Outcome, Rows};
use problems::rods::{DrivenRod, HangingRod};
use problems::small_problems::lorenz96_window;
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, StrongConstraint};
use varda_covariance::Diagonal;
use varda_implicit::{Model, Rk4, lorenz::Lorenz96};

pub(super) fn run(rows: &mut Rows) {
    rows.case("flagship-truth", flagship_truth);
    rows.case("reference_values-tip", tip);
    let small = [388.6557570224758, 2499.876979576174];
    rows.case("reference_values-lorenz96-40", |case| lorenz96(case, 40, small, Some(-248.04375322925)));
    let large = [6131.583457861555, 11107.61576870228];
    rows.case("reference_values-lorenz96-1000", |case| lorenz96(case, 1000, large, None));
}

/// Hanging at rest, then 150 steps: the truth that the windows' fixtures start from.
fn flagship_truth(case: &mut Case) -> Outcome {
    #[derive(serde::Deserialize)]
    struct Given {
        truth_x: Vec<f64>,
        truth_v: Vec<f64>,
        prior: Prior,
    }
    #[derive(serde::Deserialize)]
    struct Prior {
        vbar: f64,
        sigma_v: f64,
    }
    impl super::fixture::Fixture for Given {
        fn validate(&self) -> Result<(), String> {
            super::fixture::expect_length("truth_x", self.truth_x.len(), 72)?;
            super::fixture::expect_length("truth_v", self.truth_v.len(), 72)
        }
    }
    let path = super::shipped().join("hanging-rod/case1-clamp-seed0/problem.json");
    let given = <Given as super::fixture::Fixture>::read(&path)?;
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let (x, v) = truth.split_at(truth.len() / 2);
    case.reason("150 steps solved to 1e-11 m and 1e-9 m/s each, in a damped motion: ten times that");
    case.at_most("positions", largest_difference(x, &given.truth_x), 1e-10, "m")
        .computed(super::fixture::norm(x));
    case.at_most("velocities", largest_difference(v, &given.truth_v), 1e-8, "m/s")
        .computed(super::fixture::norm(v));
    let error = (rod.prior.sigma_v - given.prior.sigma_v).abs();
    case.at_most("sigma_v = 2 mean speed", error, 1e-8, "m/s").computed(rod.prior.sigma_v);
    let scene = Problem::from_scene(&SceneFile::open("hanging-rod", &[])?)?;
    let theirs = scene.truth.ok_or("a twin experiment knows its truth")?;
    case.at_most("truth of the scene", largest_difference(&theirs[..truth.len()], &truth), 1e-8, "m, m/s");
    if (given.prior.sigma_v - 2.0 * given.prior.vbar).abs() > 1e-12 {
        return Err("sigma_v of the fixture is not 2 vbar".into());
    }
    Ok(())
}

/// Where a soft rod of 25 segments is after two seconds.
fn tip(case: &mut Case) -> Outcome {
    let (mut model, mut x) = DrivenRod::SOFT.model(0.02)?;
    let mut next = x.clone();
    for k in 0..100 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    let vertices = model.step_mut().vertices(2.0, &x)?;
    let error = largest_difference(vertices[25].as_slice(), &[0.291641, 0.071304, -0.925106]);
    let note = format!("tip {:.6?} m", vertices[25]);
    case.at_most("tip", error, 2e-6, "m")
        .computed(error)
        .note(note)
        .because("uncertainty stated with the value");
    Ok(())
}

/// J and its gradient at x_b + 0.1 sin i, at B = 0.25 I, R = I.
fn lorenz96(case: &mut Case, n: usize, [cost, gradient_norm]: [f64; 2], first: Option<f64>) -> Outcome {
    let (background, mut set, v) = lorenz96_window(n)?;
    let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
    let b = Diagonal::uniform(n, 0.5)?;
    let mut problem = StrongConstraint::new(&mut model, ControlTransform::new(background, &b)?, &mut set)?;
    let mut g = vec![0.0; n];
    let j = problem.evaluate(&v, Some(&mut g))?;
    // dJ/dx = (dJ/dv)/σ
    g.iter_mut().for_each(|g| *g *= 2.0);
    let size = super::fixture::norm(&g);
    case.reason("100 steps of a chaotic model amplify rounding by about 1e2; five hundred times that");
    case.at_most("j", (j - cost).abs() / cost, 1e-11, "-").computed(j);
    case.at_most("gradient", (size - gradient_norm).abs() / gradient_norm, 1e-11, "-").computed(size);
    if let Some(first) = first {
        case.at_most("gradient_0", (g[0] - first).abs() / first.abs(), 1e-11, "-").computed(g[0]);
    }
    Ok(())
}
