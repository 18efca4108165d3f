//! Weak constraint: over forcing, over states, by a direct solve, and in the limit of no model error.

use super::common::{gap, tight};
use super::linear::{TIGHT, dense, kalman, step_matrix};
use crate::row::{Case, Outcome, Rows};
use nalgebra::DMatrix;
use problems::small_problems::{self, LINEAR_STEPS, coupled, difference};
use varda_assimilation::{
    ControlTransform, CostFunction, Forcing, InnerSolver, LeastSquares, Status, StrongConstraint,
    WeakForcing, WeakPosterior, WeakState, propagate_errors,
};
use varda_covariance::Diagonal;

pub(super) fn rows(rows: &mut Rows) {
    rows.case("linear window, model error", smoother);
    rows.case("lorenz96, 6 variables, error in every step", |case| forms(case, Forcing::every_step(6)));
    rows.case("lorenz96, 6 variables, half of them, every third step", |case| {
        forms(case, Forcing { components: vec![0, 2, 4], steps: 3, held: false })
    });
    rows.case("lorenz96, 6 variables, curved H", vanishing);
}

const SOLVERS: [(&str, InnerSolver); 3] =
    [("primal", InnerSolver::Primal), ("dual", InnerSolver::Dual), ("direct", InnerSolver::Direct)];

/// Every state of the window against the Rauch–Tung–Striebel smoother with Q.
fn smoother(case: &mut Case) -> Outcome {
    let (mut model, background, mut set) = small_problems::linear()?;
    let (b, q) = (coupled(4, 0.8)?, coupled(4, 0.3)?);
    let step = step_matrix(&mut model)?;
    let (_, smoothed) = kalman(&step, &dense(&b), &dense(&q), &background, &set)?;
    let worst = |state: &dyn Fn(usize) -> Vec<f64>| {
        let gaps = (0..=LINEAR_STEPS).map(|k| difference(&state(k), smoothed[k].0.as_slice()));
        gaps.fold(0.0, |worst: f64, gap| if gap <= worst { worst } else { gap })
    };
    case.reason(TIGHT);
    for (name, inner) in SOLVERS {
        let transform = ControlTransform::new(background.clone(), &b)?;
        let mut forcing =
            WeakForcing::new(&mut model, transform.clone(), &q, Forcing::every_step(4), &mut set)?;
        let mut v = vec![0.0; forcing.dim()];
        tight(&mut forcing, &mut v, inner)?;
        let gap = worst(&|k| forcing.state(k).to_vec());
        case.at_most(&format!("weak-forcing, {name} = rts smoother"), gap, 1e-9, "-");
        if inner == InnerSolver::Primal {
            forcing.linearize(&v, &mut vec![0.0; v.len()])?;
            let columns = WeakPosterior::new(&mut forcing)?.with_errors(&transform, &q, 1000);
            let states: Vec<f64> = (0..=LINEAR_STEPS).flat_map(|k| forcing.state(k).to_vec()).collect();
            drop(forcing);
            let (mut worst, every) = (0.0, Forcing::every_step(4));
            propagate_errors(&mut model, &columns, (&every, &q), &states, &mut |at| {
                let w = DMatrix::from_column_slice(4, at.now.len() / 4, at.now);
                let gap = difference((&w * w.transpose()).as_slice(), smoothed[at.step].1.as_slice());
                worst = if gap <= worst { worst } else { gap };
                Ok(())
            })?;
            case.at_most("weak-forcing: every covariance = rts smoother's", worst, 1e-9, "-");
        }
        let every = Forcing::every_step(4);
        let mut states = WeakState::new(&mut model, background.clone(), &b, &q, every, &mut set)?;
        let mut v = states.background()?;
        tight(&mut states, &mut v, inner)?;
        let gap = worst(&|k| states.state(k).to_vec());
        case.at_most(&format!("weak-state, {name} = rts smoother"), gap, 1e-9, "-");
    }
    Ok(())
}

fn forms(case: &mut Case, forcing: Forcing) -> Outcome {
    let (mut model, background, mut set) = small_problems::curved()?;
    let (b, q) = (coupled(6, 0.5)?, coupled(forcing.components.len(), 0.2)?);
    let transform = ControlTransform::new(background.clone(), &b)?;
    let mut cost = WeakForcing::new(&mut model, transform, &q, forcing.clone(), &mut set)?;
    let mut v = vec![0.0; cost.dim()];
    let one = tight(&mut cost, &mut v, InnerSolver::Primal)?;
    case.count("weak-forcing: converged", usize::from(one.status == Status::Converged), 1);
    let reference: Vec<f64> = (0..=12).flat_map(|k| cost.state(k).to_vec()).collect();
    drop(cost);
    case.reason(
        "gradients of 1e-11 of the first in two variables that Q of 0.2² and a curved model lie \
        between: a thousand times",
    );
    for (name, inner) in [("primal", InnerSolver::Primal), ("dual", InnerSolver::Dual)] {
        let mut cost = WeakState::new(&mut model, background.clone(), &b, &q, forcing.clone(), &mut set)?;
        let mut x = cost.background()?;
        let two = tight(&mut cost, &mut x, inner)?;
        let what = format!("weak-state, {name} = weak-forcing");
        case.count(
            &format!("weak-state, {name}: converged"),
            usize::from(two.status == Status::Converged),
            1,
        );
        case.at_most(&format!("{what}: J"), gap(two.value, one.value), 1e-8, "-").computed(two.value);
        let states: Vec<f64> = (0..=12).flat_map(|k| cost.state(k).to_vec()).collect();
        case.at_most(&format!("{what}: states"), difference(&states, &reference), 1e-8, "-");
        let apart = (two.terms.model_error - one.terms.model_error).abs() / one.value;
        case.at_most(&format!("{what}: J_q"), apart, 1e-8, "-").computed(two.terms.model_error);
    }
    Ok(())
}

/// ‖v(weak) − v(strong)‖ falls like Q, that is like σ_q².
fn vanishing(case: &mut Case) -> Outcome {
    let (mut model, background, mut set) = small_problems::curved()?;
    let b = coupled(6, 0.5)?;
    let transform = ControlTransform::new(background, &b)?;
    let mut strong = vec![0.0; 6];
    tight(
        &mut StrongConstraint::new(&mut model, transform.clone(), &mut set)?,
        &mut strong,
        InnerSolver::Primal,
    )?;
    let mut points = Vec::new();
    for sigma in [1e-2, 3e-3, 1e-3, 3e-4, 1e-4] {
        let q = Diagonal::uniform(6, sigma)?;
        let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, Forcing::every_step(6), &mut set)?;
        let mut weak = vec![0.0; cost.dim()];
        weak[..6].copy_from_slice(&strong);
        tight(&mut cost, &mut weak, InnerSolver::Primal)?;
        points.push((sigma.ln(), difference(&weak[..6], &strong).ln()));
    }
    let n = points.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let rate = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>()
        / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>();
    let largest = points[0].1.exp();
    case.at_most("weak → strong as Q → 0: |rate − 2|", (rate - 2.0).abs(), 0.1, "-")
        .computed(rate)
        .because(
            "the next term of the expansion in σ_q² moves the slope over two decades by a few per \
            cent",
        )
        .note(format!("|Δv| = {largest:.1e} at σ_q = 1e-2"));
    Ok(())
}
