//! The assembled cost of every method beyond strong 4D-Var.

use crate::small_problems::{self, coupled, localized, normals, ring};
use std::error::Error;
use varda_assimilation::{
    ControlTransform, CostFunction, Dual, EnVar, Forcing, InnerCost, LeastSquares, StrongConstraint,
    WeakForcing, WeakState,
};
use varda_covariance::Hybrid;
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Model, Rk4};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// A cost, by what it offers.
pub enum Assembled<'c> {
    /// Products with its Hessian in v.
    Products(&'c mut dyn LeastSquares),
    /// Products in its increments p; v is made of states.
    Increments(&'c mut dyn LeastSquares),
}

impl Assembled<'_> {
    /// What every cost offers.
    pub fn cost(&mut self) -> &mut dyn CostFunction {
        match self {
            Assembled::Products(cost) => *cost,
            Assembled::Increments(cost) => *cost,
        }
    }
}

/// What is done with each cost: its name, a v that perturbations of order one may be added to, and the cost.
pub type Visit<'v> = dyn FnMut(&str, &[f64], Assembled) -> Result<()> + 'v;

/// Makes one cost after the other, all on Lorenz 1996 with six variables, and hands it to `visit`.
///
/// # Errors
/// A problem that cannot be set up, or what `visit` returns.
pub fn for_each_method(visit: &mut Visit) -> Result<()> {
    let (mut model, background, mut set) = small_problems::curved()?;
    let (b, q, q_half) = (coupled(6, 0.5)?, coupled(6, 0.2)?, coupled(3, 0.2)?);
    let transform = ControlTransform::new(background.clone(), &b)?;
    let some = |steps, held| Forcing { components: vec![0, 2, 4], steps, held };

    let mut products = |name: &str, cost: &mut dyn LeastSquares| {
        let origin = vec![0.0; cost.dim()];
        visit(name, &origin, Assembled::Products(cost))
    };
    let every = Forcing::every_step(6);
    let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, every.clone(), &mut set)?;
    products("weak-forcing, every step", &mut cost)?;
    drop(cost);
    for (name, forcing) in [
        ("weak-forcing, half of the state, every third step", some(3, false)),
        ("weak-forcing, half of the state, held over five steps", some(5, true)),
    ] {
        let mut cost = WeakForcing::new(&mut model, transform.clone(), &q_half, forcing, &mut set)?;
        products(name, &mut cost)?;
    }

    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set)?;
    for (name, seed) in [("first", 50), ("second", 51)] {
        cost.linearize(&normals(seed, 6), &mut [0.0; 6])?;
        products(&format!("inner cost, {name} outer iterate"), &mut InnerCost::new(&mut cost))?;
        products(&format!("dual cost, {name} outer iterate"), &mut Dual::new(&mut cost)?)?;
    }
    cost.set_huber(2.0)?;
    cost.evaluate(&[0.0; 6], None)?;
    let seen = cost.observations();
    let rows = cost.predicted().iter().zip(seen.values()).zip(seen.sigma());
    let inside = rows.filter(|((p, y), s)| (*y - *p).abs() <= 2.0 * **s).count();
    if inside == 0 || inside == seen.dim() {
        return Err(format!("{inside} of {} rows inside the threshold: an empty test", seen.dim()).into());
    }
    products("4dvar, huber norm", &mut cost)?;
    drop(cost);

    let hybrid = Hybrid::new(&b, 0.6, localized()?, 0.8)?;
    let mut seen = ring(&normals(6, 12))?;
    let anchors = [0, 2, 5].repeat(4);
    let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96::new(6, 8.0), 0, 0.03)) };
    let mut cost = EnVar::hybrid(&make, background.clone(), &hybrid, &mut seen, &anchors)?;
    for (name, seed) in [("first", 52), ("second", 53)] {
        let about: Vec<f64> = normals(seed, cost.dim()).iter().map(|v| 0.3 * v).collect();
        cost.relinearize(&about)?;
        products(&format!("hybrid-4denvar, {name} outer iterate"), &mut cost)?;
    }

    let mut states = |name: &str, cost: &mut WeakState| {
        let origin = cost.background()?;
        visit(name, &origin, Assembled::Increments(cost))
    };
    let mut cost = WeakState::new(&mut model, background.clone(), &b, &q, every, &mut set)?;
    states("weak-state, every step", &mut cost)?;
    drop(cost);
    let mut cost = WeakState::new(&mut model, background, &b, &q_half, some(3, false), &mut set)?;
    states("weak-state, half of the state, every third step", &mut cost)
}
